// Plays levels to the controller's inputs and records its outputs, tick by tick. Timing is PIO's and DMA's; the
// processor fills lists before and reads them after.
//
// Everything starts together: each machine waits for one and the same pin, the mark, which the rig raises itself. Its
// rise at the pad is tick 0.
//
// PLAYER takes words from the list: levels, and how long they stand. TRACKS follow one pin each, with a time stamp for
// every change: a loop of two cycles counts in Y and looks once a turn. A pin whose changes must be known to the tick
// has two tracks, one that looks in even ticks and one in odd ticks: the change is where the earlier of them saw it.
// The ways out of the loop take an even number of cycles, so that a track keeps its phase. SAMPLER writes down four
// neighbouring pins in every tick for as long as there is memory. Pins that change seldom are stamped by an interrupt,
// to some microseconds.

#include "rig.h"

#include <string.h>

#include "../board.h"
#include "../rp2040/hardware.h"
#include "../rp2040/registers.h"

#define PAD_DRIVE_2MA 0U  // two outputs wired together by mistake harm neither
#define PIO_FDEBUG(pio) ((pio) + 0x008U)
#define FDEBUG_RX_LOST(machine) (1U << (machine))

#define DMA_PLAYER 0U
#define DMA_TRACK(track) (1U + (track))

enum { PLAYER_MACHINE = 0 };  // of PIO0; tracks are its other three and the four of PIO1
enum { SAMPLER_TRACK = 3 };   // PIO1's first machine does either

// Addresses of the programs.
enum {
    PLAY = 0,
    PLAY_WAITS = 3,
    PLAY_BEGINS = 4,
    PLAY_CUE = 6,
    TRACK = 9,  // in both
    TRACK_EVEN = TRACK,
    TRACK_IS_LOW = TRACK + 1,
    TRACK_LOOKS_LOW = TRACK + 2,
    TRACK_ROSE = TRACK + 3,
    TRACK_IS_HIGH = TRACK + 5,
    TRACK_FELL = TRACK + 7,
    TRACK_ODD = TRACK + 10,
    SAMPLE = 24,
    SAMPLE_WAITS = 25,
    SAMPLE_LOOKS = 26,
};

static const uint16_t player[] = {
    PULL,  // levels and time of the next word
    OUT_PINS(RIG_LIST_PINS),
    OUT_X(18U),
    JMP_X_DEC(PLAY_WAITS),  // wraps to PLAY
    PULL,                   // PLAY_BEGINS
    WAIT_PIN_HIGH(PIN_MARK),
    WAIT_PIN_HIGH(PIN_MARK),  // PLAY_CUE: or for a pin of the controller's to be low ..
    WAIT_PIN_HIGH(PIN_MARK),  // .. and then to rise
    JMP(PLAY + 1U),
};

static const uint16_t track[] = {
    WAIT_PIN_HIGH(PIN_MARK),     // TRACK_EVEN
    JMP_Y_DEC(TRACK_LOOKS_LOW),  // TRACK_IS_LOW
    JMP_PIN(TRACK_ROSE),         // wraps to TRACK_IS_LOW
    MOV_ISR_Y,                   // TRACK_ROSE
    PUSH_NO_BLOCK,
    JMP_Y_DEC(TRACK_IS_HIGH + 1U),  // TRACK_IS_HIGH
    JMP_PIN(TRACK_IS_HIGH),
    MOV_ISR_Y,  // TRACK_FELL
    PUSH_NO_BLOCK | DELAY(1U),
    JMP(TRACK_IS_LOW),
    WAIT_PIN_HIGH(PIN_MARK),  // TRACK_ODD
    JMP(TRACK_IS_LOW),
};
_Static_assert(TRACK_FELL == TRACK_IS_HIGH + 2U, "a track falls out of its loop");

static const uint16_t sampler[] = {
    WAIT_PIN_HIGH(PIN_MARK), JMP_X_DEC(SAMPLE_WAITS),
    IN_PINS(4U),  // wraps to itself
};

static uint32_t list[RIG_LIST_WORDS];
static volatile uint32_t area[RIG_AREA_WORDS];
static volatile uint32_t slow[2U * RIG_SLOW_MAX];  // tick, pin and level

static struct {
    bench_record_t record;
    uint32_t room;  // words of a track
    uint32_t mark;  // tick at which it rose
    uint16_t driven;
    uint16_t levels;
    volatile uint16_t slow_changes;
    bool runs;
} bench = {.record = {.tracks = {RIG_NONE, RIG_NONE, RIG_NONE, RIG_NONE, RIG_NONE, RIG_NONE, RIG_NONE},
                      .sample = RIG_NONE,
                      .cue = RIG_NONE}};

static uint32_t pio_of(const uint32_t number)
{
    return (number < SAMPLER_TRACK) ? PIO0 : PIO1;
}

static uint32_t machine_of(const uint32_t number)
{
    return (number < SAMPLER_TRACK) ? number + 1U : number - SAMPLER_TRACK;
}

static uint32_t request_of(const uint32_t number)
{
    return DREQ_PIO_RX((number < SAMPLER_TRACK) ? 0U : 1U, machine_of(number));
}

static bool samples(const uint32_t number)
{
    return (number == SAMPLER_TRACK) && (bench.record.sample != RIG_NONE);
}

static bool is_used(const uint32_t number)
{
    return samples(number) || (bench.record.tracks[number] != RIG_NONE);
}

static uint32_t tick_now(void)
{
    interrupts_off();
    const uint32_t tick = board_tick();
    interrupts_on();
    return tick;
}

// ---- pins ----

static void force(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO0, PLAYER_MACHINE)) = instruction;
}

// PLAYER stands still: what is forced upon it is done at once.
static void set_pin(const uint32_t pin, const uint32_t level, const uint32_t direction)
{
    REGISTER(PIO_PINCTRL(PIO0, PLAYER_MACHINE)) = PINS_SET(pin, 1U);
    force(SET_PINS(level));
    force(SET_DIRECTIONS(direction));
}

bool bench_levels(const uint16_t drive, const uint16_t levels)
{
    if ((drive & ~RIG_DRIVES) != 0U) {
        return false;
    }
    bench_stop();
    for (uint32_t pin = 0; pin < 16U; pin++) {
        if (((RIG_DRIVES >> pin) & 1U) != 0U) {
            set_pin(pin, ((uint32_t)levels >> pin) & 1U, ((uint32_t)drive >> pin) & 1U);
        }
    }
    bench.driven = drive;
    bench.levels = levels;
    return true;
}

void bench_pins_handler(void)
{
    const uint32_t tick = board_tick() - bench.mark;
    for (uint32_t word = 0; word < 2U; word++) {
        const uint32_t edges = REGISTER(IO_INTR0 + 4U * word);
        REGISTER(IO_INTR0 + 4U * word) = edges;
        for (uint32_t i = 0; i < 8U; i++) {
            const uint32_t pin = 8U * word + i;
            const bool is_slow = (((uint32_t)bench.record.slow >> pin) & 1U) != 0U;
            if (is_slow && ((edges & (EDGE_LOW(i) | EDGE_HIGH(i))) != 0U) && (bench.slow_changes < RIG_SLOW_MAX)) {
                slow[2U * bench.slow_changes] = tick;
                slow[2U * bench.slow_changes + 1U] = (pin << 1) | ((REGISTER(SIO_GPIO_IN) >> pin) & 1U);
                bench.slow_changes = (uint16_t)(bench.slow_changes + 1U);
            }
        }
    }
}

static void watch_slow_pins(const uint32_t pins)
{
    for (uint32_t word = 0; word < 2U; word++) {
        uint32_t edges = 0;
        for (uint32_t i = 0; i < 8U; i++) {
            edges |= (((pins >> (8U * word + i)) & 1U) != 0U) ? (EDGE_LOW(i) | EDGE_HIGH(i)) : 0U;
        }
        REGISTER(IO_PROC0_INTE0 + 4U * word) = edges;
        REGISTER(IO_INTR0 + 4U * word) = 0xFFFFFFFFU;
    }
}

// ---- list and recording ----

bool bench_list(const uint32_t at, const uint8_t* const words, const uint32_t count)
{
    if (bench.runs || (count > RIG_LIST_WORDS) || (at > RIG_LIST_WORDS - count)) {
        return false;
    }
    memcpy(&list[at], words, 4U * count);
    return true;
}

bool bench_record(const bench_record_t* const record)
{
    if (bench.runs || (record->sample_words > RIG_AREA_WORDS) || ((record->slow & ~RIG_LOOKS) != 0U) ||
        ((record->sample != RIG_NONE) && (record->sample > 12U)) ||
        ((record->cue != RIG_NONE) && (record->cue > 15U))) {
        return false;
    }
    for (uint32_t i = 0; i < RIG_TRACKS; i++) {
        if ((record->tracks[i] != RIG_NONE) && ((record->tracks[i] & ~RIG_TRACK_ODD & 0xFFU) >= PIN_MARK)) {
            return false;
        }
    }
    bench.record = *record;
    return true;
}

static void start_dma(const uint32_t number, const uint32_t at, const uint32_t words)
{
    const uint32_t channel = DMA_TRACK(number);
    REGISTER(DMA_READ(channel)) = PIO_RX(pio_of(number), machine_of(number));
    REGISTER(DMA_WRITE(channel)) = (uint32_t)(uintptr_t)&area[at];
    REGISTER(DMA_COUNT(channel)) = words;
    REGISTER(DMA_CTRL_TRIGGER(channel)) = DMA_QUIET | DMA_REQUEST(request_of(number)) | DMA_CHAIN(channel) |
                                          DMA_INCREMENT_WRITE | DMA_WORDS | DMA_PRIORITY | DMA_ENABLE;
}

static void ready_track(const uint32_t number)
{
    const uint32_t pio = pio_of(number);
    const uint32_t machine = machine_of(number);
    const uint32_t which = bench.record.tracks[number];
    REGISTER(PIO_SHIFTCTRL(pio, machine)) = 0U;
    REGISTER(PIO_EXECCTRL(pio, machine)) =
        EXEC_WRAP(TRACK_IS_LOW, TRACK_LOOKS_LOW) | EXEC_JUMP_PIN(which & ~RIG_TRACK_ODD & 0xFFU);
    REGISTER(PIO_INSTRUCTION(pio, machine)) = MOV_Y_NOT_NULL;
    REGISTER(PIO_INSTRUCTION(pio, machine)) = JMP(((which & RIG_TRACK_ODD) != 0U) ? TRACK_ODD : TRACK_EVEN);
    start_dma(number, number * bench.room, bench.room);
}

static void ready_sampler(void)
{
    const uint32_t pio = pio_of(SAMPLER_TRACK);
    const uint32_t machine = machine_of(SAMPLER_TRACK);
    REGISTER(PIO_SHIFTCTRL(pio, machine)) = SHIFT_AUTOPUSH;  // every 32 bits, in from the right
    REGISTER(PIO_EXECCTRL(pio, machine)) = EXEC_WRAP(SAMPLE_LOOKS, SAMPLE_LOOKS);
    REGISTER(PIO_PINCTRL(pio, machine)) = PINS_IN(bench.record.sample);
    REGISTER(PIO_TX(pio, machine)) = bench.record.sample_delay;
    REGISTER(PIO_INSTRUCTION(pio, machine)) = PULL_NO_BLOCK;
    REGISTER(PIO_INSTRUCTION(pio, machine)) = MOV_X_OSR;
    REGISTER(PIO_INSTRUCTION(pio, machine)) = JMP(SAMPLE);
    start_dma(SAMPLER_TRACK, RIG_AREA_WORDS - bench.record.sample_words, bench.record.sample_words);
}

static void ready_player(const uint32_t words)
{
    const bool has_cue = bench.record.cue != RIG_NONE;
    REGISTER(PIO_MEMORY(PIO0, PLAY_CUE)) = has_cue ? WAIT_PIN_LOW(bench.record.cue) : WAIT_PIN_HIGH(PIN_MARK);
    REGISTER(PIO_MEMORY(PIO0, PLAY_CUE + 1U)) = WAIT_PIN_HIGH(has_cue ? bench.record.cue : PIN_MARK);
    REGISTER(PIO_SHIFTCTRL(PIO0, PLAYER_MACHINE)) = SHIFT_OUT_RIGHT;
    REGISTER(PIO_EXECCTRL(PIO0, PLAYER_MACHINE)) = EXEC_WRAP(PLAY, PLAY_WAITS);
    REGISTER(PIO_PINCTRL(PIO0, PLAYER_MACHINE)) = PINS_OUT(RIG_LIST_FIRST_PIN, RIG_LIST_PINS);
    force(JMP(PLAY_BEGINS));
    if (words > 0U) {
        REGISTER(DMA_READ(DMA_PLAYER)) = (uint32_t)(uintptr_t)list;
        REGISTER(DMA_WRITE(DMA_PLAYER)) = PIO_TX(PIO0, PLAYER_MACHINE);
        REGISTER(DMA_COUNT(DMA_PLAYER)) = words;
        REGISTER(DMA_CTRL_TRIGGER(DMA_PLAYER)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_TX(0U, PLAYER_MACHINE)) |
                                                 DMA_CHAIN(DMA_PLAYER) | DMA_INCREMENT_READ | DMA_WORDS | DMA_PRIORITY |
                                                 DMA_ENABLE;
    }
}

// Machines stand still and their FIFOs are empty: what is left in them is of the run before.
static void halt(void)
{
    CLEAR_BITS(PIO_CTRL(PIO0)) = 0xFU;
    CLEAR_BITS(PIO_CTRL(PIO1)) = 0xFU;
    REGISTER(SIO_GPIO_OUT_CLEAR) = 1U << PIN_MARK;
    dma_stop(DMA_PLAYER);
    while ((REGISTER(PIO_FLEVEL(PIO0)) & 0xFU) != 0U) {
        force(PULL);
    }
    for (uint32_t i = 0; i < RIG_TRACKS; i++) {
        dma_stop(DMA_TRACK(i));
        while ((REGISTER(PIO_FSTAT(pio_of(i))) & FSTAT_RX_EMPTY(machine_of(i))) == 0U) {
            (void)REGISTER(PIO_RX(pio_of(i), machine_of(i)));
        }
    }
    SET_BITS(PIO_CTRL(PIO0)) = 0xF0U;
    SET_BITS(PIO_CTRL(PIO1)) = 0xF0U;
}

bool bench_go(const uint32_t words)
{
    if (bench.runs || (words > RIG_LIST_WORDS)) {
        return false;
    }
    halt();
    const uint32_t sampled = (bench.record.sample != RIG_NONE) ? bench.record.sample_words : 0U;
    bench.room = (RIG_AREA_WORDS - sampled) / RIG_TRACKS;
    uint32_t machines[2] = {PIO_MACHINE(PLAYER_MACHINE), 0U};
    for (uint32_t i = 0; i < RIG_TRACKS; i++) {
        if (samples(i)) {
            ready_sampler();
        } else if (is_used(i)) {
            ready_track(i);
        }
        machines[(pio_of(i) == PIO0) ? 0 : 1] |= is_used(i) ? PIO_MACHINE(machine_of(i)) : 0U;
    }
    ready_player(words);
    REGISTER(PIO_FDEBUG(PIO0)) = 0x0F0F0F0FU;
    REGISTER(PIO_FDEBUG(PIO1)) = 0x0F0F0F0FU;
    SET_BITS(PIO_CTRL(PIO1)) = machines[1];
    SET_BITS(PIO_CTRL(PIO0)) = machines[0];
    bench.slow_changes = 0;
    bench.runs = true;
    watch_slow_pins(bench.record.slow);
    bench.mark = tick_now();  // close enough for the slow pins; all others count from the mark itself
    bench.mark = time_of_write(SIO_GPIO_OUT_SET, 1U << PIN_MARK);
    return true;
}

// What is played ends where it is; what was recorded stays to be read.
void bench_stop(void)
{
    if (!bench.runs) {
        return;
    }
    watch_slow_pins(0U);
    CLEAR_BITS(PIO_CTRL(PIO0)) = 0xFU;
    CLEAR_BITS(PIO_CTRL(PIO1)) = 0xFU;
    bench.runs = false;
}

static uint32_t recorded(const uint32_t number, const uint32_t room)
{
    return room - REGISTER(DMA_COUNT(DMA_TRACK(number)));
}

static bool lost(const uint32_t number)
{
    return (REGISTER(PIO_FDEBUG(pio_of(number))) & FDEBUG_RX_LOST(machine_of(number))) != 0U;
}

void bench_state(bench_state_t* const state)
{
    memset(state, 0, sizeof *state);
    const bool is_played = (REGISTER(DMA_CTRL(DMA_PLAYER)) & DMA_BUSY) == 0U;
    state->tick = tick_now() - bench.mark;
    state->levels = REGISTER(SIO_GPIO_IN);
    state->unplayed = is_played ? 0U : (uint16_t)REGISTER(DMA_COUNT(DMA_PLAYER));
    state->slow = bench.slow_changes;
    state->room = (uint16_t)bench.room;
    state->flags = (uint8_t)((bench.runs ? BENCH_RUNS : 0U) | (is_played ? BENCH_PLAYED : 0U));
    for (uint32_t i = 0; (bench.room > 0U) && (i < RIG_TRACKS); i++) {
        if (samples(i)) {
            state->sampled = recorded(i, bench.record.sample_words);
        } else if (is_used(i)) {
            state->tracked[i] = (uint16_t)recorded(i, bench.room);
            state->flags |= lost(i) ? BENCH_LOST : 0U;
        }
    }
}

uint32_t bench_words(const uint8_t which)
{
    return (which == RIG_AREA_RECORDED) ? RIG_AREA_WORDS : 2U * RIG_SLOW_MAX;
}

uint32_t bench_word(const uint8_t which, const uint32_t at)
{
    if (at >= bench_words(which)) {
        return 0U;
    }
    return (which == RIG_AREA_RECORDED) ? area[at] : slow[at];
}

void bench_run(void)
{
    (void)tick_now();  // SysTick wraps every 168 ms
}

void bench_start(void)
{
    REGISTER(SIO_GPIO_OUT_CLEAR) = 1U << PIN_MARK;
    REGISTER(SIO_GPIO_OE_SET) = 1U << PIN_MARK;
    pin_use(PIN_MARK, FUNCTION_SIO, PAD_INPUT | PAD_DRIVE_4MA);
    for (uint32_t pin = 0; pin < PIN_MARK; pin++) {
        if (((RIG_DRIVES >> pin) & 1U) != 0U) {  // not driven yet, and pulled as the controller pulls
            const uint32_t pull = (pin == PIN_INTERLOCK_ANTIVALENT) ? PAD_PULL_DOWN : PAD_PULL_UP;
            pin_use(pin, FUNCTION_PIO0, PAD_INPUT | PAD_SCHMITT | PAD_DRIVE_2MA | pull);
        } else if (((RIG_LOOKS >> pin) & 1U) != 0U) {
            pin_use(pin, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_DOWN);
        }
    }
    pio_load(PIO0, PLAY, player, sizeof player / sizeof player[0]);
    pio_load(PIO0, TRACK, track, sizeof track / sizeof track[0]);
    pio_load(PIO1, TRACK, track, sizeof track / sizeof track[0]);
    pio_load(PIO1, SAMPLE, sampler, sizeof sampler / sizeof sampler[0]);
    halt();
    watch_slow_pins(0U);
    irq_enable(IRQ_IO_BANK0);
}
