// A host and a camera for tests: sends commands over the simulated line, makes sync edges, keeps what came back.

#include "rig.h"

#include <string.h>

#include "check.h"
#include "link.h"

#define GOT_MAX 1024U
#define SEEN_MAX 65536U

static got_t got[GOT_MAX];
static size_t got_count;
static native_transition_t seen[SEEN_MAX];
static size_t seen_count;
static uint8_t partial[256];
static size_t partial_length;
static bool over_usb;
static uint8_t next_sequence;

static void keep(uint8_t* const bytes, const size_t coded)
{
    const size_t length = cobs_decode(bytes, coded);
    EXPECT(length >= 3U);
    const layout_t* const layout = layout_of(bytes[0]);
    EXPECT(layout != NULL);
    const uint16_t crc = (uint16_t)(bytes[length - 2U] | (bytes[length - 1U] << 8));
    EXPECT_EQ(link_crc(bytes, length - 2U, layout->schema), crc);
    got_t* const entry = &got[got_count++ % GOT_MAX];
    memset(entry, 0, sizeof *entry);
    entry->id = bytes[0];
    size_t at = 1;
    if ((bytes[0] & 0x80U) == 0U) {
        entry->sequence = bytes[at++];
    } else if (bytes[0] != NOTICE_GARBLED) {
        entry->sequence = (uint16_t)(bytes[1] | (bytes[2] << 8));
        entry->boot = bytes[3];
        at = 4;
    }
    EXPECT_EQ(length, at + layout->length + 2U);
    memcpy(entry->payload, bytes + at, layout->length);
}

void rig_over_usb(const bool usb)
{
    over_usb = usb;
    partial_length = 0;
}

void rig_pass(const uint64_t ticks)
{
    native_run_until(native_tick() + ticks);
    uint8_t byte;
    while ((over_usb ? native_usb_read : native_serial_read)(&byte, 1) == 1U) {
        if (byte != 0U) {
            partial[partial_length++] = byte;
        } else if (partial_length > 0U) {
            keep(partial, partial_length);
            partial_length = 0;
        }
    }
}

void rig_power_on(void)
{
    native_begin();
    over_usb = false;
    got_count = 0;
    seen_count = 0;
    partial_length = 0;
    next_sequence = 0;
    native_power_on(1, BOOT_CAUSE_POWER_ON);
}

void rig_start(void)
{
    rig_power_on();
    native_input(0, PIN_INTERLOCK, 0);
    rig_identify();
    rig_forget();
}

void rig_identify(void)
{
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_IDENTIFY, payload), STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_INFO, (const uint8_t[]){LEVEL}), STATUS_OK);
}

command_stage_t rig_config(const uint8_t generation, const uint8_t ratio)
{
    return (command_stage_t){.generation = generation,
                             .ratio = ratio,
                             .frame_period = PERIOD,
                             .exposure = 38 * MS,
                             .readout = 28 * MS,
                             .tolerance = 20,
                             .projector_delay = 3 * MS,
                             .projector_width = 2 * MS,
                             .led_delay = 4 * MS,
                             .led_width = 5 * MS};
}

void rig_configure(const command_stage_t* const config)
{
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_pack(config, payload);
    EXPECT_EQ(rig_status_of(COMMAND_STAGE, payload), STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, &config->generation), STATUS_OK);
}

void rig_arm(const uint8_t outputs)
{
    EXPECT_EQ(rig_status_of(COMMAND_ARM, &outputs), STATUS_OK);
}

void rig_raw(const uint8_t* const bytes, const size_t size)
{
    EXPECT_EQ((over_usb ? native_usb_write : native_serial_write)(bytes, size), size);
}

void rig_send(const uint8_t id, const uint8_t sequence, const uint8_t* const payload)
{
    const layout_t* const layout = layout_of(id);
    uint8_t body[2 + PAYLOAD_MAX] = {id, sequence};
    if (layout->length > 0U) {
        memcpy(body + 2, payload, layout->length);
    }
    uint8_t wire[MAX_WIRE];
    rig_raw(wire, link_frame(body, 2U + layout->length, layout->schema, wire));
}

const uint8_t* rig_command(const uint8_t id, const uint8_t* const payload)
{
    const uint8_t sequence = next_sequence++;
    const size_t before = got_count;
    rig_send(id, sequence, payload);
    rig_pass(2 * MS);
    for (size_t i = before; i < got_count; i++) {
        if ((got[i % GOT_MAX].id == id + REPLY_BIT) && (got[i % GOT_MAX].sequence == sequence)) {
            return got[i % GOT_MAX].payload;
        }
    }
    return NULL;
}

uint8_t rig_status_of(const uint8_t id, const uint8_t* const payload)
{
    const uint8_t* const reply = rig_command(id, payload);
    EXPECT(reply != NULL);
    return (reply == NULL) ? 0xFFU : reply[0];
}

reply_status_t rig_status(void)
{
    reply_status_t status = {0};
    const uint8_t* const reply = rig_command(COMMAND_STATUS, NULL);
    EXPECT(reply != NULL);
    if (reply != NULL) {
        reply_status_unpack(&status, reply);
    }
    return status;
}

uint64_t rig_pulse(void)
{
    const uint64_t edge = native_tick();
    native_input(edge, PIN_SYNC, 0);
    native_input(edge + 10 * US, PIN_SYNC, 1);
    rig_pass(10 * US);
    return edge;
}

uint64_t rig_edge(const uint64_t period)
{
    rig_send(COMMAND_PING, 0xFF, NULL);
    const uint64_t edge = rig_pulse();
    rig_pass(period - 10 * US);
    return edge;
}

const got_t* rig_take(const uint8_t id)
{
    for (size_t i = 0; i < got_count; i++) {
        if (got[i].id == id) {
            got[i].id = 0xFF;
            return &got[i];
        }
    }
    return NULL;
}

size_t rig_count(const uint8_t id)
{
    size_t count = 0;
    for (size_t i = 0; i < got_count; i++) {
        count += (got[i].id == id) ? 1U : 0U;
    }
    return count;
}

void rig_forget(void)
{
    rig_look();
    seen_count = 0;
    got_count = 0;
}

void rig_look(void)
{
    seen_count += native_pins(seen + seen_count, SEEN_MAX - seen_count);
}

static uint64_t nth(const uint8_t pin, const uint8_t level, size_t index)
{
    rig_look();
    for (size_t i = 0; i < seen_count; i++) {
        if ((seen[i].pin == pin) && (seen[i].level == level) && (index-- == 0U)) {
            return seen[i].tick;
        }
    }
    return 0;
}

uint64_t rig_rise(const uint8_t pin, const size_t index)
{
    return nth(pin, 1, index);
}

uint64_t rig_fall(const uint8_t pin, const size_t index)
{
    return nth(pin, 0, index);
}

size_t rig_rises(const uint8_t pin)
{
    rig_look();
    size_t count = 0;
    for (size_t i = 0; i < seen_count; i++) {
        count += ((seen[i].pin == pin) && (seen[i].level == 1U)) ? 1U : 0U;
    }
    return count;
}

event_edge_t rig_take_edge(void)
{
    event_edge_t edge = {.flags = 0xFF};
    const got_t* const taken = rig_take(EVENT_EDGE);
    EXPECT(taken != NULL);
    if (taken != NULL) {
        event_edge_unpack(&edge, taken->payload);
    }
    return edge;
}

void rig_scan(const uint8_t ratio)
{
    rig_start();
    const command_stage_t config = rig_config(1, ratio);
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    rig_forget();
}

uint8_t rig_start_train(const uint16_t repeat)
{
    uint8_t payload[COMMAND_BURST_LENGTH];
    command_burst_pack(&(command_burst_t){.code = BURST_CODE_MPSL25, .chip = 50, .repeat = repeat, .period = 20 * 1000},
                       payload);
    return rig_status_of(COMMAND_BURST, payload);
}

event_fault_t rig_take_fault(void)
{
    event_fault_t fault = {0};
    const got_t* const taken = rig_take(EVENT_FAULT);
    EXPECT(taken != NULL);
    if (taken != NULL) {
        event_fault_unpack(&fault, taken->payload);
    }
    return fault;
}
