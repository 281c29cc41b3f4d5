// USB as a CDC-ACM device of full speed: the bus, and endpoint 0, where the device says what it is and the host asks
// things of it. One configuration, one interface for control, one for data.
//
// Everything is done in usb_run, from the main loop. The interrupt wakes that; and where a setup packet comes, it takes
// back what endpoint 0 still holds for the transfer before. A host that loses interest in one (macOS, whenever it
// closes a port) never fetches its answer, and the controller keeps it armed: the next request would get it.

#include <string.h>

#include "../board.h"
#include "../ticks.h"
#include "hardware.h"
#include "registers.h"
#include "endpoints.h"

#define STRING_MAX 24U  // characters of the longest string descriptor

#define NOTICE_ADDRESS 0x81U
#define DATA_IN_ADDRESS 0x82U
#define DATA_OUT_ADDRESS 0x02U

#ifndef USB_PRODUCT
#define USB_PRODUCT "annulus controller"
#endif

enum { STRING_LANGUAGES, STRING_MAKER, STRING_PRODUCT, STRING_SERIAL, STRINGS };

// USB 2.0; functions of several interfaces, told by an interface association; packets of endpoint 0; Raspberry Pi,
// serial port of a Pico; device 1.0.
static const uint8_t device_descriptor[18] = {18,   1,          0x00,         0x02,           0xEF,          2,
                                              1,    USB_PACKET, 0x8A,         0x2E,           0x0A,          0x00,
                                              0x00, 0x01,       STRING_MAKER, STRING_PRODUCT, STRING_SERIAL, 1};

#define CONFIGURATION_LENGTH 75U

static const uint8_t configuration_descriptor[CONFIGURATION_LENGTH] = {
    9,    2,          CONFIGURATION_LENGTH,
    0,    2,          1,
    0,    0x80,       50,  // two interfaces, bus-powered, 100 mA
    8,    11,         0,
    2,    2,          2,
    0,    0,  // association of both: communications, ACM
    9,    4,          0,
    0,    1,          2,
    2,    0,          0,  // interface 0: communications, ACM, no AT commands
    5,    0x24,       0x00,
    0x20, 0x01,  // CDC 1.20
    5,    0x24,       0x01,
    0x00, 1,  // no call management; data are interface 1's
    4,    0x24,       0x02,
    0x02,  // line coding and control line state
    5,    0x24,       0x06,
    0,    1,  // union of 0 and 1
    7,    5,          NOTICE_ADDRESS,
    3,    8,          0,
    16,  // interrupt, 8 bytes, every 16 ms; never used
    9,    4,          1,
    0,    2,          10,
    0,    0,          0,  // interface 1: CDC data
    7,    5,          DATA_OUT_ADDRESS,
    2,    USB_PACKET, 0,
    0,  // bulk
    7,    5,          DATA_IN_ADDRESS,
    2,    USB_PACKET, 0,
    0,  // bulk
};

#define USB_INT_ALL (USB_INT_BUFFER | USB_INT_SETUP | USB_INT_BUS_RESET | USB_INT_SUSPEND | USB_INT_RESUME)

enum { REST, ANSWERING, ANSWERED, TAKING, TAKEN };  // of a control transfer

static struct {
    uint8_t phase;
    const uint8_t* answer;  // what is left of it
    uint32_t left;
    bool ends_short;  // the answer is shorter than asked for: an empty packet ends one of whole packets
    bool data1;       // toggle of the next packet in
    uint8_t address;  // to be taken when the transfer is over
    uint8_t made[2U + 2U * STRING_MAX];
} control;

static uint8_t line_coding[7];  // it changes nothing

typedef struct {
    uint8_t type;
    uint8_t request;
    uint16_t value;
    uint16_t index;
    uint16_t length;
} setup_t;

// With a setup packet here that nobody has looked at, what was just handed over belongs to a transfer that is over; the
// interrupt may have gone by before.
static void void_if_over(void)
{
    if ((REGISTER(USB_SIE_STATUS) & SIE_SETUP) != 0U) {
        usb_void_control();
    }
}

static void refuse(void)
{
    control.phase = REST;
    REGISTER(USB_EP_STALL_ARM) = BIT(CONTROL_IN) | BIT(CONTROL_OUT);
    REGISTER(USB_BUFFER_CONTROL(CONTROL_IN)) = BUFFER_STALL;
    REGISTER(USB_BUFFER_CONTROL(CONTROL_OUT)) = BUFFER_STALL;
    void_if_over();
}

static void hand_over_control(const uint32_t endpoint, const uint32_t bits)
{
    if ((REGISTER(USB_SIE_STATUS) & SIE_SETUP) != 0U) {
        return;  // not for a moment either: the next request's data may be asked for in it
    }
    usb_hand_over(endpoint, bits);
    void_if_over();
}

static void send_control(const uint32_t size)
{
    const uint32_t toggle = control.data1 ? BUFFER_DATA1 : 0U;
    control.data1 = !control.data1;
    hand_over_control(CONTROL_IN, BUFFER_FULL | toggle | size);
}

static void agree(void)
{
    control.phase = TAKEN;
    send_control(0U);
}

static void answer_further(void)
{
    const uint32_t size = (control.left < USB_PACKET) ? control.left : USB_PACKET;
    usb_copy_out(CONTROL_IN, 0U, control.answer, size);
    control.answer += size;
    control.left -= size;
    control.ends_short = control.ends_short && (size == USB_PACKET);
    send_control(size);
}

static void answer(const setup_t* const setup, const uint8_t* const bytes, const uint32_t size)
{
    control.phase = ANSWERING;
    control.answer = bytes;
    control.left = (size < setup->length) ? size : setup->length;
    control.ends_short = control.left < setup->length;
    answer_further();
}

static void answer_string(const setup_t* const setup, const uint32_t index)
{
    static const uint8_t languages[] = {4, 3, 0x09, 0x04};  // English
    if (index == STRING_LANGUAGES) {
        answer(setup, languages, sizeof languages);
        return;
    }
    const char* const texts[STRINGS] = {"", "annulus", USB_PRODUCT, (const char*)board_serial_number()};
    uint8_t at = 2;
    for (const char* text = texts[index]; *text != '\0'; text++) {
        control.made[at++] = (uint8_t)*text;
        control.made[at++] = 0U;
    }
    control.made[0] = at;
    control.made[1] = 3U;
    answer(setup, control.made, at);
}

static void get_descriptor(const setup_t* const setup)
{
    const uint32_t index = setup->value & 0xFFU;
    const uint32_t kind = (uint32_t)setup->value >> 8;
    if ((kind == 1U) && (index == 0U)) {
        answer(setup, device_descriptor, sizeof device_descriptor);
    } else if ((kind == 2U) && (index == 0U)) {
        answer(setup, configuration_descriptor, sizeof configuration_descriptor);
    } else if ((kind == 3U) && (index < STRINGS)) {
        answer_string(setup, index);
    } else {
        refuse();  // a device qualifier, too: there is no high speed
    }
}

static void answer_small(const setup_t* const setup, const uint8_t value, const uint32_t size)
{
    control.made[0] = value;
    control.made[1] = 0U;
    answer(setup, control.made, size);
}

static void set_configuration(const setup_t* const setup)
{
    if (setup->value > 1U) {
        refuse();
        return;
    }
    usb_port_close();
    if (setup->value == 1U) {
        usb_port_open();
    }
    agree();
}

// Endpoint of an address, or CONTROL_IN for none that can be halted.
static uint32_t endpoint_of(const uint32_t address)
{
    switch (address) {
    case NOTICE_ADDRESS:
        return NOTICE_IN;
    case DATA_IN_ADDRESS:
        return DATA_IN;
    case DATA_OUT_ADDRESS:
        return DATA_OUT;
    default:
        return CONTROL_IN;
    }
}

static void set_halt(const setup_t* const setup, const bool halt)
{
    const uint32_t endpoint = endpoint_of(setup->index);
    if ((endpoint == CONTROL_IN) || (setup->value != 0U) || !usb_port.configured) {
        refuse();
        return;
    }
    usb_port_halt(endpoint, halt);
    agree();
}

enum { TO_DEVICE = 0x00, FROM_DEVICE = 0x80, TO_INTERFACE = 0x01, FROM_INTERFACE = 0x81 };
enum { TO_ENDPOINT = 0x02, FROM_ENDPOINT = 0x82, CLASS_TO_INTERFACE = 0x21, CLASS_FROM_INTERFACE = 0xA1 };
#define REQUEST(type, number) (((uint32_t)(type) << 8) | (number))

static void carry_out(const setup_t* const setup)
{
    switch (REQUEST(setup->type, setup->request)) {
    case REQUEST(FROM_DEVICE, 6):
        get_descriptor(setup);
        break;
    case REQUEST(TO_DEVICE, 5):  // takes force when the host has its acknowledgement
        control.address = (uint8_t)(setup->value & 0x7FU);
        agree();
        break;
    case REQUEST(TO_DEVICE, 9):
        set_configuration(setup);
        break;
    case REQUEST(FROM_DEVICE, 8):
        answer_small(setup, usb_port.configured ? 1U : 0U, 1U);
        break;
    case REQUEST(FROM_DEVICE, 0):
    case REQUEST(FROM_INTERFACE, 0):
        answer_small(setup, 0U, 2U);
        break;
    case REQUEST(FROM_ENDPOINT, 0):
        answer_small(setup, usb_port_halted(endpoint_of(setup->index)) ? 1U : 0U, 2U);
        break;
    case REQUEST(TO_ENDPOINT, 1):
        set_halt(setup, false);
        break;
    case REQUEST(TO_ENDPOINT, 3):
        set_halt(setup, true);
        break;
    case REQUEST(FROM_INTERFACE, 10):
        answer_small(setup, 0U, 1U);
        break;
    case REQUEST(CLASS_TO_INTERFACE, 0x20):  // SET_LINE_CODING
        control.phase = TAKING;
        hand_over_control(CONTROL_OUT, BUFFER_DATA1 | USB_PACKET);
        break;
    case REQUEST(CLASS_FROM_INTERFACE, 0x21):  // GET_LINE_CODING
        answer(setup, line_coding, sizeof line_coding);
        break;
    case REQUEST(CLASS_TO_INTERFACE, 0x22):  // SET_CONTROL_LINE_STATE
        usb_port_ready((setup->value & 1U) != 0U);
        agree();
        break;
    default:
        refuse();
        break;
    }
}

// What was on its way of an earlier transfer is void.
static void begin_control(void)
{
    const uint32_t first = REGISTER(USB_DPSRAM);
    const uint32_t second = REGISTER(USB_DPSRAM + 4U);
    const setup_t setup = {.type = (uint8_t)first,
                           .request = (uint8_t)(first >> 8),
                           .value = (uint16_t)(first >> 16),
                           .index = (uint16_t)second,
                           .length = (uint16_t)(second >> 16)};
    usb_take_back(BIT(CONTROL_IN) | BIT(CONTROL_OUT));
    control.data1 = true;
    control.address = 0;
    // Data that nobody announced, or none where there must be: only a request for data may have any length.
    const bool from_device = (setup.type & 0x80U) != 0U;
    const uint16_t expected = (REQUEST(setup.type, setup.request) == REQUEST(CLASS_TO_INTERFACE, 0x20)) ? 7U : 0U;
    if (from_device ? (setup.length == 0U) : (setup.length != expected)) {
        refuse();
    } else {
        carry_out(&setup);
    }
}

// is_over : another transfer has begun, and this one gets nothing more.
static void control_sent(const bool is_over)
{
    if (is_over && (control.phase == ANSWERING)) {
        control.phase = REST;
    } else if ((control.phase == ANSWERING) && ((control.left > 0U) || control.ends_short)) {
        answer_further();
    } else if (control.phase == ANSWERING) {
        control.phase = ANSWERED;
        hand_over_control(CONTROL_OUT, BUFFER_DATA1 | USB_PACKET);  // the host's empty packet
    } else if (control.phase == TAKEN) {
        control.phase = REST;
        if (control.address != 0U) {
            REGISTER(USB_ADDRESS) = control.address;
        }
    }
}

static void control_received(const bool is_over)
{
    const uint32_t size = REGISTER(USB_BUFFER_CONTROL(CONTROL_OUT)) & BUFFER_LENGTH;
    if (is_over) {
        control.phase = REST;
    } else if ((control.phase == TAKING) && (size == sizeof line_coding)) {
        for (uint32_t i = 0; i < sizeof line_coding; i++) {
            line_coding[i] = usb_packet_of(CONTROL_OUT)[i];
        }
        agree();
    } else if (control.phase == TAKING) {
        refuse();
    } else {
        control.phase = REST;
    }
}

// ---- the bus ----

static void bus_reset(void)
{
    REGISTER(USB_ADDRESS) = 0U;
    usb_take_back(BIT(CONTROL_IN) | BIT(CONTROL_OUT));
    control.phase = REST;
    control.address = 0;
    usb_port_close();
}

// A hanging controller is put into reset, which lets go of D+: the host sees the plug pulled. It stays there for as
// long as a hub may take to believe that, and then it is a device newly plugged in. So it is without VBUS, where that
// is sensed, until it is back: a device must not feed a bus that has no power (USB 2.0, 7.1.5 and 7.2.1).
#define AWAY_US 10000U

static struct {
    bool away;
    uint32_t until_us;
    uint32_t times;
} recovery;

static void leave(const uint32_t for_us)
{
    usb_port_forget();  // to the core its host is gone: what was armed is dark in the next round
    control.phase = REST;
    irq_disable(IRQ_USB);  // what is pending stays so, and its handler would find the block in reset
    SET_BITS(RESETS_RESET) = RESET_USB;
    recovery.away = true;
    recovery.until_us = REGISTER(TIMER_RAW_LOW) + for_us;
}

static void come_back(void)
{
    const uint32_t now_us = REGISTER(TIMER_RAW_LOW);
    if (!tick_is_past(now_us, recovery.until_us)) {
        return;
    }
    recovery.until_us = now_us;  // moved along: a plug may stay out for longer than two ticks can be apart
    if (!variant_vbus_back()) {
        return;
    }
    CLEAR_BITS(RESETS_RESET) = RESET_USB;
    if ((REGISTER(RESETS_DONE) & RESET_USB) != 0U) {
        recovery.away = false;
        usb_start();
    }
}

uint32_t usb_hangs(void)
{
    return recovery.times;
}

// The order matters: a buffer done belongs to the transfer before a setup packet seen earlier in this round.
void usb_run(void)
{
    if (recovery.away) {
        come_back();
        return;
    }
    if (!variant_vbus()) {
        leave(0U);
        return;
    }
    const uint32_t status = REGISTER(USB_SIE_STATUS) & (SIE_BUS_RESET | SIE_SUSPENDED | SIE_RESUME | SIE_SETUP);
    const uint32_t done = REGISTER(USB_BUFF_STATUS);
    REGISTER(USB_SIE_STATUS) = status;
    REGISTER(USB_BUFF_STATUS) = done;
    if ((status & SIE_BUS_RESET) != 0U) {
        bus_reset();
    } else {
        const bool is_over = (status & SIE_SETUP) != 0U;
        if ((done & BIT(CONTROL_IN)) != 0U) {
            control_sent(is_over);
        }
        if ((done & BIT(CONTROL_OUT)) != 0U) {
            control_received(is_over);
        }
        usb_port_done(done);
    }
    if ((status & (SIE_SUSPENDED | SIE_RESUME | SIE_BUS_RESET | SIE_SETUP)) != 0U) {
        usb_port.suspended = status == SIE_SUSPENDED;
        usb_frame_wake();
    }
    if ((status & SIE_SETUP) != 0U) {
        begin_control();
    }
    if (usb_port.configured && !usb_port.suspended && usb_frame_overdue()) {
        recovery.times++;
        leave(AWAY_US);
        return;
    }
    usb_port_flush();
    REGISTER(USB_INTE) = USB_INT_ALL;
}

// Until usb_run has looked nothing else is waited for, and then not even another setup packet: none of endpoint 0's
// buffers is left.
void usb_handler(void)
{
    const bool is_setup = (REGISTER(USB_SIE_STATUS) & SIE_SETUP) != 0U;
    REGISTER(USB_INTE) = is_setup ? 0U : USB_INT_SETUP;
    if (is_setup) {
        usb_void_control();
    }
}

void usb_let_go(void)
{
    if ((REGISTER(RESETS_DONE) & RESET_USB) != 0U) {
        CLEAR_BITS(USB_SIE_CTRL) = SIE_PULL_UP;
    }
}

void usb_start(void)
{
    if (!variant_vbus_back()) {
        leave(0U);
        return;
    }
    static const uint8_t one_mbaud[sizeof line_coding] = {0x40, 0x42, 0x0F, 0x00, 0, 0, 8};  // 8N1
    memcpy(line_coding, one_mbaud, sizeof line_coding);
    for (uint32_t at = 0; at < 0x100U; at += 4U) {
        REGISTER(USB_DPSRAM + at) = 0U;
    }
    REGISTER(USB_MUXING) = (1U << 0) | (1U << 3);  // to the PHY, soft connect
    REGISTER(USB_POWER) = (1U << 3) | (1U << 2);   // there is a bus: GP24 is no pin that can tell the block so
    REGISTER(USB_MAIN_CTRL) = 1U;                  // device, on
    REGISTER(USB_SIE_CTRL) = 1U << 29;             // BUFF_STATUS for endpoint 0 as well
    usb_place_packets(NOTICE_IN, NOTICE_IN);
    usb_place_packets(DATA_IN, DATA_IN);
    usb_place_packets(DATA_OUT, DATA_OUT);
    irq_enable(IRQ_USB);  // one that was pending as the block left finds nothing
    REGISTER(USB_INTE) = USB_INT_ALL;
    interrupts_off();  // a plug that was pulled meanwhile let go of D+ already
    if (variant_vbus()) {
        SET_BITS(USB_SIE_CTRL) = SIE_PULL_UP;  // here we are
    }
    interrupts_on();
}
