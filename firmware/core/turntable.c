// The turntable: where it may go, how fast it is at every step, and why it stops.
//
// The speed depends on nothing but how many steps have been made and how many are left: it is the one that a constant
// acceleration from the start speed reaches in the fewer of these two, or the one asked for. So a ramp has no state,
// ends at the start speed whatever happened on the way, and a stop is nothing but a nearer end.

#include "turntable.h"

#include "../board.h"
#include "../ticks.h"

// Speeds are counted in quarters of a step a second, so that their squares fit 32 bits and slow ramps are fine.
#define SPEED_TICKS (4U * TICK_HZ)
#define LEAD_TICKS ((int32_t)(TURNTABLE_LEAD_MS * TICKS_PER_MS))
#define LAG_TICKS ((int32_t)(TURNTABLE_LAG_MS * TICKS_PER_MS))

#define SQUARE_A_STEP 32U  // what one step at 1 step/s^2 adds to the square of such a speed: 16 * 2 * a

// Places of fields in MOVE and TURNTABLE, as `detail` names them.
enum { FIELD_POSITION = 0, FIELD_LOWEST = 0, FIELD_HIGHEST = 1, FIELD_START_PERIOD = 3 };

static bool is_position(const int32_t position)
{
    const int32_t most = (int32_t)TURNTABLE_POSITION_MAX_STEPS;
    return (position >= -most) && (position <= most);
}

void turntable_reset(turntable_t* const self)
{
    *self = (turntable_t){
        .config = {.lowest = -(int32_t)TURNTABLE_POSITION_MAX_STEPS, .highest = (int32_t)TURNTABLE_POSITION_MAX_STEPS}};
    board_turntable_watch(0U);
}

uint8_t turntable_configure(turntable_t* const self, const command_turntable_t* const command, uint8_t* const detail)
{
    if (self->moving) {
        return STATUS_BAD_STATE;
    }
    const bool lowest = is_position(command->lowest);
    const bool highest = is_position(command->highest) && (command->highest >= command->lowest);
    const bool start = (command->acceleration == 0U) || (command->start_period >= TURNTABLE_PERIOD_MIN_TICKS);
    if (!lowest || !highest || !start) {
        *detail = !lowest ? FIELD_LOWEST : !highest ? FIELD_HIGHEST : FIELD_START_PERIOD;
        return STATUS_OUT_OF_RANGE;
    }
    self->config = *command;
    self->lost = false;
    board_turntable_watch(command->switches & (TURNTABLE_END_LOW | TURNTABLE_END_HIGH));
    return STATUS_OK;
}

static uint32_t square(const uint32_t speed)
{
    return speed * speed;
}

// Rounded down.
static uint32_t root(const uint32_t value)
{
    uint32_t result = 0;
    for (uint32_t bit = 1U << 15; bit > 0U; bit >>= 1) {
        const uint32_t trial = result | bit;
        result = (square(trial) <= value) ? trial : result;
    }
    return result;
}

static bool has_ramp(const turntable_t* const self)
{
    return (self->config.acceleration > 0U) && (self->period < self->config.start_period);
}

// The period at so many steps from the beginning or the end of a move.
static uint32_t period_at(const turntable_t* const self, const uint32_t steps)
{
    if (!has_ramp(self)) {
        return self->period;
    }
    const uint64_t reached =
        square(SPEED_TICKS / self->config.start_period) + (uint64_t)SQUARE_A_STEP * self->config.acceleration * steps;
    if (reached >= square(SPEED_TICKS / self->period)) {
        return self->period;
    }
    const uint32_t speed = root((uint32_t)reached);
    const uint32_t period = (SPEED_TICKS + speed - 1U) / speed;
    return (period < self->config.start_period) ? period : self->config.start_period;
}

// Steps that the ramp takes from the pace in force down to the start speed.
static uint32_t braking_steps(const turntable_t* const self)
{
    if (!has_ramp(self) || (self->pace >= self->config.start_period)) {
        return 0U;
    }
    const uint32_t from = square(SPEED_TICKS / self->pace);
    const uint32_t to = square(SPEED_TICKS / self->config.start_period);
    return (uint32_t)((from - to) / ((uint64_t)SQUARE_A_STEP * self->config.acceleration)) + 1U;
}

static void power_up(turntable_t* const self)
{
    if (!self->powered) {
        board_turntable_power(true);
        self->powered = true;
        self->awake = false;
        self->powered_at = board_tick();  // after it, so that the lead is never short
    }
}

// What the driver still needs until it takes a step.
static uint32_t lead_left(const turntable_t* const self)
{
    const int32_t left = LEAD_TICKS - ticks_since(board_tick(), self->powered_at);
    return (self->awake || (left <= 0)) ? 0U : (uint32_t)left;
}

// Both ticks are forgotten when their time is over, long before they wrap.
static void watch_power(turntable_t* const self, const uint32_t now)
{
    self->awake = self->awake || (ticks_since(now, self->powered_at) >= LEAD_TICKS);
    self->swings = self->swings && (ticks_since(now, self->stood_at) < LAG_TICKS);
    if (self->powered && !self->moving && !self->hold && !self->swings) {
        board_turntable_power(false);
        self->powered = false;
    }
}

uint8_t turntable_move(turntable_t* const self, const command_move_t* const command, uint8_t* const detail)
{
    if (self->moving) {
        return STATUS_BAD_STATE;
    }
    const int32_t from = board_turntable_position();
    if ((command->position < self->config.lowest) || (command->position > self->config.highest)) {
        *detail = FIELD_POSITION;
        return STATUS_OUT_OF_RANGE;
    }
    const bool up = command->position > from;
    const uint8_t towards = up ? TURNTABLE_END_HIGH : (command->position < from) ? TURNTABLE_END_LOW : 0U;
    if ((board_turntable_reached() & towards) != 0U) {
        *detail = up ? STOP_CAUSE_END_HIGH : STOP_CAUSE_END_LOW;
        return STATUS_UNSAFE;
    }
    self->moving = true;
    self->hold = command->hold != 0U;
    self->cause = 0U;
    self->towards = towards;
    self->period = command->period;
    // At most 2 * TURNTABLE_POSITION_MAX_STEPS: three words a step still fit a DMA channel's count.
    self->steps = (uint32_t)(up ? command->position - from : from - command->position);
    self->pace = period_at(self, 0U);
    if (self->hold || (self->steps > 0U)) {
        power_up(self);
    }
    board_turntable_move(command->position, self->pace, lead_left(self));
    return STATUS_OK;
}

static void end_within(turntable_t* const self, const uint32_t steps)
{
    if (steps < board_turntable_left()) {
        self->steps -= board_turntable_shorten(steps);  // by its own look: another step may have begun since this one
    }
}

// The first reason is the one that is told.
static void because(turntable_t* const self, const uint8_t cause)
{
    self->cause = (self->cause == 0U) ? cause : self->cause;
}

static void mark_lost(turntable_t* const self)
{
    self->lost = self->lost || (has_ramp(self) && (self->pace < self->config.start_period));
}

void turntable_stop(turntable_t* const self, const uint8_t cause)
{
    if (self->moving && board_turntable_moving()) {
        because(self, cause);
        end_within(self, braking_steps(self));
    }
}

void turntable_cut(turntable_t* const self)
{
    if (self->moving && board_turntable_moving()) {
        self->cause = STOP_CAUSE_FAULT;
        mark_lost(self);
    }
    self->hold = false;
    self->powered = false;
    self->swings = false;
    board_turntable_cut();
}

static void watch_switch(turntable_t* const self, const uint8_t reached)
{
    if ((reached & self->towards) == 0U) {
        return;
    }
    const uint8_t cause = (self->towards == TURNTABLE_END_HIGH) ? STOP_CAUSE_END_HIGH : STOP_CAUSE_END_LOW;
    if ((self->config.switches & TURNTABLE_END_HARD) == 0U) {
        if (self->cause == 0U) {
            turntable_stop(self, cause);
        }
    } else if (board_turntable_left() > 0U) {
        because(self, cause);
        mark_lost(self);
        end_within(self, 0U);
    }
}

void turntable_run(turntable_t* const self, events_t* const events, const uint32_t now)
{
    const uint8_t reached = board_turntable_reached();  // also forgets a touch while nothing moves
    if (self->moving && board_turntable_moving()) {
        watch_switch(self, reached);
        const uint32_t left = board_turntable_left();
        const uint32_t made = self->steps - left;
        const uint32_t pace = period_at(self, (made < left) ? made : left);
        if (pace != self->pace) {
            self->pace = pace;
            board_turntable_pace(pace);
        }
    } else if (self->moving) {
        self->moving = false;
        if (self->powered && (self->steps > 0U)) {
            self->swings = true;
            self->stood_at = board_tick();  // not `now`: the last step may have come since this round began
        }
        const int32_t position = board_turntable_position();
        if (self->cause != 0U) {
            event_turntable_stopped_pack(
                &(event_turntable_stopped_t){
                    .tick = now, .position = position, .cause = self->cause, .lost = self->lost ? 1U : 0U},
                events_emit(events, EVENT_TURNTABLE_STOPPED));
        }
        event_turntable_done_pack(&(event_turntable_done_t){.tick = now, .position = position},
                                  events_emit(events, EVENT_TURNTABLE_DONE));
    }
    watch_power(self, now);
}
