// Several slides take the projector's flashes in turn, each on an output of its own.

#include "check.h"
#include "rig.h"

static const uint8_t lamps[] = {PIN_PROJECTOR, PIN_SLIDE_2, PIN_SLIDE_3, PIN_SLIDE_4, PIN_LED};
#define LAMPS (sizeof lamps / sizeof lamps[0])

static uint8_t ask(const uint8_t generation, const uint8_t count)
{
    uint8_t payload[COMMAND_SLIDES_LENGTH];
    command_slides_pack(&(command_slides_t){.generation = generation, .count = count}, payload);
    return rig_status_of(COMMAND_SLIDES, payload);
}

static uint8_t stage(const uint8_t generation, const uint8_t ratio)
{
    const command_stage_t config = rig_config(generation, ratio);
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_pack(&config, payload);
    return rig_status_of(COMMAND_STAGE, payload);
}

static uint8_t commit(const uint8_t generation)
{
    return rig_status_of(COMMAND_COMMIT, &generation);
}

static void configure(const uint8_t generation, const uint8_t ratio, const uint8_t count)
{
    EXPECT_EQ(stage(generation, ratio), STATUS_OK);
    EXPECT_EQ(ask(generation, count), STATUS_OK);
    EXPECT_EQ(commit(generation), STATUS_OK);
    rig_pass(MS);
}

static reply_slides_lit_t lit(void)
{
    reply_slides_lit_t reply;
    reply_slides_lit_unpack(&reply, rig_command(COMMAND_SLIDES_LIT, NULL));
    return reply;
}

static size_t rises(void)
{
    size_t count = 0;
    for (size_t i = 0; i < LAMPS; i++) {
        count += rig_rises(lamps[i]);
    }
    return count;
}

// The edge's frame has one flash, on the output of the slide that its slot names, to the tick; or the LED's.
static void takes_its_turn(const event_edge_t* const edge, const uint64_t tick, const uint8_t count)
{
    const uint8_t pin = (edge->lamp == LAMP_LED) ? PIN_LED : lamps[edge->slot % count];
    EXPECT_EQ(rises(), edge->lamp != LAMP_DARK);
    if (edge->lamp != LAMP_DARK) {
        EXPECT_EQ(rig_rise(pin, 0), tick + edge->delay);
        EXPECT_EQ(rig_fall(pin, 0), tick + edge->delay + edge->width);
    }
}

static void each_slide_takes_its_turn_and_none_the_leds(void)
{
    for (uint8_t count = 1; count <= SLIDES_MAX; count++) {
        const uint8_t ratio = (uint8_t)((count == 1U) ? 4U : 2U * count);
        rig_start();
        configure(1, ratio, count);
        EXPECT_EQ(lit().count, count);
        EXPECT_EQ(lit().driven, count);
        rig_arm(ARM_LAMPS);
        for (uint8_t i = 0; i < 2U * (ratio + 1U); i++) {
            rig_forget();
            const uint64_t tick = rig_edge(PERIOD);
            const event_edge_t edge = rig_take_edge();
            EXPECT_EQ(edge.slot, i % (ratio + 1U));
            EXPECT_EQ(edge.lamp, (edge.slot == ratio) ? LAMP_LED : LAMP_PROJECTOR);
            takes_its_turn(&edge, tick, count);
        }
    }
}

static void a_preamble_lights_them_by_the_place_in_it(void)
{
    rig_start();
    configure(1, 4, 4);
    uint8_t payload[COMMAND_PREAMBLE_LENGTH];
    command_preamble_pack(&(command_preamble_t){.length = PREAMBLE_MAX}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_PREAMBLE, payload), STATUS_OK);
    rig_arm(ARM_LAMPS);
    for (uint8_t i = 0; i < PREAMBLE_MAX; i++) {
        rig_forget();
        const uint64_t tick = rig_edge(PERIOD);
        const event_edge_t edge = rig_take_edge();
        EXPECT_EQ(edge.flags & EDGE_PREAMBLE, EDGE_PREAMBLE);
        EXPECT_EQ(edge.slot, i);
        takes_its_turn(&edge, tick, 4);
    }
}

static void a_count_that_does_not_share_out_is_refused(void)
{
    rig_start();
    EXPECT_EQ(ask(1, 2), STATUS_BAD_STATE);  // nothing is staged
    EXPECT_EQ(stage(1, 4), STATUS_OK);
    EXPECT_EQ(ask(1, 0), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask(1, 3), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask(1, SLIDES_MAX + 1U), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask(0, 2), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask(2, 2), STATUS_BAD_STATE);  // another one is
    EXPECT_EQ(ask(1, 4), STATUS_OK);
    EXPECT_EQ(commit(1), STATUS_OK);
    rig_pass(MS);
    EXPECT_EQ(stage(2, 0), STATUS_OK);
    EXPECT_EQ(ask(2, 2), STATUS_OUT_OF_RANGE);  // the LED alone
    EXPECT_EQ(commit(2), STATUS_OK);
    rig_pass(MS);
    EXPECT_EQ(lit().count, 1);
    EXPECT_EQ(lit().driven, 4);  // dark, as outputs are from now on
}

// Who knows nothing of slides changes nothing of them, but for a cycle that they do not fit.
static void a_stage_without_it_keeps_them_where_they_fit(void)
{
    rig_start();
    configure(1, 4, 2);
    EXPECT_EQ(stage(2, 8), STATUS_OK);
    EXPECT_EQ(commit(2), STATUS_OK);
    rig_pass(MS);
    EXPECT_EQ(lit().count, 2);
    EXPECT_EQ(stage(3, 3), STATUS_OK);
    EXPECT_EQ(commit(3), STATUS_OK);
    rig_pass(MS);
    EXPECT_EQ(lit().count, 1);
}

static void nothing_changes_them_while_armed(void)
{
    rig_start();
    configure(1, 4, 2);
    rig_arm(ARM_LAMPS);
    EXPECT_EQ(stage(2, 4), STATUS_OK);
    EXPECT_EQ(ask(2, 4), STATUS_BAD_STATE);
    rig_arm(0);
    EXPECT_EQ(ask(2, 4), STATUS_OK);
    rig_arm(ARM_LAMPS);
    EXPECT_EQ(commit(2), STATUS_BAD_STATE);
    EXPECT_EQ(stage(3, 8), STATUS_OK);  // another cycle of the same slides
    EXPECT_EQ(commit(3), STATUS_OK);
    uint8_t after = 0;
    for (uint8_t i = 0; i < 20U; i++) {
        rig_forget();
        const uint64_t tick = rig_edge(PERIOD);
        const event_edge_t edge = rig_take_edge();
        takes_its_turn(&edge, tick, 2);
        after += edge.generation == 3U;
    }
    EXPECT(after >= 10U);
}

static void dark_is_every_output_that_is_not_armed(void)
{
    static const uint8_t slides[] = {PIN_SLIDE_2, PIN_SLIDE_3, PIN_SLIDE_4};
    rig_start();
    for (size_t i = 0; i < 3U; i++) {
        native_pull(slides[i], 1);  // a wire that pulls up shows which outputs are driven
    }
    EXPECT_EQ(lit().driven, 0);
    configure(1, 4, 1);
    for (size_t i = 0; i < 3U; i++) {
        EXPECT_EQ(native_pin(slides[i]), 1);  // none of a head that has no slides
    }
    configure(2, 2, 2);
    EXPECT_EQ(native_pin(PIN_SLIDE_2), 0);
    EXPECT_EQ(native_pin(PIN_SLIDE_3), 1);
    configure(3, 4, 4);
    rig_forget();
    for (uint8_t i = 0; i < 6U; i++) {
        rig_edge(PERIOD);
    }
    EXPECT_EQ(rises(), 0);
    rig_arm(ARM_LAMPS);
    rig_edge(PERIOD);
    const uint64_t edge = rig_pulse();
    rig_pass(edge + rig_config(1, 4).projector_delay + MS - native_tick());
    EXPECT_EQ(native_pin(PIN_SLIDE_2), 1);
    rig_arm(0);
    for (size_t i = 0; i < LAMPS; i++) {
        EXPECT_EQ(native_pin(lamps[i]), 0);
    }
    rig_arm(ARM_LAMPS);
    rig_edge(PERIOD);
    rig_forget();
    rig_pass(30 * PERIOD);  // sync lost, and the host silent: disarmed
    rig_edge(PERIOD);
    EXPECT_EQ(rises(), 0);
    native_power_on(2, BOOT_CAUSE_WATCHDOG);
    rig_pass(MS);
    for (size_t i = 0; i < 3U; i++) {
        EXPECT_EQ(native_pin(slides[i]), 1);  // let go
    }
}

static void the_cycle_begins_anew_with_the_first_slide(void)
{
    rig_start();
    configure(1, 4, 4);
    rig_arm(ARM_LAMPS);
    rig_forget();
    for (uint8_t i = 0; i < 7U; i++) {
        rig_edge(PERIOD);
    }
    rig_forget();
    rig_pulse();
    rig_pass(PERIOD);
    const uint8_t next = (uint8_t)((rig_take_edge().slot + 1U) % 5U);
    for (uint8_t i = 0; i < 3U; i++) {  // no edges: the sync is lost; the slot waits for the next one
        rig_pass(PERIOD);
        rig_command(COMMAND_PING, NULL);
    }
    rig_forget();
    const uint64_t tick = rig_edge(PERIOD);
    const event_edge_t edge = rig_take_edge();
    EXPECT_EQ(edge.slot, next);
    takes_its_turn(&edge, tick, 4);
    rig_arm(0);
    rig_arm(ARM_LAMPS);
    rig_forget();
    const uint64_t again = rig_edge(PERIOD);
    const event_edge_t first = rig_take_edge();
    EXPECT_EQ(first.slot, 0);
    takes_its_turn(&first, again, 4);
}

static void inverted_they_are_as_the_projector_is(void)
{
    rig_start();
    for (size_t i = 0; i < LAMPS - 1U; i++) {
        native_pull(lamps[i], 1);
    }
    EXPECT_EQ(stage(1, 4), STATUS_OK);
    uint8_t payload[COMMAND_POLARITY_LENGTH];
    command_polarity_pack(&(command_polarity_t){.generation = 1, .inverted = POLARITY_PROJECTOR}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_POLARITY, payload), STATUS_OK);
    EXPECT_EQ(ask(1, 4), STATUS_OK);
    EXPECT_EQ(commit(1), STATUS_OK);
    rig_pass(MS);
    rig_arm(ARM_LAMPS);
    rig_look();
    for (size_t i = 0; i < 4U; i++) {
        EXPECT_EQ(rig_fall(lamps[i], 0), 0);  // never lit on the way here
        rig_forget();
        const uint64_t tick = rig_edge(PERIOD);
        const event_edge_t edge = rig_take_edge();
        EXPECT_EQ(rig_fall(lamps[i], 0), tick + edge.delay);
        EXPECT_EQ(rig_rise(lamps[i], 0), tick + edge.delay + edge.width);
    }
}

void slides_tests(void)
{
    RUN(each_slide_takes_its_turn_and_none_the_leds);
    RUN(a_preamble_lights_them_by_the_place_in_it);
    RUN(a_count_that_does_not_share_out_is_refused);
    RUN(a_stage_without_it_keeps_them_where_they_fit);
    RUN(nothing_changes_them_while_armed);
    RUN(dark_is_every_output_that_is_not_armed);
    RUN(the_cycle_begins_anew_with_the_first_slide);
    RUN(inverted_they_are_as_the_projector_is);
}
