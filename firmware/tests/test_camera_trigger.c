// Triggers for cameras: each one's end is the sync edge.

#include "check.h"
#include "rig.h"

#define WIDTH (20U * (uint32_t)MS)

static uint8_t ask_after(const uint8_t generation, const uint32_t width, const uint32_t delay)
{
    uint8_t payload[COMMAND_CAMERA_TRIGGER_LENGTH];
    command_camera_trigger_pack(&(command_camera_trigger_t){.generation = generation, .width = width, .delay = delay},
                                payload);
    return rig_status_of(COMMAND_CAMERA_TRIGGER, payload);
}

static uint8_t ask(const uint8_t generation, const uint32_t width)
{
    return ask_after(generation, width, 0);
}

static void stage_triggered(const uint8_t generation, const uint32_t width)
{
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_t config = rig_config(generation, 0);
    config.exposure = WIDTH;
    config.readout = 0;
    config.tolerance = 5;
    config.led_delay = 25U * (uint32_t)MS;
    command_stage_pack(&config, payload);
    EXPECT_EQ(rig_status_of(COMMAND_STAGE, payload), STATUS_OK);
    EXPECT_EQ(ask(generation, width), STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){generation}), STATUS_OK);
}

static void flashes_lie_in_the_exposure_that_the_trigger_makes(void)
{
    rig_start();
    rig_look();
    stage_triggered(1, WIDTH);
    rig_arm(ARM_LAMPS);
    rig_pass(130 * MS);
    rig_look();
    const uint64_t first = rig_rise(PIN_CAMERA_TRIGGER, 0);
    for (size_t i = 0; i < 3U; i++) {
        EXPECT_EQ(rig_rise(PIN_CAMERA_TRIGGER, i), first + i * PERIOD);
        EXPECT_EQ(rig_fall(PIN_CAMERA_TRIGGER, i), first + i * PERIOD + WIDTH);
        const event_edge_t edge = rig_take_edge();
        EXPECT_EQ(native_boot_tick() + edge.tick, first + i * PERIOD + WIDTH);
        EXPECT_EQ(rig_rise(PIN_LED, i), first + i * PERIOD + WIDTH + 25U * MS);
        EXPECT(rig_rise(PIN_LED, i) > rig_rise(PIN_CAMERA_TRIGGER, i + 1U));
    }
    EXPECT_EQ(rig_status().rejected, 0);
}

static void the_sync_input_counts_only_without_a_trigger(void)
{
    rig_start();
    stage_triggered(1, WIDTH);
    rig_pass(100 * MS);
    rig_forget();
    rig_pulse();
    rig_pass(MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 0);
    stage_triggered(2, 0);
    rig_pass(100 * MS);
    rig_forget();
    rig_pulse();
    rig_pass(MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 1);
    reply_wiring_t wiring;
    reply_wiring_unpack(&wiring, rig_command(COMMAND_WIRING, NULL));
    EXPECT_EQ(wiring.camera_trigger, 0);
}

static void a_trigger_fits_its_period_or_is_refused(void)
{
    rig_start();
    EXPECT_EQ(ask(1, WIDTH), STATUS_BAD_STATE);  // nothing is staged
    stage_triggered(1, WIDTH);
    const command_stage_t config = rig_config(2, 0);
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_pack(&config, payload);
    EXPECT_EQ(rig_status_of(COMMAND_STAGE, payload), STATUS_OK);
    EXPECT_EQ(ask(2, CAMERA_TRIGGER_MIN_TICKS - 1U), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask(2, (uint32_t)PERIOD - CAMERA_TRIGGER_MIN_TICKS + 1U), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask(0, WIDTH), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask(2, WIDTH + 1U), STATUS_OK);
    rig_arm(ARM_LAMPS);
    EXPECT_EQ(ask(2, WIDTH), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){2}), STATUS_BAD_STATE);  // another trigger, armed
    native_power_on(2, BOOT_CAUSE_WATCHDOG);
    rig_pass(100 * MS);
    rig_look();
    EXPECT_EQ(native_pin(PIN_CAMERA_TRIGGER), 0);
    rig_pass(100 * MS);
    rig_look();
    EXPECT_EQ(native_pin(PIN_CAMERA_TRIGGER), 0);
}

static void each_accepted_edge_of_the_sync_input_begins_one_and_stays_the_edge(void)
{
    const uint32_t delay = 15U * (uint32_t)MS;
    uint8_t payload[COMMAND_STAGE_LENGTH];
    rig_start();
    const command_stage_t config = rig_config(1, 0);
    command_stage_pack(&config, payload);
    EXPECT_EQ(rig_status_of(COMMAND_STAGE, payload), STATUS_OK);
    const uint32_t earliest = (uint32_t)PERIOD - (uint32_t)PERIOD / 1000U * config.tolerance;
    const uint32_t least = CAMERA_TRIGGER_MIN_TICKS;
    EXPECT_EQ(ask_after(1, WIDTH, least - 1U), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask_after(1, 0, delay), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask_after(1, earliest - delay - least + 1U, delay), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask_after(1, UINT32_MAX, UINT32_MAX), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(ask_after(1, earliest - delay - least, delay), STATUS_OK);
    EXPECT_EQ(ask_after(1, WIDTH, delay), STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){1}), STATUS_OK);
    rig_pass(100 * MS);
    rig_look();
    EXPECT_EQ(native_pin(PIN_CAMERA_TRIGGER), 0);  // nothing begins one
    rig_forget();
    for (size_t i = 0; i < 3U; i++) {
        const uint64_t edge = rig_pulse();
        rig_pass(MS);
        rig_pulse();  // is refused, and begins none
        rig_pass(PERIOD - MS);
        rig_look();
        EXPECT_EQ(rig_rise(PIN_CAMERA_TRIGGER, i), edge + delay);
        EXPECT_EQ(rig_fall(PIN_CAMERA_TRIGGER, i), edge + delay + WIDTH);
        EXPECT_EQ(native_boot_tick() + rig_take_edge().tick, edge);
    }
    EXPECT_EQ(rig_status().rejected, 3);
    reply_wiring_t wiring;
    reply_wiring_unpack(&wiring, rig_command(COMMAND_WIRING, NULL));
    EXPECT_EQ(wiring.camera_trigger_delay, delay);
    command_stage_t shorter = rig_config(2, 0);
    shorter.frame_period = delay + WIDTH;
    shorter.exposure = shorter.frame_period;
    shorter.readout = 0;
    command_stage_pack(&shorter, payload);
    EXPECT_EQ(rig_status_of(COMMAND_STAGE, payload), STATUS_OK);  // leaves no room for it: none with that one
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){2}), STATUS_OK);
    rig_pass(MS);
    reply_wiring_unpack(&wiring, rig_command(COMMAND_WIRING, NULL));
    EXPECT_EQ(wiring.camera_trigger, 0);
    EXPECT_EQ(wiring.camera_trigger_delay, 0);
}

void camera_trigger_tests(void)
{
    RUN(each_accepted_edge_of_the_sync_input_begins_one_and_stays_the_edge);
    RUN(flashes_lie_in_the_exposure_that_the_trigger_makes);
    RUN(the_sync_input_counts_only_without_a_trigger);
    RUN(a_trigger_fits_its_period_or_is_refused);
}
