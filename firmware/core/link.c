// Bytes to commands, and replies, notices and events to bytes. Knows no command's meaning and no port.

#include "link.h"

#include <string.h>

#include "count.h"

#define CRC_SIZE 2U
#define COMMAND_HEADER 2U  // id, sequence

static uint16_t crc_byte(const uint16_t before, const uint8_t byte)
{
    static const uint16_t of_nibble[16] = {0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
                                           0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF};
    uint32_t crc = before;
    crc = (crc << 4) ^ of_nibble[((crc >> 12) ^ (byte >> 4)) & 0xFU];
    crc = (crc << 4) ^ of_nibble[((crc >> 12) ^ byte) & 0xFU];
    return (uint16_t)crc;
}

uint16_t link_crc(const uint8_t* const body, const size_t length, const uint8_t schema)
{
    uint16_t crc = 0xFFFFU;
    for (size_t i = 0; i < length; i++) {
        crc = crc_byte(crc, body[i]);
    }
    return crc_byte(crc, schema) ^ 0xFFFFU;
}

size_t cobs_decode(uint8_t* const bytes, const size_t length)
{
    size_t from = 0;
    size_t to = 0;
    while (from < length) {
        const uint8_t code = bytes[from];
        if ((code == 0U) || (from + code > length)) {
            return 0;
        }
        // The write position never overtakes the read position: each code byte read makes at most one zero.
        memmove(bytes + to, bytes + from + 1U, code - 1U);
        to += code - 1U;
        from += code;
        if (from < length) {
            bytes[to++] = 0U;
        }
    }
    return to;
}

uint8_t link_frame(const uint8_t* const body, const size_t length, const uint8_t schema, uint8_t wire[const MAX_WIRE])
{
    const uint32_t crc = link_crc(body, length, schema);
    uint8_t code_at = 0;
    uint8_t to = 1;
    for (size_t i = 0; i < length + CRC_SIZE; i++) {
        const uint8_t byte = (i < length) ? body[i] : (uint8_t)((i == length) ? crc : crc >> 8);
        if (byte == 0U) {
            wire[code_at] = (uint8_t)(to - code_at);
            code_at = to++;
        } else {
            wire[to++] = byte;
        }
    }
    wire[code_at] = (uint8_t)(to - code_at);
    wire[to++] = 0U;
    return to;
}

void link_start(link_t* const self)
{
    const uint16_t bad_frames = self->bad_frames;
    memset(self, 0, sizeof *self);
    self->bad_frames = bad_frames;
    self->sending[0] = 0U;  // a lone delimiter
    self->sending_length = 1;
}

static bool refuse(link_t* const self)
{
    count_one_more(&self->bad_frames);
    self->garbled = true;
    return false;
}

// The kept reply to the same command with the same sequence and the same body, told by its CRC.
static kept_reply_t* find_reply(link_t* const self, const command_t* const command)
{
    for (uint8_t i = 0; i < REPLIES_KEPT; i++) {
        kept_reply_t* const reply = &self->replies[i];
        if (reply->known && (reply->id == command->layout->id) && (reply->sequence == command->sequence) &&
            (reply->crc == command->crc)) {
            return reply;
        }
    }
    return NULL;
}

static bool end_of_frame(link_t* const self, command_t* const command, bool* const host_alive)
{
    const size_t length = cobs_decode(self->received, self->received_length);
    if (length < COMMAND_HEADER + CRC_SIZE) {
        return refuse(self);
    }
    const uint8_t* const body = self->received;
    const layout_t* const layout = (body[0] < REPLY_BIT) ? layout_of(body[0]) : NULL;
    if ((layout == NULL) || (length != COMMAND_HEADER + layout->length + CRC_SIZE)) {
        return refuse(self);
    }
    const uint16_t crc = (uint16_t)(body[length - 2U] | (body[length - 1U] << 8));
    if (crc != link_crc(body, length - CRC_SIZE, layout->schema)) {
        return refuse(self);
    }
    *host_alive = true;
    command->layout = layout;
    command->sequence = body[1];
    command->crc = crc;
    memcpy(command->payload, body + COMMAND_HEADER, layout->length);
    kept_reply_t* const reply = find_reply(self, command);
    if (reply != NULL) {
        reply->pending = true;
        return false;
    }
    return true;
}

bool link_has_room(const link_t* const self)
{
    return !self->replies[self->next_reply].pending;
}

bool link_receive(link_t* const self, const uint8_t byte, command_t* const command, bool* const host_alive)
{
    if (byte != 0U) {
        if (self->received_length < sizeof self->received - 1U) {
            self->received[self->received_length++] = byte;
        } else {
            self->overflow = true;
        }
        return false;
    }
    bool complete = false;
    if (self->overflow) {
        refuse(self);
    } else if (self->received_length > 0U) {  // an empty frame is how a host clears the line: no fault
        complete = end_of_frame(self, command, host_alive);
    }
    self->received_length = 0;
    self->overflow = false;
    return complete;
}

void link_reply(link_t* const self, const command_t* const command, const uint8_t* const payload)
{
    const layout_t* const layout = layout_of(command->layout->id + REPLY_BIT);
    uint8_t body[COMMAND_HEADER + PAYLOAD_MAX];
    body[0] = layout->id;
    body[1] = command->sequence;
    memcpy(body + COMMAND_HEADER, payload, layout->length);
    kept_reply_t* const reply = &self->replies[self->next_reply];
    self->next_reply = (uint8_t)((self->next_reply + 1U) % REPLIES_KEPT);
    reply->pending = true;
    reply->known = command->layout->query == 0U;
    reply->id = command->layout->id;
    reply->sequence = command->sequence;
    reply->crc = command->crc;
    reply->length = link_frame(body, COMMAND_HEADER + layout->length, layout->schema, reply->wire);
}

void link_forget(link_t* const self)
{
    for (uint8_t i = 0; i < REPLIES_KEPT; i++) {
        self->replies[i].known = false;
    }
}

bool link_next(link_t* const self)
{
    for (uint8_t i = 0; i < REPLIES_KEPT; i++) {  // from the oldest: next_reply is the one to be overwritten next
        kept_reply_t* const reply = &self->replies[(self->next_reply + i) % REPLIES_KEPT];
        if (reply->pending) {
            reply->pending = false;
            memcpy(self->sending, reply->wire, reply->length);
            self->sending_length = reply->length;
            self->sending_at = 0;
            return true;
        }
    }
    if (self->garbled) {
        self->garbled = false;
        uint8_t body[1U + NOTICE_GARBLED_LENGTH] = {NOTICE_GARBLED};
        notice_garbled_pack(&(notice_garbled_t){.bad_frames = self->bad_frames}, body + 1U);
        self->sending_length = link_frame(body, sizeof body, layout_of(NOTICE_GARBLED)->schema, self->sending);
        self->sending_at = 0;
        return true;
    }
    return false;
}

void link_send_event(link_t* const self, const uint8_t id, const uint16_t sequence, const uint8_t boot,
                     const uint8_t* const payload)
{
    const layout_t* const layout = layout_of(id);
    uint8_t body[4U + EVENT_PAYLOAD_MAX] = {id, (uint8_t)sequence, (uint8_t)(sequence >> 8), boot};
    memcpy(body + 4U, payload, layout->length);
    self->sending_length = link_frame(body, 4U + layout->length, layout->schema, self->sending);
    self->sending_at = 0;
}

bool link_busy(const link_t* const self)
{
    return self->sending_at < self->sending_length;
}

bool link_idle(const link_t* const self)
{
    for (uint8_t i = 0; i < REPLIES_KEPT; i++) {
        if (self->replies[i].pending) {
            return false;
        }
    }
    return !link_busy(self);
}
