// What each command does, once dispatch.c has found its fields in range and what it needs in place.

#include "commands.h"

#include "../board.h"
#include "dispatch.h"
#include "safety.h"

#define FIELD_BOARD 2U  // its place in UPDATE_BEGIN, as `detail` names it

uint8_t commands_refusal(const controller_t* const self, const uint8_t needs, const uint8_t range,
                         uint8_t* const detail)
{
    if (range != RANGE_OK) {
        *detail = range;
        return STATUS_OUT_OF_RANGE;
    }
    if ((needs == NEEDS_MICROWAVE) && ((self->armed & ARM_MICROWAVE) == 0U)) {
        return (self->fault != FAULT_NONE) ? STATUS_UNSAFE : STATUS_BAD_STATE;
    }
    const bool there = (needs == NEEDS_SESSION) ? (self->asking == self->session) : commands_allowed(self);
    return ((needs == NEEDS_NOTHING) || there) ? STATUS_OK : STATUS_SCHEMA;
}

static uint8_t status_if(const bool taken)
{
    return taken ? STATUS_OK : STATUS_BAD_STATE;
}

// ---- leaving ----

static void leave(controller_t* const self, const uint8_t where)
{
    self->leaving = where;
    self->leaving_since = board_tick();
}

uint8_t execute_reset(controller_t* const self, const command_reset_t* const command, reply_reset_t* const reply)
{
    (void)reply;
    if (command->magic != RESET_MAGIC) {
        return STATUS_OUT_OF_RANGE;
    }
    leave(self, LEAVE_TO_START);
    return safety_arm(self, 0U);
}

// Unlike a reset it is refused while anything is armed or moves: nobody flashes a head at work by mistake. And without
// a USB host, since the boot loader speaks nothing else: a head on the UART alone would be silent for good.
uint8_t execute_bootloader(controller_t* const self, const command_bootloader_t* const command,
                           reply_bootloader_t* const reply)
{
    if (command->magic != BOOTLOADER_MAGIC) {
        return STATUS_OUT_OF_RANGE;
    }
    if ((self->armed != 0U) || self->turntable.moving) {
        return STATUS_BAD_STATE;
    }
    if (!board_bootloader_reachable()) {
        reply->detail = BOOTLOADER_NEEDS_USB;
        return STATUS_BAD_STATE;
    }
    leave(self, LEAVE_TO_BOOTLOADER);
    return STATUS_OK;
}

// ---- lamps ----

// What was staged, if it was just now, or was committed; else what is in force.
static uint8_t generation_after(const controller_t* const self, const uint8_t status)
{
    return (status == STATUS_OK) ? self->sequencer.staged.generation : self->sequencer.config.generation;
}

uint8_t execute_stage(controller_t* const self, const command_stage_t* const command, reply_stage_t* const reply)
{
    return sequencer_stage(&self->sequencer, command, reply);
}

void holds_stage(const controller_t* const self, reply_stage_t* const reply)
{
    reply->generation = generation_after(self, reply->status);
}

uint8_t execute_polarity(controller_t* const self, const command_polarity_t* const command,
                         reply_polarity_t* const reply)
{
    (void)reply;
    return status_if((self->armed == 0U) && sequencer_polarity(&self->sequencer, command));
}

void holds_polarity(const controller_t* const self, reply_polarity_t* const reply)
{
    if (self->sequencer.is_staged) {
        reply->generation = self->sequencer.staged.generation;
        reply->inverted = self->sequencer.staged_wiring.inverted;
    }
}

uint8_t execute_camera_trigger(controller_t* const self, const command_camera_trigger_t* const command,
                               reply_camera_trigger_t* const reply)
{
    return (self->armed != 0U) ? STATUS_BAD_STATE : sequencer_camera_trigger(&self->sequencer, command, &reply->detail);
}

void holds_camera_trigger(const controller_t* const self, reply_camera_trigger_t* const reply)
{
    if (self->sequencer.is_staged) {
        reply->generation = self->sequencer.staged.generation;
        reply->width = self->sequencer.staged_wiring.trigger_ticks;
        reply->delay = self->sequencer.staged_wiring.trigger_delay_ticks;
    }
}

uint8_t execute_slides(controller_t* const self, const command_slides_t* const command, reply_slides_t* const reply)
{
    return (self->armed != 0U) ? STATUS_BAD_STATE : sequencer_slides(&self->sequencer, command, &reply->detail);
}

void holds_slides(const controller_t* const self, reply_slides_t* const reply)
{
    if (self->sequencer.is_staged) {
        reply->generation = self->sequencer.staged.generation;
        reply->count = self->sequencer.staged_wiring.slides;
    }
}

uint8_t execute_commit(controller_t* const self, const command_commit_t* const command, reply_commit_t* const reply)
{
    (void)reply;
    return status_if(sequencer_commit(&self->sequencer, command->generation, self->armed != 0U));
}

void holds_commit(const controller_t* const self, reply_commit_t* const reply)
{
    reply->generation = generation_after(self, reply->status);
}

uint8_t execute_preamble(controller_t* const self, const command_preamble_t* const command,
                         reply_preamble_t* const reply)
{
    (void)reply;
    sequencer_preamble(&self->sequencer, command);
    return STATUS_OK;
}

void holds_preamble(const controller_t* const self, reply_preamble_t* const reply)
{
    reply->length = self->sequencer.preamble.config.length;
    reply->interval = self->sequencer.preamble.config.interval;
}

// ---- arming ----

// Anybody may disarm; so who may arm is no matter of the schema's `needs`.
uint8_t execute_arm(controller_t* const self, const command_arm_t* const command, reply_arm_t* const reply)
{
    const bool known = (command->outputs & ~(ARM_LAMPS | ARM_MICROWAVE)) == 0U;
    const bool allowed = (command->outputs == 0U) || commands_allowed(self);
    const bool busy = self->update.under_way && (command->outputs != 0U);  // writing flash holds up the main loop
    const uint8_t refused = !known ? STATUS_OUT_OF_RANGE : !allowed ? STATUS_SCHEMA : STATUS_BAD_STATE;
    const uint8_t status = (known && allowed && !busy) ? safety_arm(self, command->outputs) : refused;
    reply->outputs = self->armed;
    return status;
}

uint8_t execute_clear(controller_t* const self, reply_clear_t* const reply)
{
    const uint8_t status = safety_clear(self);
    reply->fault = events_fault_at_level(self->fault, self->level[self->asking]);
    return status;
}

// ---- microwave ----

uint8_t execute_pattern(controller_t* const self, const command_pattern_t* const command, reply_pattern_t* const reply)
{
    return bursts_upload(&self->bursts, command, &reply->detail);
}

void holds_pattern(const controller_t* const self, reply_pattern_t* const reply)
{
    reply->length = self->bursts.uploaded.length;
}

uint8_t execute_burst(controller_t* const self, const command_burst_t* const command, reply_burst_t* const reply)
{
    bool refused = false;
    const uint8_t status = bursts_fire(&self->bursts, command, reply, &refused);
    safety_insist(self, !refused, OUTPUT_MICROWAVE);
    return status;
}

uint8_t execute_burst_stop(controller_t* const self, reply_burst_stop_t* const reply)
{
    (void)self;
    board_burst_stop();
    board_burst_running(&reply->done);
    return STATUS_OK;
}

// ---- turntable ----

uint8_t execute_move(controller_t* const self, const command_move_t* const command, reply_move_t* const reply)
{
    if ((self->fault != FAULT_NONE) || board_interlock_open()) {
        return STATUS_UNSAFE;
    }
    return self->update.under_way ? STATUS_BAD_STATE : turntable_move(&self->turntable, command, &reply->detail);
}

void holds_move(const controller_t* const self, reply_move_t* const reply)
{
    (void)self;
    reply->position = board_turntable_position();
}

uint8_t execute_turntable(controller_t* const self, const command_turntable_t* const command,
                          reply_turntable_t* const reply)
{
    return turntable_configure(&self->turntable, command, &reply->detail);
}

void holds_turntable(const controller_t* const self, reply_turntable_t* const reply)
{
    const command_turntable_t* const config = &self->turntable.config;
    reply->lowest = config->lowest;
    reply->highest = config->highest;
    reply->acceleration = config->acceleration;
    reply->start_period = config->start_period;
    reply->switches = config->switches;
}

uint8_t execute_turntable_stop(controller_t* const self, reply_turntable_stop_t* const reply)
{
    turntable_stop(&self->turntable, STOP_CAUSE_STOPPED);
    reply->position = board_turntable_position();
    return STATUS_OK;
}

uint8_t execute_interlock(controller_t* const self, const command_interlock_t* const command,
                          reply_interlock_t* const reply)
{
    (void)reply;
    return safety_interlock(self, command->inputs);
}

void holds_interlock(const controller_t* const self, reply_interlock_t* const reply)
{
    (void)self;
    reply->inputs = board_interlock();
}

// ---- the board's own pins ----

// The odometer pays for it: so nobody begins one on a head at work.
uint8_t execute_measure(controller_t* const self, const command_measure_t* const command, reply_measure_t* const reply)
{
    (void)reply;
    if ((command->looks > 0U) && (self->armed != 0U) && !board_measuring()) {
        return STATUS_BAD_STATE;
    }
    board_measure(&(board_look_t){.looks = command->looks,
                                  .pin = command->pin,
                                  .level = command->level,
                                  .first = command->first,
                                  .delay_ticks = command->delay});
    if (command->looks > 0U) {
        sequencer_measures(&self->sequencer);
    }
    return STATUS_OK;
}

// ---- a new application ----

// Unlike what drives outputs, an update needs no common schema: it must be open to whoever cannot do anything else.
// That it is for another board is told to anybody, the session's line or not.
uint8_t execute_update_begin(controller_t* const self, const command_update_begin_t* const command,
                             reply_update_begin_t* const reply)
{
    for (size_t i = 0; i < sizeof command->board; i++) {
        if (command->board[i] != board_name()[i]) {
            reply->detail = FIELD_BOARD;
            return STATUS_OUT_OF_RANGE;
        }
    }
    if (self->asking != self->session) {
        return STATUS_SCHEMA;
    }
    if ((self->armed != 0U) || self->turntable.moving) {
        return STATUS_BAD_STATE;
    }
    update_begin(&self->update, command->size, command->crc, board_tick());
    return STATUS_OK;
}

void holds_update_begin(const controller_t* const self, reply_update_begin_t* const reply)
{
    reply->next = self->update.next;
}

uint8_t execute_update_data(controller_t* const self, const command_update_data_t* const command,
                            reply_update_data_t* const reply)
{
    return status_if(update_take(&self->update, command->offset, command->chunk, board_tick(), &reply->detail));
}

void holds_update_data(const controller_t* const self, reply_update_data_t* const reply)
{
    reply->next = self->update.next;
}

uint8_t execute_update_end(controller_t* const self, reply_update_end_t* const reply)
{
    const bool taken = update_finish(&self->update, &reply->detail);
    if (taken) {
        leave(self, LEAVE_TO_START);
    }
    return status_if(taken);
}

void holds_update_end(const controller_t* const self, reply_update_end_t* const reply)
{
    reply->next = self->update.next;
}
