// Trains of on/off chips for the microwave gate: which codes there are, and what may be sent.

#include "bursts.h"

#include <string.h>

#include "../board.h"
#include "../duty.h"

// Places of fields in BURST and PATTERN, as `detail` names them.
enum {
    FIELD_CHIP = 1,
    FIELD_PERIOD = 3,
    FIELD_TRIGGER_OFFSET = 4,
    FIELD_CHIPS = 1,
};

static bool chip_at(const uint8_t* const chips, const uint16_t index)
{
    return (chips[index / 8U] >> (index % 8U)) & 1U;
}

uint8_t bursts_upload(bursts_t* const self, const command_pattern_t* const pattern, uint8_t* const detail)
{
    if (self->running) {
        return STATUS_BAD_STATE;
    }
    for (uint16_t i = pattern->length; i < CHIPS_MAX; i++) {
        if (chip_at(pattern->chips, i)) {
            *detail = FIELD_CHIPS;
            return STATUS_OUT_OF_RANGE;
        }
    }
    self->uploaded = *pattern;
    return STATUS_OK;
}

// Chips of a code; the length stays 0 when nothing was uploaded.
static void fetch_code(const bursts_t* const self, const uint8_t code, board_burst_t* const burst)
{
    if (code == BURST_CODE_UPLOADED) {
        memcpy(burst->chips, self->uploaded.chips, sizeof burst->chips);
        burst->length = self->uploaded.length;
        return;
    }
    for (const char* chip = burst_codes[code]; *chip != '\0'; chip++, burst->length++) {
        if (*chip == '1') {
            burst->chips[burst->length / 8U] |= (uint8_t)(1U << (burst->length % 8U));
        }
    }
}

// Does any run of on-chips make a pulse the source must not send?
static bool is_pulse_forbidden(const board_burst_t* const burst)
{
    uint32_t run_ticks = 0;
    bool forbidden = false;
    for (uint32_t i = 0; i <= sizeof burst->chips; i++) {  // and eight that are off
        uint32_t chips = board_chips(burst, i);
        for (uint32_t bit = 0; bit < 8U; bit++, chips >>= 1) {
            if ((chips & 1U) != 0U) {
                run_ticks += burst->chip_ticks;
            } else if (run_ticks > 0U) {
                forbidden |= (run_ticks < MICROWAVE_PULSE_MIN_TICKS) || (run_ticks > MICROWAVE_PULSE_MAX_TICKS);
                run_ticks = 0;
            }
        }
    }
    return forbidden;
}

// A status; on OUT_OF_RANGE `detail` names the field.
static uint8_t check_train(const board_burst_t* const burst, uint8_t* const detail)
{
    if ((burst->chip_ticks < CHIP_MIN_TICKS) || (burst->chip_ticks > CHIP_MAX_TICKS)) {
        *detail = FIELD_CHIP;
        return STATUS_OUT_OF_RANGE;
    }
    // One dark chip at least between bursts, so that pulses of neighbours never join.
    const uint32_t burst_ticks = (uint32_t)burst->length * burst->chip_ticks;
    if ((burst->period_ticks < burst_ticks + burst->chip_ticks) || (burst->period_ticks < BURST_PERIOD_MIN_TICKS) ||
        (burst->period_ticks > BURST_PERIOD_MAX_TICKS)) {
        *detail = FIELD_PERIOD;
        return STATUS_OUT_OF_RANGE;
    }
    // A trigger belongs to one burst: after the chips of the one before, over before the chips of the next.
    if ((burst->trigger_offset < -(int32_t)(burst->period_ticks - burst_ticks)) ||
        (burst->trigger_offset > (int32_t)burst->period_ticks - (int32_t)TRIGGER_TICKS)) {
        *detail = FIELD_TRIGGER_OFFSET;
        return STATUS_OUT_OF_RANGE;
    }
    if (is_pulse_forbidden(burst)) {
        return STATUS_PULSE_WIDTH;
    }
    if (duty_exceeds(board_on_ticks(burst), burst->period_ticks, MICROWAVE_DUTY_MAX_PERMILLE)) {
        *detail = OUTPUT_MICROWAVE;
        return STATUS_DUTY;
    }
    return STATUS_OK;
}

uint8_t bursts_fire(bursts_t* const self, const command_burst_t* const command, reply_burst_t* const reply,
                    bool* const refused)
{
    board_burst_t burst = {.chip_ticks = command->chip,
                           .repeat = command->repeat,
                           .period_ticks = command->period,
                           .trigger_offset = command->trigger_offset};
    fetch_code(self, command->code, &burst);
    reply->length = burst.length;
    if (self->running || (burst.length == 0U)) {
        return STATUS_BAD_STATE;
    }
    const uint8_t status = check_train(&burst, &reply->detail);
    if (status != STATUS_OK) {
        return status;
    }
    const board_burst_started_t started = board_burst(&burst, &reply->start);
    if (started != BOARD_BURST_STARTED) {
        *refused = started == BOARD_BURST_OVER_LIMIT;
        reply->detail = *refused ? OUTPUT_MICROWAVE : 0U;
        return *refused ? STATUS_DUTY : STATUS_UNSAFE;
    }
    self->running = true;
    self->fault = FAULT_NONE;
    return STATUS_OK;
}

void bursts_cut(bursts_t* const self, const uint8_t fault)
{
    self->fault = fault;
}

bool bursts_ended(const bursts_t* const self, uint16_t* const done)
{
    return self->running && !board_burst_running(done);
}

void bursts_report(bursts_t* const self, events_t* const events, const uint16_t done, const uint32_t now)
{
    self->running = false;
    event_burst_done_pack(&(event_burst_done_t){.tick = now, .done = done, .fault = self->fault},
                          events_emit(events, EVENT_BURST_DONE));
}
