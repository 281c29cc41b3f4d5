// The sync follower and the lamps: two machines of PIO0, drained by DMA into rings.
//
// SYNC decides which falling edges count. It counts time in Y, one every 20 ns, looks at the pin once in between, and
// pushes Y at an edge; then it counts the hold-off without looking. LAMP waits for the pin itself, so that a lamp
// follows its edge by a constant: it starts looking when SYNC says so (flag 5), and fires only when SYNC has accepted
// the edge (flag 4), which is said early enough never to be waited for. A lamp machine without a flash waits for the
// FIFO, and the edge passes it by.

#include "../board.h"
#include "../core/messages.h"
#include "../duty.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

#define ACCEPTED 4U  // flags between the two machines
#define LOOK 5U

// Addresses inside the program.
enum {
    HIGH = 0,
    ARMED = 2,
    STOPS_LOOKING = 4,
    HOLD = 11,
    LOOKS_AGAIN = 14,
    LAMP_WAITS = 22,
    TAKEN = 26,
    LAMP_WIDTH = 29,
    PROGRAM_LENGTH = 32
};

static const uint16_t program[PROGRAM_LENGTH] = {
    // SYNC: wraps from 1 to 0
    [HIGH] = JMP_Y_DEC(1),
    JMP_PIN(ARMED),
    [ARMED] = JMP_Y_DEC(3),
    JMP_PIN(ARMED),
    [STOPS_LOOKING] = FLAG_SET(ACCEPTED),  // at the latest two cycles after the cycle in which LAMP saw the edge
    MOV_ISR_Y,
    PUSH_NO_BLOCK,
    PULL_NO_BLOCK,  // a new hold-off, or X: the last one
    MOV_X_OSR,
    FLAG_CLEAR(ACCEPTED),  // nobody took it
    FLAG_CLEAR(LOOK) | DELAY(1U),
    [HOLD] = JMP_Y_DEC(12),
    JMP_X_DEC(HOLD),
    MOV_X_OSR,
    [LOOKS_AGAIN] = FLAG_SET(LOOK),
    JMP(HIGH) | DELAY(1U),
    // LAMP: wraps from 30 to 16. Words: delay, width - 2, lamp bits and tag.
    [LAMP_IDLE] = PULL,
    MOV_X_OSR,
    PULL,
    MOV_Y_OSR,
    [LAMP_LAST_PULL] = PULL,
    WAIT_FLAG(LOOK),
    [LAMP_WAITS] = WAIT_PIN_HIGH(PIN_SYNC),
    WAIT_PIN_LOW(PIN_SYNC),
    MOV_ISR_OSR | DELAY(1U),
    WAIT_FLAG(ACCEPTED),
    [TAKEN] = PUSH_NO_BLOCK,  // this flash is taken
    [LAMP_DELAY] = JMP_X_DEC(LAMP_DELAY),
    MOV_PINS_OSR,
    [LAMP_WIDTH] = JMP_Y_DEC(LAMP_WIDTH),
    MOV_PINS_NULL,
    JMP(LAMP_IDLE),  // only the turntable's machine comes here
};

// Cycles SYNC spends per accepted edge without counting: 3..10 with a delay, and 13..15 with a delay.
#define UNCOUNTED_TICKS 12U
// From SYNC's first count to the tick that time_of_write gives as it starts, and from pin to stamp: 2 from LDR to STR
// and 1 until it runs, less 2 of the pin's synchroniser and 2 from the look that finds the edge to the next count.
#define STAMP_BEFORE 1U
// Ticks from an accepted edge to the next that can be, beside two for each count: 8 from the look that found it to the
// loop, 2 for the pass with which the loop ends, 4 to the first look, 4 more to the one that finds an edge behind it.
#define HOLDOFF_OVERHEAD 18U
#define LAMP_WIDTH_MIN_TICKS 2U
#define HOLDOFF_AT_RESET_TICKS 100000U

// What the lamp machine writes at once: from the second slide's lamp on, past pin 31, to the LED's. Pins between them
// are no PIO0's, so that what it writes there goes nowhere; GP8 and GP16, which are, lie outside. So every flash says
// of all lamps whether they are lit, and no two of them ever are.
#define LAMP_PINS_FIRST PIN_SLIDE_2
#define LAMP_PINS (32U - LAMP_PINS_FIRST + PIN_LED + 1U)
#define LAMP_BIT(pin) (1UL << (((pin)-LAMP_PINS_FIRST) & 31U))
_Static_assert((PIN_CAMERA_TRIGGER < PIN_SLIDE_2) && (PIN_STEP > PIN_LED), "outputs of PIO0's other machines");
_Static_assert((PIN_SLIDE_4 == PIN_SLIDE_2 + 2) && (SLIDES_MAX == 4U), "slides side by side");

#define EDGES_KEPT 128U  // a stall of 100 ms at the shortest hold-off; then the watchdog bites
#define EDGE_RING_BITS 9U

static volatile uint32_t stamps[EDGES_KEPT] __attribute__((aligned(512)));  // SYNC's Y, by DMA; then its tick
static volatile uint32_t at_edge[EDGES_KEPT]
    __attribute__((aligned(512)));  // odometer: its count, by DMA; then its place
static uint8_t tags[EDGES_KEPT];

static struct {
    uint32_t start;     // tick of SYNC's first count
    uint32_t settled;   // edges whose tag is known
    uint32_t reported;  // edges the core has got
    bool loaded;        // the lamp machine holds a flash no edge has taken yet
    uint8_t tag;        // of that
    uint8_t lamp;
    uint32_t delay;
    uint32_t width;
    uint32_t holdoff;       // SYNC has it, or will take it with the next edge
    uint32_t refuse_until;  // no edge is accepted before; meaningful while a lamp owes
    duty_t duty[2];         // of the projector and the LED
    bool triggered;         // edges are the ends of a camera's triggers, and none is refused
    uint32_t refused;       // edges of the sync input, when that last changed
} lamps;

// ---- edges ----

// Slides share one duty: what one of them may be lit, they may be together.
static duty_t* duty_of(const uint8_t lamp)
{
    return &lamps.duty[(lamp == LAMP_LED) ? 1 : 0];
}

static uint32_t stamp_tick(const uint32_t edge)
{
    const uint32_t counted = UINT32_MAX - stamps[edge % EDGES_KEPT];
    return lamps.start + 2U * counted + UNCOUNTED_TICKS * edge;
}

static bool is_taken(void)
{
    return (REGISTER(PIO_FSTAT(PIO0)) & FSTAT_RX_EMPTY(LAMP_MACHINE)) == 0U;
}

// Find out of every edge so far which flash it took, and where the odometer stood. The lamp machine reports within a
// few cycles of the edge, long before its stamp can be read here. Invariant: when a flash is loaded, every earlier edge
// is settled. So the first edge after it is the one that took it, however long both have been waiting.
static void settle(void)
{
    const uint32_t written = (REGISTER(DMA_WRITE(DMA_AT_EDGE)) - (uint32_t)(uintptr_t)at_edge) / 4U;
    while (lamps.settled % EDGES_KEPT != written % EDGES_KEPT) {
        const uint32_t index = lamps.settled % EDGES_KEPT;
        const uint32_t tick = stamp_tick(lamps.settled);
        uint8_t tag = 0;
        if (lamps.loaded && is_taken()) {
            (void)REGISTER(PIO_RX(PIO0, LAMP_MACHINE));
            tag = lamps.tag;
            lamps.loaded = false;
            if (lamps.lamp != LAMP_DARK) {
                duty_charge(duty_of(lamps.lamp), tick + lamps.delay, lamps.width, LAMP_DUTY_MAX_PERMILLE);
            }
        }
        lamps.refuse_until = tick + lamps.holdoff;
        tags[index] = tag;
        stamps[index] = tick;  // from here on: what SYNC counts from may change before it is reported
        at_edge[index] = (uint32_t)odometer_decode(odometer_transitions(at_edge[index]));
        lamps.settled++;
    }
}

// Whatever edge was accepted until now is settled: its stamp is in the ring after 50 ticks at the latest.
static void settle_all(void)
{
    const uint32_t now = board_tick();
    while (board_tick() - now < 50U) {
    }
    settle();
}

// The odometer is read before the edges: one that is not yet among them then came later, and nothing beyond its place
// was decoded.
void board_lamps_run(void)
{
    const uint32_t transitions = odometer_now();
    settle();
    odometer_decode(transitions);
    const uint32_t now = board_tick();
    duty_run(duty_of(LAMP_PROJECTOR), now);
    duty_run(duty_of(LAMP_LED), now);
}

bool board_edge(board_edge_t* const edge)
{
    if (lamps.reported == lamps.settled) {
        return false;
    }
    const uint32_t index = lamps.reported % EDGES_KEPT;
    *edge = (board_edge_t){.tick = stamps[index], .tag = tags[index], .odometer = (int32_t)at_edge[index]};
    lamps.reported++;
    return true;
}

uint32_t board_edges_refused(void)
{
    settle();
    return lamps.triggered ? lamps.refused : pinuse_sync_edges(lamps.settled) - lamps.settled;
}

int32_t board_odometer(void)
{
    return odometer_state()->position;
}

void board_health(board_health_t* const health)
{
    *health = (board_health_t){
        .odometer_lost = odometer_state()->lost,
        .odometer_impossible = odometer_state()->impossible,
        .edges_dropped = 0,  // the ring holds 128, the watchdog lets 100 come: no round waits for the flash any more
        .usb_hangs = usb_hangs()};
}

// ---- flashes ----

static void lamp_execute(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO0, LAMP_MACHINE)) = instruction;
}

// Is SYNC looking for an edge? Else one was accepted less than a hold-off ago.
static bool sync_looks(void)
{
    const uint32_t at = REGISTER(PIO_ADDRESS(PIO0, SYNC_MACHINE));
    return (at < STOPS_LOOKING) || (at >= LOOKS_AGAIN);
}

// Words of a flash that the lamp machine has not yet fetched: it is timing another.
static bool is_behind(void)
{
    return ((REGISTER(PIO_FLEVEL(PIO0)) >> (8U * LAMP_MACHINE)) & 0xFU) != 0U;
}

// Send the lamp machine, which holds nothing any more, back to where it waits for a flash. It may have been looking, or
// about to: SYNC says so only once a hold-off. So the flag is put as SYNC itself would have it now, and again if that
// changed meanwhile; it changes twice a hold-off at most.
static void lamp_to_idle(void)
{
    lamp_execute(JMP(LAMP_IDLE));
    bool looks;
    do {
        looks = sync_looks();
        lamp_execute(looks ? FLAG_SET(LOOK) : FLAG_CLEAR(LOOK));
    } while (sync_looks() != looks);
}

// Whatever the lamp machine does or holds: gone, gates low. An edge it took before is settled as taken; one accepted
// since finds nothing.
void board_lamps_cut(void)
{
    CLEAR_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(LAMP_MACHINE);
    lamp_execute(MOV_PINS_NULL);
    settle_all();
    for (uint32_t i = 0; i < 4U; i++) {
        lamp_execute(PULL_NO_BLOCK);
    }
    while (is_taken()) {
        (void)REGISTER(PIO_RX(PIO0, LAMP_MACHINE));
    }
    lamps.loaded = false;
    SET_BITS(PIO_CTRL(PIO0)) = PIO_RESTART(LAMP_MACHINE);
    lamp_to_idle();
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(LAMP_MACHINE);
}

// Take back a flash no edge has taken. One instruction of the lamp machine decides whether it is: while that one sends
// it back instead, no edge can take it, and what it had reported before is the whole truth. An edge within that moment
// finds nothing and stays dark.
static void withdraw(void)
{
    if (!lamps.loaded) {
        return;
    }
    REGISTER(PIO_MEMORY(PIO0, TAKEN)) = JMP(LAMP_IDLE);
    if (is_taken()) {
        settle_all();
    } else if (is_behind()) {
        board_lamps_cut();
    } else {
        lamp_to_idle();
    }
    lamps.loaded = false;
    REGISTER(PIO_MEMORY(PIO0, TAKEN)) = program[TAKEN];
}

static uint32_t holdoff_count(const uint32_t ticks)
{
    return (ticks > HOLDOFF_OVERHEAD) ? (ticks - HOLDOFF_OVERHEAD) / 2U : 0U;
}

static void sync_execute(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO0, SYNC_MACHINE)) = instruction;
}

// From now on SYNC looks for an edge, and counts its time from here.
static void sync_from_here(void)
{
    sync_execute(MOV_Y_NOT_NULL);
    sync_execute(FLAG_SET(LOOK));
    sync_execute(JMP(HIGH));
    const uint32_t machines = PIO_MACHINE(SYNC_MACHINE) | PIO_MACHINE(LAMP_MACHINE);
    const uint32_t began = time_of_write(SET_ADDRESS(PIO_CTRL(PIO0)), machines) - STAMP_BEFORE;
    lamps.start = began - UNCOUNTED_TICKS * lamps.settled;
}

static uint32_t at_edge_control(const uint32_t then)
{
    return DMA_QUIET | DMA_REQUEST(DREQ_ALWAYS) | DMA_CHAIN(then) | DMA_RING_WRITE | DMA_RING(EDGE_RING_BITS) |
           DMA_INCREMENT_WRITE | DMA_WORDS | DMA_PRIORITY | DMA_ENABLE;
}

// Both machines must agree: the lamp machine holds nothing meanwhile, and a pin that stands high is no edge to either.
// A hold-off under way was of what was before, and ends: else a faster clock's first edges would be lost in it.
// What stamps set off has run to its end, too, when the last edge is settled, and is changed before another can come.
void lamps_follow(const uint32_t pin, const uint32_t holdoff_ticks, const uint32_t then)
{
    pinuse_count_sync(false, 0U);  // before what was accepted is settled: else one of these could count as refused, too
    CLEAR_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(SYNC_MACHINE);
    board_lamps_cut();
    CLEAR_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(LAMP_MACHINE);
    lamps.refused = board_edges_refused();
    lamps.refuse_until = board_tick();
    sync_execute(FLAG_CLEAR(ACCEPTED));
    sync_execute(MOV_X_OSR);
    sync_execute(PULL_NO_BLOCK);  // the hold-off that waits for an edge, or X: so that the next one has room
    if (holdoff_ticks != 0U) {
        lamps.holdoff = holdoff_ticks;
        REGISTER(PIO_TX(PIO0, SYNC_MACHINE)) = holdoff_count(lamps.holdoff);
        sync_execute(PULL_NO_BLOCK);
    }
    sync_execute(MOV_X_OSR);
    REGISTER(PIO_EXECCTRL(PIO0, SYNC_MACHINE)) = EXEC_JUMP_PIN(pin) | EXEC_WRAP(HIGH, HIGH + 1U);
    REGISTER(PIO_MEMORY(PIO0, LAMP_WAITS)) = WAIT_PIN_HIGH(pin);
    REGISTER(PIO_MEMORY(PIO0, LAMP_WAITS + 1U)) = WAIT_PIN_LOW(pin);
    REGISTER(DMA_CTRL(DMA_AT_EDGE)) = at_edge_control(then);
    lamps.triggered = pin != PIN_SYNC;
    pinuse_count_sync(!lamps.triggered, lamps.settled + lamps.refused);
    sync_from_here();
}

// SYNC takes it with the next edge. A second change before that edge has no room: the first one holds for that edge.
static void set_holdoff(const uint32_t ticks)
{
    const uint32_t level = (REGISTER(PIO_FLEVEL(PIO0)) >> (8U * SYNC_MACHINE)) & 0xFU;
    if ((ticks != lamps.holdoff) && (level == 0U)) {
        REGISTER(PIO_TX(PIO0, SYNC_MACHINE)) = holdoff_count(ticks);
        lamps.holdoff = ticks;
    }
}

// Limits at the pin: no flash outlasts its hold-off, and none takes more than the duty's share of it.
static bool is_allowed(const board_flash_t* const flash)
{
    const uint64_t width = flash->width_ticks;
    return (width >= LAMP_WIDTH_MIN_TICKS) && (width <= LAMP_WIDTH_MAX_TICKS) &&
           (flash->delay_ticks + width <= flash->holdoff_ticks) &&
           (width * 1000U <= (uint64_t)LAMP_DUTY_MAX_PERMILLE * flash->holdoff_ticks);
}

// Whatever configurations and hold-offs follow each other, a lamp that owes dark time stays dark. It owes from the tick
// on at which it came on: so from a flash on, and over any span, it is on for the duty's share and one flash more at
// most, and no two flashes join.
static bool would_owe(const board_flash_t* const flash)
{
    const uint32_t now = board_tick();
    const uint32_t first_edge = tick_is_past(now, lamps.refuse_until) ? now : lamps.refuse_until;
    return !duty_allows(duty_of(flash->lamp), first_edge + flash->delay_ticks);
}

static uint32_t gate_of(const board_flash_t* const flash)
{
    if (flash->lamp == LAMP_LED) {
        return LAMP_BIT(PIN_LED);
    }
    return (flash->slide == 0U) ? LAMP_BIT(PIN_PROJECTOR) : LAMP_BIT(PIN_SLIDE_2) << (flash->slide - 1U);
}

bool board_flash_load(const board_flash_t* const flash)
{
    settle();
    const bool lit = flash->lamp != LAMP_DARK;
    const bool allowed = !lit || is_allowed(flash);  // before: nothing is loaded for as short as can be
    const bool owes = lit && would_owe(flash);
    withdraw();
    if (!allowed) {
        return false;
    }
    set_holdoff(flash->holdoff_ticks);
    if (owes || (lit && (lamps.holdoff < flash->holdoff_ticks))) {
        return true;  // the next edge may come too soon for it, or its hold-off be too short: let that edge pass
    }
    const uint32_t gates = lit ? gate_of(flash) : 0U;
    lamps.tag = flash->tag;
    lamps.lamp = flash->lamp;
    lamps.delay = flash->delay_ticks;
    lamps.width = flash->width_ticks;
    lamps.loaded = true;
    REGISTER(PIO_TX(PIO0, LAMP_MACHINE)) = lit ? flash->delay_ticks : 0U;
    REGISTER(PIO_TX(PIO0, LAMP_MACHINE)) = lit ? flash->width_ticks - LAMP_WIDTH_MIN_TICKS : 0U;
    REGISTER(PIO_TX(PIO0, LAMP_MACHINE)) = gates;  // the machine is loaded with this word, not before
    if (!sync_looks()) {
        settle_all();  // an edge that came while these words were written; for the next one a hold-off has to end
    }
    return true;
}

static void start_rings(void)
{
    REGISTER(DMA_READ(DMA_AT_EDGE)) = DMA_COUNT(DMA_ODOMETER);
    REGISTER(DMA_WRITE(DMA_AT_EDGE)) = (uint32_t)(uintptr_t)at_edge;
    REGISTER(DMA_COUNT(DMA_AT_EDGE)) = 1U;
    REGISTER(DMA_CTRL(DMA_AT_EDGE)) = at_edge_control(DMA_STAMP);
    REGISTER(DMA_READ(DMA_STAMP)) = PIO_RX(PIO0, SYNC_MACHINE);
    REGISTER(DMA_WRITE(DMA_STAMP)) = (uint32_t)(uintptr_t)stamps;
    REGISTER(DMA_COUNT(DMA_STAMP)) = 1U;
    REGISTER(DMA_CTRL_TRIGGER(DMA_STAMP)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_RX(0U, SYNC_MACHINE)) |
                                            DMA_CHAIN(DMA_AT_EDGE) | DMA_RING_WRITE | DMA_RING(EDGE_RING_BITS) |
                                            DMA_INCREMENT_WRITE | DMA_WORDS | DMA_PRIORITY | DMA_ENABLE;
}

void lamps_start(void)
{
    odometer_start();
    const duty_t owed = {.owing = board_cause() != BOOT_CAUSE_POWER_ON,
                         .paid_at = BOARD_FLASH_OWES_MAX - time_before()};
    lamps.duty[0] = owed;
    lamps.duty[1] = owed;
    pio_load(PIO0, 0U, program, PROGRAM_LENGTH);
    REGISTER(PIO_EXECCTRL(PIO0, SYNC_MACHINE)) = EXEC_JUMP_PIN(PIN_SYNC) | EXEC_WRAP(HIGH, HIGH + 1U);
    REGISTER(PIO_EXECCTRL(PIO0, LAMP_MACHINE)) = EXEC_WRAP(LAMP_IDLE, PROGRAM_LENGTH - 2U);
    const uint32_t lamp_pins = PINS_OUT(LAMP_PINS_FIRST, LAMP_PINS);
    REGISTER(PIO_PINCTRL(PIO0, LAMP_MACHINE)) = lamp_pins | PINS_SET(PIN_SLIDE_2, SLIDES_MAX - 1U);
    lamp_execute(MOV_PINS_NULL);
    lamp_execute(SET_DIRECTIONS((1U << (SLIDES_MAX - 1U)) - 1U));
    REGISTER(PIO_PINCTRL(PIO0, LAMP_MACHINE)) = lamp_pins | PINS_SET(PIN_PROJECTOR, 2U);
    lamp_execute(SET_DIRECTIONS(3U));
    lamp_execute(JMP(LAMP_IDLE));

    lamps.holdoff = HOLDOFF_AT_RESET_TICKS;
    REGISTER(PIO_TX(PIO0, SYNC_MACHINE)) = holdoff_count(lamps.holdoff);
    sync_execute(PULL_NO_BLOCK);
    sync_execute(MOV_X_OSR);
    start_rings();
    sync_from_here();
}
