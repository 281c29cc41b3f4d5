// Who has which pin, the pins at rest, and the inputs and the light that are no peripheral's.

#include "../board.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

static volatile uint32_t sync_edges;
static volatile bool interlock_opened;

void pin_use(const uint32_t pin, const uint32_t function, const uint32_t pad)
{
    REGISTER(PAD(pin)) = pad;
    REGISTER(GPIO_CTRL(pin)) = function;
}

void pio_load(const uint32_t pio, const uint32_t first, const uint16_t* const program, const uint32_t length)
{
    for (uint32_t i = 0; i < length; i++) {
        REGISTER(PIO_MEMORY(pio, first + i)) = program[i];
    }
}

// Counts what the sync follower may refuse, and remembers an interlock that opened however briefly.
void pins_handler(void)
{
    const uint32_t edges = REGISTER(IO_INTR0) & (EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK));
    REGISTER(IO_INTR0) = edges;
    if ((edges & EDGE_LOW(PIN_SYNC)) != 0U) {
        sync_edges = sync_edges + 1U;
    }
    if ((edges & EDGE_HIGH(PIN_INTERLOCK)) != 0U) {
        interlock_opened = true;
    }
}

uint32_t pinuse_sync_edges(const uint32_t accepted)
{
    REGISTER(NVIC_DISABLE) = 1U << IRQ_IO_BANK0;
    if ((int32_t)(sync_edges - accepted) < 0) {
        sync_edges = accepted;
    }
    const uint32_t counted = sync_edges;
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
    return counted;
}

bool board_interlock_open(void)
{
    return ((REGISTER(SIO_GPIO_IN) >> PIN_INTERLOCK) & 1U) != 0U;
}

bool board_interlock_tripped(void)
{
    REGISTER(NVIC_DISABLE) = 1U << IRQ_IO_BANK0;
    const bool tripped = interlock_opened;
    interlock_opened = false;
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
    return tripped;
}

void board_status_light(const bool on)
{
    REGISTER(on ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLEAR) = 1U << PIN_STATUS;
}

void pinuse_start(void)
{
    // Levels before directions, directions before functions: no output ever shows anything but its level at rest.
    REGISTER(SIO_GPIO_OUT_CLEAR) = (1U << PIN_DIRECTION) | (1U << PIN_STATUS);
    REGISTER(SIO_GPIO_OUT_SET) = 1U << PIN_ENABLE;
    REGISTER(SIO_GPIO_OE_SET) = (1U << PIN_DIRECTION) | (1U << PIN_STATUS) | (1U << PIN_ENABLE);
    pin_use(PIN_DIRECTION, FUNCTION_SIO, PAD_DRIVE_4MA | PAD_PULL_DOWN);
    pin_use(PIN_ENABLE, FUNCTION_SIO, PAD_DRIVE_4MA | PAD_PULL_UP);
    pin_use(PIN_STATUS, FUNCTION_SIO, PAD_DRIVE_4MA | PAD_PULL_DOWN);
    pin_use(PIN_SYNC, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    pin_use(PIN_INTERLOCK, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    REGISTER(IO_INTR0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
    REGISTER(IO_PROC0_INTE0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
}
