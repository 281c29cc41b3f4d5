// The last 64 events, by sequence: sent once as they come, and again when asked for.

#include "events.h"

#include <stddef.h>

// Distance from `sequence` to the newest end of the ring; 0 for one that does not exist yet.
static uint16_t age(const events_t* const self, const uint16_t sequence)
{
    return (uint16_t)(self->next - sequence);
}

uint8_t* events_emit(events_t* const self, const uint8_t id)
{
    if (age(self, self->sent) == EVENT_RING) {  // about to overwrite one that was never sent
        self->sent++;
        self->overruns++;
        self->overrun = true;
    }
    event_t* const event = &self->ring[self->next % EVENT_RING];
    event->id = id;
    self->next++;
    if (self->held < EVENT_RING) {
        self->held++;
    }
    return event->payload;
}

void events_fault(events_t* const self, const uint32_t tick, const uint8_t fault, const uint32_t detail)
{
    event_fault_pack(&(event_fault_t){.tick = tick, .fault = fault, .detail = detail}, events_emit(self, EVENT_FAULT));
}

uint8_t events_reread(events_t* const self, const command_reread_t* const command, reply_reread_t* const reply)
{
    uint16_t first = command->first;
    uint16_t count = command->count;
    const uint16_t behind = age(self, first);
    if (behind > self->held) {  // older than the ring, or not yet: an event to come is 65536 - n behind
        const uint16_t missing = (uint16_t)(behind - self->held);
        const uint16_t skipped = (missing < count) ? missing : count;
        first = (uint16_t)(first + skipped);
        count = (uint16_t)(count - skipped);
    }
    if (count > age(self, first)) {
        count = age(self, first);
    }
    reply->first = first;
    reply->count = (uint8_t)count;
    self->again = first;
    self->again_count = (uint8_t)count;
    return (count > 0U) ? STATUS_OK : STATUS_GONE;
}

const event_t* events_again(events_t* const self, uint16_t* const sequence)
{
    while (self->again_count > 0U) {
        *sequence = self->again++;
        self->again_count--;
        if (age(self, *sequence) <= self->held) {  // may have left the ring since it was asked for
            return &self->ring[*sequence % EVENT_RING];
        }
    }
    return NULL;
}

const event_t* events_next(events_t* const self, uint16_t* const sequence)
{
    if (self->sent == self->next) {
        return NULL;
    }
    *sequence = self->sent++;
    return &self->ring[*sequence % EVENT_RING];
}

void events_run(events_t* const self, const uint32_t tick)
{
    // Only once there is room again: a report of an overrun must not cause the next.
    if (self->overrun && (age(self, self->sent) < EVENT_RING / 2U)) {
        self->overrun = false;
        events_fault(self, tick, FAULT_EVENT_OVERRUN, self->overruns);
    }
}
