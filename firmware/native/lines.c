// The two lines to hosts. USB is a second serial line that can be unplugged.

#include <string.h>

#include "hardware.h"

#define RING_MAX (1U << 17)
#define LINE_IN_MAX 65536U  // on the line to the controller
#define BUFFER_IN_MAX 256U  // in the controller
#define BUFFER_OUT_MAX 64U

typedef struct {
    size_t max;
    size_t first;
    size_t count;
    uint8_t bytes[RING_MAX];
} ring_t;

enum { ON_ITS_WAY, RECEIVED, TO_SEND, SENT, RINGS };

static struct {
    uint64_t arrival;    // of the first byte on its way
    uint64_t departure;  // of the first byte to send has left the line
    ring_t rings[RINGS];
} lines[LINES];
static bool usb_connected;
static bool usb_held;

static size_t put(ring_t* const ring, const uint8_t* const bytes, const size_t size)
{
    size_t taken = 0;
    while ((taken < size) && (ring->count < ring->max)) {
        ring->bytes[(ring->first + ring->count++) % RING_MAX] = bytes[taken++];
    }
    return taken;
}

static size_t take(ring_t* const ring, uint8_t* const bytes, const size_t size)
{
    size_t given = 0;
    while ((given < size) && (ring->count > 0U)) {
        bytes[given++] = ring->bytes[ring->first++ % RING_MAX];
        ring->count--;
    }
    return given;
}

static void begin(const uint8_t line)
{
    static const size_t max[RINGS] = {LINE_IN_MAX, BUFFER_IN_MAX, BUFFER_OUT_MAX, RING_MAX};
    lines[line].arrival = 0;
    for (size_t ring = 0; ring < RINGS; ring++) {
        lines[line].rings[ring].max = max[ring];
        lines[line].rings[ring].count = 0;
    }
}

void lines_begin(void)
{
    begin(LINE_UART);
    begin(LINE_USB);
    usb_connected = false;
    usb_held = false;
}

// What the controller held is lost; what is on the line arrives.
void lines_start(void)
{
    for (size_t line = 0; line < LINES; line++) {
        lines[line].rings[RECEIVED].count = 0;
        lines[line].rings[TO_SEND].count = 0;
    }
}

bool lines_waiting(void)
{
    return (lines[LINE_UART].rings[RECEIVED].count > 0U) || (lines[LINE_USB].rings[RECEIVED].count > 0U);
}

static uint64_t arrival_time(const uint8_t line)
{
    return (lines[line].rings[ON_ITS_WAY].count > 0U) ? lines[line].arrival : NEVER;
}

static uint64_t departure_time(const uint8_t line)
{
    const bool waits = (line == LINE_USB) && usb_held;
    return ((lines[line].rings[TO_SEND].count > 0U) && !waits) ? lines[line].departure : NEVER;
}

static void step_arrival(const uint8_t line)
{
    uint8_t byte = 0;
    take(&lines[line].rings[ON_ITS_WAY], &byte, 1U);
    lines[line].arrival = world.now + NATIVE_BYTE_TICKS;
    if (world.powered && (put(&lines[line].rings[RECEIVED], &byte, 1U) == 1U)) {
        time_wake();
    } else if (world.powered) {
        world.lost.received++;
    }
}

static void step_departure(const uint8_t line)
{
    uint8_t byte = 0;
    take(&lines[line].rings[TO_SEND], &byte, 1U);
    lines[line].departure = world.now + NATIVE_BYTE_TICKS;
    world.lost.sent += 1U - put(&lines[line].rings[SENT], &byte, 1U);
    if (lines[line].rings[TO_SEND].count < BUFFER_OUT_MAX / 2U) {
        time_wake();
    }
}

static uint64_t line_time(const uint8_t line)
{
    const uint64_t arrival = arrival_time(line);
    const uint64_t departure = departure_time(line);
    return (arrival < departure) ? arrival : departure;
}

uint64_t lines_time(void)
{
    const uint64_t uart = line_time(LINE_UART);
    const uint64_t usb = line_time(LINE_USB);
    return (usb < uart) ? usb : uart;
}

void lines_step(void)
{
    const uint8_t line = (line_time(LINE_USB) < line_time(LINE_UART)) ? LINE_USB : LINE_UART;
    (arrival_time(line) <= departure_time(line) ? step_arrival : step_departure)(line);
}

// ---- the host's side ----

static size_t write_line(const uint8_t line, const uint8_t* const bytes, const size_t size)
{
    ring_t* const ring = &lines[line].rings[ON_ITS_WAY];
    if ((ring->count == 0U) && (lines[line].arrival < world.now + NATIVE_BYTE_TICKS)) {
        lines[line].arrival = world.now + NATIVE_BYTE_TICKS;
    }
    return put(ring, bytes, size);
}

size_t native_serial_write(const uint8_t* const bytes, const size_t size)
{
    return write_line(LINE_UART, bytes, size);
}

size_t native_serial_read(uint8_t* const bytes, const size_t size)
{
    return take(&lines[LINE_UART].rings[SENT], bytes, size);
}

void native_usb_connect(const bool connected)
{
    usb_connected = connected;
    begin(LINE_USB);
    time_wake();
}

void native_usb_hold(const bool held)
{
    usb_held = held;
}

size_t native_usb_write(const uint8_t* const bytes, const size_t size)
{
    return usb_connected ? write_line(LINE_USB, bytes, size) : 0U;
}

size_t native_usb_read(uint8_t* const bytes, const size_t size)
{
    return take(&lines[LINE_USB].rings[SENT], bytes, size);
}

// ---- the controller's side ----

bool board_connected(const uint8_t line)
{
    time_look();
    return (line == LINE_UART) || usb_connected;
}

size_t board_receive(const uint8_t line, uint8_t* const bytes, const size_t size)
{
    time_look();
    return take(&lines[line].rings[RECEIVED], bytes, size);
}

size_t board_transmit(const uint8_t line, const uint8_t* const bytes, const size_t size)
{
    time_pass();
    if (!board_connected(line)) {
        return size;
    }
    if (lines[line].rings[TO_SEND].count == 0U) {
        lines[line].departure = world.now + NATIVE_BYTE_TICKS;
    }
    return put(&lines[line].rings[TO_SEND], bytes, size);
}

bool board_transmitted(const uint8_t line)
{
    time_look();
    return lines[line].rings[TO_SEND].count == 0U;
}
