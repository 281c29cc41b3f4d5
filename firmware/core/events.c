// The last 64 events, by sequence: sent once as they come, and again when asked for.

#include "events.h"

#include <stddef.h>

#include "count.h"

// Distance from `sequence` to the newest end of the ring; 0 for one that does not exist yet.
static uint16_t age(const events_t* const self, const uint16_t sequence)
{
    return (uint16_t)(self->next - sequence);
}

uint8_t* events_emit(events_t* const self, const uint8_t id)
{
    if (age(self, self->sent) == EVENT_RING) {  // about to overwrite one that was never sent
        self->sent++;
        count_one_more(&self->overruns);
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

uint8_t events_reread(const events_t* const self, rereads_t* const rereads, const command_reread_t* const command,
                      reply_reread_t* const reply)
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
    if (count == 0U) {
        return STATUS_GONE;
    }
    if (rereads->waiting == REREADS_MAX) {  // nothing is promised that would push out an older promise
        return STATUS_BAD_STATE;
    }
    const uint8_t last = (uint8_t)((rereads->oldest + rereads->waiting) % REREADS_MAX);
    rereads->runs[last].first = first;
    rereads->runs[last].count = (uint8_t)count;
    rereads->waiting++;
    reply->count = (uint8_t)count;
    return STATUS_OK;
}

const event_t* events_again(const events_t* const self, rereads_t* const rereads, uint16_t* const sequence)
{
    while (rereads->waiting > 0U) {
        *sequence = rereads->runs[rereads->oldest].first++;
        if (--rereads->runs[rereads->oldest].count == 0U) {
            rereads->oldest = (uint8_t)((rereads->oldest + 1U) % REREADS_MAX);
            rereads->waiting--;
        }
        if (age(self, *sequence) <= self->held) {
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

// Those that do not are only reported.
static bool latches(const uint8_t fault)
{
    return (fault != FAULT_NONE) && (fault != FAULT_LATE_LOAD) && (fault != FAULT_EVENT_OVERRUN) &&
           (fault != FAULT_ODOMETER);
}

// The known one that is nearest to a latched one that was added: what its host then does is right for both.
static uint8_t nearest(const uint8_t fault)
{
    return (fault == FAULT_INTERLOCK_DISAGREES) ? FAULT_INTERLOCK : FAULT_LIMIT;
}

uint8_t events_fault_at_level(const uint8_t fault, const uint8_t level)
{
    return (fault_since(fault) > level) ? nearest(fault) : fault;
}

event_t events_at_level(const event_t* const event, const uint8_t level)
{
    event_t said = *event;
    if (layout_of(event->id)->since > level) {
        event_fault_t stands_in;
        event_fault_unpack(&stands_in, event->payload);  // what is added begins with its tick
        stands_in.fault = FAULT_NONE;
        stands_in.detail = event->id;
        said.id = EVENT_FAULT;
        event_fault_pack(&stands_in, said.payload);
    } else if (event->id == EVENT_FAULT) {
        event_fault_t fault;
        event_fault_unpack(&fault, event->payload);
        if (fault_since(fault.fault) > level) {
            fault.detail = fault.fault;
            fault.fault = latches(fault.fault) ? nearest(fault.fault) : FAULT_NONE;
            event_fault_pack(&fault, said.payload);
        }
    } else if (event->id == EVENT_EDGE) {
        said.payload[EVENT_EDGE_LENGTH - 1U] &= (uint8_t)edge_flags_at_level(level);  // `flags` comes last
    } else if (event->id == EVENT_BURST_DONE) {
        event_burst_done_t done;
        event_burst_done_unpack(&done, event->payload);
        done.fault = events_fault_at_level(done.fault, level);
        event_burst_done_pack(&done, said.payload);
    }
    return said;
}

void events_run(events_t* const self, const uint32_t tick)
{
    // Only once there is room again: a report of an overrun must not cause the next.
    if (self->overrun && (age(self, self->sent) < EVENT_RING / 2U)) {
        self->overrun = false;
        events_fault(self, tick, FAULT_EVENT_OVERRUN, self->overruns);
    }
}
