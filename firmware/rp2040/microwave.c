// Trains of chips for the microwave gate and its digitizer trigger, played by PIO1 from lists that DMA repeats; and the
// guard that holds the gate low whatever the others do.
//
// A list word is a level and how long it holds. Both machines play the same program from the same cycle on. The list of
// one period has a power of two of words, so that one DMA channel with a ring reads it `repeat` times and then stops.
// GUARD waits for the interlock to open, or for its credit to run out, and then drives gate and trigger low in every
// cycle; of several machines that write a pin in one cycle the highest-numbered wins (datasheet 3.5.6.1), so nothing
// the others do is seen any more. A credit is 2 ms of time; the main loop lays out the next one when the last has been
// taken. So a main loop that stands still leaves both pins low 4 ms later at most, long before the watchdog bites.

#include "../board.h"
#include "../core/messages.h"
#include "../duty.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

enum { PLAY = 0, GUARD_TAKE = 4, GUARD_WATCH = 5, GUARD_CUT = 11, PROGRAM_LENGTH = 12 };

static const uint16_t program[PROGRAM_LENGTH] = {
    [PLAY] = PULL,  // wraps from 3 to 0
    OUT_PINS(1U),
    OUT_X(31U),
    JMP_X_DEC(3),
    [GUARD_TAKE] = MOV_X_OSR,
    [GUARD_WATCH] = JMP_PIN(GUARD_CUT),  // the interlock: looked at every fourth cycle at least
    JMP_X_DEC(GUARD_WATCH),
    PULL_NO_BLOCK,  // the next credit, or X again
    JMP_PIN(GUARD_CUT),
    MOV_Y_OSR,
    JMP_X_NOT_Y(GUARD_TAKE),
    [GUARD_CUT] = SET_PINS(0U),  // wraps to itself
};
_Static_assert(PROGRAM_LENGTH == ODOMETER_PROGRAM, "the odometer's program lies behind");

#define WORD_TICKS 4U    // the shortest a word can hold
#define PIECE_TICKS 16U  // words shorter than this are not made when a list is filled up: DMA keeps ahead
#define LIST_MAX 256U
#define LIST_BITS 10U                           // of its bytes
#define LEAD_TICKS 200U                         // from the start to the first thing that may happen
#define START_OFFSET 31U                        // from the tick read before the machines start to their first level
#define CREDIT 100000U                          // what GUARD counts down, once in two ticks
#define CREDIT_TICKS (2U * (CREDIT + 1U) + 5U)  // how long one lasts
#define CREDIT_GONE UINT32_MAX                  // GUARD's count after the last one
#define PERIOD_MIN_TICKS (TRIGGER_TICKS + PIECE_TICKS)

static volatile uint32_t chip_list[LIST_MAX] __attribute__((aligned(1024)));
static volatile uint32_t trigger_list[2] __attribute__((aligned(8)));

static struct {
    bool enabled;
    bool starved;      // cut because no credit came
    uint32_t guarded;  // tick at which GUARD took its first credit
    uint32_t credits;  // laid out since, the first one not counted
    bool running;
    bool stopping;
    uint16_t done;
    uint16_t repeat;
    uint32_t period;
    uint32_t busy_ticks;  // chip 0, or the trigger if that is later, to the end of a burst
    uint32_t end;         // tick of the end of the burst being sent
    uint32_t on_ticks;    // of one burst
    uint32_t rise;        // tick of the first pulse of the burst to be charged next
    uint16_t charged;     // bursts
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

static bool is_guard_cutting(void)
{
    return REGISTER(PIO_ADDRESS(PIO1, GUARD_MACHINE)) == GUARD_CUT;
}

static uint32_t credits_waiting(void)
{
    return (REGISTER(PIO_FLEVEL(PIO1)) >> (8U * GUARD_MACHINE)) & 0xFU;
}

static void lay_out_credit(void)
{
    REGISTER(PIO_TX(PIO1, GUARD_MACHINE)) = CREDIT;
    train.credits++;
}

void board_microwave_feed(void)
{
    if (train.enabled && (credits_waiting() == 0U)) {
        lay_out_credit();
    }
    duty_run(&owed, board_tick());
}

static void start_guard(void)
{
    for (uint32_t i = 0; i < 4U; i++) {
        execute(GUARD_MACHINE, PULL_NO_BLOCK);  // credits left from before
    }
    lay_out_credit();
    execute(GUARD_MACHINE, PULL_NO_BLOCK);
    execute(GUARD_MACHINE, MOV_X_OSR);
    train.credits = 0;
    lay_out_credit();
    interrupts_off();
    train.guarded = board_tick();
    execute(GUARD_MACHINE, JMP(GUARD_WATCH));
    interrupts_on();
}

// When GUARD cut, by its own count, and why.
static uint32_t cut_tick(bool* const starved)
{
    execute(GUARD_MACHINE, MOV_ISR_X);
    execute(GUARD_MACHINE, PUSH_NO_BLOCK);
    const uint32_t left = REGISTER(PIO_RX(PIO1, GUARD_MACHINE));
    const uint32_t taken = train.credits - credits_waiting();
    *starved = left == CREDIT_GONE;
    return train.guarded + taken * CREDIT_TICKS + (*starved ? CREDIT_TICKS : 2U * (CREDIT - left));
}

void dma_stop(const uint32_t channel)
{
    CLEAR_BITS(DMA_CTRL(channel)) = DMA_ENABLE;
    REGISTER(DMA_ABORT) = 1U << channel;
    while ((REGISTER(DMA_CTRL(channel)) & DMA_BUSY) != 0U) {
    }
}

static void stop_players(void)
{
    CLEAR_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(CHIP_MACHINE) | PIO_MACHINE(TRIGGER_MACHINE);
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

// Keep step with the train; after the last burst only its gap is being played, so stopping late is harmless.
static void follow_train(void)
{
    const bool cut = train.enabled && is_guard_cutting();
    const uint32_t now = cut ? cut_tick(&train.starved) : board_tick();  // what went on after the cut was dark
    if (train.running) {
        charge_until(now);
    }
    while (train.running && tick_is_past(now, train.end)) {
        train.done++;
        const bool was_last = train.done == train.repeat;
        const bool in_gap = now - train.end < train.period - train.busy_ticks;
        if (was_last || (train.stopping && in_gap)) {
            stop_players();
        }
        train.end += train.period;
    }
    if (cut) {
        train.enabled = false;
        stop_players();
    }
}

void board_microwave(const bool enabled)
{
    follow_train();
    train.enabled = enabled && !board_interlock_open();
    if (train.enabled) {
        start_guard();
    } else {
        execute(GUARD_MACHINE, JMP(GUARD_CUT));
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

static uint32_t power_of_two_from(const uint32_t count)
{
    uint32_t power = 1;
    while (power < count) {
        power *= 2U;
    }
    return power;
}

// One run as one word, or, as long as the list is to be filled up, several of the same level.
static uint32_t append(uint32_t at, const bool level, uint32_t ticks, uint32_t* const fill)
{
    while (!level && (*fill > 0U) && (ticks >= 2U * PIECE_TICKS)) {
        chip_list[at++] = word_of(false, PIECE_TICKS);
        ticks -= PIECE_TICKS;
        (*fill)--;
    }
    chip_list[at++] = word_of(level, ticks);
    return at;
}

static uint32_t count_runs(const board_burst_t* const burst, const uint32_t first)
{
    uint32_t runs = 1;
    for (uint32_t chip = first + 1U; chip <= burst->length; chip++) {
        runs += (board_chip(burst, chip) != board_chip(burst, chip - 1U)) ? 1U : 0U;
    }
    return runs;
}

// One period from the first on-chip on, its gap at the end. The words it has, or 0: it cannot be filled up.
static uint32_t write_list(const board_burst_t* const burst, const uint32_t first)
{
    const uint32_t runs = count_runs(burst, first);
    const uint32_t words = power_of_two_from(runs);
    uint32_t fill = words - runs;
    uint32_t at = 0;
    uint32_t begin = first;
    for (uint32_t chip = first + 1U; chip < burst->length; chip++) {
        if (board_chip(burst, chip) != board_chip(burst, chip - 1U)) {
            at = append(at, board_chip(burst, chip - 1U), (chip - begin) * burst->chip_ticks, &fill);
            begin = chip;
        }
    }
    uint32_t gap = burst->period_ticks - (begin - first) * burst->chip_ticks;
    if ((burst->length > 0U) && board_chip(burst, burst->length - 1U)) {
        const uint32_t ticks = (burst->length - begin) * burst->chip_ticks;
        at = append(at, true, ticks, &fill);
        gap -= ticks;
    }
    at = append(at, false, gap, &fill);
    return (fill == 0U) ? words : 0U;
}

static void start_channel(const uint32_t channel, const uint32_t machine, const volatile uint32_t* const list,
                          const uint32_t ring_bits, const uint32_t words)
{
    REGISTER(DMA_READ(channel)) = (uint32_t)(uintptr_t)list;
    REGISTER(DMA_WRITE(channel)) = PIO_TX(PIO1, machine);
    REGISTER(DMA_COUNT(channel)) = words;
    REGISTER(DMA_CTRL_TRIGGER(channel)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_TX(1U, machine)) | DMA_CHAIN(channel) |
                                          DMA_RING(ring_bits) | DMA_INCREMENT_READ | DMA_WORDS | DMA_PRIORITY |
                                          DMA_ENABLE;
}

static uint32_t bits_of(uint32_t bytes)
{
    uint32_t bits = 0;
    while (bytes > 1U) {
        bytes /= 2U;
        bits++;
    }
    return bits;
}

board_burst_started_t board_burst(const board_burst_t* const burst, uint32_t* const start)
{
    follow_train();
    if (!train.enabled) {
        return BOARD_BURST_CUT;
    }
    const uint32_t on_ticks = board_on_ticks(burst);
    if (train.running || (burst->chip_ticks < CHIP_MIN_TICKS) || (burst->period_ticks < PERIOD_MIN_TICKS) ||
        duty_exceeds(on_ticks, burst->period_ticks, MICROWAVE_DUTY_MAX_PERMILLE)) {
        return BOARD_BURST_OVER_LIMIT;
    }
    const uint32_t first = board_first_on_chip(burst);
    const uint32_t words = write_list(burst, first);
    if (words == 0U) {
        return BOARD_BURST_OVER_LIMIT;
    }
    const uint32_t offset = (burst->trigger_offset > 0) ? (uint32_t)burst->trigger_offset : 0U;
    const uint32_t before = (burst->trigger_offset < 0) ? (uint32_t)-burst->trigger_offset : 0U;
    const uint32_t until_rise = START_OFFSET + LEAD_TICKS + before + first * burst->chip_ticks;
    if ((on_ticks > 0U) && !duty_allows(&owed, board_tick() + until_rise)) {
        return BOARD_BURST_OVER_LIMIT;
    }
    trigger_list[0] = word_of(true, TRIGGER_TICKS);
    trigger_list[1] = word_of(false, burst->period_ticks - TRIGGER_TICKS);

    REGISTER(PIO_TX(PIO1, CHIP_MACHINE)) = word_of(false, LEAD_TICKS + before + first * burst->chip_ticks);
    REGISTER(PIO_TX(PIO1, TRIGGER_MACHINE)) = word_of(false, LEAD_TICKS + offset);
    start_channel(DMA_CHIPS, CHIP_MACHINE, chip_list, bits_of(4U * words), words * burst->repeat);
    start_channel(DMA_TRIGGER, TRIGGER_MACHINE, trigger_list, 3U, 2U * burst->repeat);

    const uint32_t chips_end = (uint32_t)burst->length * burst->chip_ticks;
    const int32_t trigger_end = burst->trigger_offset + (int32_t)TRIGGER_TICKS;
    train.busy_ticks = (trigger_end > (int32_t)chips_end) ? (uint32_t)trigger_end : chips_end;
    train.done = 0;
    train.repeat = burst->repeat;
    train.period = burst->period_ticks;
    train.stopping = false;
    train.running = true;
    interrupts_off();  // one between tick and start would make the tick a lie
    *start = board_tick();
    SET_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(CHIP_MACHINE) | PIO_MACHINE(TRIGGER_MACHINE);
    interrupts_on();
    train.rise = *start + until_rise;
    *start += START_OFFSET + LEAD_TICKS + before;
    train.end = *start + train.busy_ticks;
    train.busy_ticks += before;
    train.on_ticks = on_ticks;
    train.charged = 0;
    return BOARD_BURST_STARTED;
}

// A gap too short for the main loop to meet is waited for: 8 ms at most, at the expense of a late load.
void board_burst_stop(void)
{
    follow_train();
    train.stopping = true;
    if (train.running && (train.period - train.busy_ticks < 20000U)) {
        while (train.running) {
            board_microwave_feed();
            follow_train();
        }
    }
}

bool board_burst_running(uint16_t* const done)
{
    follow_train();
    *done = train.done;
    return train.running;
}

void microwave_start(void)
{
    owed = (duty_t){.owing = board_cause() != BOOT_CAUSE_POWER_ON, .paid_at = BOARD_BURST_OWES_MAX};
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
    REGISTER(PIO_EXECCTRL(PIO1, GUARD_MACHINE)) = EXEC_JUMP_PIN(PIN_INTERLOCK) | EXEC_WRAP(GUARD_CUT, GUARD_CUT);
    REGISTER(PIO_PINCTRL(PIO1, GUARD_MACHINE)) = PINS_SET(PIN_MICROWAVE, 2U);  // and the trigger next to it
    execute(GUARD_MACHINE, JMP(GUARD_CUT));
    SET_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(GUARD_MACHINE);
    pin_use(PIN_MICROWAVE, FUNCTION_PIO1, PAD_DRIVE_4MA | PAD_PULL_DOWN);
    pin_use(PIN_TRIGGER, FUNCTION_PIO1, PAD_DRIVE_4MA | PAD_PULL_DOWN);
}
