// Who has which pin, the pins at rest, and the inputs and the light that are no peripheral's.

#include "../board.h"
#include "../core/messages.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

static volatile uint32_t sync_edges;
static volatile bool interlock_opened;
static volatile bool hurried;
static bool antivalent;  // the interlock has a second input
static volatile uint32_t ends_touched;

#define END_LOW EDGE_HIGH(PIN_END_LOW - 8U)  // as pins 8..15 tell their edges
#define END_HIGH EDGE_HIGH(PIN_END_HIGH - 8U)
#define VBUS_EDGES (EDGE_LOW(PIN_VBUS - 24U) | EDGE_HIGH(PIN_VBUS - 24U))
#define ANTIVALENT_LOW EDGE_LOW(PIN_INTERLOCK_ANTIVALENT - 8U)

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
        hurried = true;
    }
    const uint32_t others = REGISTER(IO_INTR1) & (END_LOW | END_HIGH | ANTIVALENT_LOW);
    REGISTER(IO_INTR1) = others;
    ends_touched = ends_touched | (others & (END_LOW | END_HIGH));
    const uint32_t vbus = REGISTER(IO_INTR3) & VBUS_EDGES;
    if (vbus != 0U) {
        REGISTER(IO_INTR3) = vbus;
        hurried = true;
        variant_vbus_edge((vbus & EDGE_LOW(PIN_VBUS - 24U)) != 0U);
    }
    if (antivalent && ((others & ANTIVALENT_LOW) != 0U)) {
        interlock_opened = true;
        hurried = true;
    }
}

bool pinuse_hurries(void)
{
    const bool due = hurried;
    hurried = false;
    return due;
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

void board_interlock_watch(const bool second)
{
    REGISTER(NVIC_DISABLE) = 1U << IRQ_IO_BANK0;
    antivalent = second;
    interlock_opened = false;
    REGISTER(IO_INTR1) = ANTIVALENT_LOW;
    REGISTER(IO_PROC0_INTE1) = (REGISTER(IO_PROC0_INTE1) & (END_LOW | END_HIGH)) | (second ? ANTIVALENT_LOW : 0U);
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
    guard_watch(second);
}

uint8_t board_interlock(void)
{
    const uint32_t levels = REGISTER(SIO_GPIO_IN);
    const bool first_open = ((levels >> PIN_INTERLOCK) & 1U) != 0U;
    const bool second_open = antivalent && (((levels >> PIN_INTERLOCK_ANTIVALENT) & 1U) == 0U);
    return (uint8_t)((antivalent ? INTERLOCK_ANTIVALENT : 0U) | (first_open ? INTERLOCK_OPEN : 0U) |
                     (second_open ? INTERLOCK_ANTIVALENT_OPEN : 0U));
}

bool board_interlock_tripped(void)
{
    REGISTER(NVIC_DISABLE) = 1U << IRQ_IO_BANK0;
    const bool tripped = interlock_opened;
    interlock_opened = false;
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
    return tripped;
}

// Edges of switches that are not there never interrupt.
void board_turntable_watch(const uint8_t switches)
{
    const uint32_t edges = (((switches & TURNTABLE_END_LOW) != 0U) ? END_LOW : 0U) |
                           (((switches & TURNTABLE_END_HIGH) != 0U) ? END_HIGH : 0U);
    REGISTER(IO_PROC0_INTE1) = edges | (antivalent ? ANTIVALENT_LOW : 0U);
    REGISTER(IO_INTR1) = END_LOW | END_HIGH;
    ends_touched = 0;
}

uint8_t board_turntable_reached(void)
{
    REGISTER(NVIC_DISABLE) = 1U << IRQ_IO_BANK0;
    const uint32_t touched = ends_touched;
    ends_touched = 0;
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
    const uint32_t levels = REGISTER(SIO_GPIO_IN);
    const uint32_t watched = REGISTER(IO_PROC0_INTE1);  // of the interlock too, which is none of these bits
    const bool low = ((touched & END_LOW) != 0U) || (((levels >> PIN_END_LOW) & 1U) != 0U);
    const bool high = ((touched & END_HIGH) != 0U) || (((levels >> PIN_END_HIGH) & 1U) != 0U);
    return (uint8_t)(((low && ((watched & END_LOW) != 0U)) ? TURNTABLE_END_LOW : 0U) |
                     ((high && ((watched & END_HIGH) != 0U)) ? TURNTABLE_END_HIGH : 0U));
}

void board_status_light(const bool on)
{
    const bool lit = on && (board_kind() != BOARD_KIND_PICO_W);  // there it is the radio's select line
    REGISTER(lit ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLEAR) = 1U << PIN_STATUS;
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
    pin_use(PIN_INTERLOCK_ANTIVALENT, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_DOWN);
    REGISTER(IO_INTR0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
    REGISTER(IO_PROC0_INTE0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
    variant_start();
    if (board_kind() == BOARD_KIND_PICO) {
        REGISTER(IO_INTR3) = VBUS_EDGES;
        REGISTER(IO_PROC0_INTE3) = VBUS_EDGES;
    }
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
}
