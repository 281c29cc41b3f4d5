// The sync follower, the lamps and the odometer: two machines of PIO0 and one of PIO1, drained by DMA into rings.
//
// SYNC decides which falling edges count. It counts time in Y, one every 20 ns, looks at the pin once in between, and
// pushes Y at an edge; then it counts the hold-off without looking. LAMP waits for the pin itself, so that a lamp
// follows its edge by a constant: it starts looking when SYNC says so (flag 5), and fires only when SYNC has accepted
// the edge (flag 4), which is said early enough never to be waited for. A lamp machine without a flash waits for the
// FIFO, and the edge passes it by.

#include "../board.h"
#include "../core/messages.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

#define ACCEPTED 4U  // flags between the two machines
#define LOOK 5U

// Addresses inside the program.
enum { HIGH = 0, ARMED = 2, HOLD = 11, LAMP_LOOKS = 22, LAMP_TAKES = 25, LAMP_WIDTH = 29, PROGRAM_LENGTH = 32 };

static const uint16_t program[PROGRAM_LENGTH] = {
    // SYNC: wraps from 1 to 0
    [HIGH] = JMP_Y_DEC(1),
    JMP_PIN(ARMED),
    [ARMED] = JMP_Y_DEC(3),
    JMP_PIN(ARMED),
    FLAG_SET(ACCEPTED),  // at the latest two cycles after the cycle in which LAMP saw the edge
    MOV_ISR_Y,
    PUSH_NO_BLOCK,
    PULL_NO_BLOCK,  // a new hold-off, or X: the last one
    MOV_X_OSR,
    FLAG_CLEAR(ACCEPTED),  // nobody took it
    FLAG_CLEAR(LOOK) | DELAY(1U),
    [HOLD] = JMP_Y_DEC(12),
    JMP_X_DEC(HOLD),
    MOV_X_OSR,
    FLAG_SET(LOOK),
    JMP(HIGH) | DELAY(1U),
    // LAMP: wraps from 30 to 16. Words: delay, width - 2, lamp bits and tag.
    [LAMP_IDLE] = PULL,
    MOV_X_OSR,
    PULL,
    MOV_Y_OSR,
    [LAMP_LAST_PULL] = PULL,
    WAIT_FLAG(LOOK),
    [LAMP_LOOKS] = WAIT_PIN_HIGH(PIN_SYNC),
    WAIT_PIN_LOW(PIN_SYNC),
    MOV_ISR_OSR | DELAY(1U),
    [LAMP_TAKES] = WAIT_FLAG(ACCEPTED),
    PUSH_NO_BLOCK,  // this flash is taken
    [LAMP_DELAY] = JMP_X_DEC(LAMP_DELAY),
    MOV_PINS_OSR,
    [LAMP_WIDTH] = JMP_Y_DEC(LAMP_WIDTH),
    MOV_PINS_NULL,
    JMP(LAMP_IDLE),  // only the turntable's machine comes here
};

// Cycles SYNC spends per accepted edge without counting: 3..10 with a delay, and 13..15 with a delay.
#define UNCOUNTED_TICKS 12U
// From the tick read before both machines start to SYNC's first count, less its way from pin to stamp.
#define STAMP_OFFSET 26U
// Ticks of an accepted edge's dead time that are not in the loop.
#define HOLDOFF_OVERHEAD 18U
#define LAMP_WIDTH_MIN_TICKS 2U
#define HOLDOFF_AT_RESET_TICKS 100000U

#define EDGES_KEPT 128U  // a stall of 100 ms at the shortest hold-off; then the watchdog bites
#define EDGE_RING_BITS 9U
#define QUADRATURE_KEPT 512U
#define QUADRATURE_RING_BITS 9U

static volatile uint32_t stamps[EDGES_KEPT] __attribute__((aligned(512)));   // SYNC's Y, by DMA
static volatile uint32_t at_edge[EDGES_KEPT] __attribute__((aligned(512)));  // the odometer channel's count, by DMA
_Static_assert(QUADRATURE_KEPT == ODOMETER_RING_BYTES, "as it says to others");
static volatile uint8_t quadrature[QUADRATURE_KEPT] __attribute__((aligned(512)));
static uint8_t tags[EDGES_KEPT];

static struct {
    uint32_t start;     // tick of SYNC's first count
    uint32_t settled;   // edges whose tag is known
    uint32_t reported;  // edges the core has got
    bool loaded;        // the lamp machine holds a flash no edge has taken yet
    uint8_t tag;        // of that
    uint32_t load_tick;
    uint32_t holdoff;  // SYNC has it, or will take it with the next edge
} lamps;

static struct {
    uint32_t decoded;  // transitions so far
    uint8_t state;
    int32_t position;
} odometer;

// ---- odometer ----

static void decode_until(const uint32_t transitions)
{
    static const int8_t steps[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};  // B A before, B A after
    for (; (int32_t)(transitions - odometer.decoded) > 0; odometer.decoded++) {
        const uint8_t after = quadrature[odometer.decoded % QUADRATURE_KEPT] & 3U;
        odometer.position += steps[odometer.state * 4U + after];
        odometer.state = after;
    }
}

static uint32_t transitions_now(void)
{
    return UINT32_MAX - REGISTER(DMA_COUNT(DMA_ODOMETER));
}

// What lies before an edge not yet reported must not be decoded past it.
int32_t board_odometer(void)
{
    if (lamps.reported == lamps.settled) {
        decode_until(transitions_now());
    }
    return odometer.position;
}

// While it is lent, what is read of its channel lies before all that was decoded, so nothing is.
volatile uint32_t* odometer_lend(void)
{
    (void)board_odometer();
    return (volatile uint32_t*)(uintptr_t)quadrature;
}

void odometer_start(void)
{
    static const uint16_t counter[] = {
        MOV_ISR_NULL,  IN_PINS(2U),           MOV_X_ISR, JMP_X_NOT_Y(ODOMETER_PROGRAM + 4U), MOV_Y_X,
        PUSH_NO_BLOCK, JMP(ODOMETER_PROGRAM),
    };
    const uint32_t machine = ODOMETER_MACHINE;
    pin_use(PIN_ODOMETER_A, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    pin_use(PIN_ODOMETER_B, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    pio_load(PIO1, ODOMETER_PROGRAM, counter, sizeof counter / sizeof counter[0]);
    REGISTER(PIO_EXECCTRL(PIO1, machine)) = EXEC_WRAP(ODOMETER_PROGRAM, ODOMETER_PROGRAM + 3U);
    REGISTER(PIO_SHIFTCTRL(PIO1, machine)) = 0U;  // in from the right
    REGISTER(PIO_PINCTRL(PIO1, machine)) = PINS_IN(PIN_ODOMETER_A);
    REGISTER(DMA_READ(DMA_ODOMETER)) = PIO_RX(PIO1, machine);
    REGISTER(DMA_WRITE(DMA_ODOMETER)) = (uint32_t)(uintptr_t)quadrature;
    REGISTER(DMA_COUNT(DMA_ODOMETER)) = UINT32_MAX;
    REGISTER(DMA_CTRL_TRIGGER(DMA_ODOMETER)) =
        DMA_QUIET | DMA_REQUEST(DREQ_PIO_RX(1U, machine)) | DMA_CHAIN(DMA_ODOMETER) | DMA_RING_WRITE |
        DMA_RING(QUADRATURE_RING_BITS) | DMA_INCREMENT_WRITE | DMA_PRIORITY | DMA_ENABLE;
    odometer.decoded = 0;
    odometer.state = (uint8_t)((REGISTER(SIO_GPIO_IN) >> PIN_ODOMETER_A) & 3U);
    REGISTER(PIO_TX(PIO1, machine)) = odometer.state;
    REGISTER(PIO_INSTRUCTION(PIO1, machine)) = PULL_NO_BLOCK;
    REGISTER(PIO_INSTRUCTION(PIO1, machine)) = MOV_Y_OSR;
    REGISTER(PIO_INSTRUCTION(PIO1, machine)) = JMP(ODOMETER_PROGRAM);
    SET_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(machine);
}

// ---- edges ----

static uint32_t stamp_tick(const uint32_t edge)
{
    const uint32_t counted = UINT32_MAX - stamps[edge % EDGES_KEPT];
    return lamps.start + 2U * counted + UNCOUNTED_TICKS * edge;
}

static bool is_taken(void)
{
    return (REGISTER(PIO_FSTAT(PIO0)) & FSTAT_RX_EMPTY(LAMP_MACHINE)) == 0U;
}

// Find out of every edge so far which flash it took. The lamp machine reports within a few cycles of the edge, long
// before its stamp can be read here; and there is never more than one flash to be taken.
static void settle(void)
{
    const uint32_t written = (REGISTER(DMA_WRITE(DMA_AT_EDGE)) - (uint32_t)(uintptr_t)at_edge) / 4U;
    while (lamps.settled % EDGES_KEPT != written % EDGES_KEPT) {
        uint8_t tag = 0;
        const bool after_load = (int32_t)(stamp_tick(lamps.settled) - lamps.load_tick) >= 0;
        if (lamps.loaded && after_load && is_taken()) {
            (void)REGISTER(PIO_RX(PIO0, LAMP_MACHINE));
            tag = lamps.tag;
            lamps.loaded = false;
        }
        tags[lamps.settled % EDGES_KEPT] = tag;
        lamps.settled++;
    }
}

bool board_edge(board_edge_t* const edge)
{
    settle();
    if (lamps.reported == lamps.settled) {
        return false;
    }
    const uint32_t index = lamps.reported % EDGES_KEPT;
    decode_until(UINT32_MAX - at_edge[index]);
    *edge = (board_edge_t){.tick = stamp_tick(lamps.reported), .tag = tags[index], .odometer = odometer.position};
    lamps.reported++;
    return true;
}

uint32_t board_edges_refused(void)
{
    settle();
    return pinuse_sync_edges(lamps.settled) - lamps.settled;
}

// ---- flashes ----

static void lamp_execute(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO0, LAMP_MACHINE)) = instruction;
}

// Send the lamp machine back to where it waits for a flash. If it was looking for an edge, it shall look again: SYNC
// says so only once a hold-off.
static void lamp_to_idle(const uint32_t at)
{
    lamp_execute(JMP(LAMP_IDLE));
    if ((at >= LAMP_LOOKS) && (at <= LAMP_TAKES)) {
        lamp_execute(FLAG_SET(LOOK));
    }
}

// Whatever the lamp machine does or holds: gone, gates low.
void board_lamps_cut(void)
{
    CLEAR_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(LAMP_MACHINE);
    lamp_execute(MOV_PINS_NULL);
    const uint32_t at = REGISTER(PIO_ADDRESS(PIO0, LAMP_MACHINE));
    const uint32_t now = board_tick();
    while (board_tick() - now < 50U) {  // until the stamp of an edge just taken is in the ring
    }
    settle();
    for (uint32_t i = 0; i < 4U; i++) {
        lamp_execute(PULL_NO_BLOCK);
    }
    while (is_taken()) {
        (void)REGISTER(PIO_RX(PIO0, LAMP_MACHINE));
    }
    lamps.loaded = false;
    SET_BITS(PIO_CTRL(PIO0)) = PIO_RESTART(LAMP_MACHINE);
    lamp_to_idle(at);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(LAMP_MACHINE);
}

// Take back a flash no edge has taken. Its words have left the FIFO when no other flash is being timed, and then one
// jump does it; an edge within that moment finds nothing loaded and stays dark.
static void withdraw(void)
{
    settle();
    if (!lamps.loaded) {
        return;
    }
    const uint32_t at = REGISTER(PIO_ADDRESS(PIO0, LAMP_MACHINE));
    if ((at <= LAMP_LAST_PULL) || (at >= LAMP_DELAY)) {
        board_lamps_cut();
        return;
    }
    lamp_to_idle(at);
    while (is_taken()) {
        (void)REGISTER(PIO_RX(PIO0, LAMP_MACHINE));
    }
    lamps.loaded = false;
}

static uint32_t holdoff_count(const uint32_t ticks)
{
    return (ticks > HOLDOFF_OVERHEAD) ? (ticks - HOLDOFF_OVERHEAD) / 2U : 0U;
}

// SYNC takes it with the next edge. Two changes without an edge in between: the first one holds for one edge.
static void set_holdoff(const uint32_t ticks)
{
    const uint32_t level = (REGISTER(PIO_FLEVEL(PIO0)) >> (8U * SYNC_MACHINE)) & 0xFU;
    if ((ticks != lamps.holdoff) && (level == 0U)) {
        REGISTER(PIO_TX(PIO0, SYNC_MACHINE)) = holdoff_count(ticks);
        lamps.holdoff = ticks;
    }
}

bool board_flash_load(const board_flash_t* const flash)
{
    withdraw();
    const bool lit = flash->lamp != LAMP_DARK;
    const bool outlasts = (uint64_t)flash->delay_ticks + flash->width_ticks > flash->holdoff_ticks;
    const bool short_or_long =
        (flash->width_ticks < LAMP_WIDTH_MIN_TICKS) || (flash->width_ticks > LAMP_WIDTH_MAX_TICKS);
    if (lit && (short_or_long || outlasts)) {
        return false;
    }
    set_holdoff(flash->holdoff_ticks);
    const uint32_t gates = (flash->lamp == LAMP_LED) ? 1U << (PIN_LED - PIN_PROJECTOR) : (lit ? 1U : 0U);
    lamps.tag = flash->tag;
    lamps.load_tick = board_tick();
    lamps.loaded = true;
    REGISTER(PIO_TX(PIO0, LAMP_MACHINE)) = lit ? flash->delay_ticks : 0U;
    REGISTER(PIO_TX(PIO0, LAMP_MACHINE)) = lit ? flash->width_ticks - LAMP_WIDTH_MIN_TICKS : 0U;
    REGISTER(PIO_TX(PIO0, LAMP_MACHINE)) = gates;  // the machine is loaded with this word, not before
    return true;
}

static void start_rings(void)
{
    REGISTER(DMA_READ(DMA_AT_EDGE)) = DMA_COUNT(DMA_ODOMETER);
    REGISTER(DMA_WRITE(DMA_AT_EDGE)) = (uint32_t)(uintptr_t)at_edge;
    REGISTER(DMA_COUNT(DMA_AT_EDGE)) = 1U;
    REGISTER(DMA_CTRL(DMA_AT_EDGE)) = DMA_QUIET | DMA_REQUEST(DREQ_ALWAYS) | DMA_CHAIN(DMA_STAMP) | DMA_RING_WRITE |
                                      DMA_RING(EDGE_RING_BITS) | DMA_INCREMENT_WRITE | DMA_WORDS | DMA_PRIORITY |
                                      DMA_ENABLE;
    REGISTER(DMA_READ(DMA_STAMP)) = PIO_RX(PIO0, SYNC_MACHINE);
    REGISTER(DMA_WRITE(DMA_STAMP)) = (uint32_t)(uintptr_t)stamps;
    REGISTER(DMA_COUNT(DMA_STAMP)) = 1U;
    REGISTER(DMA_CTRL_TRIGGER(DMA_STAMP)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_RX(0U, SYNC_MACHINE)) |
                                            DMA_CHAIN(DMA_AT_EDGE) | DMA_RING_WRITE | DMA_RING(EDGE_RING_BITS) |
                                            DMA_INCREMENT_WRITE | DMA_WORDS | DMA_PRIORITY | DMA_ENABLE;
}

// A function of its own, so that what else changes around it leaves STAMP_OFFSET as it was measured.
__attribute__((noinline)) static void start_machines(void)
{
    interrupts_off();  // one between tick and start would put every stamp wrong
    lamps.start = board_tick();
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(SYNC_MACHINE) | PIO_MACHINE(LAMP_MACHINE);
    interrupts_on();
    lamps.start += STAMP_OFFSET;
}

void lamps_start(void)
{
    odometer_start();
    pio_load(PIO0, 0U, program, PROGRAM_LENGTH);
    REGISTER(PIO_EXECCTRL(PIO0, SYNC_MACHINE)) = EXEC_JUMP_PIN(PIN_SYNC) | EXEC_WRAP(HIGH, HIGH + 1U);
    REGISTER(PIO_EXECCTRL(PIO0, LAMP_MACHINE)) = EXEC_WRAP(LAMP_IDLE, PROGRAM_LENGTH - 2U);
    REGISTER(PIO_PINCTRL(PIO0, LAMP_MACHINE)) = PINS_OUT(PIN_PROJECTOR, 2U) | PINS_SET(PIN_PROJECTOR, 2U);
    lamp_execute(MOV_PINS_NULL);
    lamp_execute(SET_DIRECTIONS(3U));
    pin_use(PIN_PROJECTOR, FUNCTION_PIO0, PAD_DRIVE_4MA | PAD_PULL_DOWN);
    pin_use(PIN_LED, FUNCTION_PIO0, PAD_DRIVE_4MA | PAD_PULL_DOWN);
    lamp_execute(JMP(LAMP_IDLE));

    lamps.holdoff = HOLDOFF_AT_RESET_TICKS;
    REGISTER(PIO_TX(PIO0, SYNC_MACHINE)) = holdoff_count(lamps.holdoff);
    REGISTER(PIO_INSTRUCTION(PIO0, SYNC_MACHINE)) = PULL_NO_BLOCK;
    REGISTER(PIO_INSTRUCTION(PIO0, SYNC_MACHINE)) = MOV_X_OSR;
    REGISTER(PIO_INSTRUCTION(PIO0, SYNC_MACHINE)) = MOV_Y_NOT_NULL;
    REGISTER(PIO_INSTRUCTION(PIO0, SYNC_MACHINE)) = FLAG_SET(LOOK);
    REGISTER(PIO_INSTRUCTION(PIO0, SYNC_MACHINE)) = JMP(HIGH);
    start_rings();
    start_machines();
}
