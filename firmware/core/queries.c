// What a controller says of itself: who it is, how it is, what happened. Nothing here changes what it does.

#include "commands.h"

#include <string.h>

#include "../board.h"
#include "safety.h"

#ifndef ANNULUS_GIT
#define ANNULUS_GIT "unknown"
#endif
#ifndef ANNULUS_VERSION
#define ANNULUS_VERSION "0.0.0"
#endif

void query_identify(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_identify_t command;
    command_identify_unpack(&command, payload);
    const bool understood = (command.protocol == PROTOCOL_VERSION) && (command.schema == SCHEMA_HASH);
    const bool at_work = (self->armed != 0U) && (line != self->session);  // the other line's host: not to be disturbed
    if (!at_work) {
        board_measure(&(board_look_t){.looks = 0});  // nobody is left who asked for it
        sequencer_preamble(&self->sequencer, &(command_preamble_t){.length = 0});
        self->session = line;
        self->schema_ok = understood;
        if (!understood) {
            safety_arm(self, 0U);  // whoever speaks now could not read what happens
        }
    }
    self->level[line] = 1;
    memset(&self->rereads[line], 0, sizeof self->rereads[line]);
    update_stop(&self->update);
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

// The number that stands `index` dots behind the beginning.
static uint8_t part_of_version(const char* text, uint8_t index)
{
    while ((index > 0U) && (*text != 0)) {
        index -= (*text++ == '.') ? 1U : 0U;
    }
    uint32_t number = 0;
    for (; (*text >= '0') && (*text <= '9'); text++) {
        number = 10U * number + (uint32_t)(*text - '0');
    }
    return (uint8_t)number;
}

// As it was staged, byte by byte; `payload` has room for `stage`'s. The CRC is that of a frame.
static uint16_t configuration_of(const controller_t* const self, uint8_t* const payload)
{
    const command_stage_t* const config = &self->sequencer.config;
    command_stage_pack(config, payload);
    const uint8_t schema = layout_of(COMMAND_STAGE)->schema;
    return (config->generation == 0U) ? 0U : link_crc(payload, COMMAND_STAGE_LENGTH, schema);
}

void query_info(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_info_t command;
    command_info_unpack(&command, payload);
    reply_info_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_info_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.status = STATUS_OK;
        reply.detail = 0;
        self->level[line] = (command.level < LEVEL) ? command.level : LEVEL;
    }
    uint8_t configuration[COMMAND_STAGE_LENGTH];
    reply.level = LEVEL;
    reply.major = part_of_version(ANNULUS_VERSION, 0U);
    reply.minor = part_of_version(ANNULUS_VERSION, 1U);
    reply.patch = part_of_version(ANNULUS_VERSION, 2U);
    memcpy(reply.serial, board_serial_number(), sizeof reply.serial);
    memcpy(reply.commands, known_commands, sizeof reply.commands);
    reply.events = KNOWN_EVENTS;
    reply.nonce = board_nonce();
    reply.configuration = configuration_of(self, configuration);
    reply.crashes = board_crash()->crashes;
    reply.round_longest = board_trail()->longest;
    reply_info_pack(&reply, answer);
}

// The reply has the fields of `stage` between its status and the CRC.
_Static_assert(REPLY_CONFIGURATION_LENGTH == 2U + COMMAND_STAGE_LENGTH + 2U, "configuration is stage's payload");

void query_configuration(controller_t* const self, const uint8_t line, const uint8_t* const payload,
                         uint8_t* const answer)
{
    (void)line;
    (void)payload;
    answer[0] = STATUS_OK;
    answer[1] = 0;
    const uint16_t crc = configuration_of(self, answer + 2U);
    answer[2U + COMMAND_STAGE_LENGTH] = (uint8_t)crc;
    answer[3U + COMMAND_STAGE_LENGTH] = (uint8_t)(crc >> 8);
}

void query_crash(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)self;
    (void)line;
    (void)payload;
    const board_crash_t* const last = board_crash();
    reply_crash_pack(&(reply_crash_t){.status = STATUS_OK,
                                      .crashes = last->crashes,
                                      .boots = last->boots,
                                      .kind = last->kind,
                                      .boot = last->boot,
                                      .pc = last->pc,
                                      .lr = last->lr,
                                      .psr = last->psr,
                                      .part = last->trail.part,
                                      .command = last->trail.command,
                                      .rounds = last->trail.rounds,
                                      .tick = last->trail.tick,
                                      .round_longest = last->trail.longest},
                     answer);
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
    state |= self->turntable.moving ? STATE_TURNTABLE_MOVING : 0U;
    state |= self->turntable.lost ? STATE_TURNTABLE_LOST : 0U;
    state |= self->sequencer.is_staged ? STATE_STAGED : 0U;
    state |= commands_allowed(self, line) ? STATE_SCHEMA_OK : 0U;
    return state;
}

void query_status(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)payload;
    reply_status_pack(&(reply_status_t){.status = STATUS_OK,
                                        .state = state_flags(self, line),
                                        .fault = events_fault_at_level(self->fault, self->level[line]),
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

void query_health(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)self;
    (void)line;
    (void)payload;
    board_health_t health;
    board_health(&health);
    reply_health_pack(&(reply_health_t){.status = STATUS_OK,
                                        .odometer_lost = health.odometer_lost,
                                        .odometer_impossible = health.odometer_impossible,
                                        .edges_dropped = health.edges_dropped,
                                        .usb_hangs = health.usb_hangs},
                      answer);
}

void query_hardware(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)self;
    (void)line;
    (void)payload;
    reply_hardware_pack(
        &(reply_hardware_t){
            .status = STATUS_OK, .board = board_kind(), .vbus = board_vbus(), .interlock = board_interlock()},
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
