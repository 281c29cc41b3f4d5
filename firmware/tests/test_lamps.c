// The lamps' duty over time, whatever configurations and resets follow each other.

#include "rig.h"
#include "check.h"

// The longest flash that a period of 40 ms allows, as late in it, or as early, as can be.
static command_stage_t longest(const uint8_t generation, const bool late)
{
    command_stage_t config = rig_config(generation, 0);
    config.exposure = PERIOD;
    config.readout = 0;
    config.tolerance = 1;
    config.led_width = 1998 * MS / 100;
    config.led_delay = late ? config.led_width : 0U;
    return config;
}

// From any rise on and over any span: the duty's share of it, and one flash more.
static void expect_led_within_duty(void)
{
    uint64_t on = 0;
    for (size_t i = 0; i < rig_rises(PIN_LED); i++) {
        const uint64_t width = rig_fall(PIN_LED, i) - rig_rise(PIN_LED, i);
        on += width;
        EXPECT(width <= LAMP_WIDTH_MAX_TICKS);
        const uint64_t span = rig_fall(PIN_LED, i) - rig_rise(PIN_LED, 0);
        EXPECT(on <= span * LAMP_DUTY_MAX_PERMILLE / 1000U + LAMP_WIDTH_MAX_TICKS / 2U + US);
        if (i > 0U) {
            EXPECT(rig_rise(PIN_LED, i) - rig_fall(PIN_LED, i - 1U) >= width);
        }
    }
}

static void flashes_of_two_configurations_never_join(void)
{
    for (uint8_t late = 0; late < 2U; late++) {
        rig_start();
        const command_stage_t first = longest(1, late != 0U);
        const command_stage_t second = longest(2, late == 0U);
        rig_configure(&first);
        rig_arm(ARM_LAMPS);
        rig_forget();
        rig_edge(PERIOD - 4U * MS);
        rig_configure(&second);  // 4 ms
        for (size_t i = 0; i < 6U; i++) {
            rig_edge(PERIOD);
        }
        EXPECT(rig_rises(PIN_LED) >= 6U);
        EXPECT_EQ(rig_status().fault, FAULT_NONE);
        expect_led_within_duty();
    }
}

static void a_reset_forgets_no_dark_time_that_a_lamp_owes(void)
{
    rig_start();
    const command_stage_t config = longest(1, false);
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    rig_forget();
    rig_edge(config.led_width + 100U * US);
    const uint64_t first = rig_rise(PIN_LED, 0);
    native_power_on(2, BOOT_CAUSE_HOST_RESET);
    rig_identify();
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    for (size_t i = 0; i < 4U; i++) {
        rig_edge(PERIOD);
    }
    EXPECT(rig_rises(PIN_LED) >= 3U);  // dark while the earliest next edge might come within 40 ms of the reset
    EXPECT(rig_rise(PIN_LED, 1) - first >= 2U * config.led_width);
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
    expect_led_within_duty();
}

void lamps_tests(void)
{
    RUN(flashes_of_two_configurations_never_join);
    RUN(a_reset_forgets_no_dark_time_that_a_lamp_owes);
}
