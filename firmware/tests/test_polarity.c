// Pins that the wiring inverts: pads, not what the core means.

#include "check.h"
#include "rig.h"

static void stage_inverted(const uint8_t generation, const uint8_t inverted)
{
    uint8_t payload[COMMAND_STAGE_LENGTH];
    const command_stage_t config = rig_config(generation, 1);
    command_stage_pack(&config, payload);
    EXPECT_EQ(rig_status_of(COMMAND_STAGE, payload), STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_POLARITY, (const uint8_t[]){generation, inverted}), STATUS_OK);
}

static void commit(const uint8_t generation)
{
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){generation}), STATUS_OK);
}

static void an_inverted_lamp_is_lit_low_and_rests_high_from_power_on(void)
{
    rig_start();
    native_pull(PIN_PROJECTOR, 1);
    rig_look();
    stage_inverted(1, POLARITY_PROJECTOR | POLARITY_SYNC);
    commit(1);
    rig_arm(ARM_LAMPS);
    native_input(native_tick(), PIN_SYNC, 0);
    rig_pass(US);
    const uint64_t edge = native_tick();
    native_input(edge, PIN_SYNC, 1);  // rising edges count
    rig_pass(39 * MS);
    rig_look();
    const command_stage_t config = rig_config(1, 1);
    EXPECT_EQ(rig_fall(PIN_PROJECTOR, 0), edge + config.projector_delay);
    EXPECT_EQ(rig_rise(PIN_PROJECTOR, 1), edge + config.projector_delay + config.projector_width);
    native_input(native_tick(), PIN_SYNC, 0);
    const uint64_t next = native_tick() + MS;
    native_input(next, PIN_SYNC, 1);
    rig_pass(config.led_delay + 2 * MS);  // an inverted sync leaves the LED as it was
    rig_look();
    EXPECT_EQ(rig_rise(PIN_LED, 0), next + config.led_delay);
}

static void a_reset_lets_go_and_the_resistor_holds(void)
{
    rig_start();
    native_pull(PIN_LED, 1);
    stage_inverted(1, POLARITY_LED);
    commit(1);
    rig_look();
    native_power_on(2, BOOT_CAUSE_WATCHDOG);
    rig_pass(MS);
    rig_identify();
    rig_look();
    EXPECT_EQ(rig_fall(PIN_LED, 0), 0);
    EXPECT_EQ(native_pin(PIN_LED), 1);
}

static void nothing_is_turned_over_while_anything_is_armed(void)
{
    rig_start();
    stage_inverted(1, 0);
    commit(1);
    stage_inverted(2, POLARITY_MICROWAVE);
    EXPECT_EQ(rig_status_of(COMMAND_POLARITY, (const uint8_t[]){3, 0}), STATUS_BAD_STATE);
    rig_arm(ARM_MICROWAVE);
    EXPECT_EQ(rig_status_of(COMMAND_POLARITY, (const uint8_t[]){2, 0}), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){2}), STATUS_BAD_STATE);
    EXPECT_EQ(native_pin(PIN_MICROWAVE), 0);
    rig_arm(0);
    commit(2);
    EXPECT_EQ(native_pin(PIN_MICROWAVE), 1);
}

static void a_stage_without_polarity_keeps_the_one_in_force(void)
{
    rig_start();
    stage_inverted(1, POLARITY_LED | POLARITY_TRIGGER);
    commit(1);
    const command_stage_t config = rig_config(2, 1);
    rig_configure(&config);
    reply_wiring_t reply;
    reply_wiring_unpack(&reply, rig_command(COMMAND_WIRING, NULL));
    EXPECT_EQ(reply.generation, 2);
    EXPECT_EQ(reply.inverted, POLARITY_LED | POLARITY_TRIGGER);
    EXPECT_EQ(reply.driven,
              POLARITY_PROJECTOR | POLARITY_LED | POLARITY_MICROWAVE | POLARITY_TRIGGER | POLARITY_CAMERA_TRIGGER);
    EXPECT_EQ(rig_status_of(COMMAND_POLARITY, (const uint8_t[]){0, 0}), STATUS_OUT_OF_RANGE);
}

void polarity_tests(void)
{
    RUN(an_inverted_lamp_is_lit_low_and_rests_high_from_power_on);
    RUN(a_reset_lets_go_and_the_resistor_holds);
    RUN(nothing_is_turned_over_while_anything_is_armed);
    RUN(a_stage_without_polarity_keeps_the_one_in_force);
}
