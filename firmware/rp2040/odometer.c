// The odometer: a machine of PIO1 that says when either line changes, and DMA that keeps what it said.
//
// A DMA channel's count ends. It is 2^27 transitions, a multiple of the ring (an RP2350 counts to 2^28), and when they
// are over a second channel starts the first one anew: its count then stands at 2^27 again, which is the same place in
// the ring.

#include "../pins.h"
#include "../quadrature.h"
#include "hardware.h"
#include "registers.h"

#define RING_BITS 9U

static volatile uint8_t ring[QUADRATURE_KEPT] __attribute__((aligned(QUADRATURE_KEPT)));
static quadrature_t odometer;
static bool is_lent;
static volatile uint32_t nothing;  // what the second channel moves

uint32_t odometer_transitions(const uint32_t count)
{
    return quadrature_between(count, QUADRATURE_WRAP);
}

// While it is lent, what its channel counts is no transition.
uint32_t odometer_now(void)
{
    return is_lent ? odometer.decoded : odometer_transitions(REGISTER(DMA_COUNT(DMA_ODOMETER)));
}

int32_t odometer_decode(const uint32_t until)
{
    return quadrature_decode(&odometer, ring, until, odometer_now);
}

const quadrature_t* odometer_state(void)
{
    return &odometer;
}

volatile uint32_t* odometer_lend(void)
{
    odometer_decode(odometer_now());
    is_lent = true;
    return (volatile uint32_t*)(uintptr_t)ring;
}

static void start_channels(void)
{
    REGISTER(DMA_READ(DMA_ODOMETER_AGAIN)) = (uint32_t)(uintptr_t)&nothing;
    REGISTER(DMA_WRITE(DMA_ODOMETER_AGAIN)) = (uint32_t)(uintptr_t)&nothing;
    REGISTER(DMA_COUNT(DMA_ODOMETER_AGAIN)) = 1U;
    REGISTER(DMA_CTRL(DMA_ODOMETER_AGAIN)) =
        DMA_QUIET | DMA_REQUEST(DREQ_ALWAYS) | DMA_CHAIN(DMA_ODOMETER) | DMA_WORDS | DMA_PRIORITY | DMA_ENABLE;
    REGISTER(DMA_READ(DMA_ODOMETER)) = PIO_RX(PIO1, ODOMETER_MACHINE);
    REGISTER(DMA_WRITE(DMA_ODOMETER)) = (uint32_t)(uintptr_t)ring;
    REGISTER(DMA_COUNT(DMA_ODOMETER)) = QUADRATURE_WRAP;
    REGISTER(DMA_CTRL_TRIGGER(DMA_ODOMETER)) = DMA_QUIET | DMA_REQUEST(DREQ_PIO_RX(1U, ODOMETER_MACHINE)) |
                                               DMA_CHAIN(DMA_ODOMETER_AGAIN) | DMA_RING_WRITE | DMA_RING(RING_BITS) |
                                               DMA_INCREMENT_WRITE | DMA_PRIORITY | DMA_ENABLE;
}

void odometer_start(void)
{
    static const uint16_t counter[ODOMETER_PROGRAM_LENGTH] = {
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
    start_channels();
    is_lent = false;
    odometer.decoded = 0;
    odometer.state = (uint8_t)((REGISTER(SIO_GPIO_IN) >> PIN_ODOMETER_A) & 3U);
    REGISTER(PIO_TX(PIO1, machine)) = odometer.state;
    REGISTER(PIO_INSTRUCTION(PIO1, machine)) = PULL_NO_BLOCK;
    REGISTER(PIO_INSTRUCTION(PIO1, machine)) = MOV_Y_OSR;
    REGISTER(PIO_INSTRUCTION(PIO1, machine)) = JMP(ODOMETER_PROGRAM);
    SET_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(machine);
}
