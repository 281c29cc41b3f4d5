// Steps for the turntable: a machine of PIO0 that borrows the lamps' pulse, fed by DMA with one and the same word.
// Another value in that word is another speed, from the next step that DMA reads on.

#include "../board.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

// A step is the words delay, width, level; they may be one word as long as it is odd: level 1.
#define WORDS_PER_STEP 3U
#define STEP_OVERHEAD 10U
#define WORDS_AT_ONCE (DMA_COUNT_MAX / WORDS_PER_STEP * WORDS_PER_STEP)

static volatile uint32_t half_period;  // the word, where DMA reads it again and again

static struct {
    int32_t start;   // where it stood, or stands
    uint32_t steps;  // of this move
    bool up;
    bool moving;
    uint32_t later;  // words that DMA can not count yet: an RP2350's counts 89 million steps
} motor;

static uint32_t half_of(const uint32_t period_ticks)
{
    return ((period_ticks - STEP_OVERHEAD) / 2U) | 1U;
}

static int32_t place_after(const uint32_t steps)
{
    return motor.up ? motor.start + (int32_t)steps : motor.start - (int32_t)steps;
}

static void stand_at(const uint32_t steps)
{
    motor.start = place_after(steps);
    motor.moving = false;
}

static uint32_t fifo_words(void)
{
    return (REGISTER(PIO_FLEVEL(PIO0)) >> (8U * STEP_MACHINE)) & 0xFU;
}

// The pause at the seam, a round at most, is one in hours.
static void start_words(const uint32_t all)
{
    const uint32_t words = (all < WORDS_AT_ONCE) ? all : WORDS_AT_ONCE;
    motor.later = all - words;
    if (words > 0U) {
        REGISTER(DMA_READ(DMA_STEPS)) = (uint32_t)(uintptr_t)&half_period;
        REGISTER(DMA_WRITE(DMA_STEPS)) = PIO_TX(PIO0, STEP_MACHINE);
        REGISTER(DMA_COUNT(DMA_STEPS)) = words;
        REGISTER(DMA_CTRL_TRIGGER(DMA_STEPS)) =
            DMA_QUIET | DMA_REQUEST(DREQ_PIO_TX(0U, STEP_MACHINE)) | DMA_CHAIN(DMA_STEPS) | DMA_WORDS | DMA_ENABLE;
    }
}

static void finish_when_done(void)
{
    const bool fed = (REGISTER(DMA_CTRL(DMA_STEPS)) & DMA_BUSY) == 0U;
    if (motor.moving && fed && (motor.later > 0U)) {
        start_words(motor.later);
    } else if (motor.moving && fed && (fifo_words() == 0U) &&
               (REGISTER(PIO_ADDRESS(PIO0, STEP_MACHINE)) == LAMP_IDLE)) {
        stand_at(motor.steps);
    }
}

void board_turntable_power(const bool on)
{
    REGISTER(on ? SIO_GPIO_OUT_CLEAR : SIO_GPIO_OUT_SET) = 1U << PIN_ENABLE;
}

// The delay of the first step is no word of DMA's: the machine, which stands, gets it at once, and DMA the rest.
void board_turntable_move(const int32_t position, const uint32_t period_ticks, const uint32_t wait_ticks)
{
    motor.up = position >= motor.start;
    motor.steps = motor.up ? (uint32_t)position - (uint32_t)motor.start : (uint32_t)motor.start - (uint32_t)position;
    motor.moving = motor.steps > 0U;
    REGISTER(motor.up ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLEAR) = 1U << PIN_DIRECTION;
    half_period = half_of(period_ticks);
    if (motor.moving) {
        REGISTER(PIO_TX(PIO0, STEP_MACHINE)) = (wait_ticks > half_period) ? wait_ticks : half_period;
        start_words(WORDS_PER_STEP * motor.steps - 1U);
    }
}

void board_turntable_pace(const uint32_t period_ticks)
{
    half_period = half_of(period_ticks);
}

uint32_t board_turntable_left(void)
{
    return motor.moving ? (REGISTER(DMA_COUNT(DMA_STEPS)) + motor.later) / WORDS_PER_STEP : 0U;
}

// What DMA had still to move; none is under way any more.
static uint32_t pause_words(void)
{
    CLEAR_BITS(DMA_CTRL(DMA_STEPS)) = DMA_ENABLE;
    for (uint32_t i = 0; i < 4U; i++) {
        (void)REGISTER(DMA_CTRL(DMA_STEPS));
    }
    return REGISTER(DMA_COUNT(DMA_STEPS)) + motor.later;
}

uint32_t board_turntable_shorten(const uint32_t steps)
{
    const uint32_t words = pause_words();
    const uint32_t left = words / WORDS_PER_STEP;
    dma_stop(DMA_STEPS);
    const uint32_t kept = (left > steps) ? steps : left;
    start_words(words - WORDS_PER_STEP * (left - kept));  // and what belongs to a step begun
    motor.steps -= left - kept;
    return left - kept;
}

// Words that the machine has taken tell the steps; with all three of one taken, its place tells whether STEP has risen.
static uint32_t steps_made(const uint32_t waiting)
{
    const uint32_t taken = WORDS_PER_STEP * motor.steps - waiting - fifo_words();
    const uint32_t at = REGISTER(PIO_ADDRESS(PIO0, STEP_MACHINE));
    const bool before_rise = (at == LAMP_DELAY) || (at == LAMP_DELAY + 1U);
    return taken / WORDS_PER_STEP - (before_rise ? 1U : 0U);
}

void board_turntable_cut(void)
{
    CLEAR_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(STEP_MACHINE);
    REGISTER(SIO_GPIO_OUT_SET) = 1U << PIN_ENABLE;  // not before: no step is counted that the driver ignored
    if (motor.moving) {
        const uint32_t words = pause_words();
        dma_stop(DMA_STEPS);
        stand_at(steps_made(words));
    }
    for (uint32_t i = 0; i < 4U; i++) {
        REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = PULL_NO_BLOCK;
    }
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = MOV_PINS_NULL;
    SET_BITS(PIO_CTRL(PIO0)) = PIO_RESTART(STEP_MACHINE);
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = JMP(LAMP_IDLE);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(STEP_MACHINE);
}

bool board_turntable_moving(void)
{
    finish_when_done();
    return motor.moving;
}

// With DMA and in the FIFO. A word that goes from one to the other between the two readings is in neither, or in both:
// so they are read until two pairs agree, which take longer than it. Words go three at a time, once a step.
static uint32_t words_waiting(void)
{
    uint32_t with_dma = REGISTER(DMA_COUNT(DMA_STEPS));
    uint32_t in_fifo = fifo_words();
    for (bool same = false; !same;) {
        const uint32_t count = REGISTER(DMA_COUNT(DMA_STEPS));
        const uint32_t level = fifo_words();
        same = (count == with_dma) && (level == in_fifo);
        with_dma = count;
        in_fifo = level;
    }
    return with_dma + in_fifo + motor.later;
}

// While it moves: steps begun, one more or less.
int32_t board_turntable_position(void)
{
    finish_when_done();
    if (!motor.moving) {
        return motor.start;
    }
    return place_after(motor.steps - (words_waiting() + WORDS_PER_STEP - 1U) / WORDS_PER_STEP);
}

void turntable_start(void)
{
    REGISTER(PIO_EXECCTRL(PIO0, STEP_MACHINE)) = EXEC_WRAP(LAMP_DELAY, LAMP_LAST_PULL);
    REGISTER(PIO_PINCTRL(PIO0, STEP_MACHINE)) = PINS_OUT(PIN_STEP, 1U) | PINS_SET(PIN_STEP, 1U);
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = MOV_PINS_NULL;
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = SET_DIRECTIONS(1U);
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = JMP(LAMP_IDLE);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(STEP_MACHINE);
    pin_use(PIN_END_LOW, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    pin_use(PIN_END_HIGH, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    pin_use(PIN_STEP, FUNCTION_PIO0, PAD_DRIVE_4MA | PAD_PULL_DOWN);
}
