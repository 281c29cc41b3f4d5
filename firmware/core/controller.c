// The controller as a whole: what a main loop starts and runs.

#include "controller.h"

#include <string.h>

#include "../board.h"
#include "commands.h"
#include "safety.h"

void controller_start(controller_t* const self)
{
    memset(self, 0, sizeof *self);
    const uint8_t cause = board_cause();
    const uint32_t now = board_tick();
    event_booted_pack(&(event_booted_t){.cause = cause, .tick = now}, events_emit(&self->events, EVENT_BOOTED));
    if (cause == BOOT_CAUSE_WATCHDOG) {
        safety_trip(self, FAULT_WATCHDOG, 0U);
    }
    sequencer_start(&self->sequencer);
    link_start(&self->link);
}

static void report_stage(controller_t* const self, const uint32_t now)
{
    if (self->moving && !board_stage_moving()) {
        self->moving = false;
        event_stage_done_pack(&(event_stage_done_t){.tick = now, .position = board_stage_position()},
                              events_emit(&self->events, EVENT_STAGE_DONE));
    }
}

// One command a round at most, so that no round is long and no more than one flash is loaded in it.
static void receive(controller_t* const self)
{
    command_t command;
    bool complete = false;
    uint8_t byte;
    while (!complete && (self->leaving == LEAVE_NOT) && (board_receive(&byte, 1U) == 1U)) {
        bool heard = false;
        complete = link_receive(&self->link, byte, &command, &heard);
        if (heard) {
            self->heard = board_tick();
        }
    }
    if (complete) {
        uint8_t reply[PAYLOAD_MAX];
        commands_execute(self, &command, reply);
        link_reply(&self->link, &command, reply);
    }
}

static void transmit(controller_t* const self)
{
    link_t* const link = &self->link;
    for (;;) {
        if (!link_busy(link) && !link_next(link)) {
            uint16_t sequence;
            const event_t* const event = events_next(&self->events, &sequence);
            if (event == NULL) {
                return;
            }
            link_send_event(link, event->id, sequence, board_boot(), event->payload);
        }
        link->sending_at += (uint8_t)board_transmit(link->sending + link->sending_at,
                                                    (size_t)(link->sending_length - link->sending_at));
        if (link_busy(link)) {
            return;  // the line is full
        }
    }
}

void controller_run(controller_t* const self)
{
    board_watchdog_kick();
    if ((self->leaving != LEAVE_NOT) && link_idle(&self->link) && board_transmitted()) {
        if (self->leaving == LEAVE_TO_BOOTLOADER) {
            board_bootloader();
        } else {
            board_reset();
        }
        return;
    }
    const uint32_t now = board_tick();
    sequencer_edges(&self->sequencer, &self->events, now);
    safety_run(self, now);
    receive(self);
    safety_insist(self, sequencer_load(&self->sequencer, &self->events, now));
    bursts_run(&self->bursts, &self->events, board_tick());
    report_stage(self, now);
    events_run(&self->events, now);
    board_status_light(self->armed != 0U);
    transmit(self);
}
