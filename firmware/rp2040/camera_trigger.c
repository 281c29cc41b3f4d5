// Triggers for cameras: a machine of PIO0 that borrows the lamps' pulse, fed by two DMA channels. One moves the three
// words of a trigger, delay, width and level; the other then sets it to the first of them again.
//
// Of a clock of their own: the two feed the machine for ever, and the sync follower looks at the trigger's own pin. The
// end of a trigger is an edge like any other, stamped where all are and with the same way from pin to lamp.
//
// Begun by the sync input: each accepted edge's stamp sets the two off, once. Between two edges the machine has come to
// rest and its FIFO is empty, so that they never wait and the next stamp never waits for them.

#include "../board.h"
#include "../pins.h"
#include "hardware.h"
#include "registers.h"

#define WORDS 3U
#define WIDTH_OVERHEAD 2U   // ticks of a pulse that are not in its word
#define PERIOD_OVERHEAD 8U  // and of a period, beside pulse and delay

static uint32_t words[WORDS];
static const uint32_t* const first_word = words;  // what the second channel hands to the first

static board_trigger_t running;  // width 0: none

static void execute(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO0, CAMERA_MACHINE)) = instruction;
}

static void stop(void)
{
    CLEAR_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(CAMERA_MACHINE);
    if (running.delay_ticks == 0U) {
        CLEAR_BITS(DMA_CTRL(DMA_CAMERA_AGAIN)) = DMA_ENABLE;  // first: it would start the other again
        dma_stop(DMA_CAMERA);
        dma_stop(DMA_CAMERA_AGAIN);
    } else {
        REGISTER(DMA_CTRL(DMA_CAMERA)) = DMA_CHAIN(DMA_CAMERA);  // both are idle, and nothing sets them off
        REGISTER(DMA_CTRL(DMA_CAMERA_AGAIN)) = DMA_CHAIN(DMA_CAMERA_AGAIN);
    }
    for (uint32_t i = 0; i < 4U; i++) {
        execute(PULL_NO_BLOCK);
    }
    execute(MOV_PINS_NULL);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_RESTART(CAMERA_MACHINE);
    running.width_ticks = 0;
}

static void give(const uint32_t word)
{
    REGISTER(PIO_TX(PIO0, CAMERA_MACHINE)) = word;
    execute(PULL_NO_BLOCK);
}

// `then`: what a trigger's words in the machine set off in the end.
static void feed(const uint32_t then, const bool at_once)
{
    REGISTER(DMA_READ(DMA_CAMERA_AGAIN)) = (uint32_t)(uintptr_t)&first_word;
    REGISTER(DMA_WRITE(DMA_CAMERA_AGAIN)) = DMA_READ(DMA_CAMERA);
    REGISTER(DMA_COUNT(DMA_CAMERA_AGAIN)) = 1U;
    REGISTER(DMA_CTRL(DMA_CAMERA_AGAIN)) =
        DMA_QUIET | DMA_REQUEST(DREQ_ALWAYS) | DMA_CHAIN(then) | DMA_WORDS | DMA_ENABLE;
    REGISTER(DMA_READ(DMA_CAMERA)) = (uint32_t)(uintptr_t)words;
    REGISTER(DMA_WRITE(DMA_CAMERA)) = PIO_TX(PIO0, CAMERA_MACHINE);
    REGISTER(DMA_COUNT(DMA_CAMERA)) = WORDS;
    REGISTER(at_once ? DMA_CTRL_TRIGGER(DMA_CAMERA) : DMA_CTRL(DMA_CAMERA)) =
        DMA_QUIET | DMA_REQUEST(DREQ_PIO_TX(0U, CAMERA_MACHINE)) | DMA_CHAIN(DMA_CAMERA_AGAIN) | DMA_INCREMENT_READ |
        DMA_WORDS | DMA_ENABLE;
}

static void run_by_itself(void)
{
    words[0] = running.period_ticks - running.width_ticks - PERIOD_OVERHEAD;
    // The first trigger begins by hand, before anybody looks: a pin that is followed must stand high.
    give(0U);
    execute(MOV_X_OSR);
    give(words[1]);
    execute(MOV_Y_OSR);
    give(words[2]);
    execute(MOV_PINS_OSR);
    execute(JMP(LAMP_DELAY));
    // The end of the first trigger may come before a flash is loaded, and begins no hold-off of the sync input's: half
    // a period is the shortest that a tolerance allows, and shorter than from trigger to trigger.
    lamps_follow(PIN_CAMERA_TRIGGER, running.period_ticks / 2U, DMA_STAMP);
    feed(DMA_CAMERA, true);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(CAMERA_MACHINE);
}

static void run_by_edges(void)
{
    words[0] = running.delay_ticks;
    execute(JMP(LAMP_IDLE));
    feed(DMA_STAMP, false);
    SET_BITS(PIO_CTRL(PIO0)) = PIO_MACHINE(CAMERA_MACHINE);
    lamps_follow(PIN_SYNC, running.delay_ticks + running.width_ticks + CAMERA_TRIGGER_MIN_TICKS, DMA_CAMERA);
}

static bool runs_already(const board_trigger_t* const trigger)
{
    const bool clock = (trigger->delay_ticks != 0U) || (running.period_ticks == trigger->period_ticks);
    return (running.width_ticks == trigger->width_ticks) &&
           ((trigger->width_ticks == 0U) || ((running.delay_ticks == trigger->delay_ticks) && clock));
}

void board_camera_trigger(const board_trigger_t* const trigger)
{
    if (runs_already(trigger)) {
        return;
    }
    if (running.width_ticks != 0U) {
        lamps_follow(PIN_SYNC, 0U, DMA_STAMP);
        stop();
    }
    if (trigger->width_ticks == 0U) {
        return;
    }
    running = *trigger;
    words[1] = running.width_ticks - WIDTH_OVERHEAD;
    words[2] = 1U;
    if (running.delay_ticks == 0U) {
        run_by_itself();
    } else {
        run_by_edges();
    }
}

// The pin is driven once a configuration says with which polarity.
void camera_trigger_start(void)
{
    REGISTER(PIO_EXECCTRL(PIO0, CAMERA_MACHINE)) = EXEC_WRAP(LAMP_DELAY, LAMP_LAST_PULL);
    REGISTER(PIO_PINCTRL(PIO0, CAMERA_MACHINE)) = PINS_OUT(PIN_CAMERA_TRIGGER, 1U) | PINS_SET(PIN_CAMERA_TRIGGER, 1U);
    execute(MOV_PINS_NULL);
    execute(SET_DIRECTIONS(1U));
}
