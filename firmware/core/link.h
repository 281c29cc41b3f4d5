// Bytes to commands, and replies, notices and events to bytes. Knows no command's meaning and no port.

#ifndef ANNULUS_LINK_H
#define ANNULUS_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "messages.h"

#define REPLIES_KEPT 8U  // as many commands as a host may have outstanding; see protocol/README.md

typedef struct {
    const layout_t* layout;
    uint8_t sequence;
    uint16_t crc;
    uint8_t payload[PAYLOAD_MAX];
} command_t;

typedef struct {
    bool pending;  // waits to be sent
    bool known;    // a repeat of this command is answered from here
    uint8_t id;
    uint8_t sequence;
    uint16_t crc;
    uint8_t length;
    uint8_t wire[MAX_WIRE];
} kept_reply_t;

typedef struct {
    uint8_t received[MAX_WIRE];
    uint8_t received_length;
    bool overflow;
    bool garbled;  // a notice is due
    uint16_t bad_frames;
    kept_reply_t replies[REPLIES_KEPT];
    uint8_t next_reply;
    uint8_t sending[MAX_WIRE];
    uint8_t sending_length;
    uint8_t sending_at;
} link_t;

// CRC-16 of the body and the schema byte, poly 0x1021, init 0xFFFF, xorout 0xFFFF.
uint16_t link_crc(const uint8_t* body, size_t length, uint8_t schema);

// Decode in place what stands before a delimiter; the decoded length, or 0 when it is not COBS.
size_t cobs_decode(uint8_t* bytes, size_t length);

// `body` (no CRC yet) as a frame, delimiter included; its length.
uint8_t link_frame(const uint8_t* body, size_t length, uint8_t schema, uint8_t wire[MAX_WIRE]);

// After a reset, or when a host is there again. Forgets all but the count of bad frames, and ends whatever frame was
// cut short, so that the first one after it can be read.
void link_start(link_t* self);

// One byte from the line. True when it completed a valid command that has to be carried out: fill in a reply with
// link_reply. A repeat of a known command is answered from memory and not reported here.
bool link_receive(link_t* self, uint8_t byte, command_t* command, bool* host_alive);

// Is there room for one more answer? Before that nothing should be taken from the line.
bool link_has_room(const link_t* self);

// Queue the answer to the command just received.
void link_reply(link_t* self, const command_t* command, const uint8_t* payload);

// No command received so far is a repeat of one to come: a new session begins.
void link_forget(link_t* self);

// The frame to send next, if one waits here: replies oldest first, then a notice.
bool link_next(link_t* self);

// Put an event into the sending buffer. Only when link_busy is false.
void link_send_event(link_t* self, uint8_t id, uint16_t sequence, uint8_t boot, const uint8_t* payload);

bool link_busy(const link_t* self);
bool link_idle(const link_t* self);  // nothing being sent and no reply waiting

#endif
