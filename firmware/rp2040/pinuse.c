// Who has which pin, the pins at rest, and the inputs and the light that are no peripheral's.

#include "../board.h"
#include "../core/messages.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

// Outputs whose driver may want the other level. Each is made by PIO, which knows nothing of it: the pad inverts.
static const struct {
    uint8_t flag;  // POLARITY_*
    uint8_t pin;
    uint8_t function;
    uint8_t slide;  // of which it is the lamp's, from 0; of other lamps 0
} gates[] = {{POLARITY_PROJECTOR, PIN_PROJECTOR, FUNCTION_PIO0, 0},
             {POLARITY_PROJECTOR, PIN_SLIDE_2, FUNCTION_PIO0, 1},
             {POLARITY_PROJECTOR, PIN_SLIDE_3, FUNCTION_PIO0, 2},
             {POLARITY_PROJECTOR, PIN_SLIDE_4, FUNCTION_PIO0, 3},
             {POLARITY_LED, PIN_LED, FUNCTION_PIO0, 0},
             {POLARITY_MICROWAVE, PIN_MICROWAVE, FUNCTION_PIO1, 0},
             {POLARITY_TRIGGER, PIN_TRIGGER, FUNCTION_PIO1, 0},
             {POLARITY_CAMERA_TRIGGER, PIN_CAMERA_TRIGGER, FUNCTION_PIO0, 0}};
#define GATES (sizeof gates / sizeof gates[0])

static uint8_t gates_driven;
static uint8_t gates_inverted;  // those of the driven ones
static uint8_t slides_driven;   // beside the first
static volatile uint32_t sync_edges;
static volatile bool interlock_opened;
static volatile bool hurried;
static volatile uint32_t interrupts;  // of this round
static bool antivalent;               // the interlock has a second input
static volatile uint32_t ends_touched;

// Of 1 us or so. A wire that rings has no more of them: what comes then waits, latched, for the next round, and of the
// sync input's edges some are not counted.
#define INTERRUPTS_A_ROUND 64U

#define END_LOW EDGE_HIGH(PIN_END_LOW - 8U)  // as pins 8..15 tell their edges
#define END_HIGH EDGE_HIGH(PIN_END_HIGH - 8U)
#define VBUS_EDGES (EDGE_LOW(PIN_VBUS - 24U) | EDGE_HIGH(PIN_VBUS - 24U))
#define ANTIVALENT_LOW EDGE_LOW(PIN_INTERLOCK_ANTIVALENT - 8U)

// Polarity before function: the pad is not driven before it would show its dark level. The pad's own pull goes with the
// resistor outside.
static void drive_gate(const size_t gate, const bool inverted)
{
    const uint32_t pin = gates[gate].pin;
    const bool followed = gates[gate].flag == POLARITY_CAMERA_TRIGGER;  // by the sync follower: as if never inverted
    const uint32_t over = inverted ? OUT_INVERT | (followed ? IN_INVERT : 0U) : 0U;
    const uint32_t looks = followed ? PAD_INPUT : REGISTER(PAD(pin)) & PAD_INPUT;  // whoever measures goes on
    REGISTER(GPIO_CTRL(pin)) = FUNCTION_NONE | over;
    REGISTER(PAD(pin)) = PAD_DRIVE_4MA | (inverted ? PAD_PULL_UP : PAD_PULL_DOWN) | looks;
    REGISTER(GPIO_CTRL(pin)) = gates[gate].function | over;
}

// Does the interrupt see the pad or what the override makes of it? The datasheet does not say in so many words, and it
// does not matter here: an edge each pulse is counted, and a loop that was not woken comes 100 us later.
void board_polarity(const uint8_t pins, const uint8_t inverted)
{
    for (size_t gate = 0; gate < GATES; gate++) {
        const uint8_t flag = gates[gate].flag;
        const bool stands = ((gates_driven & flag) != 0U) && (((gates_inverted ^ inverted) & flag) == 0U);
        if (((pins & flag) != 0U) && !stands && (gates[gate].slide <= slides_driven)) {
            drive_gate(gate, (inverted & flag) != 0U);
        }
    }
    gates_driven |= pins & POLARITY_OUTPUTS;
    gates_inverted = (uint8_t)((gates_inverted & ~pins) | (inverted & pins));
    if ((pins & POLARITY_SYNC) != 0U) {
        const bool sync = (inverted & POLARITY_SYNC) != 0U;
        REGISTER(PAD(PIN_SYNC)) = PAD_INPUT | PAD_SCHMITT | (sync ? PAD_INPUT_PULL_DOWN : PAD_PULL_UP);
        REGISTER(GPIO_CTRL(PIN_SYNC)) = FUNCTION_SIO | (sync ? IN_INVERT : 0U);
    }
}

// A head without slides may have anything on their pins: nothing is driven there before a host wants it.
void board_slides(const uint8_t count)
{
    for (size_t gate = 0; gate < GATES; gate++) {
        if ((gates[gate].slide > slides_driven) && (gates[gate].slide < count)) {
            drive_gate(gate, (gates_inverted & gates[gate].flag) != 0U);
        }
    }
    if (slides_driven + 1U < count) {
        slides_driven = (uint8_t)(count - 1U);
    }
}

uint8_t board_slides_driven(void)
{
    return ((gates_driven & POLARITY_PROJECTOR) != 0U) ? slides_driven + 1U : 0U;
}

uint8_t board_driven(void)
{
    return gates_driven;
}

// PIO in reset would let them go: they are held dark by the pads themselves, until the reset of everything.
void pinuse_darken(void)
{
    for (size_t gate = 0; gate < GATES; gate++) {
        if (((gates_driven & gates[gate].flag) != 0U) && (gates[gate].slide <= slides_driven)) {
            const uint32_t dark = ((gates_inverted & gates[gate].flag) != 0U) ? OUT_HIGH : OUT_LOW;
            REGISTER(GPIO_CTRL(gates[gate].pin)) = gates[gate].function | OUT_ENABLED | dark;
        }
    }
}

// Counts what the sync follower may refuse, and remembers an interlock that opened however briefly.
void pins_handler(void)
{
    const uint32_t edges = REGISTER(IO_INTR0) & REGISTER(IO_PROC0_INTE0);
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
        if ((vbus & EDGE_LOW(PIN_VBUS - 24U)) != 0U) {
            variant_vbus_gone();
            usb_let_go();  // D+ does not wait for the main loop, which this wakes
        }
    }
    if (antivalent && ((others & ANTIVALENT_LOW) != 0U)) {
        interlock_opened = true;
        hurried = true;
    }
    interrupts = interrupts + 1U;
    if (interrupts >= INTERRUPTS_A_ROUND) {
        irq_disable(IRQ_IO_BANK0);
    }
}

void pinuse_run(void)
{
    interrupts = 0;
    irq_enable(IRQ_IO_BANK0);
}

bool pinuse_hurries(void)
{
    const bool due = hurried;
    hurried = false;
    return due;
}

uint32_t pinuse_sync_edges(const uint32_t accepted)
{
    irq_disable(IRQ_IO_BANK0);
    if ((int32_t)(sync_edges - accepted) < 0) {
        sync_edges = accepted;
    }
    const uint32_t counted = sync_edges;
    irq_enable(IRQ_IO_BANK0);
    return counted;
}

void pinuse_count_sync(const bool counts, const uint32_t before)
{
    const uint32_t edges = EDGE_HIGH(PIN_INTERLOCK) | (counts ? EDGE_LOW(PIN_SYNC) : 0U);
    REGISTER(IO_INTR0) = EDGE_LOW(PIN_SYNC);
    if (counts) {
        sync_edges = before;
    }
    REGISTER(IO_PROC0_INTE0) = edges;
}

void pinuse_watch_interlock(const bool second)
{
    irq_disable(IRQ_IO_BANK0);
    antivalent = second;
    REGISTER(IO_INTR1) = ANTIVALENT_LOW;
    REGISTER(IO_PROC0_INTE1) = (REGISTER(IO_PROC0_INTE1) & (END_LOW | END_HIGH)) | (second ? ANTIVALENT_LOW : 0U);
    irq_enable(IRQ_IO_BANK0);
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
    irq_disable(IRQ_IO_BANK0);
    const bool tripped = interlock_opened;
    interlock_opened = false;
    irq_enable(IRQ_IO_BANK0);
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
    irq_disable(IRQ_IO_BANK0);
    const uint32_t touched = ends_touched;
    ends_touched = 0;
    irq_enable(IRQ_IO_BANK0);
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
    pin_use(PIN_INTERLOCK_ANTIVALENT, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_INPUT_PULL_DOWN);
    REGISTER(IO_INTR0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
    REGISTER(IO_PROC0_INTE0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
    variant_start();
    if (variant_senses_vbus()) {
        REGISTER(IO_INTR3) = VBUS_EDGES;
        REGISTER(IO_PROC0_INTE3) = VBUS_EDGES;
    }
    irq_enable(IRQ_IO_BANK0);
}
