// What must hold whatever comes: what leaves on either line can be read, and pins keep the compiled-in limits.

#include <stdlib.h>
#include <string.h>

#include "../board.h"
#include "fuzz.h"

#define LOOK_TICKS 100000U  // 1 ms: a line's buffers are emptied before they overflow

static struct {
    uint8_t frame[MAX_WIRE];
    size_t length;
    bool may_be_cut;  // the next frame
} lines[LINES];

static uint64_t boot_tick;
static uint64_t risen[PIN_COUNT];
static uint8_t lit;  // the lamp that is; PIN_COUNT: none
static uint64_t carried_out;

void require(const bool condition)
{
    if (!condition) {
        abort();
    }
}

uint64_t watch_carried_out(void)
{
    return carried_out;
}

void watch_cut(const uint8_t line)
{
    lines[line].may_be_cut = true;
}

void watch_begin(void)
{
    memset(lines, 0, sizeof lines);
    memset(risen, 0, sizeof risen);
    boot_tick = 0;
    lit = PIN_COUNT;
}

static bool is_good(uint8_t* const bytes, const size_t coded)
{
    const size_t decoded = cobs_decode(bytes, coded);
    const layout_t* const layout = (decoded >= 3U) ? layout_of(bytes[0]) : NULL;
    if (layout == NULL) {
        return false;
    }
    const uint16_t crc = (uint16_t)(bytes[decoded - 2U] | (bytes[decoded - 1U] << 8));
    if (link_crc(bytes, decoded - 2U, layout->schema) != crc) {
        return false;
    }
    if ((bytes[0] >= REPLY_BIT) && (bytes[0] < 2U * REPLY_BIT) && (bytes[2] == STATUS_OK)) {
        carried_out |= 1ULL << (bytes[0] - REPLY_BIT);
    }
    return true;
}

// A frame longer than the protocol allows, or an undecodable one, must never leave the controller; except the one that
// was cut short, which the delimiter sent first after that ends.
static void check_line(const uint8_t line)
{
    uint8_t byte;
    while (((line == LINE_USB) ? native_usb_read : native_serial_read)(&byte, 1) == 1U) {
        if (byte != 0U) {
            require(lines[line].length < MAX_WIRE - 1U);
            lines[line].frame[lines[line].length++] = byte;
        } else if (lines[line].length > 0U) {
            require(is_good(lines[line].frame, lines[line].length) || lines[line].may_be_cut);
            lines[line].may_be_cut = false;  // only one was on its way
            lines[line].length = 0;
        }
    }
}

static bool is_lamp(const uint8_t pin)
{
    return (pin == PIN_PROJECTOR) || (pin == PIN_LED) || ((pin >= PIN_SLIDE_2) && (pin <= PIN_SLIDE_4));
}

static void check_pins(void)
{
    native_transition_t changes[64];
    size_t count;
    while ((count = native_pins(changes, 64)) > 0U) {
        for (size_t i = 0; i < count; i++) {
            const uint8_t pin = changes[i].pin;
            if (changes[i].level == 1U) {
                risen[pin] = changes[i].tick;
                require(!is_lamp(pin) || (lit == PIN_COUNT));  // never two at once, in no tick
                lit = is_lamp(pin) ? pin : lit;
                continue;
            }
            lit = (lit == pin) ? PIN_COUNT : lit;
            const uint64_t high = changes[i].tick - risen[pin];
            require(!is_lamp(pin) || (high <= LAMP_WIDTH_MAX_TICKS));
            require((pin != PIN_MICROWAVE) || (high <= MICROWAVE_PULSE_MAX_TICKS));
        }
    }
    require((native_pin(PIN_INTERLOCK) == 0U) || (native_pin(PIN_MICROWAVE) == 0U));
}

void watch_run(const uint64_t ticks)
{
    const uint64_t until = native_tick() + ticks;
    while (native_tick() < until) {
        native_run_until((until - native_tick() < LOOK_TICKS) ? until : native_tick() + LOOK_TICKS);
        if (boot_tick != native_boot_tick()) {
            boot_tick = native_boot_tick();
            watch_cut(LINE_UART);
            watch_cut(LINE_USB);
        }
        check_line(LINE_UART);
        check_line(LINE_USB);
        check_pins();
    }
}
