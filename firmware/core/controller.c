// The controller as a whole: what a main loop starts and runs.

#include "controller.h"

#include <string.h>

#include "../board.h"
#include "../ticks.h"
#include "dispatch.h"
#include "safety.h"

#define HUSH_TICKS (TICK_HZ / 10U)           // an encoder gone bad must not fill the line with its reports
#define LEAVE_TICKS ((int32_t)TICK_HZ / 10)  // patience with a host that does not fetch the acknowledgement

void controller_start(controller_t* const self)
{
    memset(self, 0, sizeof *self);
    memset(self->level, 1, sizeof self->level);
    turntable_reset(&self->turntable);
    const uint8_t cause = board_cause();
    const uint32_t now = board_tick();
    event_booted_pack(&(event_booted_t){.cause = cause, .tick = now}, events_emit(&self->events, EVENT_BOOTED));
    if (cause == BOOT_CAUSE_WATCHDOG) {
        safety_trip(self, FAULT_WATCHDOG, 0U);
    }
    sequencer_start(&self->sequencer);
}

// Safety looks again first: what cut a train may have happened since this round began, and its report names the cause.
static void end_burst(controller_t* const self)
{
    uint16_t done;
    if (bursts_ended(&self->bursts, &done)) {
        const uint32_t now = board_tick();
        safety_run(self, now);
        bursts_report(&self->bursts, &self->events, done, now);
    }
}

// An odometer that is off says so, once for all that was missed since it last did.
static void report_odometer(controller_t* const self)
{
    board_health_t health;
    board_health(&health);
    const uint32_t now = board_tick();  // none of it was missed later, however long this round has lasted
    const uint32_t missed = health.odometer_lost + health.odometer_impossible;
    self->odometer_hushed = self->odometer_hushed && !tick_is_past(now, self->odometer_hushed_until);
    if ((missed != self->odometer_missed) && !self->odometer_hushed) {
        self->odometer_missed = missed;
        self->odometer_hushed = true;
        self->odometer_hushed_until = now + HUSH_TICKS;
        events_fault(&self->events, now, FAULT_ODOMETER, missed);
    }
}

// A host that is there again begins at a frame's beginning, and finds nothing of what was meant for the one before.
static void watch_connection(controller_t* const self, const uint8_t line)
{
    const bool connected = board_connected(line);
    if (connected && !self->connected[line]) {
        link_start(&self->links[line]);
        memset(&self->rereads[line], 0, sizeof self->rereads[line]);
        self->level[line] = 1;
        self->holds[line] = false;
    }
    self->connected[line] = connected;
}

static bool needs_flash(const command_t* const command)
{
    const uint8_t id = command->layout->id;
    return (id == COMMAND_UPDATE_BEGIN) || (id == COMMAND_UPDATE_DATA) || (id == COMMAND_UPDATE_END);
}

static void execute(controller_t* const self, const uint8_t line, const command_t* const command)
{
    uint8_t reply[PAYLOAD_MAX];
    board_trail()->part = PART_COMMAND;
    board_trail()->command = command->layout->id;
    dispatch(self, line, command, reply);
    link_reply(&self->links[line], command, reply);
}

// One command a line and round at most, so that no round is long. An update's waits while the flash is at work, and
// nothing more is taken from its line.
static void receive(controller_t* const self, const uint8_t line)
{
    link_t* const link = &self->links[line];
    command_t* const held = &self->held[line];
    bool complete = self->holds[line];
    uint8_t byte;
    while (!complete && (self->leaving == LEAVE_NOT) && link_has_room(link) && (board_receive(line, &byte, 1U) == 1U)) {
        bool heard = false;
        complete = link_receive(link, byte, held, &heard);
        if (heard && (line == self->session)) {  // whoever only looks on keeps nothing alight
            self->heard = board_tick();
        }
    }
    self->holds[line] = complete && needs_flash(held) && self->flash_busy;
    if (complete && !self->holds[line]) {
        execute(self, line, held);
        self->flash_busy = board_update_run();
    }
}

static const event_t* next_event(controller_t* const self, const uint8_t line, uint16_t* const sequence)
{
    const event_t* const again = events_again(&self->events, &self->rereads[line], sequence);
    return ((again == NULL) && (line == self->session)) ? events_next(&self->events, sequence) : again;
}

static void transmit(controller_t* const self, const uint8_t line)
{
    link_t* const link = &self->links[line];
    for (;;) {
        if (!link_busy(link) && !link_next(link)) {
            uint16_t sequence;
            const event_t* const event = next_event(self, line, &sequence);
            if (event == NULL) {
                return;
            }
            const event_t said = events_at_level(event, self->level[line]);
            link_send_event(link, said.id, sequence, board_boot(), said.payload);
        }
        link->sending_at += (uint8_t)board_transmit(line, link->sending + link->sending_at,
                                                    (size_t)(link->sending_length - link->sending_at));
        if (link_busy(link)) {
            return;  // the line is full
        }
    }
}

// Told to go, and the acknowledgement has left; or nobody fetches it.
static bool may_leave(const controller_t* const self)
{
    bool quiet = true;
    for (uint8_t line = 0; line < LINES; line++) {
        quiet = quiet && link_idle(&self->links[line]) && board_transmitted(line);
    }
    const bool waited = ticks_since(board_tick(), self->leaving_since) > LEAVE_TICKS;
    return (quiet || waited) && !self->flash_busy;
}

void controller_run(controller_t* const self)
{
    board_watchdog_kick();
    board_microwave_feed();
    board_trail_t* const trail = board_trail();
    trail->rounds++;
    self->flash_busy = board_update_run();
    if ((self->leaving != LEAVE_NOT) && may_leave(self)) {
        if (self->leaving == LEAVE_TO_BOOTLOADER) {
            board_bootloader();
        } else {
            board_reset();
        }
        return;
    }
    const uint32_t now = board_tick();
    trail->tick = now;
    trail->part = PART_EDGES;
    sequencer_edges(&self->sequencer, &self->events, now);
    trail->part = PART_SAFETY;
    safety_run(self, now);
    for (uint8_t line = 0; line < LINES; line++) {
        trail->part = PART_RECEIVE;
        watch_connection(self, line);
        receive(self, line);
    }
    trail->part = PART_LOAD;
    const bool accepted = sequencer_load(&self->sequencer, &self->events, now);
    safety_insist(self, accepted, sequencer_lamp(&self->sequencer));
    trail->part = PART_SAFETY;
    end_burst(self);
    trail->part = PART_REPORTS;
    turntable_run(&self->turntable, &self->events, now);
    board_measure_run();
    report_odometer(self);
    update_run(&self->update, now);
    events_run(&self->events, now);
    board_status_light(self->armed != 0U);
    trail->part = PART_TRANSMIT;
    for (uint8_t line = 0; line < LINES; line++) {
        transmit(self, line);
    }
}
