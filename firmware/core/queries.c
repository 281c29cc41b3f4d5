// What a controller says of itself: who it is, how it is, what happened. Nothing here changes what it does.

#include "commands.h"

#include <string.h>

#include "../board.h"
#include "safety.h"

#ifndef ANNULUS_GIT
#define ANNULUS_GIT "unknown"
#endif

void query_identify(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_identify_t command;
    command_identify_unpack(&command, payload);
    const bool understood = (command.protocol == PROTOCOL_VERSION) && (command.schema == SCHEMA_HASH);
    const bool at_work = (self->armed != 0U) && (line != self->session);  // the other line's host: not to be disturbed
    if (!at_work) {
        board_measure(&(board_look_t){.looks = 0});  // nobody is left who asked for it
        self->session = line;
        self->schema_ok = understood;
        if (!understood) {
            safety_arm(self, 0U);  // whoever speaks now could not read what happens
        }
    }
    link_forget(&self->links[line]);
    const uint8_t taken = at_work ? STATUS_BAD_STATE : STATUS_OK;
    reply_identify_t reply = {.status = understood ? taken : STATUS_SCHEMA,
                              .protocol = PROTOCOL_VERSION,
                              .schema = SCHEMA_HASH,
                              .boot = board_boot(),
                              .cause = board_cause(),
                              .tick_hz = TICK_HZ,
                              .git = {0},
                              .lamp_width_max = LAMP_WIDTH_MAX_TICKS,
                              .lamp_duty_max = LAMP_DUTY_MAX_PERMILLE,
                              .pulse_min = MICROWAVE_PULSE_MIN_TICKS,
                              .pulse_max = MICROWAVE_PULSE_MAX_TICKS};
    static const char git[] = ANNULUS_GIT;
    memcpy(reply.git, git, (sizeof git - 1U < sizeof reply.git) ? sizeof git - 1U : sizeof reply.git);
    memcpy(reply.board, board_name(), sizeof reply.board);
    reply_identify_pack(&reply, answer);
}

void query_ping(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)self;
    (void)line;
    (void)payload;
    reply_ping_pack(&(reply_ping_t){.status = STATUS_OK, .tick = board_tick()}, answer);
}

static uint16_t state_flags(const controller_t* const self, const uint8_t line)
{
    uint16_t state = 0;
    state |= self->sequencer.synced ? STATE_SYNCED : 0U;
    state |= ((self->armed & ARM_LAMPS) != 0U) ? STATE_LAMPS_ARMED : 0U;
    state |= ((self->armed & ARM_MICROWAVE) != 0U) ? STATE_MICROWAVE_ARMED : 0U;
    state |= self->bursts.running ? STATE_BURST_RUNNING : 0U;
    state |= board_interlock_open() ? STATE_INTERLOCK_OPEN : 0U;
    state |= self->moving ? STATE_TURNTABLE_MOVING : 0U;
    state |= self->sequencer.is_staged ? STATE_STAGED : 0U;
    state |= commands_allowed(self, line) ? STATE_SCHEMA_OK : 0U;
    return state;
}

void query_status(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)payload;
    reply_status_pack(&(reply_status_t){.status = STATUS_OK,
                                        .state = state_flags(self, line),
                                        .fault = self->fault,
                                        .generation = self->sequencer.config.generation,
                                        .edges = self->sequencer.edges,
                                        .rejected = board_edges_refused(),
                                        .period = self->sequencer.period,
                                        .odometer = board_odometer(),
                                        .events = self->events.next,
                                        .bad_frames = self->links[line].bad_frames,
                                        .late = self->sequencer.late,
                                        .overruns = self->events.overruns,
                                        .turntable = board_turntable_position()},
                      answer);
}

void query_reread(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_reread_t command;
    command_reread_unpack(&command, payload);
    reply_reread_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_reread_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        reply.status = events_reread(&self->events, &self->rereads[line], &command, &reply);
    }
    reply_reread_pack(&reply, answer);
}

void query_samples(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)self;
    (void)line;
    command_samples_t command;
    command_samples_unpack(&command, payload);
    reply_samples_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_samples_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply = (reply_samples_t){.status = STATUS_OK};
        bool differs = false;
        reply.looks = board_measured(command.latest != 0U, command.word, reply.bits, &differs);
        reply.differs = differs ? 1U : 0U;
    }
    reply_samples_pack(&reply, answer);
}
