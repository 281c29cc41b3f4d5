// Steps for the turntable: a machine of PIO0 that borrows the lamps' pulse, fed by DMA with one and the same word.

#include "../board.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

// A step is the words delay, width, level; they may be one word as long as it is odd: level 1.
#define WORDS_PER_STEP 3U
#define STEP_OVERHEAD 10U

static volatile uint32_t half_period;  // the word, where DMA reads it again and again

static struct {
    int32_t start;
    int32_t target;
    bool hold;
    bool moving;
} motor;

static uint32_t steps_of(const int32_t from, const int32_t to)
{
    return (to > from) ? (uint32_t)to - (uint32_t)from : (uint32_t)from - (uint32_t)to;
}

static void finish_when_done(void)
{
    const bool fed = (REGISTER(DMA_CTRL(DMA_STEPS)) & DMA_BUSY) == 0U;
    const bool empty = ((REGISTER(PIO_FLEVEL(PIO0)) >> (8U * STEP_MACHINE)) & 0xFU) == 0U;
    if (motor.moving && fed && empty && (REGISTER(PIO_ADDRESS(PIO0, STEP_MACHINE)) == LAMP_IDLE)) {
        motor.moving = false;
        motor.start = motor.target;
        REGISTER(motor.hold ? SIO_GPIO_OUT_CLEAR : SIO_GPIO_OUT_SET) = 1U << PIN_ENABLE;
    }
}

void board_turntable_move(const int32_t position, const uint32_t period_ticks, const bool hold)
{
    motor.target = position;
    motor.hold = hold;
    motor.moving = true;
    REGISTER((position >= motor.start) ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLEAR) = 1U << PIN_DIRECTION;
    REGISTER(SIO_GPIO_OUT_CLEAR) = 1U << PIN_ENABLE;
    half_period = ((period_ticks - STEP_OVERHEAD) / 2U) | 1U;
    const uint32_t words = WORDS_PER_STEP * steps_of(motor.start, position);
    if (words > 0U) {
        REGISTER(DMA_READ(DMA_STEPS)) = (uint32_t)(uintptr_t)&half_period;
        REGISTER(DMA_WRITE(DMA_STEPS)) = PIO_TX(PIO0, STEP_MACHINE);
        REGISTER(DMA_COUNT(DMA_STEPS)) = words;
        REGISTER(DMA_CTRL_TRIGGER(DMA_STEPS)) =
            DMA_QUIET | DMA_REQUEST(DREQ_PIO_TX(0U, STEP_MACHINE)) | DMA_CHAIN(DMA_STEPS) | DMA_WORDS | DMA_ENABLE;
    }
}

bool board_turntable_moving(void)
{
    finish_when_done();
    return motor.moving;
}

// While it moves: steps begun, one more or less.
int32_t board_turntable_position(void)
{
    finish_when_done();
    if (!motor.moving) {
        return motor.start;
    }
    const uint32_t waiting =
        REGISTER(DMA_COUNT(DMA_STEPS)) + ((REGISTER(PIO_FLEVEL(PIO0)) >> (8U * STEP_MACHINE)) & 0xFU);
    const uint32_t left = (waiting + WORDS_PER_STEP - 1U) / WORDS_PER_STEP;
    return (motor.target > motor.start) ? motor.target - (int32_t)left : motor.target + (int32_t)left;
}

void turntable_start(void)
{
    REGISTER(PIO_EXECCTRL(PIO0, STEP_MACHINE)) = EXEC_WRAP(LAMP_DELAY, LAMP_LAST_PULL);
    REGISTER(PIO_PINCTRL(PIO0, STEP_MACHINE)) = PINS_OUT(PIN_STEP, 1U) | PINS_SET(PIN_STEP, 1U);
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = MOV_PINS_NULL;
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = SET_DIRECTIONS(1U);
    REGISTER(PIO_INSTRUCTION(PIO0, STEP_MACHINE)) = JMP(LAMP_IDLE);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(STEP_MACHINE);
    pin_use(PIN_STEP, FUNCTION_PIO0, PAD_DRIVE_4MA | PAD_PULL_DOWN);
}
