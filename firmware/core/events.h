// The last 64 events, by sequence: sent once as they come, and again when asked for.

#ifndef ANNULUS_EVENTS_H
#define ANNULUS_EVENTS_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

typedef struct {
    uint8_t id;
    uint8_t payload[EVENT_PAYLOAD_MAX];
} event_t;

#define REREADS_MAX 8U  // promised and not yet sent, a line: as many commands as a host may have outstanding

// Events promised to one line, in the order in which they were asked for.
typedef struct {
    struct {
        uint16_t first;
        uint8_t count;
    } runs[REREADS_MAX];
    uint8_t oldest;
    uint8_t waiting;  // runs
} rereads_t;

typedef struct {
    event_t ring[EVENT_RING];
    uint16_t next;  // sequence the next event will carry
    uint16_t sent;  // sequence to be sent next
    uint8_t held;   // how many the ring holds
    uint16_t overruns;
    bool overrun;  // a fault event about it is due
} events_t;

// Room for the next event's payload; it counts from now on.
uint8_t* events_emit(events_t* self, uint8_t id);

// A latched or passing fault, said as an event.
void events_fault(events_t* self, uint32_t tick, uint8_t fault, uint32_t detail);

// Promise `count` from `first` again. STATUS_OK, STATUS_GONE, or STATUS_BAD_STATE while no further promise can be kept;
// the reply says which will follow.
uint8_t events_reread(const events_t* self, rereads_t* rereads, const command_reread_t* command, reply_reread_t* reply);

// The event to send again now and its sequence, or NULL. These go first: the host waits for them. One that has left the
// ring since it was promised is passed over; whoever asks for it once more hears that it is gone.
const event_t* events_again(const events_t* self, rereads_t* rereads, uint16_t* sequence);

// The event to send for the first time, and its sequence, or NULL.
const event_t* events_next(events_t* self, uint16_t* sequence);

// An event as a host of this level can read it. What it does not know becomes a `fault`, so that its sequence number is
// not missed: with code `limit` if something latched, else `none`; detail: the id or the code it stands for.
event_t events_at_level(const event_t* event, uint8_t level);

// A latched fault's code as a host of this level can read it.
uint8_t events_fault_at_level(uint8_t fault, uint8_t level);

// Once a round: an overrun that is over is reported.
void events_run(events_t* self, uint32_t tick);

#endif
