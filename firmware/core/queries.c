// What a controller says of itself: who it is, how it is, what happened. Nothing here changes what it does.

#include "commands.h"

#include <string.h>

#include "../board.h"
#include "dispatch.h"
#include "safety.h"

#ifndef ANNULUS_GIT
#define ANNULUS_GIT "unknown"
#endif
#ifndef ANNULUS_VERSION
#define ANNULUS_VERSION "0.0.0"
#endif

uint8_t execute_identify(controller_t* const self, const command_identify_t* const command,
                         reply_identify_t* const reply)
{
    const uint8_t line = self->asking;
    const bool understood = (command->protocol == PROTOCOL_VERSION) && (command->schema == SCHEMA_HASH);
    const bool at_work = (self->armed != 0U) && (line != self->session);  // the other line's host: not to be disturbed
    if (!at_work) {
        board_measure(&(board_look_t){.looks = 0});  // nobody is left who asked for it
        sequencer_preamble(&self->sequencer, &(command_preamble_t){.length = 0});
        self->session = line;
        self->schema_ok = understood;
        if (understood) {
            board_image_confirm();
        } else {
            safety_arm(self, 0U);  // whoever speaks now could not read what happens
        }
    }
    self->level[line] = 1;
    memset(&self->rereads[line], 0, sizeof self->rereads[line]);
    update_stop(&self->update);
    link_forget(&self->links[line]);
    const uint8_t taken = at_work ? STATUS_BAD_STATE : STATUS_OK;
    *reply = (reply_identify_t){.protocol = PROTOCOL_VERSION,
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
    memcpy(reply->git, git, (sizeof git - 1U < sizeof reply->git) ? sizeof git - 1U : sizeof reply->git);
    memcpy(reply->board, board_name(), sizeof reply->board);
    return understood ? taken : STATUS_SCHEMA;
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

uint8_t execute_info(controller_t* const self, const command_info_t* const command, reply_info_t* const reply)
{
    (void)reply;
    self->level[self->asking] = (command->level < LEVEL) ? command->level : LEVEL;
    return STATUS_OK;
}

void holds_info(const controller_t* const self, reply_info_t* const reply)
{
    uint8_t configuration[COMMAND_STAGE_LENGTH];
    reply->level = LEVEL;
    reply->major = part_of_version(ANNULUS_VERSION, 0U);
    reply->minor = part_of_version(ANNULUS_VERSION, 1U);
    reply->patch = part_of_version(ANNULUS_VERSION, 2U);
    memcpy(reply->serial, board_serial_number(), sizeof reply->serial);
    memcpy(reply->commands, known_commands, sizeof reply->commands);
    reply->events = KNOWN_EVENTS;
    reply->nonce = board_nonce();
    reply->configuration = configuration_of(self, configuration);
    reply->crashes = board_crash()->crashes;
    reply->round_longest = board_trail()->longest;
}

// The reply has the fields of `stage` between its status and the CRC.
_Static_assert(REPLY_CONFIGURATION_LENGTH == 2U + COMMAND_STAGE_LENGTH + 2U, "configuration is stage's payload");

uint8_t execute_configuration(controller_t* const self, reply_configuration_t* const reply)
{
    uint8_t payload[REPLY_CONFIGURATION_LENGTH] = {0};
    const uint16_t crc = configuration_of(self, payload + 2U);
    reply_configuration_unpack(reply, payload);
    reply->crc = crc;
    return STATUS_OK;
}

uint8_t execute_wiring(controller_t* const self, reply_wiring_t* const reply)
{
    *reply = (reply_wiring_t){.generation = self->sequencer.config.generation,
                              .inverted = self->sequencer.wiring.inverted,
                              .driven = board_driven(),
                              .camera_trigger = self->sequencer.wiring.trigger_ticks,
                              .camera_trigger_delay = self->sequencer.wiring.trigger_delay_ticks};
    return STATUS_OK;
}

uint8_t execute_slides_lit(controller_t* const self, reply_slides_lit_t* const reply)
{
    *reply = (reply_slides_lit_t){.generation = self->sequencer.config.generation,
                                  .count = self->sequencer.wiring.slides,
                                  .driven = board_slides_driven()};
    return STATUS_OK;
}

uint8_t execute_image(controller_t* const self, reply_image_t* const reply)
{
    (void)self;
    board_image_t image;
    board_image(&image);
    *reply = (reply_image_t){
        .slot = image.slot, .starts = image.starts, .why = image.why, .flash = image.flash, .crc = image.crc};
    return STATUS_OK;
}

uint8_t execute_crash(controller_t* const self, reply_crash_t* const reply)
{
    const board_crash_t* const last = board_crash();
    const bool unknown = (last->kind == CRASH_DAMAGED) && (self->level[self->asking] < 3U);
    *reply = (reply_crash_t){.crashes = last->crashes,
                             .boots = last->boots,
                             .kind = unknown ? CRASH_STUCK : last->kind,
                             .boot = last->boot,
                             .pc = last->pc,
                             .lr = last->lr,
                             .psr = last->psr,
                             .part = last->trail.part,
                             .command = last->trail.command,
                             .rounds = last->trail.rounds,
                             .tick = last->trail.tick,
                             .round_longest = last->trail.longest};
    return STATUS_OK;
}

uint8_t execute_ping(controller_t* const self, reply_ping_t* const reply)
{
    (void)self;
    *reply = (reply_ping_t){.tick = board_tick()};
    return STATUS_OK;
}

static uint16_t state_flags(const controller_t* const self)
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
    state |= commands_allowed(self) ? STATE_SCHEMA_OK : 0U;
    return state;
}

uint8_t execute_status(controller_t* const self, reply_status_t* const reply)
{
    const uint8_t level = self->level[self->asking];
    *reply = (reply_status_t){.state = (uint16_t)(state_flags(self) & state_flags_at_level(level)),
                              .fault = events_fault_at_level(self->fault, level),
                              .generation = self->sequencer.config.generation,
                              .edges = self->sequencer.edges,
                              .rejected = board_edges_refused(),
                              .period = self->sequencer.period,
                              .odometer = board_odometer(),
                              .events = self->events.next,
                              .bad_frames = self->links[self->asking].bad_frames,
                              .late = self->sequencer.late,
                              .overruns = self->events.overruns,
                              .turntable = board_turntable_position()};
    return STATUS_OK;
}

uint8_t execute_health(controller_t* const self, reply_health_t* const reply)
{
    (void)self;
    board_health_t health;
    board_health(&health);
    *reply = (reply_health_t){.odometer_lost = health.odometer_lost,
                              .odometer_impossible = health.odometer_impossible,
                              .edges_dropped = health.edges_dropped,
                              .usb_hangs = health.usb_hangs};
    return STATUS_OK;
}

uint8_t execute_hardware(controller_t* const self, reply_hardware_t* const reply)
{
    (void)self;
    *reply = (reply_hardware_t){.board = board_kind(), .vbus = board_vbus(), .interlock = board_interlock()};
    return STATUS_OK;
}

uint8_t execute_reread(controller_t* const self, const command_reread_t* const command, reply_reread_t* const reply)
{
    return events_reread(&self->events, &self->rereads[self->asking], command, reply);
}

uint8_t execute_samples(controller_t* const self, const command_samples_t* const command, reply_samples_t* const reply)
{
    (void)self;
    bool differs = false;
    reply->looks = board_measured(command->latest != 0U, command->word, reply->bits, &differs);
    reply->differs = differs ? 1U : 0U;
    return STATUS_OK;
}
