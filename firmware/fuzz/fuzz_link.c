// Feeds arbitrary bytes, edges and interlock changes to the whole core, and checks what must hold whatever comes.
// Built with libFuzzer (make fuzz), or with replay.c to run a corpus under gcc (make check).

#include <stdlib.h>

#include "../native/native.h"
#include "link.h"

static void require(const bool condition)
{
    if (!condition) {
        abort();
    }
}

static bool is_good(uint8_t* const bytes, const size_t coded)
{
    const size_t decoded = cobs_decode(bytes, coded);
    const layout_t* const layout = (decoded >= 3U) ? layout_of(bytes[0]) : NULL;
    if (layout == NULL) {
        return false;
    }
    const uint16_t crc = (uint16_t)(bytes[decoded - 2U] | (bytes[decoded - 1U] << 8));
    return link_crc(bytes, decoded - 2U, layout->schema) == crc;
}

static uint8_t frame[MAX_WIRE];
static size_t length;
static uint64_t boot_tick;

// A frame longer than the protocol allows, or an undecodable one, must never leave the controller; except the one that
// a reset cut short, which the delimiter sent first after a reset ends.
static void check_output(void)
{
    bool may_be_cut = native_boot_tick() != boot_tick;
    boot_tick = native_boot_tick();
    uint8_t byte;
    while (native_serial_read(&byte, 1) == 1U) {
        if (byte != 0U) {
            require(length < sizeof frame - 1U);
            frame[length++] = byte;
            continue;
        }
        if (length == 0U) {
            continue;
        }
        if (!is_good(frame, length)) {
            require(may_be_cut);
            may_be_cut = false;  // only one was on its way
        }
        length = 0;
    }
}

// An odd first byte wraps every chunk in a right CRC and COBS, so that the fuzzer gets behind the link.
static void send(const uint8_t* const bytes, const size_t size, const bool framed)
{
    if (framed && (size > 0U)) {
        const layout_t* const layout = layout_of(bytes[0] % 13U);
        uint8_t body[2U + PAYLOAD_MAX] = {layout->id, (size > 1U) ? bytes[1] : 0U};
        for (size_t i = 2; (i < size) && (i < sizeof body); i++) {
            body[i] = bytes[i];
        }
        if ((layout->id == COMMAND_IDENTIFY) && ((body[1] & 1U) == 0U)) {  // or a new schema would lock the corpus out
            command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, body + 2);
        }
        uint8_t wire[MAX_WIRE];
        native_serial_write(wire, link_frame(body, 2U + layout->length, layout->schema, wire));
    } else {
        native_serial_write(bytes, size);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size)
{
    native_begin();
    native_power_on(1, 0);
    length = 0;
    boot_tick = 0;
    native_run_until(1000000U);
    check_output();
    while (size > 1U) {
        const uint8_t what = data[0];
        size_t chunk = data[1] % 64U;
        data += 2;
        size -= 2;
        chunk = (chunk < size) ? chunk : size;
        send(data, chunk, (what & 1U) != 0U);
        data += chunk;
        size -= chunk;
        native_input(native_tick() + 1000U, PIN_SYNC, (what >> 1) & 1U);
        native_input(native_tick() + 2000U, PIN_INTERLOCK, (what >> 2) & 1U);
        if ((what & 8U) != 0U) {
            native_stall_cpu(what * 10000ULL);
        }
        native_run_until(native_tick() + 20000U + what * 20000ULL);
        native_transition_t pins[64];
        while (native_pins(pins, 64) > 0U) {
        }
        check_output();
        // Open interlock: no microwave, ever.
        require((native_pin(PIN_INTERLOCK) == 0U) || (native_pin(PIN_MICROWAVE) == 0U));
        // At most one lamp at a time.
        require((native_pin(PIN_PROJECTOR) & native_pin(PIN_LED)) == 0U);
    }
    return 0;
}
