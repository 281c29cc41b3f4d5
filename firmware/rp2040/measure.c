// The controller looks at its own pins: a machine waits for an edge, lets some ticks go by, and then hands over the
// levels of four neighbouring pins in every tick, through DMA, until a look's worth is there. Outputs are seen as they
// stand at their pads, whoever drives them.
//
// Machine, FIFO and memory are the odometer's, which stands still meanwhile. Two looks have room: the first one, and
// the latest, which is compared with it; the first difference ends the measurement, so that it can be fetched.

#include <string.h>

#include "../board.h"
#include "../pins.h"
#include "hardware.h"
#include "registers.h"

#define LOOK_BYTES (4U * BOARD_LOOK_WORDS)
_Static_assert(2U * LOOK_BYTES == ODOMETER_RING_BYTES, "two looks fill the odometer's ring");

static struct {
    volatile uint32_t* ring;  // the odometer's, NULL while it counts
    board_look_t look;
    uint16_t taken;
    bool looking;
    bool differs;
} measure;

static void execute(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO1, ODOMETER_MACHINE)) = instruction;
}

static void halt(void)
{
    CLEAR_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(ODOMETER_MACHINE);
    dma_stop(DMA_ODOMETER);
    while ((REGISTER(PIO_FSTAT(PIO1)) & FSTAT_RX_EMPTY(ODOMETER_MACHINE)) == 0U) {
        (void)REGISTER(PIO_RX(PIO1, ODOMETER_MACHINE));
    }
    SET_BITS(PIO_CTRL(PIO1)) = PIO_RESTART(ODOMETER_MACHINE);  // its half-filled word
    measure.looking = false;
}

static void begin_look(void)
{
    halt();
    REGISTER(DMA_READ(DMA_ODOMETER)) = PIO_RX(PIO1, ODOMETER_MACHINE);
    REGISTER(DMA_WRITE(DMA_ODOMETER)) = (uint32_t)(uintptr_t)measure.ring + ((measure.taken > 0U) ? LOOK_BYTES : 0U);
    REGISTER(DMA_COUNT(DMA_ODOMETER)) = BOARD_LOOK_WORDS;
    REGISTER(DMA_CTRL_TRIGGER(DMA_ODOMETER)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_RX(1U, ODOMETER_MACHINE)) |
                                               DMA_CHAIN(DMA_ODOMETER) | DMA_INCREMENT_WRITE | DMA_WORDS |
                                               DMA_PRIORITY | DMA_ENABLE;
    execute(JMP(MEASURE_PROGRAM));
    SET_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(ODOMETER_MACHINE);
    measure.looking = true;
}

void board_measure(const board_look_t* const look)
{
    if ((look->looks == 0U) && (measure.ring == NULL)) {
        return;
    }
    measure.ring = odometer_lend();
    halt();
    if (look->looks == 0U) {
        measure.ring = NULL;
        odometer_start();
        return;
    }
    for (uint32_t pin = PIN_PROJECTOR; pin <= PIN_ENABLE; pin++) {
        SET_BITS(PAD(pin)) = PAD_INPUT;  // outputs, too
    }
    const bool rises = look->level != 0U;
    const uint16_t program[] = {
        MOV_X_OSR,
        rises ? WAIT_PIN_LOW(look->pin) : WAIT_PIN_HIGH(look->pin),
        rises ? WAIT_PIN_HIGH(look->pin) : WAIT_PIN_LOW(look->pin),
        JMP_X_DEC(MEASURE_PROGRAM + 3U),
        IN_PINS(4U),  // wraps to itself
    };
    pio_load(PIO1, MEASURE_PROGRAM, program, sizeof program / sizeof program[0]);
    REGISTER(PIO_EXECCTRL(PIO1, ODOMETER_MACHINE)) = EXEC_WRAP(MEASURE_PROGRAM + 4U, MEASURE_PROGRAM + 4U);
    REGISTER(PIO_SHIFTCTRL(PIO1, ODOMETER_MACHINE)) = SHIFT_AUTOPUSH;  // every 32 bits, in from the right
    REGISTER(PIO_PINCTRL(PIO1, ODOMETER_MACHINE)) = PINS_IN(look->first);
    REGISTER(PIO_TX(PIO1, ODOMETER_MACHINE)) = look->delay_ticks;
    execute(PULL_NO_BLOCK);
    measure.look = *look;
    measure.taken = 0;
    measure.differs = false;
    begin_look();
}

bool board_measuring(void)
{
    return measure.ring != NULL;
}

void board_measure_run(void)
{
    if (!measure.looking || ((REGISTER(DMA_CTRL(DMA_ODOMETER)) & DMA_BUSY) != 0U)) {
        return;
    }
    measure.looking = false;
    measure.taken++;
    for (uint32_t word = 0; (measure.taken > 1U) && (word < BOARD_LOOK_WORDS); word++) {
        measure.differs = measure.differs || (measure.ring[word] != measure.ring[BOARD_LOOK_WORDS + word]);
    }
    if ((measure.taken < measure.look.looks) && !measure.differs) {
        begin_look();
    }
}

uint16_t board_measured(const bool latest, const uint8_t word, uint8_t bits[const BOARD_SAMPLE_BYTES],
                        bool* const differs)
{
    *differs = measure.differs;
    const uint32_t from = word + (latest ? BOARD_LOOK_WORDS : 0U);
    for (uint32_t i = 0; (measure.ring != NULL) && (i < BOARD_SAMPLE_BYTES / 4U); i++) {
        const uint32_t samples = measure.ring[from + i];
        memcpy(&bits[4U * i], &samples, sizeof samples);
    }
    return measure.taken;
}
