// Frames of the rig's line: COBS(operation, sequence, payload, CRC-32) and a zero. One request at a time, answered at
// once; only `read` is answered by several frames, as many as the line takes a round.

#include <string.h>

#include "../board.h"
#include "../crc32.h"
#include "rig.h"

#define HEAD_BYTES 2U
#define CRC_BYTES 4U
#define FRAME_MAX (HEAD_BYTES + RIG_PAYLOAD_MAX + CRC_BYTES + 2U)  // COBS' code byte and the zero
_Static_assert(FRAME_MAX <= 254U, "one COBS code byte is enough");

typedef struct {
    uint8_t line;
    uint8_t in[FRAME_MAX];
    uint32_t filled;
    bool too_long;
    uint8_t out[FRAME_MAX];
    uint32_t size;
    uint32_t sent;
} talk_t;

static talk_t talks[LINES];

static struct {
    talk_t* to;  // NULL: nothing is being read
    uint8_t sequence;
    uint8_t area;
    uint32_t at;
    uint32_t left;
} reading;

static void put16(uint8_t* const to, const uint32_t value)
{
    to[0] = (uint8_t)value;
    to[1] = (uint8_t)(value >> 8);
}

static void put32(uint8_t* const to, const uint32_t value)
{
    put16(to, value);
    put16(to + 2, value >> 16);
}

static uint32_t get16(const uint8_t* const from)
{
    return (uint32_t)from[0] | ((uint32_t)from[1] << 8);
}

static uint32_t get32(const uint8_t* const from)
{
    return get16(from) | (get16(from + 2) << 16);
}

// ---- frames ----

static void send(talk_t* const talk, const uint8_t operation, const uint8_t sequence, const uint8_t* const payload,
                 const uint32_t length)
{
    uint8_t body[FRAME_MAX];
    body[0] = operation;
    body[1] = sequence;
    memcpy(&body[HEAD_BYTES], payload, length);
    put32(&body[HEAD_BYTES + length], crc32_of(body, HEAD_BYTES + length));
    const uint32_t size = HEAD_BYTES + length + CRC_BYTES;
    uint32_t code_at = 0;
    for (uint32_t i = 0; i < size; i++) {
        talk->out[i + 1U] = body[i];
        if (body[i] == 0U) {
            talk->out[code_at] = (uint8_t)(i + 1U - code_at);
            code_at = i + 1U;
        }
    }
    talk->out[code_at] = (uint8_t)(size + 1U - code_at);
    talk->out[size + 1U] = 0U;
    talk->size = size + 2U;
    talk->sent = 0;
}

// In place; its size, or 0 when a code byte points past the end.
static uint32_t unstuff(uint8_t* const bytes, const uint32_t size)
{
    uint32_t at = 0;
    uint32_t to = 0;
    while (at < size) {
        const uint32_t code = bytes[at];
        if ((code == 0U) || (at + code > size)) {
            return 0;
        }
        if (at > 0U) {
            bytes[to++] = 0U;
        }
        for (uint32_t i = 1; i < code; i++) {
            bytes[to++] = bytes[at + i];
        }
        at += code;
    }
    return to;
}

// ---- requests ----

static uint8_t hello(uint8_t* const payload, uint32_t* const length)
{
    static const char version[] = ANNULUS_VERSION " " ANNULUS_GIT;
    payload[0] = RIG_PROTOCOL;
    memcpy(&payload[1], board_serial_number(), 16U);
    memcpy(&payload[17], version, sizeof version);
    *length = 17U + sizeof version;
    return RIG_OK;
}

static uint8_t state_of(uint8_t* const payload, uint32_t* const length)
{
    bench_state_t state;
    bench_state(&state);
    payload[0] = state.flags;
    put32(&payload[1], state.tick);
    put32(&payload[5], state.levels);
    put32(&payload[9], state.sampled);
    put16(&payload[13], state.unplayed);
    put16(&payload[15], state.slow);
    put16(&payload[17], state.room);
    for (uint32_t i = 0; i < RIG_TRACKS; i++) {
        put16(&payload[19U + 2U * i], state.tracked[i]);
    }
    *length = 19U + 2U * RIG_TRACKS;
    return RIG_OK;
}

static uint8_t record(const uint8_t* const payload)
{
    bench_record_t wanted;
    memcpy(wanted.tracks, payload, RIG_TRACKS);
    wanted.sample = payload[7];
    wanted.cue = payload[8];
    wanted.slow = (uint16_t)get16(&payload[9]);
    wanted.sample_delay = get32(&payload[11]);
    wanted.sample_words = get32(&payload[15]);
    return bench_record(&wanted) ? RIG_OK : RIG_OUT_OF_RANGE;
}

static uint8_t read_area(talk_t* const talk, const uint8_t sequence, const uint8_t* const payload)
{
    const uint32_t at = get32(&payload[1]);
    const uint32_t words = get32(&payload[5]);
    if ((payload[0] > RIG_AREA_SLOW) || (words > bench_words(payload[0])) || (at > bench_words(payload[0]) - words)) {
        return RIG_OUT_OF_RANGE;
    }
    reading.to = talk;
    reading.sequence = sequence;
    reading.area = payload[0];
    reading.at = at;
    reading.left = words;
    return RIG_OK;
}

// -1: any.
static int32_t length_of(const uint8_t operation)
{
    switch (operation) {
    case RIG_LIST:
        return -1;
    case RIG_LEVELS:
        return 4;
    case RIG_RECORD:
        return 19;
    case RIG_GO:
        return 2;
    case RIG_READ:
        return 9;
    default:
        return 0;
    }
}

static uint8_t list(const uint8_t* const payload, const uint32_t length)
{
    if ((length < 2U) || ((length - 2U) % 4U != 0U)) {
        return RIG_BAD_LENGTH;
    }
    return bench_list(get16(payload), &payload[2], (length - 2U) / 4U) ? RIG_OK : RIG_OUT_OF_RANGE;
}

static void carry_out(talk_t* const talk, const uint8_t* const body, const uint32_t size)
{
    const uint8_t operation = body[0];
    const uint8_t* const payload = &body[HEAD_BYTES];
    const uint32_t length = size - HEAD_BYTES;
    uint8_t answer[RIG_PAYLOAD_MAX];
    uint32_t more = 0;
    uint8_t status = RIG_OK;
    const int32_t expected = length_of(operation);
    if ((expected >= 0) && (length != (uint32_t)expected)) {
        status = RIG_BAD_LENGTH;
    } else {
        reading.to = NULL;
        switch (operation) {
        case RIG_HELLO:
            status = hello(&answer[1], &more);
            break;
        case RIG_LEVELS:
            status = bench_levels((uint16_t)get16(payload), (uint16_t)get16(&payload[2])) ? RIG_OK : RIG_OUT_OF_RANGE;
            break;
        case RIG_LIST:
            status = list(payload, length);
            break;
        case RIG_RECORD:
            status = record(payload);
            break;
        case RIG_GO:
            status = bench_go(get16(payload)) ? RIG_OK : RIG_BUSY;
            break;
        case RIG_STATE:
            status = state_of(&answer[1], &more);
            break;
        case RIG_READ:
            status = read_area(talk, body[1], payload);
            break;
        case RIG_STOP:
            bench_stop();
            break;
        case RIG_BOOTLOADER:
            bench_stop();
            board_bootloader();
            break;
        default:
            status = RIG_UNKNOWN;
            break;
        }
    }
    answer[0] = status;
    send(talk, operation, body[1], answer, 1U + more);
}

static void take_frame(talk_t* const talk)
{
    const uint32_t size = unstuff(talk->in, talk->filled);
    if (size >= HEAD_BYTES + CRC_BYTES) {
        const uint32_t length = size - CRC_BYTES;
        if (crc32_of(talk->in, length) == get32(&talk->in[length])) {
            carry_out(talk, talk->in, length);
        }
    }
}

// ---- rounds ----

static bool flush(talk_t* const talk)
{
    if (talk->sent < talk->size) {
        talk->sent += (uint32_t)board_transmit(talk->line, &talk->out[talk->sent], talk->size - talk->sent);
    }
    return talk->sent == talk->size;
}

static void go_on_reading(talk_t* const talk)
{
    uint8_t payload[4U + 4U * RIG_WORDS_MAX];
    const uint32_t words = (reading.left < RIG_WORDS_MAX) ? reading.left : RIG_WORDS_MAX;
    put32(payload, reading.at);
    for (uint32_t i = 0; i < words; i++) {
        put32(&payload[4U + 4U * i], bench_word(reading.area, reading.at + i));
    }
    send(talk, RIG_DATA, reading.sequence, payload, 4U + 4U * words);
    reading.at += words;
    reading.left -= words;
    if (reading.left == 0U) {
        reading.to = NULL;
    }
}

// A frame whose answer has not gone yet waits, and with it what comes after: at the host, at last.
static void receive(talk_t* const talk)
{
    uint8_t byte;
    while (flush(talk) && (board_receive(talk->line, &byte, 1U) == 1U)) {
        if (byte == 0U) {
            if (!talk->too_long && (talk->filled > 0U)) {
                take_frame(talk);
            }
            talk->filled = 0;
            talk->too_long = false;
        } else if (talk->filled < FRAME_MAX) {
            talk->in[talk->filled++] = byte;
        } else {
            talk->too_long = true;
        }
    }
}

void talk_run(void)
{
    for (uint8_t line = 0; line < LINES; line++) {
        talk_t* const talk = &talks[line];
        talk->line = line;
        receive(talk);
        while ((reading.to == talk) && (reading.left > 0U) && flush(talk)) {
            go_on_reading(talk);
        }
        (void)flush(talk);
    }
}

bool talk_is_busy(void)
{
    return (reading.to != NULL) || (talks[LINE_USB].sent < talks[LINE_USB].size);
}
