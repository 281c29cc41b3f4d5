// Levels of the pins, what became of them, and the inputs and the light that are no peripheral's.

#include <string.h>

#include "hardware.h"

#define TRANSITIONS_MAX (1U << 17)

static native_transition_t transitions[TRANSITIONS_MAX];  // ring
static size_t transition_first;
static size_t transition_count;
static bool antivalent;  // the interlock has a second input
static bool interlock_tripped;
static uint8_t ends_watched;
static uint8_t ends_touched;
static uint8_t wires[PIN_COUNT];   // the input an output drives, a tick later; 0 = none
static uint8_t pulls[PIN_COUNT];   // an output's level while nobody drives it
static uint8_t driven[PIN_COUNT];  // an output's level by whoever makes it, before the pad inverts it
static uint8_t gates_driven;       // POLARITY_*
static uint8_t slides_driven;      // beside the first, which is the projector's gate

static uint8_t polarity_of(const uint8_t pin)
{
    static const uint8_t flags[PIN_COUNT] = {
        [PIN_SYNC] = POLARITY_SYNC,         [PIN_PROJECTOR] = POLARITY_PROJECTOR,
        [PIN_LED] = POLARITY_LED,           [PIN_MICROWAVE] = POLARITY_MICROWAVE,
        [PIN_TRIGGER] = POLARITY_TRIGGER,   [PIN_CAMERA_TRIGGER] = POLARITY_CAMERA_TRIGGER,
        [PIN_SLIDE_2] = POLARITY_PROJECTOR, [PIN_SLIDE_3] = POLARITY_PROJECTOR,
        [PIN_SLIDE_4] = POLARITY_PROJECTOR};
    return flags[pin];
}

static bool is_inverted(const uint8_t pin)
{
    return (world.inverted & polarity_of(pin)) != 0U;
}

void native_wire(const uint8_t from, const uint8_t to)
{
    if (from < PIN_COUNT) {
        wires[from] = to;
        if (to != 0U) {
            native_input(world.now, to, world.levels[from]);
        }
    }
}

void pinuse_begin(void)
{
    for (uint8_t pin = 0; pin < PIN_COUNT; pin++) {
        world.levels[pin] = (HIGH_AT_RESET_PINS >> pin) & 1U;
        pulls[pin] = world.levels[pin];
        driven[pin] = world.levels[pin];
    }
    transition_count = 0;
    gates_driven = 0;
    slides_driven = 0;
    world.inverted = 0;
    memset(wires, 0, sizeof wires);
}

// What stands at the pad.
static void set_level(const uint8_t pin, const uint8_t level)
{
    if (world.levels[pin] == level) {
        return;
    }
    measure_before();
    world.levels[pin] = level;
    measure_after(pin, level);
    if (wires[pin] != 0U) {
        native_input(world.now + 1U, wires[pin], level);
    }
    if (transition_count == TRANSITIONS_MAX) {
        world.lost.transitions++;
        return;
    }
    const size_t at = (transition_first + transition_count++) % TRANSITIONS_MAX;
    transitions[at] = (native_transition_t){.tick = world.now, .pin = pin, .level = level};
}

static void settle(const uint8_t pin)
{
    const uint8_t gate = polarity_of(pin);
    const bool is_idle = (pin >= PIN_SLIDE_2) && (pin <= PIN_SLIDE_4) && (pin >= PIN_SLIDE_2 + slides_driven);
    const bool is_free = (gate != 0U) && (((gates_driven & gate) == 0U) || is_idle);
    const uint8_t level = is_inverted(pin) ? !driven[pin] : driven[pin];
    set_level(pin, is_free ? pulls[pin] : level);
}

void pinuse_drive(const uint8_t pin, const uint8_t level)
{
    driven[pin] = level;
    settle(pin);
}

uint8_t pinuse_driven(const uint8_t pin)
{
    return driven[pin];
}

uint8_t pinuse_seen(const uint8_t pin)
{
    return is_inverted(pin) ? !world.levels[pin] : world.levels[pin];
}

void native_pull(const uint8_t pin, const uint8_t level)
{
    if ((pin < PIN_COUNT) && (((OUTPUT_PINS >> pin) & 1U) != 0U)) {
        pulls[pin] = (level != 0U) ? 1U : 0U;
        settle(pin);
    }
}

void pinuse_polarity(const uint8_t pins, const uint8_t inverted)
{
    gates_driven |= pins & POLARITY_OUTPUTS;
    world.inverted = (uint8_t)((world.inverted & ~pins) | (inverted & pins));
    for (uint8_t pin = PIN_PROJECTOR; pin < PIN_COUNT; pin++) {
        if (((OUTPUT_PINS >> pin) & 1U) != 0U) {
            settle(pin);
        }
    }
}

void board_slides(const uint8_t count)
{
    time_pass();
    for (; slides_driven + 1U < count; slides_driven++) {
        driven[PIN_SLIDE_2 + slides_driven] = 0;
    }
    for (uint8_t pin = PIN_SLIDE_2; pin <= PIN_SLIDE_4; pin++) {
        settle(pin);
    }
}

uint8_t board_slides_driven(void)
{
    time_look();
    return ((gates_driven & POLARITY_PROJECTOR) != 0U) ? slides_driven + 1U : 0U;
}

uint8_t board_driven(void)
{
    time_look();
    return gates_driven;
}

void pinuse_start(void)
{
    gates_driven = 0;
    slides_driven = 0;
    world.inverted = 0;
    for (uint8_t pin = 0; pin < PIN_COUNT; pin++) {
        if ((OUTPUT_PINS >> pin) & 1U) {
            pinuse_drive(pin, (HIGH_AT_RESET_PINS >> pin) & 1U);
        }
    }
    antivalent = false;
    interlock_tripped = false;
    ends_watched = 0;
    ends_touched = 0;
}

bool pinuse_opens_interlock(const uint8_t pin, const uint8_t level)
{
    return ((pin == PIN_INTERLOCK) && (level == 1U)) ||
           (antivalent && (pin == PIN_INTERLOCK_ANTIVALENT) && (level == 0U));
}

bool pinuse_input(const uint8_t pin, const uint8_t level)
{
    measure_before();
    const bool changed = world.levels[pin] != level;
    world.levels[pin] = level;
    if (changed) {
        measure_after(pin, pinuse_seen(pin));
    }
    if (world.powered && changed && pinuse_opens_interlock(pin, level)) {
        interlock_tripped = true;
    }
    if (world.powered && changed && (level == 1U)) {
        ends_touched |= (pin == PIN_END_LOW) ? TURNTABLE_END_LOW : (pin == PIN_END_HIGH) ? TURNTABLE_END_HIGH : 0U;
    }
    return changed;
}

void board_turntable_watch(const uint8_t switches)
{
    time_pass();
    ends_watched = switches;
    ends_touched = 0;
}

uint8_t board_turntable_reached(void)
{
    time_look();
    const uint8_t touched = ends_touched;
    ends_touched = 0;
    const uint8_t now =
        (uint8_t)((world.levels[PIN_END_LOW] * TURNTABLE_END_LOW) | (world.levels[PIN_END_HIGH] * TURNTABLE_END_HIGH));
    return ends_watched & (touched | now);
}

void board_interlock_watch(const bool second)
{
    time_pass();
    antivalent = second;
}

uint8_t board_interlock(void)
{
    time_look();
    const bool first_open = world.levels[PIN_INTERLOCK] == 1U;
    const bool second_open = antivalent && (world.levels[PIN_INTERLOCK_ANTIVALENT] == 0U);
    return (uint8_t)((antivalent ? INTERLOCK_ANTIVALENT : 0U) | (first_open ? INTERLOCK_OPEN : 0U) |
                     (second_open ? INTERLOCK_ANTIVALENT_OPEN : 0U));
}

bool board_interlock_tripped(void)
{
    time_look();
    const bool tripped = interlock_tripped;
    interlock_tripped = false;
    return tripped;
}

void board_status_light(const bool on)
{
    time_look();
    pinuse_drive(PIN_STATUS, on ? 1 : 0);
}

size_t native_pins(native_transition_t* const drained, const size_t size)
{
    size_t given = 0;
    while ((given < size) && (transition_count > 0U)) {
        drained[given++] = transitions[transition_first];
        transition_first = (transition_first + 1U) % TRANSITIONS_MAX;
        transition_count--;
    }
    return given;
}

uint8_t native_pin(const uint8_t pin)
{
    return (pin < PIN_COUNT) ? world.levels[pin] : 0U;
}
