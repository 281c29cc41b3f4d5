// Triggers for cameras: a machine of PIO0 that borrows the lamps' pulse, fed for ever by two DMA channels. One moves
// the three words of a period, delay, width and level; the other then sets it to the first of them again.
//
// The sync follower looks at the trigger's own pin: the end of a trigger is an edge like any other, stamped where all
// are and with the same way from pin to lamp.

#include "../board.h"
#include "../pins.h"
#include "hardware.h"
#include "registers.h"

#define WORDS 3U
#define WIDTH_OVERHEAD 2U   // ticks of a pulse that are not in its word
#define PERIOD_OVERHEAD 8U  // and of a period, beside pulse and delay

static uint32_t words[WORDS];
static const uint32_t* const first_word = words;  // what the second channel hands to the first

static struct {
    uint32_t period;
    uint32_t width;  // 0: none runs
} running;

static void execute(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO0, CAMERA_MACHINE)) = instruction;
}

static void stop(void)
{
    CLEAR_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(CAMERA_MACHINE);
    CLEAR_BITS(DMA_CTRL(DMA_CAMERA_AGAIN)) = DMA_ENABLE;  // first: it would start the other again
    dma_stop(DMA_CAMERA);
    dma_stop(DMA_CAMERA_AGAIN);
    for (uint32_t i = 0; i < 4U; i++) {
        execute(PULL_NO_BLOCK);
    }
    execute(MOV_PINS_NULL);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_RESTART(CAMERA_MACHINE);
    running.width = 0;
}

static void give(const uint32_t word)
{
    REGISTER(PIO_TX(PIO0, CAMERA_MACHINE)) = word;
    execute(PULL_NO_BLOCK);
}

static void feed(void)
{
    REGISTER(DMA_READ(DMA_CAMERA_AGAIN)) = (uint32_t)(uintptr_t)&first_word;
    REGISTER(DMA_WRITE(DMA_CAMERA_AGAIN)) = DMA_READ(DMA_CAMERA);
    REGISTER(DMA_COUNT(DMA_CAMERA_AGAIN)) = 1U;
    REGISTER(DMA_CTRL(DMA_CAMERA_AGAIN)) =
        DMA_QUIET | DMA_REQUEST(DREQ_ALWAYS) | DMA_CHAIN(DMA_CAMERA) | DMA_WORDS | DMA_ENABLE;
    REGISTER(DMA_READ(DMA_CAMERA)) = (uint32_t)(uintptr_t)words;
    REGISTER(DMA_WRITE(DMA_CAMERA)) = PIO_TX(PIO0, CAMERA_MACHINE);
    REGISTER(DMA_COUNT(DMA_CAMERA)) = WORDS;
    REGISTER(DMA_CTRL_TRIGGER(DMA_CAMERA)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_TX(0U, CAMERA_MACHINE)) |
                                             DMA_CHAIN(DMA_CAMERA_AGAIN) | DMA_INCREMENT_READ | DMA_WORDS | DMA_ENABLE;
}

void board_camera_trigger(const uint32_t period_ticks, const uint32_t width_ticks)
{
    if ((running.width == width_ticks) && ((width_ticks == 0U) || (running.period == period_ticks))) {
        return;
    }
    if (running.width != 0U) {
        lamps_follow(PIN_SYNC, 0U);
        stop();
    }
    if (width_ticks == 0U) {
        return;
    }
    running.period = period_ticks;
    running.width = width_ticks;
    words[0] = period_ticks - width_ticks - PERIOD_OVERHEAD;
    words[1] = width_ticks - WIDTH_OVERHEAD;
    words[2] = 1U;
    // The first trigger begins by hand, before anybody looks: a pin that is followed must stand high.
    give(0U);
    execute(MOV_X_OSR);
    give(words[1]);
    execute(MOV_Y_OSR);
    give(words[2]);
    execute(MOV_PINS_OSR);
    execute(JMP(LAMP_DELAY));
    lamps_follow(PIN_CAMERA_TRIGGER, period_ticks);
    feed();
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(CAMERA_MACHINE);
}

// The pin is driven once a configuration says with which polarity.
void camera_trigger_start(void)
{
    REGISTER(PIO_EXECCTRL(PIO0, CAMERA_MACHINE)) = EXEC_WRAP(LAMP_DELAY, LAMP_LAST_PULL);
    REGISTER(PIO_PINCTRL(PIO0, CAMERA_MACHINE)) = PINS_OUT(PIN_CAMERA_TRIGGER, 1U) | PINS_SET(PIN_CAMERA_TRIGGER, 1U);
    execute(MOV_PINS_NULL);
    execute(SET_DIRECTIONS(1U));
}
