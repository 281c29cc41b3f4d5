// What each command does. Every reply carries a status and the values that now hold, whether they were taken or not.

#include "commands.h"

#include "../board.h"
#include "safety.h"

static void leave(controller_t* const self, const uint8_t where)
{
    self->leaving = where;
    self->leaving_since = board_tick();
}

static void reset(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)line;
    command_reset_t command;
    command_reset_unpack(&command, payload);
    const bool meant = command.magic == RESET_MAGIC;
    if (meant) {
        leave(self, LEAVE_TO_START);
        safety_arm(self, 0U);
    }
    reply_reset_pack(&(reply_reset_t){.status = meant ? STATUS_OK : STATUS_OUT_OF_RANGE}, answer);
}

// Unlike a reset it is refused while anything is armed or moves: nobody flashes a head at work by mistake. And without
// a USB host, since the boot loader speaks nothing else: a head on the UART alone would be silent for good.
static void bootloader(controller_t* const self, const uint8_t line, const uint8_t* const payload,
                       uint8_t* const answer)
{
    (void)line;
    command_bootloader_t command;
    command_bootloader_unpack(&command, payload);
    reply_bootloader_t reply = {.status = STATUS_OUT_OF_RANGE};
    if (command.magic == BOOTLOADER_MAGIC) {
        const bool busy = (self->armed != 0U) || self->turntable.moving;
        const bool stranded = !board_bootloader_reachable();
        reply.status = (busy || stranded) ? STATUS_BAD_STATE : STATUS_OK;
        reply.detail = (!busy && stranded) ? BOOTLOADER_NEEDS_USB : 0U;
        if (reply.status == STATUS_OK) {
            leave(self, LEAVE_TO_BOOTLOADER);
        }
    }
    reply_bootloader_pack(&reply, answer);
}

static void stage(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_stage_t command;
    command_stage_unpack(&command, payload);
    reply_stage_t reply = {.generation = self->sequencer.config.generation};
    reply.detail = command_stage_range(&command);
    if (reply.detail != RANGE_OK) {
        reply.status = STATUS_OUT_OF_RANGE;
    } else {
        reply.detail = 0;
        reply.status =
            commands_allowed(self, line) ? sequencer_stage(&self->sequencer, &command, &reply) : STATUS_SCHEMA;
    }
    reply_stage_pack(&reply, answer);
}

static void preamble(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_preamble_t command;
    command_preamble_unpack(&command, payload);
    reply_preamble_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_preamble_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        reply.status = STATUS_SCHEMA;
        if (commands_allowed(self, line)) {
            reply.status = STATUS_OK;
            sequencer_preamble(&self->sequencer, &command);
        }
    }
    reply.length = self->sequencer.preamble.config.length;
    reply.interval = self->sequencer.preamble.config.interval;
    reply_preamble_pack(&reply, answer);
}

static void commit(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_commit_t command;
    command_commit_unpack(&command, payload);
    reply_commit_t reply = {.status = STATUS_SCHEMA, .generation = self->sequencer.config.generation};
    if (commands_allowed(self, line)) {
        const bool taken = sequencer_commit(&self->sequencer, command.generation);
        reply.status = taken ? STATUS_OK : STATUS_BAD_STATE;
        reply.generation = taken ? command.generation : reply.generation;
    }
    reply_commit_pack(&reply, answer);
}

static void arm(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_arm_t command;
    command_arm_unpack(&command, payload);
    const bool known = (command.outputs & ~(ARM_LAMPS | ARM_MICROWAVE)) == 0U;
    const bool allowed = (command.outputs == 0U) || commands_allowed(self, line);
    const bool busy = self->update.under_way && (command.outputs != 0U);  // writing flash holds up the main loop
    const uint8_t refused = !known ? STATUS_OUT_OF_RANGE : !allowed ? STATUS_SCHEMA : STATUS_BAD_STATE;
    const uint8_t outcome = (known && allowed && !busy) ? safety_arm(self, command.outputs) : refused;
    reply_arm_pack(&(reply_arm_t){.status = outcome, .outputs = self->armed}, answer);
}

static void clear(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    (void)payload;
    const uint8_t outcome = safety_clear(self);
    const uint8_t fault = events_fault_at_level(self->fault, self->level[line]);
    reply_clear_pack(&(reply_clear_t){.status = outcome, .fault = fault}, answer);
}

static void pattern(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_pattern_t command;
    command_pattern_unpack(&command, payload);
    reply_pattern_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_pattern_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        reply.status =
            commands_allowed(self, line) ? bursts_upload(&self->bursts, &command, &reply.detail) : STATUS_SCHEMA;
    }
    reply.length = self->bursts.uploaded.length;
    reply_pattern_pack(&reply, answer);
}

static void burst(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_burst_t command;
    command_burst_unpack(&command, payload);
    reply_burst_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_burst_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        if ((self->armed & ARM_MICROWAVE) == 0U) {
            reply.status = (self->fault != FAULT_NONE) ? STATUS_UNSAFE : STATUS_BAD_STATE;
        } else if (!commands_allowed(self, line)) {
            reply.status = STATUS_SCHEMA;
        } else {
            bool refused = false;
            reply.status = bursts_fire(&self->bursts, &command, &reply, &refused);
            safety_insist(self, !refused, OUTPUT_MICROWAVE);
        }
    }
    reply_burst_pack(&reply, answer);
}

static void burst_stop(controller_t* const self, const uint8_t line, const uint8_t* const payload,
                       uint8_t* const answer)
{
    (void)self;
    (void)line;
    (void)payload;
    board_burst_stop();
    reply_burst_stop_t reply = {.status = STATUS_OK};
    board_burst_running(&reply.done);
    reply_burst_stop_pack(&reply, answer);
}

static void move(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_move_t command;
    command_move_unpack(&command, payload);
    reply_move_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_move_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        if (!commands_allowed(self, line)) {
            reply.status = STATUS_SCHEMA;
        } else if ((self->fault != FAULT_NONE) || board_interlock_open()) {
            reply.status = STATUS_UNSAFE;
        } else if (self->update.under_way) {
            reply.status = STATUS_BAD_STATE;
        } else {
            reply.status = turntable_move(&self->turntable, &command, &reply.detail);
        }
    }
    reply.position = board_turntable_position();
    reply_move_pack(&reply, answer);
}

static void turntable(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_turntable_t command;
    command_turntable_unpack(&command, payload);
    reply_turntable_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_turntable_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        reply.status = commands_allowed(self, line) ? turntable_configure(&self->turntable, &command, &reply.detail)
                                                    : STATUS_SCHEMA;
    }
    const command_turntable_t* const config = &self->turntable.config;
    reply.lowest = config->lowest;
    reply.highest = config->highest;
    reply.acceleration = config->acceleration;
    reply.start_period = config->start_period;
    reply.switches = config->switches;
    reply_turntable_pack(&reply, answer);
}

static void stop_turntable(controller_t* const self, const uint8_t line, const uint8_t* const payload,
                           uint8_t* const answer)
{
    (void)line;
    (void)payload;
    turntable_stop(&self->turntable, STOP_CAUSE_STOPPED);
    reply_turntable_stop_pack(&(reply_turntable_stop_t){.status = STATUS_OK, .position = board_turntable_position()},
                              answer);
}

static void interlock(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_interlock_t command;
    command_interlock_unpack(&command, payload);
    reply_interlock_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_interlock_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        reply.status = commands_allowed(self, line) ? safety_interlock(self, command.inputs) : STATUS_SCHEMA;
    }
    reply.inputs = board_interlock();
    reply_interlock_pack(&reply, answer);
}

// The odometer pays for it: so nobody begins one on a head at work.
static void measure(controller_t* const self, const uint8_t line, const uint8_t* const payload, uint8_t* const answer)
{
    command_measure_t command;
    command_measure_unpack(&command, payload);
    reply_measure_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_measure_range(&command)};
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        if (!commands_allowed(self, line)) {
            reply.status = STATUS_SCHEMA;
        } else if ((command.looks > 0U) && (self->armed != 0U) && !board_measuring()) {
            reply.status = STATUS_BAD_STATE;
        } else {
            reply.status = STATUS_OK;
            board_measure(&(board_look_t){.looks = command.looks,
                                          .pin = command.pin,
                                          .level = command.level,
                                          .first = command.first,
                                          .delay_ticks = command.delay});
        }
    }
    reply_measure_pack(&reply, answer);
}

// Unlike what drives outputs, an update needs no common schema: it must be open to whoever cannot do anything else.
static void update_begins(controller_t* const self, const uint8_t line, const uint8_t* const payload,
                          uint8_t* const answer)
{
    command_update_begin_t command;
    command_update_begin_unpack(&command, payload);
    reply_update_begin_t reply = {.status = STATUS_OUT_OF_RANGE, .detail = command_update_begin_range(&command)};
    for (size_t i = 0; (i < sizeof command.board) && (reply.detail == RANGE_OK); i++) {
        reply.detail = (command.board[i] == board_name()[i]) ? RANGE_OK : 2U;  // the field `board`
    }
    if (reply.detail == RANGE_OK) {
        reply.detail = 0;
        if (line != self->session) {
            reply.status = STATUS_SCHEMA;
        } else if ((self->armed != 0U) || self->turntable.moving) {
            reply.status = STATUS_BAD_STATE;
        } else {
            reply.status = STATUS_OK;
            update_begin(&self->update, command.size, command.crc, board_tick());
        }
    }
    reply.next = self->update.next;
    reply_update_begin_pack(&reply, answer);
}

static void update_data(controller_t* const self, const uint8_t line, const uint8_t* const payload,
                        uint8_t* const answer)
{
    command_update_data_t command;
    command_update_data_unpack(&command, payload);
    reply_update_data_t reply = {.status = STATUS_SCHEMA};
    if (line == self->session) {
        const bool taken = update_take(&self->update, command.offset, command.chunk, board_tick(), &reply.detail);
        reply.status = taken ? STATUS_OK : STATUS_BAD_STATE;
    }
    reply.next = self->update.next;
    reply_update_data_pack(&reply, answer);
}

static void update_end(controller_t* const self, const uint8_t line, const uint8_t* const payload,
                       uint8_t* const answer)
{
    (void)payload;
    reply_update_end_t reply = {.status = STATUS_SCHEMA};
    if (line == self->session) {
        const bool taken = update_finish(&self->update, &reply.detail);
        reply.status = taken ? STATUS_OK : STATUS_BAD_STATE;
        if (taken) {
            leave(self, LEAVE_TO_START);
        }
    }
    reply.next = self->update.next;
    reply_update_end_pack(&reply, answer);
}

// The link lets through no id without a layout, and every command has one here.
static void (*const handlers[])(controller_t* self, uint8_t line, const uint8_t* payload, uint8_t* answer) = {
    [COMMAND_IDENTIFY] = query_identify,
    [COMMAND_RESET] = reset,
    [COMMAND_PING] = query_ping,
    [COMMAND_STATUS] = query_status,
    [COMMAND_STAGE] = stage,
    [COMMAND_COMMIT] = commit,
    [COMMAND_PREAMBLE] = preamble,
    [COMMAND_ARM] = arm,
    [COMMAND_CLEAR] = clear,
    [COMMAND_REREAD] = query_reread,
    [COMMAND_HEALTH] = query_health,
    [COMMAND_PATTERN] = pattern,
    [COMMAND_BURST] = burst,
    [COMMAND_BURST_STOP] = burst_stop,
    [COMMAND_MOVE] = move,
    [COMMAND_BOOTLOADER] = bootloader,
    [COMMAND_TURNTABLE] = turntable,
    [COMMAND_TURNTABLE_STOP] = stop_turntable,
    [COMMAND_INTERLOCK] = interlock,
    [COMMAND_HARDWARE] = query_hardware,
    [COMMAND_MEASURE] = measure,
    [COMMAND_SAMPLES] = query_samples,
    [COMMAND_INFO] = query_info,
    [COMMAND_CONFIGURATION] = query_configuration,
    [COMMAND_CRASH] = query_crash,
    [COMMAND_UPDATE_BEGIN] = update_begins,
    [COMMAND_UPDATE_DATA] = update_data,
    [COMMAND_UPDATE_END] = update_end,
};

void commands_execute(controller_t* const self, const uint8_t line, const command_t* const command,
                      uint8_t reply[const PAYLOAD_MAX])
{
    handlers[command->layout->id](self, line, command->payload, reply);
}
