// USB's buffers and the port's data, both ways: the second line to the core.
//
// A buffer belongs to the controller from the moment its AVAILABLE bit is set until BUFF_STATUS says it is done, and is
// not touched in between. A host waits as long as it has to: a buffer that was not handed over is answered with NAK.

#include <string.h>

#include "../board.h"
#include "hardware.h"
#include "registers.h"
#include "endpoints.h"

struct usb_port usb_port;

// Two buffers in turn: one is filled while the controller has the other. It takes one packet at a time.
static struct {
    bool data1;
    bool taken;       // the controller has a buffer: not the one that is filled
    bool whole;       // the last packet was a whole one: the host waits for more
    uint32_t buffer;  // that is filled
    uint32_t filled;
} in;

static struct {
    bool data1;
    uint32_t length;  // of the packet that is here, 0 = none
    uint32_t at;
} out;

// ---- buffers ----

// The controller may look at the register at any moment, at 48 MHz: everything else first, AVAILABLE three of its
// cycles later (4.1.2.5.1).
void usb_hand_over(const uint32_t endpoint, const uint32_t bits)
{
    REGISTER(USB_BUFFER_CONTROL(endpoint)) = bits;
    __asm volatile(USB_CYCLES_PASS);
    REGISTER(USB_BUFFER_CONTROL(endpoint)) = bits | BUFFER_AVAILABLE;
}

// Take buffers back from the controller: which of them it still had. The first Picos (RP2040-B0, B1) never say that
// they are done: erratum E2.
static uint32_t abort_buffers(const uint32_t endpoints)
{
    uint32_t had = 0;
    SET_BITS(USB_EP_ABORT) = endpoints;
    for (uint32_t i = 0; (i < 1000U) && ((REGISTER(USB_EP_ABORT_DONE) & endpoints) != endpoints); i++) {
    }
    for (uint32_t endpoint = CONTROL_IN; endpoint <= DATA_OUT; endpoint++) {
        if ((endpoints & BIT(endpoint)) != 0U) {
            had |= ((REGISTER(USB_BUFFER_CONTROL(endpoint)) & BUFFER_AVAILABLE) != 0U) ? BIT(endpoint) : 0U;
            REGISTER(USB_BUFFER_CONTROL(endpoint)) = 0U;
        }
    }
    REGISTER(USB_EP_ABORT_DONE) = endpoints;
    CLEAR_BITS(USB_EP_ABORT) = endpoints;
    return had;
}

uint32_t usb_take_back(const uint32_t endpoints)
{
    const uint32_t had = abort_buffers(endpoints);
    REGISTER(USB_BUFF_STATUS) = endpoints;
    return had;
}

void usb_void_control(void)
{
    abort_buffers(BIT(CONTROL_IN) | BIT(CONTROL_OUT));
}

void usb_place_packets(const uint32_t endpoint, const uint32_t buffer)
{
    const uint32_t kind = (endpoint == NOTICE_IN) ? ENDPOINT_INTERRUPT_TYPE : ENDPOINT_BULK;
    REGISTER(USB_ENDPOINT_CONTROL(endpoint)) =
        ENDPOINT_ENABLE | ENDPOINT_INTERRUPT | kind | ((uint32_t)(uintptr_t)usb_packet_of(buffer) - USB_DPSRAM);
}

volatile uint8_t* usb_packet_of(const uint32_t buffer)
{
    return (volatile uint8_t*)(uintptr_t)(USB_DPSRAM +
                                          ((buffer <= CONTROL_OUT) ? 0x100U : 0x180U + USB_PACKET * buffer));
}

void usb_copy_out(const uint32_t buffer, const uint32_t at, const uint8_t* const bytes, const uint32_t size)
{
    volatile uint8_t* const packet = usb_packet_of(buffer);
    for (uint32_t i = 0; i < size; i++) {
        packet[at + i] = bytes[i];
    }
}

// ---- data ----

bool usb_port_halted(const uint32_t endpoint)
{
    return (usb_port.halted & BIT(endpoint)) != 0U;
}

// Not now if the packet before is still there, or the frame late; usb_port_flush comes back to it.
static void send_packet(void)
{
    if (in.taken || !usb_frame_early()) {
        return;
    }
    const uint32_t toggle = in.data1 ? BUFFER_DATA1 : 0U;
    in.data1 = !in.data1;
    in.taken = true;
    in.whole = in.filled == USB_PACKET;
    usb_place_packets(DATA_IN, in.buffer);
    usb_hand_over(DATA_IN, BUFFER_FULL | toggle | in.filled);
    in.buffer = (in.buffer == DATA_IN) ? DATA_IN_SECOND : DATA_IN;
    in.filled = 0;
}

static void ask_for_packet(void)
{
    const uint32_t toggle = out.data1 ? BUFFER_DATA1 : 0U;
    out.data1 = !out.data1;
    out.length = 0;
    out.at = 0;
    usb_hand_over(DATA_OUT, toggle | USB_PACKET);
}

static void forget_in(void)
{
    memset(&in, 0, sizeof in);
    in.buffer = DATA_IN;
}

static void restart_in(void)
{
    usb_take_back(BIT(DATA_IN));
    forget_in();
    usb_port.halted &= (uint8_t)~BIT(DATA_IN);
}

static void restart_out(void)
{
    usb_take_back(BIT(DATA_OUT));
    memset(&out, 0, sizeof out);
    usb_port.halted &= (uint8_t)~BIT(DATA_OUT);
    ask_for_packet();
}

// A charger configures nothing, and a bus without its host falls silent, which counts as suspended.
bool usb_hosted(void)
{
    return usb_port.configured && !usb_port.suspended && variant_vbus();
}

bool usb_connected(void)
{
    return usb_hosted() && usb_port.host_ready;
}

size_t usb_receive(uint8_t* const bytes, const size_t size)
{
    size_t given = 0;
    const volatile uint8_t* const packet = usb_packet_of(DATA_OUT);
    while ((given < size) && (out.at < out.length)) {
        bytes[given++] = packet[out.at++];
    }
    if ((out.length > 0U) && (out.at == out.length) && !usb_port_halted(DATA_OUT)) {
        ask_for_packet();
    }
    return given;
}

size_t usb_transmit(const uint8_t* const bytes, const size_t size)
{
    if (!usb_connected()) {
        in.filled = 0;
        return size;
    }
    if (usb_port_halted(DATA_IN)) {
        return 0;
    }
    const uint32_t room = USB_PACKET - in.filled;
    const uint32_t taken = (size < room) ? (uint32_t)size : room;
    usb_copy_out(in.buffer, in.filled, bytes, taken);
    in.filled += taken;
    if (in.filled == USB_PACKET) {
        send_packet();
    }
    return taken;
}

bool usb_transmitted(void)
{
    return !usb_connected() || (!in.taken && (in.filled == 0U));
}

// ---- the port ----

void usb_port_open(void)
{
    usb_port.configured = true;
    usb_frame_wake();
    ask_for_packet();
}

// What nobody fetched before the port was closed is not for whoever opens it next. The toggles go on: a packet taken
// back leaves its own to the next one.
void usb_port_ready(const bool ready)
{
    if (usb_port.host_ready && !ready && !usb_port_halted(DATA_IN)) {
        in.data1 = (usb_take_back(BIT(DATA_IN)) != 0U) ? !in.data1 : in.data1;
        in.taken = false;
        in.whole = false;
        in.filled = 0;
    }
    usb_port.host_ready = ready;
}

void usb_port_forget(void)
{
    memset(&usb_port, 0, sizeof usb_port);
    forget_in();
    memset(&out, 0, sizeof out);
}

void usb_port_close(void)
{
    usb_take_back(BIT(NOTICE_IN) | BIT(DATA_IN) | BIT(DATA_OUT));
    usb_port_forget();
}

void usb_port_halt(const uint32_t endpoint, const bool halt)
{
    if (endpoint == DATA_IN) {
        restart_in();
    } else if (endpoint == DATA_OUT) {
        restart_out();
    } else {
        usb_port.halted &= (uint8_t)~BIT(endpoint);
        REGISTER(USB_BUFFER_CONTROL(endpoint)) = 0U;
    }
    if (halt) {
        usb_take_back(BIT(endpoint));
        usb_port.halted |= (uint8_t)BIT(endpoint);
        REGISTER(USB_BUFFER_CONTROL(endpoint)) = BUFFER_STALL;
    }
}

void usb_port_done(const uint32_t endpoints)
{
    if ((endpoints & BIT(DATA_IN)) != 0U) {
        in.taken = false;
    }
    if ((endpoints & BIT(DATA_OUT)) != 0U) {
        out.length = REGISTER(USB_BUFFER_CONTROL(DATA_OUT)) & BUFFER_LENGTH;
        if (out.length == 0U) {
            ask_for_packet();
        }
    }
}

void usb_port_flush(void)
{
    if (usb_connected() && !usb_port_halted(DATA_IN) && ((in.filled > 0U) || in.whole)) {
        send_packet();
    }
}
