// The board's own measurements.

#include <string.h>

#include "rig.h"
#include "check.h"

static uint8_t measure(const uint16_t looks, const uint8_t pin, const uint8_t level, const uint32_t delay)
{
    uint8_t payload[COMMAND_MEASURE_LENGTH];
    command_measure_pack(
        &(command_measure_t){.looks = looks, .pin = pin, .level = level, .first = PIN_SYNC, .delay = delay}, payload);
    return rig_status_of(COMMAND_MEASURE, payload);
}

static reply_samples_t samples(const uint8_t latest, const uint8_t word)
{
    uint8_t payload[COMMAND_SAMPLES_LENGTH];
    command_samples_pack(&(command_samples_t){.latest = latest, .word = word}, payload);
    reply_samples_t reply;
    reply_samples_unpack(&reply, rig_command(COMMAND_SAMPLES, payload));
    return reply;
}

// Of the first 64 ticks, in how many these pins stood so.
static uint32_t ticks_at(const reply_samples_t* const reply, const uint8_t levels)
{
    uint32_t ticks = 0;
    for (uint32_t i = 0; i < sizeof reply->bits; i++) {
        ticks += ((reply->bits[i] >> 4) == levels) ? 1U : 0U;
        ticks += ((reply->bits[i] & 15U) == levels) ? 1U : 0U;
    }
    return ticks;
}

static void a_look_shows_a_flash_tick_by_tick(void)
{
    rig_start();
    command_stage_t config = rig_config(1, 0);
    config.led_width = 20;
    rig_configure(&config);
    EXPECT_EQ(measure(1, PIN_SYNC, 0, config.led_delay - 12U), STATUS_OK);
    rig_arm(ARM_LAMPS);
    rig_edge(PERIOD);
    const reply_samples_t seen = samples(0, 0);
    EXPECT_EQ(seen.looks, 1);
    EXPECT_EQ(ticks_at(&seen, 1U | (1U << (PIN_LED - PIN_SYNC))), 20);
    EXPECT_EQ(ticks_at(&seen, 1U), 44);
    EXPECT_EQ(seen.bits[3], 0x11);  // a word's first sample is in its highest bits: ten ticks until it lights
    EXPECT_EQ(seen.bits[7], 0x11);
    EXPECT_EQ(seen.bits[6], 0x55);
}

static void looks_that_are_alike_are_counted_and_one_that_differs_ends_it(void)
{
    rig_start();
    command_stage_t config = rig_config(1, 4);
    rig_configure(&config);
    EXPECT_EQ(measure(9, PIN_SYNC, 0, config.led_delay - 12U), STATUS_OK);
    rig_arm(ARM_LAMPS);
    for (uint32_t i = 0; i < 9U; i++) {
        rig_edge(PERIOD);
    }
    const reply_samples_t seen = samples(1, 0);
    EXPECT_EQ(seen.looks, 5);  // the fifth lights the LED
    EXPECT_EQ(seen.differs, 1);
    EXPECT_EQ(seen.bits[6] & 15U, 5);
}

static void nobody_begins_to_measure_on_a_head_at_work(void)
{
    rig_scan(4);
    EXPECT_EQ(measure(1, PIN_SYNC, 0, 0), STATUS_BAD_STATE);
    rig_arm(0);
    EXPECT_EQ(measure(1, PIN_SYNC, 0, 0), STATUS_OK);
    rig_arm(ARM_LAMPS);
    EXPECT_EQ(measure(1, PIN_SYNC, 0, 7), STATUS_OK);
    EXPECT_EQ(measure(0, 0, 0, 0), STATUS_OK);
    EXPECT_EQ(measure(1, PIN_SYNC, 0, 0), STATUS_BAD_STATE);
}

static void turn(const uint32_t counts)
{
    static uint32_t at;
    static const uint8_t levels[] = {0, 1, 3, 2};  // B A
    for (uint32_t i = 0; i < counts; i++) {
        const uint8_t level = levels[++at % 4U];
        native_input(native_tick() + 1U, PIN_ODOMETER_A, level & 1U);
        native_input(native_tick() + 1U, PIN_ODOMETER_B, level >> 1);
        rig_pass(100U);
    }
    rig_pass(MS);
}

static event_edge_t edge(void)
{
    rig_edge(PERIOD);
    rig_pass(MS);
    event_edge_t event;
    event_edge_unpack(&event, rig_take(EVENT_EDGE)->payload);
    return event;
}

static void edges_that_a_measurement_left_uncounted_say_so(void)
{
    rig_start();
    const uint8_t level = LEVEL;
    rig_status_of(COMMAND_INFO, &level);
    rig_edge(PERIOD);
    turn(8);
    rig_forget();
    const event_edge_t before = edge();
    EXPECT_EQ(before.flags & EDGE_ODOMETER_FROZEN, 0);
    EXPECT_EQ(measure(1, PIN_STEP, 1, 0), STATUS_OK);
    turn(8);
    const event_edge_t during = edge();
    EXPECT_EQ(during.flags & EDGE_ODOMETER_FROZEN, EDGE_ODOMETER_FROZEN);
    EXPECT_EQ(during.odometer, before.odometer);  // as on the Pico
    EXPECT_EQ(measure(0, 0, 0, 0), STATUS_OK);
    EXPECT_EQ(edge().flags & EDGE_ODOMETER_FROZEN, EDGE_ODOMETER_FROZEN);  // since the one before
    turn(4);
    const event_edge_t after = edge();
    EXPECT_EQ(after.flags & EDGE_ODOMETER_FROZEN, 0);
    EXPECT_EQ(after.odometer - before.odometer, 4);
    EXPECT_EQ(measure(1, PIN_STEP, 1, 0), STATUS_OK);  // begun and ended between two edges
    EXPECT_EQ(measure(0, 0, 0, 0), STATUS_OK);
    EXPECT_EQ(edge().flags & EDGE_ODOMETER_FROZEN, EDGE_ODOMETER_FROZEN);
    EXPECT_EQ(edge().flags & EDGE_ODOMETER_FROZEN, 0);
    for (uint8_t lower = 1; lower < 3U; lower++) {
        rig_status_of(COMMAND_INFO, &lower);
        EXPECT_EQ(measure(1, PIN_STEP, 1, 0), STATUS_OK);
        EXPECT_EQ(edge().flags & EDGE_ODOMETER_FROZEN, 0);  // it would not know the flag
    }
}

static void a_wire_carries_an_outputs_level_to_an_input(void)
{
    rig_start();
    native_wire(PIN_MICROWAVE, PIN_INTERLOCK);
    rig_arm(ARM_MICROWAVE);
    uint8_t payload[COMMAND_BURST_LENGTH];
    command_burst_pack(&(command_burst_t){.code = BURST_CODE_SINGLE, .chip = 3000, .repeat = 1, .period = 100000},
                       payload);
    EXPECT_EQ(rig_status_of(COMMAND_BURST, payload), STATUS_OK);
    EXPECT_EQ(rig_fall(PIN_MICROWAVE, 0) - rig_rise(PIN_MICROWAVE, 0), 1);
    EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
    EXPECT_EQ(rig_status().state & STATE_INTERLOCK_OPEN, 0);  // dark again, so closed again
}

void measure_tests(void)
{
    RUN(a_look_shows_a_flash_tick_by_tick);
    RUN(looks_that_are_alike_are_counted_and_one_that_differs_ends_it);
    RUN(nobody_begins_to_measure_on_a_head_at_work);
    RUN(edges_that_a_measurement_left_uncounted_say_so);
    RUN(a_wire_carries_an_outputs_level_to_an_input);
}
