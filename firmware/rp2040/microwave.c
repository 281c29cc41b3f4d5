// Trains of chips for the microwave gate and its digitizer trigger, played by PIO1 from lists that DMA repeats; and the
// guard that holds the gate low whatever the others do.
//
// A list word is a level and how long it holds. Both machines play the same program from the same cycle on. The list of
// one period has a power of two of words, so that one DMA channel with a ring reads it `repeat` times and then stops.
//
// Ending a train early cuts no burst in half and waits for nothing: the first word of both lists becomes a low one that
// lasts for 21 s, and the burst that would begin with it never does. DMA reads a first word when the fourth word before
// it begins to be played, so both lists of a burst begin at about the same time and end with short words: between two
// such readings it is known which burst is the last, and the two words are written then. Where the pin's levels leave
// no room for that at the end of a list (a trigger right before the next burst; over 126 pulses a burst) the list
// begins with the end of its last pulse instead; with over 126 pulses that is one burst earlier, so one more is sent.
//
// GUARD, the machine that cuts whatever the others do, is guard.c's; the words of its program lie behind PLAY's.

#include "../board.h"
#include "../core/messages.h"
#include "../duty.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

enum { PLAY = 0, PROGRAM_LENGTH = 12 };

static const uint16_t program[PROGRAM_LENGTH] = {
    [PLAY] = PULL,  // wraps from 3 to 0
    OUT_PINS(1U),
    OUT_X(31U),
    JMP_X_DEC(3),
    [GUARD_TAKE] = MOV_X_OSR,
    [GUARD_WATCH] = JMP_PIN(GUARD_CUT),  // the interlock: looked at every fourth cycle at least
    JMP_X_DEC(GUARD_WATCH),
    [GUARD_SPENT] = PULL_NO_BLOCK,  // the next credit, or X again
    JMP_PIN(GUARD_CUT),
    MOV_Y_OSR,
    JMP_X_NOT_Y(GUARD_TAKE),
    [GUARD_CUT] = SET_PINS(0U),  // wraps to itself
};
_Static_assert(PROGRAM_LENGTH == ODOMETER_PROGRAM, "the odometer's program lies behind");

#define WORD_TICKS 4U    // the shortest a word can hold
#define PIECE_TICKS 16U  // words shorter than this are not made when a run is split: DMA keeps ahead
#define FIFO_WORDS 4U    // read ahead of the one being played
#define LIST_MIN 8U      // words: more than are read ahead
#define LIST_MAX 256U
#define LOW_FOR_EVER 0xFFFFFFFEU                             // for 21 s
#define TAIL_TICKS (FIFO_WORDS * PIECE_TICKS + PIECE_TICKS)  // low at a list's end, to be cut into short words
// From the tick read before the first words are written until they are, some 30 cycles by the listing; and 8 that DMA
// may be behind its request.
#define COMMIT_TICKS 48
#define LEAD_TICKS 200U  // from the start to the first thing that may happen

static volatile uint32_t chip_list[LIST_MAX] __attribute__((aligned(1024)));
static volatile uint32_t trigger_list[LIST_MIN] __attribute__((aligned(4U * LIST_MIN)));

static struct {
    bool enabled;
    bool starved;  // cut because no credit came
    bool running;
    bool stopping;
    uint16_t done;
    uint16_t repeat;
    uint32_t period;
    uint32_t end;           // tick of the end of the burst being sent
    uint16_t begun;         // bursts that nothing but a cut keeps from being sent
    uint32_t commit;        // tick from which on that is so of the next one
    uint32_t commit_ticks;  // how long after that its first words have been read
    uint32_t on_ticks;      // of one burst
    uint32_t rise;          // tick of the first pulse of the burst to be charged next
    uint16_t charged;       // bursts
} train;

static duty_t owed;

static uint32_t word_of(const bool level, const uint32_t ticks)
{
    return ((ticks - WORD_TICKS) << 1) | (level ? 1U : 0U);
}

static void execute(const uint32_t machine, const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO1, machine)) = instruction;
}

void board_microwave_feed(void)
{
    if (train.enabled) {
        guard_feed();
    }
    duty_run(&owed, board_tick());
}

// They drive nothing any more. Before an instruction is forced upon GUARD: it takes the place of the one that drives
// the pins low (datasheet 3.5.7), and a rise in that very cycle would reach the pin.
static void halt_players(void)
{
    CLEAR_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(CHIP_MACHINE) | PIO_MACHINE(TRIGGER_MACHINE);
}

static void stop_players(void)
{
    halt_players();
    dma_stop(DMA_CHIPS);
    dma_stop(DMA_TRIGGER);
    for (uint32_t machine = CHIP_MACHINE; machine <= TRIGGER_MACHINE; machine++) {
        execute(machine, MOV_PINS_NULL);
        for (uint32_t i = 0; i < 4U; i++) {
            execute(machine, PULL_NO_BLOCK);
        }
    }
    SET_BITS(PIO_CTRL(PIO1)) = PIO_RESTART(CHIP_MACHINE) | PIO_RESTART(TRIGGER_MACHINE);
    execute(CHIP_MACHINE, JMP(PLAY));
    execute(TRIGGER_MACHINE, JMP(PLAY));
    train.running = false;
}

// A burst is charged in full once its first pulse may have begun, whatever cuts it.
static void charge_until(const uint32_t now)
{
    while ((train.charged < train.repeat) && tick_is_past(now, train.rise)) {
        duty_charge(&owed, train.rise, train.on_ticks, MICROWAVE_DUTY_MAX_PERMILLE);
        train.charged++;
        train.rise += train.period;
    }
}

// Both lists begin with silence from now on if it is this early and this late; false: it is not.
__attribute__((noinline)) static bool silence_lists(const uint32_t from, const uint32_t until)
{
    interrupts_off();
    const uint32_t now = board_tick();
    const bool is_time = tick_is_past(now, from) && !tick_is_past(now, until);
    if (is_time) {
        chip_list[0] = LOW_FOR_EVER;
        trigger_list[0] = LOW_FOR_EVER;
    }
    interrupts_on();
    return is_time;
}

static void begin_until(const uint32_t now)
{
    while ((train.begun < train.repeat) && tick_is_past(now, train.commit)) {
        train.begun++;
        train.commit += train.period;
    }
}

// With the burst last begun, unless right now that could be this one or the next.
static void try_to_end(void)
{
    if ((train.begun < train.repeat) && silence_lists(train.commit - train.period + train.commit_ticks, train.commit)) {
        train.repeat = train.begun;
    }
}

// Keep step with the train; after the last burst only its gap is being played, so stopping late is harmless.
static void follow_train(void)
{
    const uint32_t looked = board_tick();  // before the guard is looked at: up to here it had not cut
    const bool cut = train.enabled && guard_is_cutting();
    if (cut) {
        halt_players();
    }
    const uint32_t now = cut ? guard_cut_tick(&train.starved) : looked;  // what went on after the cut was dark
    if (train.running) {
        charge_until(now);
        begin_until(now);
        if (train.stopping && !cut) {
            begin_until(board_tick());  // again: what came before may have taken longer than a burst
            try_to_end();
        }
        while ((train.done < train.repeat) && tick_is_past(now, train.end)) {
            train.done++;
            train.end += train.period;
        }
        if (cut || (train.done == train.repeat)) {
            stop_players();
        }
    }
    train.enabled = train.enabled && !cut;
}

void board_microwave(const bool enabled)
{
    const bool on = enabled && !board_interlock_open();
    const bool was_cut = guard_is_cutting();
    if (!on && was_cut) {
        halt_players();
    } else if (!on) {
        guard_cut();  // before the train is followed: GUARD counts when it cuts
    }
    follow_train();
    train.starved = train.starved && was_cut;
    train.enabled = on;
    if (on) {
        guard_start();
    } else {
        stop_players();
    }
}

bool board_microwave_starved(void)
{
    follow_train();
    const bool starved = train.starved;
    train.starved = false;
    return starved;
}

// One period of a pin, in ticks from chip 0. It is written from its end on, and what is missing to a power of two of
// words is made by cutting pieces off the ends of its last runs. There is always enough to cut: a period has 20 times
// the ticks of its pulses, and 600 at least.
typedef struct {
    volatile uint32_t* words;
    uint32_t size;       // words
    uint32_t at;         // the one written last
    uint32_t fill;       // pieces still to be cut
    int32_t begin;       // of word 0
    int32_t first_rise;  // equal to last_fall: no pulse
    int32_t last_fall;
    int32_t read_ahead;  // how long before `begin` DMA reads word 0 of the next burst
} list_t;

static void prepend_word(list_t* const list, const bool level, const uint32_t ticks)
{
    list->at--;
    list->words[list->at] = word_of(level, ticks);
    list->read_ahead += (list->at + FIFO_WORDS >= list->size) ? (int32_t)ticks : 0;
}

static void prepend(list_t* const list, const bool level, uint32_t ticks)
{
    for (; (list->fill > 0U) && (ticks >= 2U * PIECE_TICKS); list->fill--) {
        prepend_word(list, level, PIECE_TICKS);
        ticks -= PIECE_TICKS;
    }
    if (ticks > 0U) {
        prepend_word(list, level, ticks);
    }
}

// The same, where nothing is to be cut and DMA does not read ahead: most of a list.
static inline void prepend_soon(list_t* const list, const bool level, const uint32_t ticks)
{
    const uint32_t at = list->at - 1U;
    if (((list->fill == 0U) || (ticks < 2U * PIECE_TICKS)) && (at + FIFO_WORDS < list->size)) {
        list->at = at;
        list->words[at] = word_of(level, ticks);
    } else {
        prepend(list, level, ticks);
    }
}

// A list of so many pulses that begins at `begin` with all of them in its period; or, where low ticks at its end are
// too few, with the end of the last pulse before.
static void open_list(list_t* const list, const uint32_t pulses, const int32_t begin, const uint32_t period)
{
    const bool has_tail = (begin + (int32_t)period - list->last_fall >= (int32_t)TAIL_TICKS) &&
                          (2U * pulses + 1U + FIFO_WORDS <= LIST_MAX);
    const uint32_t runs = ((pulses > 0U) ? 2U * pulses : 1U) + (has_tail ? 1U : 0U);
    list->begin = has_tail ? begin : list->last_fall - (int32_t)period;
    list->size = LIST_MIN;
    while ((list->size < runs + FIFO_WORDS) && (list->size < LIST_MAX)) {
        list->size *= 2U;
    }
    list->at = list->size;
    list->fill = list->size - runs;
    list->read_ahead = 0;
    prepend(list, false, (uint32_t)(list->begin + (int32_t)period - list->last_fall));
}

static void close_list(list_t* const list)
{
    prepend(list, false, (uint32_t)(list->first_rise - list->begin));
}

static void write_chips(list_t* const list, const board_burst_t* const burst, const int32_t begin)
{
    open_list(list, board_pulses(burst), begin, burst->period_ticks);
    const uint32_t first = (uint32_t)list->first_rise / burst->chip_ticks;
    uint32_t end = (uint32_t)list->last_fall / burst->chip_ticks;
    bool level = true;
    for (uint32_t chip = end; chip > first + 1U; chip--) {  // 256 of these are the longest part of any round
        const uint32_t before = chip - 2U;
        const bool turns = (((burst->chips[before / 8U] >> (before % 8U)) & 1U) != 0U) != level;
        if (turns) {
            prepend_soon(list, level, (end - chip + 1U) * burst->chip_ticks);
            end = chip - 1U;
            level = !level;
        }
    }
    if (end > first) {
        prepend(list, level, (end - first) * burst->chip_ticks);
    }
    close_list(list);
}

static void write_trigger(list_t* const list, const board_burst_t* const burst, const int32_t begin)
{
    open_list(list, 1U, begin, burst->period_ticks);
    prepend(list, true, TRIGGER_TICKS);
    close_list(list);
}

// Where the first word ends: the first burst does without it.
static int32_t first_end(const list_t* const list)
{
    return list->begin + (int32_t)((list->words[0] >> 1) + WORD_TICKS);
}

// Word 0 in another length, and then the list from word 1 on.
static void start_list(const list_t* const list, const uint32_t channel, const uint32_t machine,
                       const uint32_t first_ticks, const uint32_t repeat)
{
    uint32_t ring_bits = 2;
    while ((1U << ring_bits) < 4U * list->size) {
        ring_bits++;
    }
    REGISTER(PIO_TX(PIO1, machine)) = word_of(false, first_ticks);
    REGISTER(DMA_READ(channel)) = (uint32_t)(uintptr_t)&list->words[1];
    REGISTER(DMA_WRITE(channel)) = PIO_TX(PIO1, machine);
    // And word 0 once more at the end: a list without low ticks at its end leaves its pin high, and word 0 is low.
    REGISTER(DMA_COUNT(channel)) = list->size * repeat;
    REGISTER(DMA_CTRL_TRIGGER(channel)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_TX(1U, machine)) | DMA_CHAIN(channel) |
                                          DMA_RING(ring_bits) | DMA_INCREMENT_READ | DMA_WORDS | DMA_PRIORITY |
                                          DMA_ENABLE;
}

static int32_t least(const int32_t a, const int32_t b)
{
    return (a < b) ? a : b;
}

static int32_t greatest(const int32_t a, const int32_t b)
{
    return (a > b) ? a : b;
}

board_burst_started_t board_burst(const board_burst_t* const burst, uint32_t* const start)
{
    follow_train();
    if (!train.enabled) {
        return BOARD_BURST_CUT;
    }
    const uint32_t on_ticks = board_on_ticks(burst);
    if (train.running || (burst->chip_ticks < CHIP_MIN_TICKS) || (burst->period_ticks < BURST_PERIOD_MIN_TICKS) ||
        duty_exceeds(on_ticks, burst->period_ticks, MICROWAVE_DUTY_MAX_PERMILLE)) {
        return BOARD_BURST_OVER_LIMIT;
    }
    list_t trigger = {.words = trigger_list, .first_rise = burst->trigger_offset};
    trigger.last_fall = trigger.first_rise + (int32_t)TRIGGER_TICKS;
    list_t chips = {.words = chip_list, .first_rise = trigger.first_rise, .last_fall = trigger.first_rise};
    if (on_ticks > 0U) {
        chips.first_rise = (int32_t)(board_first_on_chip(burst) * burst->chip_ticks);
        chips.last_fall = (int32_t)(board_on_end(burst) * burst->chip_ticks);
    }
    const int32_t begin = least(chips.first_rise, trigger.first_rise);
    write_chips(&chips, burst, begin - (int32_t)PIECE_TICKS);
    write_trigger(&trigger, burst, begin - (int32_t)PIECE_TICKS);

    const int32_t lead = least(first_end(&chips), first_end(&trigger)) - (int32_t)LEAD_TICKS;  // ticks from chip 0
    const uint32_t until_chip0 = START_OFFSET - (uint32_t)lead;
    const uint32_t until_rise = until_chip0 + (uint32_t)chips.first_rise;
    if ((on_ticks > 0U) && !duty_allows(&owed, board_tick() + until_rise)) {
        return BOARD_BURST_OVER_LIMIT;
    }
    start_list(&chips, DMA_CHIPS, CHIP_MACHINE, (uint32_t)(first_end(&chips) - lead), burst->repeat);
    start_list(&trigger, DMA_TRIGGER, TRIGGER_MACHINE, (uint32_t)(first_end(&trigger) - lead), burst->repeat);

    const int32_t chips_read = chips.begin - chips.read_ahead;
    const int32_t trigger_read = trigger.begin - trigger.read_ahead;
    const int32_t commit = least(chips_read, trigger_read) - COMMIT_TICKS;
    train.commit_ticks = (uint32_t)(greatest(chips_read, trigger_read) + COMMIT_TICKS - commit);
    train.done = 0;
    train.begun = 1;
    train.repeat = burst->repeat;
    train.period = burst->period_ticks;
    train.on_ticks = on_ticks;
    train.charged = 0;
    train.stopping = false;
    train.running = true;
    const uint32_t machines = PIO_MACHINE(CHIP_MACHINE) | PIO_MACHINE(TRIGGER_MACHINE);
    *start = time_of_write(SET_ADDRESS(PIO_CTRL(PIO1)), machines) + until_chip0;
    train.rise = *start + (uint32_t)chips.first_rise;
    train.end = *start + (uint32_t)greatest((int32_t)burst->length * burst->chip_ticks, trigger.last_fall);
    train.commit = *start + train.period + (uint32_t)commit;
    return BOARD_BURST_STARTED;
}

void board_burst_stop(void)
{
    train.stopping = true;
    follow_train();
}

bool microwave_hurries(void)
{
    return train.running && train.stopping;
}

bool board_burst_running(uint16_t* const done)
{
    follow_train();
    *done = train.done;
    return train.running;
}

void microwave_start(void)
{
    owed = (duty_t){.owing = board_cause() != BOOT_CAUSE_POWER_ON, .paid_at = BOARD_BURST_OWES_MAX - time_before()};
    pio_load(PIO1, 0U, program, PROGRAM_LENGTH);
    for (uint32_t machine = CHIP_MACHINE; machine <= TRIGGER_MACHINE; machine++) {
        const uint32_t pin = (machine == CHIP_MACHINE) ? PIN_MICROWAVE : PIN_TRIGGER;
        REGISTER(PIO_EXECCTRL(PIO1, machine)) = EXEC_WRAP(PLAY, PLAY + 3U);
        REGISTER(PIO_SHIFTCTRL(PIO1, machine)) = SHIFT_OUT_RIGHT;
        REGISTER(PIO_PINCTRL(PIO1, machine)) = PINS_OUT(pin, 1U) | PINS_SET(pin, 1U);
        execute(machine, MOV_PINS_NULL);
        execute(machine, SET_DIRECTIONS(1U));
        execute(machine, JMP(PLAY));
    }
    guard_load();
}
