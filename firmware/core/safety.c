// Why something must go dark, and what follows from it: faults latch, and disarm everything until they are cleared.

#include "safety.h"

#include "../board.h"
#include "../ticks.h"

static void set_microwave(controller_t* const self, const bool on)
{
    if (on) {  // which needs no configuration
        board_polarity(POLARITY_BURSTS, self->sequencer.wiring.inverted);
    }
    board_microwave(on);
    self->armed = (uint8_t)(on ? self->armed | ARM_MICROWAVE : self->armed & ~ARM_MICROWAVE);
}

static void set_lamps(controller_t* const self, const bool on)
{
    if (on) {
        sequencer_arm(&self->sequencer);
    } else {
        sequencer_disarm(&self->sequencer);
    }
    self->armed = (uint8_t)(on ? self->armed | ARM_LAMPS : self->armed & ~ARM_LAMPS);
}

void safety_trip(controller_t* const self, const uint8_t fault, const uint32_t detail)
{
    if (self->fault != FAULT_NONE) {
        return;  // the first cause stays: `clear` asks whether that one is gone, and nothing is live any more
    }
    self->fault = fault;
    bursts_cut(&self->bursts, fault);
    set_microwave(self, false);
    turntable_cut(&self->turntable);
    if ((self->armed & ARM_LAMPS) != 0U) {
        set_lamps(self, false);
    }
    events_fault(&self->events, board_tick(), fault, detail);
}

void safety_insist(controller_t* const self, const bool accepted, const uint32_t output)
{
    if (!accepted) {
        safety_trip(self, FAULT_LIMIT, output);
    }
}

// One input open and the other closed is a relay that changes over, for as long as its contacts take. What lasts longer
// is a wire, a short or a welded contact. Where a fault is latched already it stays the first cause: this is told, and
// holds up `clear` as well.
static void watch_interlock(controller_t* const self, const uint32_t now)
{
    safety_interlock_t* const interlock = &self->interlock;
    const uint8_t inputs = board_interlock();
    const bool first = (inputs & INTERLOCK_OPEN) != 0U;
    const bool second = (inputs & INTERLOCK_ANTIVALENT_OPEN) != 0U;
    const bool disagreed = interlock->disagrees;
    interlock->disagrees = ((inputs & INTERLOCK_ANTIVALENT) != 0U) && (first != second);
    if (interlock->disagrees && !disagreed) {
        interlock->since = board_tick();  // not `now`: they may have come to since this round began
    }
    if (!interlock->disagrees || interlock->distrusted ||
        (ticks_since(now, interlock->since) <= (int32_t)(INTERLOCK_DISAGREE_MS * TICKS_PER_MS))) {
        return;
    }
    interlock->distrusted = true;
    if (self->fault == FAULT_NONE) {
        safety_trip(self, FAULT_INTERLOCK_DISAGREES, inputs);
    } else {
        events_fault(&self->events, now, FAULT_INTERLOCK_DISAGREES, inputs);
    }
}

uint8_t safety_interlock(controller_t* const self, const uint8_t inputs)
{
    if ((self->armed != 0U) || self->turntable.moving) {
        return STATUS_BAD_STATE;
    }
    const bool antivalent = (inputs & INTERLOCK_ANTIVALENT) != 0U;
    if (antivalent != ((board_interlock() & INTERLOCK_ANTIVALENT) != 0U)) {  // said again, it forgets nothing
        board_interlock_watch(antivalent);
        self->interlock = (safety_interlock_t){.disagrees = false};
    }
    return STATUS_OK;
}

static int32_t host_timeout_ticks(const controller_t* const self)
{
    const uint32_t ms = self->sequencer.config.host_timeout;
    return (int32_t)(((ms == 0U) ? HOST_TIMEOUT_DEFAULT_MS : ms) * TICKS_PER_MS);
}

void safety_run(controller_t* const self, const uint32_t now)
{
    const bool starved = board_microwave_starved();  // first: an interlock that opens in between is the cause of both
    const bool tripped = board_interlock_tripped();  // also forgets a trip while nothing was live
    const bool live = (self->armed != 0U) || self->turntable.moving;
    const bool open = self->turntable.powered && board_interlock_open();  // also where nobody saw it open
    if (open || (tripped && (live || self->turntable.powered))) {
        safety_trip(self, FAULT_INTERLOCK, 0U);
    }
    watch_interlock(self, now);
    if ((self->fault != FAULT_NONE) || !live) {
        return;
    }
    if (starved) {
        safety_trip(self, FAULT_WATCHDOG, BOARD_STARVED_MS);
    } else if (!board_connected(self->session) || (ticks_since(now, self->heard) > host_timeout_ticks(self))) {
        safety_trip(self, FAULT_HOST_TIMEOUT, now - self->heard);
    }
}

uint8_t safety_arm(controller_t* const self, const uint8_t outputs)
{
    const bool lamps = (outputs & ARM_LAMPS) != 0U;
    const bool microwave = (outputs & ARM_MICROWAVE) != 0U;
    if (outputs != 0U) {
        if ((self->fault != FAULT_NONE) || (microwave && board_interlock_open())) {
            return STATUS_UNSAFE;
        }
        if (lamps && (self->sequencer.config.generation == 0U)) {
            return STATUS_BAD_STATE;
        }
    }
    if (outputs == 0U) {
        turntable_stop(&self->turntable, STOP_CAUSE_STOPPED);
    }
    if (microwave != ((self->armed & ARM_MICROWAVE) != 0U)) {
        set_microwave(self, microwave);
    }
    if (lamps != ((self->armed & ARM_LAMPS) != 0U)) {  // already firing lamps keep their place in the cycle
        set_lamps(self, lamps);
    }
    return STATUS_OK;
}

uint8_t safety_clear(controller_t* const self)
{
    const bool of_interlock =
        (self->fault == FAULT_INTERLOCK) || (self->fault == FAULT_INTERLOCK_DISAGREES) || self->interlock.distrusted;
    if (of_interlock && board_interlock_open()) {
        return STATUS_UNSAFE;
    }
    self->interlock.distrusted = false;
    self->interlock.disagrees = false;  // what disagrees from now on does so from now on
    self->fault = FAULT_NONE;
    return STATUS_OK;
}
