// Decides which lamp the next frame gets, and when; says what every edge really took. Knows nothing of pins: the board
// fires what it is handed.

#include "sequencer.h"

#include "../board.h"
#include "../ticks.h"
#include "count.h"

// Places of fields in STAGE, as `detail` names them.
enum {
    FIELD_FRAME_PERIOD = 2,
    FIELD_EXPOSURE = 3,
    FIELD_READOUT = 4,
    FIELD_HOST_TIMEOUT = 6,
    FIELD_PROJECTOR_WIDTH = 8,
    FIELD_LED_WIDTH = 10,
};

// Of CAMERA_TRIGGER.
#define FIELD_TRIGGER_WIDTH 1U
#define FIELD_TRIGGER_DELAY 2U

// Of SLIDES.
#define FIELD_SLIDES_COUNT 1U

static uint32_t tolerance_ticks(const command_stage_t* const config)
{
    return (uint32_t)(((uint64_t)config->frame_period * config->tolerance) / 1000U);
}

// An edge earlier than this after the last one is no edge. Without a configuration only chatter can be told.
static uint32_t holdoff_ticks(const command_stage_t* const config)
{
    return (config->generation == 0U) ? FRAME_PERIOD_MIN_TICKS / 2U : config->frame_period - tolerance_ticks(config);
}

static bool is_led_slot(const command_stage_t* const config, const uint8_t slot)
{
    return slot == config->ratio;
}

static uint8_t lamp_due(const sequencer_t* const self)
{
    if (self->preamble.running) {
        return preamble_lamp(&self->preamble, self->config.ratio);
    }
    return is_led_slot(&self->config, self->slot) ? LAMP_LED : LAMP_PROJECTOR;
}

// What the next edge has to take. Invariant: of a projector's flash the slot alone says which slide is lit, in a
// preamble too, and it is one; so an edge's report needs no more than it always had.
static plan_t plan_next(const sequencer_t* const self)
{
    plan_t plan = {.slot = self->slot,
                   .lamp = LAMP_DARK,
                   .generation = self->config.generation,
                   .armed = self->armed,
                   .preamble = self->preamble.running};
    const uint8_t lamp = lamp_due(self);
    if (self->armed && (lamp != LAMP_DARK)) {
        const bool led = lamp == LAMP_LED;
        plan.delay_ticks = led ? self->config.led_delay : self->config.projector_delay;
        plan.width_ticks = led ? self->config.led_width : self->config.projector_width;
        plan.lamp = (plan.width_ticks > 0U) ? lamp : LAMP_DARK;
        plan.slide = led ? 0U : self->slot % self->wiring.slides;
    }
    return plan;
}

// From slot 0: of a preamble, where there is one, else of the lamp cycle.
static void begin(sequencer_t* const self, const bool with_preamble)
{
    self->preamble.running = with_preamble && (self->preamble.config.length > 0U);
    self->preamble.config.now = 0;
    self->preamble.cycles = 0;
    self->slot = 0;
    self->reload = true;
}

// An edge took the slot before.
static void next_slot(sequencer_t* const self, const uint8_t taken)
{
    preamble_t* const preamble = &self->preamble;
    self->slot = (uint8_t)(taken + 1U);
    if (preamble->running) {
        if (self->slot >= preamble->config.length) {
            begin(self, false);
        }
        return;
    }
    bool due = preamble->config.now != 0U;
    if (is_led_slot(&self->config, taken)) {
        self->slot = 0;
        due |= preamble_cycle(preamble);
    }
    if (due) {
        begin(self, true);
    }
}

static void put_in_force(sequencer_t* const self, events_t* const events, const uint32_t now)
{
    if (self->config.frame_period != self->staged.frame_period) {
        self->synced = false;  // to be found again at the new period
    }
    self->config = self->staged;
    if (((self->wiring.inverted ^ self->staged_wiring.inverted) & POLARITY_CAMERA_TRIGGER) != 0U) {
        board_camera_trigger(
            &(board_trigger_t){.width_ticks = 0U});  // else a pin that is followed would be turned over
    }
    self->wiring = self->staged_wiring;
    board_polarity(POLARITY_SYNC | POLARITY_OUTPUTS, self->wiring.inverted);
    board_slides(self->wiring.slides);
    board_camera_trigger(&(board_trigger_t){.width_ticks = self->wiring.trigger_ticks,
                                            .delay_ticks = self->wiring.trigger_delay_ticks,
                                            .period_ticks = self->config.frame_period});
    self->is_staged = false;
    self->is_committed = false;
    event_configured_pack(
        &(event_configured_t){.tick = now, .edge = self->edges, .generation = self->config.generation},
        events_emit(events, EVENT_CONFIGURED));
}

static bool is_regular(const sequencer_t* const self, const uint32_t interval)
{
    const uint32_t period = self->config.frame_period;
    const uint32_t off = (interval > period) ? interval - period : period - interval;
    return off <= tolerance_ticks(&self->config);
}

static void report_edge(sequencer_t* const self, const board_edge_t* const edge, events_t* const events)
{
    const bool late = edge->tag == 0U;
    // One that came before the lamps were armed, and is heard of only now, is none of the cycle that begins.
    const bool is_of_cycle = self->armed && !(self->just_armed && !tick_is_past(edge->tick, self->armed_at));
    const plan_t dark = {.slot = self->slot,
                         .lamp = LAMP_DARK,
                         .generation = self->config.generation,
                         .armed = is_of_cycle,
                         .preamble = is_of_cycle && self->preamble.running};
    const plan_t* const plan = late ? &dark : &self->plans[edge->tag - 1U];
    const bool configured = self->config.generation != 0U;
    const uint32_t interval = edge->tick - self->last_tick;
    const bool regular = self->has_last && configured && is_regular(self, interval);

    uint8_t flags = 0;
    flags |= late ? EDGE_LATE_LOAD : 0U;
    flags |= (self->has_last && configured && !regular) ? EDGE_IRREGULAR : 0U;
    flags |= self->has_last ? 0U : EDGE_FIRST;
    flags |= plan->armed ? 0U : EDGE_DISARMED;
    flags |= plan->preamble ? EDGE_PREAMBLE : 0U;
    flags |= self->odometer_stood ? EDGE_ODOMETER_FROZEN : 0U;
    event_edge_pack(&(event_edge_t){.edge = self->edges,
                                    .tick = edge->tick,
                                    .slot = plan->slot,
                                    .lamp = plan->lamp,
                                    .delay = plan->delay_ticks,
                                    .width = plan->width_ticks,
                                    .odometer = edge->odometer,
                                    .generation = plan->generation,
                                    .flags = flags},
                    events_emit(events, EVENT_EDGE));
    if (late) {
        count_one_more(&self->late);
        events_fault(events, edge->tick, FAULT_LATE_LOAD, self->edges);
    }
    if (regular && !self->synced) {
        self->synced = true;
        event_sync_found_pack(&(event_sync_found_t){.tick = edge->tick, .edge = self->edges},
                              events_emit(events, EVENT_SYNC_FOUND));
    }
    if (plan->preamble) {
        preamble_step(&self->preamble);
    }
    if (is_of_cycle && plan->armed) {  // a late edge uses up its slot as well: the cycle keeps step with the frames
        next_slot(self, plan->slot);
    }
    self->period = self->has_last ? interval : 0U;
    self->last_tick = edge->tick;
    self->has_last = true;
    self->edges++;
}

// An interval is only meaningful while the tick counter cannot have wrapped and the next edge is not overdue. The last
// edge may be younger than `now`, which was read before the edges were.
static void check_sync(sequencer_t* const self, events_t* const events, const uint32_t now)
{
    const uint32_t period = (self->config.generation == 0U) ? FRAME_PERIOD_MAX_TICKS : self->config.frame_period;
    if (!self->has_last || (ticks_since(now, self->last_tick) <= (int32_t)(period / 2U * 5U))) {
        return;
    }
    self->has_last = false;
    if (self->synced) {
        self->synced = false;
        event_sync_lost_pack(&(event_sync_lost_t){.tick = now, .last_edge = self->edges - 1U},
                             events_emit(events, EVENT_SYNC_LOST));
    }
}

void sequencer_start(sequencer_t* const self)
{
    preamble_seed(&self->preamble, board_nonce());
    self->wiring.slides = 1;
    self->reload = true;
}

void sequencer_edges(sequencer_t* const self, events_t* const events, const uint32_t now)
{
    board_edge_t edge;
    bool any = false;
    board_lamps_run();
    while (board_edge(&edge)) {  // all of them before loading: after a stall, the next edge is not the second
        report_edge(self, &edge, events);
        self->reload = true;
        any = true;
    }
    self->just_armed = false;
    // A measurement is begun and ended by commands, which come later in a round: if none is under way now, the edges
    // just reported are the last ones that it can have concerned.
    self->odometer_stood = self->odometer_stood && (board_measuring() || !any);
    check_sync(self, events, now);
}

// Invariant: between two rounds the board holds exactly one flash, and `plans` knows it and the one before by their
// tags. So whichever an edge took, it is reported as what it was; an edge that found none is dark and reported as late.
bool sequencer_load(sequencer_t* const self, events_t* const events, const uint32_t now)
{
    if (!self->reload) {
        return true;
    }
    self->reload = false;
    if (self->is_committed && (self->slot == 0U)) {
        put_in_force(self, events, now);
    }
    self->tag = (uint8_t)((self->tag % PLANS_KEPT) + 1U);
    plan_t* const plan = &self->plans[self->tag - 1U];
    *plan = plan_next(self);
    const board_flash_t flash = {.tag = self->tag,
                                 .lamp = plan->lamp,
                                 .slide = plan->slide,
                                 .delay_ticks = plan->delay_ticks,
                                 .width_ticks = plan->width_ticks,
                                 .holdoff_ticks = holdoff_ticks(&self->config)};
    return board_flash_load(&flash);
}

uint8_t sequencer_lamp(const sequencer_t* const self)
{
    return (self->tag == 0U) ? LAMP_DARK : self->plans[self->tag - 1U].lamp;
}

// `shortest`: from an edge to the earliest next one that would be accepted; what a flash may take of it is the duty.
static uint8_t check_flash(const reply_stage_t* const window, const uint32_t shortest, const uint32_t delay,
                           const uint32_t width)
{
    if (width == 0U) {
        return STATUS_OK;
    }
    if ((delay < window->window_open) || ((uint64_t)delay + width > window->window_close)) {
        return STATUS_WINDOW;
    }
    const uint64_t permille = LAMP_DUTY_MAX_PERMILLE;
    return ((uint64_t)width * 1000U > permille * shortest) ? STATUS_DUTY : STATUS_OK;
}

static uint8_t check_limits(const command_stage_t* const config)
{
    if ((config->frame_period < FRAME_PERIOD_MIN_TICKS) || (config->frame_period > FRAME_PERIOD_MAX_TICKS)) {
        return FIELD_FRAME_PERIOD;
    }
    if (config->exposure > config->frame_period) {
        return FIELD_EXPOSURE;
    }
    if (config->readout > config->frame_period) {
        return FIELD_READOUT;
    }
    if ((config->host_timeout != 0U) &&
        ((config->host_timeout < HOST_TIMEOUT_MIN_MS) || (config->host_timeout > HOST_TIMEOUT_MAX_MS))) {
        return FIELD_HOST_TIMEOUT;
    }
    if (config->projector_width > LAMP_WIDTH_MAX_TICKS) {
        return FIELD_PROJECTOR_WIDTH;
    }
    if (config->led_width > LAMP_WIDTH_MAX_TICKS) {
        return FIELD_LED_WIDTH;
    }
    return RANGE_OK;
}

// One that begins with an edge must be over before another can be accepted, one of its own clock before the next.
static uint8_t check_trigger(const command_stage_t* const config, const uint32_t width, const uint32_t delay)
{
    const uint32_t least = CAMERA_TRIGGER_MIN_TICKS;
    if (width == 0U) {
        return (delay == 0U) ? RANGE_OK : FIELD_TRIGGER_DELAY;
    }
    if ((delay != 0U) && (delay < least)) {
        return FIELD_TRIGGER_DELAY;
    }
    const uint64_t room = (delay == 0U) ? config->frame_period : holdoff_ticks(config);
    return ((width < least) || ((uint64_t)delay + width + least > room)) ? FIELD_TRIGGER_WIDTH : RANGE_OK;
}

// A cycle in which one slide is lit more often than another is none that a host could want.
static bool shares_out(const command_stage_t* const config, const uint8_t slides)
{
    return (slides == 1U) || ((config->ratio > 0U) && (config->ratio % slides == 0U));
}

uint8_t sequencer_stage(sequencer_t* const self, const command_stage_t* const config, reply_stage_t* const reply)
{
    reply->generation = self->config.generation;
    const uint8_t field = check_limits(config);
    if (field != RANGE_OK) {
        reply->detail = field;
        return STATUS_OUT_OF_RANGE;
    }
    // The flash must end before the earliest edge the qualification lets through, else it would run into the next one.
    const uint32_t first_row_closes = config->frame_period - config->readout;
    const uint32_t next_edge = holdoff_ticks(config);
    reply->window_open = config->frame_period - config->exposure;
    reply->window_close = (first_row_closes < next_edge) ? first_row_closes : next_edge;
    uint8_t status = STATUS_OK;
    if (config->ratio > 0U) {
        reply->detail = LAMP_PROJECTOR;
        status = check_flash(reply, next_edge, config->projector_delay, config->projector_width);
    }
    if (status == STATUS_OK) {
        reply->detail = LAMP_LED;
        status = check_flash(reply, next_edge, config->led_delay, config->led_width);
    }
    if (status != STATUS_OK) {
        return status;
    }
    reply->detail = 0;
    if (self->is_committed) {
        return STATUS_BAD_STATE;  // what waits for slot 0 must not change under it
    }
    self->staged = *config;
    self->staged_wiring = self->wiring;  // a host that knows nothing of it changes nothing of it
    if (check_trigger(config, self->wiring.trigger_ticks, self->wiring.trigger_delay_ticks) != RANGE_OK) {
        self->staged_wiring.trigger_ticks = 0;  // but for what its period leaves no room for
        self->staged_wiring.trigger_delay_ticks = 0;
    }
    if (!shares_out(config, self->wiring.slides)) {
        self->staged_wiring.slides = 1;
    }
    self->is_staged = true;
    reply->generation = config->generation;
    return STATUS_OK;
}

bool sequencer_polarity(sequencer_t* const self, const command_polarity_t* const config)
{
    if (!self->is_staged || self->is_committed || (self->staged.generation != config->generation)) {
        return false;
    }
    self->staged_wiring.inverted = config->inverted;
    return true;
}

uint8_t sequencer_camera_trigger(sequencer_t* const self, const command_camera_trigger_t* const config,
                                 uint8_t* const detail)
{
    if (!self->is_staged || self->is_committed || (self->staged.generation != config->generation)) {
        return STATUS_BAD_STATE;
    }
    *detail = check_trigger(&self->staged, config->width, config->delay);
    if (*detail != RANGE_OK) {
        return STATUS_OUT_OF_RANGE;
    }
    *detail = 0;
    self->staged_wiring.trigger_ticks = config->width;
    self->staged_wiring.trigger_delay_ticks = config->delay;
    return STATUS_OK;
}

uint8_t sequencer_slides(sequencer_t* const self, const command_slides_t* const config, uint8_t* const detail)
{
    if (!self->is_staged || self->is_committed || (self->staged.generation != config->generation)) {
        return STATUS_BAD_STATE;
    }
    if (!shares_out(&self->staged, config->count)) {
        *detail = FIELD_SLIDES_COUNT;
        return STATUS_OUT_OF_RANGE;
    }
    self->staged_wiring.slides = config->count;
    return STATUS_OK;
}

// Does the staged configuration change what the pins do by themselves?
static bool rewires(const sequencer_t* const self)
{
    const wiring_t* const staged = &self->staged_wiring;
    const bool other_period = self->staged.frame_period != self->config.frame_period;
    const bool own_clock = (staged->trigger_ticks != 0U) && (staged->trigger_delay_ticks == 0U);
    return (staged->inverted != self->wiring.inverted) || (staged->slides != self->wiring.slides) ||
           (staged->trigger_ticks != self->wiring.trigger_ticks) ||
           (staged->trigger_delay_ticks != self->wiring.trigger_delay_ticks) || (own_clock && other_period);
}

// An output whose polarity changes changes its level at once, lit or dark: so nothing may be armed, and what is armed
// later finds it in force.
bool sequencer_commit(sequencer_t* const self, const uint8_t generation, const bool live)
{
    if (!self->is_staged || (self->staged.generation != generation)) {
        return false;
    }
    if (live && rewires(self)) {
        return false;
    }
    self->is_committed = true;
    self->reload |= !self->armed;  // else it waits for the edge before slot 0
    return true;
}

// What is loaded stays loaded: its edge may just be coming.
void sequencer_preamble(sequencer_t* const self, const command_preamble_t* const config)
{
    preamble_t* const preamble = &self->preamble;
    preamble->config = *config;
    preamble->cycles = 0;
    if (!self->armed || preamble->running || (config->length == 0U)) {
        preamble->config.now = 0;
    }
}

void sequencer_measures(sequencer_t* const self)
{
    self->odometer_stood = true;
}

void sequencer_arm(sequencer_t* const self)
{
    self->armed = true;
    self->just_armed = true;
    self->armed_at = board_tick();
    begin(self, true);
}

void sequencer_disarm(sequencer_t* const self)
{
    board_lamps_cut();
    self->armed = false;
    begin(self, false);
}
