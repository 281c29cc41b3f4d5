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

typedef struct {
    event_t ring[EVENT_RING];
    uint16_t next;        // sequence the next event will carry
    uint16_t sent;        // sequence to be sent next
    uint8_t held;         // how many the ring holds
    uint16_t again;       // sequence to be sent again next
    uint8_t again_count;  // how many more
    uint16_t overruns;
    bool overrun;  // a fault event about it is due
} events_t;

// Room for the next event's payload; it counts from now on.
uint8_t* events_emit(events_t* self, uint8_t id);

// A latched or passing fault, said as an event.
void events_fault(events_t* self, uint32_t tick, uint8_t fault, uint32_t detail);

// Send `count` from `first` again. STATUS_OK or STATUS_GONE; the reply says which will follow.
uint8_t events_reread(events_t* self, const command_reread_t* command, reply_reread_t* reply);

// The event to send again now and its sequence, or NULL. These go first: the host waits for them.
const event_t* events_again(events_t* self, uint16_t* sequence);

// The event to send for the first time, and its sequence, or NULL.
const event_t* events_next(events_t* self, uint16_t* sequence);

// Once a round: an overrun that is over is reported.
void events_run(events_t* self, uint32_t tick);

#endif
