// Hosts, a camera, an encoder, switches, plugs and power, all drawn from the input, before the whole core. Built with
// libFuzzer (make fuzz), or with replay.c to run a corpus under gcc (make check).
//
// The input is a row of steps: a byte of what, a byte of how much, and then as many bytes as the step takes.

#include <string.h>

#include "../board.h"
#include "fuzz.h"

#define STEPS_MAX 200U                  // and
#define WORLD_MAX_TICKS (TICK_HZ / 2U)  // bound an input: the fuzzer counts runs a second
#define STEP_TICKS 100000U              // 1 ms: between two steps, unless one says otherwise
#define SILENCE_TICKS ((UPDATE_SILENCE_MS + 100ULL) * TICKS_PER_MS)  // the longest that anything waits
#define SYNC_LOW_TICKS 1000U

enum { STEP_BYTES, STEP_COMMAND, STEP_MEANT, STEP_EDGES, STEP_INPUT, STEP_ODOMETER, STEP_OUTSIDE, STEP_TIME, STEPS };
enum { USB_PLUGGED, USB_UNPLUGGED, USB_HELD, USB_FETCHED, STALLED, REFUSED, POWER, OUTSIDES };

static const uint8_t* data;
static size_t size;

static uint8_t next(void)
{
    if (size == 0U) {
        return 0;
    }
    size--;
    return *data++;
}

static void write_line(const uint8_t line, const uint8_t* const bytes, const size_t length)
{
    ((line == LINE_USB) ? native_usb_write : native_serial_write)(bytes, length);
}

static void send_bytes(const uint8_t line, size_t length)
{
    length = (length < size) ? length : size;
    write_line(line, data, length);
    data += length;
    size -= length;
}

// Of every command there is: whoever adds one adds it here too. From its id on, so that the corpus keeps its meaning.
static const layout_t* command_from(const uint8_t byte)
{
    uint8_t id = byte % REPLY_BIT;
    while (layout_of(id) == NULL) {
        id = (uint8_t)((id + 1U) % REPLY_BIT);
    }
    return layout_of(id);
}

// In a right CRC and COBS, so that the fuzzer gets behind the link.
static void send_command(const uint8_t line, const uint8_t which, const bool meant)
{
    const layout_t* const layout = command_from(which);
    uint8_t bytes[PAYLOAD_MAX] = {0};
    uint8_t body[2U + PAYLOAD_MAX] = {layout->id, next()};
    for (size_t i = next() % PAYLOAD_MAX, at = 0; at < i; at++) {
        bytes[at] = next();
    }
    if (meant) {
        meant_payload(layout, bytes, body + 2);
    } else {
        memcpy(body + 2, bytes, sizeof bytes);
    }
    if (layout->id == COMMAND_POLARITY) {
        body[2U + 1U] &= POLARITY_SYNC;  // watch.c judges outputs as they are when none is inverted
    }
    uint8_t wire[MAX_WIRE];
    write_line(line, wire, link_frame(body, 2U + layout->length, layout->schema, wire));
}

static void make_edges(const uint8_t count, const uint32_t interval)
{
    for (uint32_t i = 0; i < count % 8U; i++) {
        const uint64_t at = native_tick() + 1U + (uint64_t)i * interval;
        native_input(at, PIN_SYNC, 0);
        native_input(at + SYNC_LOW_TICKS, PIN_SYNC, 1);
    }
}

static void turn_odometer(const uint8_t steps)
{
    static const uint8_t levels[] = {0, 1, 3, 2};  // A, B
    for (uint32_t i = 0; i < steps; i++) {
        const uint8_t level = levels[((steps & 1U) != 0U) ? i % 4U : 3U - i % 4U];
        native_input(native_tick() + 1U + 50U * i, PIN_ODOMETER_A, level & 1U);
        native_input(native_tick() + 1U + 50U * i, PIN_ODOMETER_B, level >> 1);
    }
}

static void change_outside(const uint8_t what)
{
    switch (what % OUTSIDES) {
    case USB_PLUGGED:
    case USB_UNPLUGGED:
        watch_run(1);  // what had arrived is read
        native_usb_connect((what % OUTSIDES) == USB_PLUGGED);
        watch_cut(LINE_USB);
        break;
    case USB_HELD:
    case USB_FETCHED:
        native_usb_hold((what % OUTSIDES) == USB_HELD);
        break;
    case STALLED:
        native_stall_cpu(STEP_TICKS * (1ULL + what / OUTSIDES));
        break;
    case REFUSED:
        native_refuse_next();
        break;
    default:
        native_power_on(what, (what & 8U) ? BOOT_CAUSE_WATCHDOG : BOOT_CAUSE_POWER_ON);
        break;
    }
}

static void step(void)
{
    static const uint8_t inputs[] = {
        PIN_INTERLOCK, PIN_END_LOW, PIN_END_HIGH, PIN_SYNC, PIN_ODOMETER_A, PIN_ODOMETER_B, PIN_INTERLOCK_ANTIVALENT};
    const uint8_t what = next();
    const uint8_t how = next();
    const uint8_t line = (what & 0x80U) ? LINE_USB : LINE_UART;
    uint64_t ticks = STEP_TICKS;
    switch (what % STEPS) {
    case STEP_BYTES:
        send_bytes(line, how % MAX_WIRE);
        break;
    case STEP_COMMAND:
    case STEP_MEANT:
        send_command(line, how, (what % STEPS) == STEP_MEANT);
        break;
    case STEP_EDGES:
        make_edges(how, FRAME_PERIOD_MIN_TICKS / 2U + 1000U * next());
        ticks = STEP_TICKS * (how % 32U);
        break;
    case STEP_INPUT:
        native_input(native_tick() + 1U + next(), inputs[how % sizeof inputs], (how >> 7) & 1U);
        break;
    case STEP_ODOMETER:
        turn_odometer(how);
        break;
    case STEP_OUTSIDE:
        change_outside(how);
        break;
    default:
        ticks = (how == UINT8_MAX) ? SILENCE_TICKS : 2000ULL * how * how;  // 1.3 s at most: host timeouts
        break;
    }
    watch_run(ticks);
}

int LLVMFuzzerTestOneInput(const uint8_t* const input, const size_t input_size)
{
    data = input;
    size = input_size;
    native_begin();
    native_seed(next());
    native_input(0, PIN_INTERLOCK, 0);
    native_power_on(1, 0);
    watch_begin();
    watch_run(STEP_TICKS);
    for (uint32_t i = 0; (i < STEPS_MAX) && (size > 0U) && (native_tick() < WORLD_MAX_TICKS); i++) {
        step();
    }
    return 0;
}
