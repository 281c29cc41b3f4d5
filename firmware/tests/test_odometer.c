// The odometer between edges, and when the main loop cannot follow it.

#include "check.h"
#include "rig.h"

static uint8_t phase;

// So many steps, up or down, one every so many ticks from now on.
static void turn(const int steps, const uint64_t every)
{
    static const uint8_t gray[4] = {3, 1, 0, 2};  // A B from both pulled up: A falls first
    const uint64_t from = native_tick();
    for (int i = 0; i < ((steps > 0) ? steps : -steps); i++) {
        phase = (uint8_t)((phase + ((steps > 0) ? 1 : 3)) % 4U);
        native_input(from + (uint64_t)i * every, PIN_ODOMETER_A, gray[phase] >> 1);
        native_input(from + (uint64_t)i * every, PIN_ODOMETER_B, gray[phase] & 1U);
    }
}

static reply_health_t health(void)
{
    reply_health_t reply = {0};
    const uint8_t* const payload = rig_command(COMMAND_HEALTH, NULL);
    EXPECT(payload != NULL);
    if (payload != NULL) {
        reply_health_unpack(&reply, payload);
    }
    return reply;
}

static uint32_t told(void)
{
    const got_t* const event = rig_take(EVENT_FAULT);
    EXPECT(event != NULL);
    event_fault_t fault = {0};
    if (event != NULL) {
        event_fault_unpack(&fault, event->payload);
    }
    EXPECT_EQ(fault.fault, FAULT_ODOMETER);
    return fault.detail;
}

static void there_and_back_without_a_camera_reads_zero(void)
{
    rig_start();
    phase = 0;
    turn(600, 20 * US);
    rig_pass(13 * MS);
    turn(-600, 20 * US);
    rig_pass(13 * MS);
    EXPECT_EQ(rig_status().odometer, 0);
    EXPECT_EQ(health().odometer_lost, 0);
    EXPECT_EQ(rig_count(EVENT_FAULT), 0);
}

static void what_a_stalled_loop_could_not_follow_is_counted_and_said(void)
{
    rig_scan(0);
    phase = 0;
    native_stall_cpu(50 * MS);
    turn(1000, 40 * US);
    rig_pass(60 * MS);
    const reply_health_t counted = health();
    EXPECT(counted.odometer_lost >= 1000 - 512);
    EXPECT(counted.odometer_lost <= 1000 - 400);
    EXPECT_EQ(rig_count(EVENT_FAULT), 1);
    EXPECT_EQ(told(), counted.odometer_lost);
    const reply_status_t status = rig_status();
    EXPECT_EQ(status.odometer, (int32_t)(1000 - counted.odometer_lost));
    EXPECT_EQ(status.fault, FAULT_NONE);
    EXPECT_EQ(status.state & STATE_LAMPS_ARMED, STATE_LAMPS_ARMED);
    turn(-100, 20 * US);
    rig_pass(3 * MS);
    EXPECT_EQ(rig_status().odometer, (int32_t)(900 - counted.odometer_lost));
}

static void both_lines_at_once_are_counted_and_said_but_not_in_a_flood(void)
{
    rig_start();
    for (uint8_t i = 0; i < 30; i++) {
        native_input(native_tick(), PIN_ODOMETER_A, i % 2U);
        native_input(native_tick(), PIN_ODOMETER_B, i % 2U);
        rig_pass(1 * MS);
    }
    rig_pass(110 * MS);
    EXPECT_EQ(health().odometer_impossible, 30);
    EXPECT_EQ(rig_count(EVENT_FAULT), 2);
    EXPECT_EQ(told(), 1);
    EXPECT_EQ(told(), 30);
    EXPECT_EQ(rig_status().odometer, 0);
}

void odometer_tests(void)
{
    RUN(there_and_back_without_a_camera_reads_zero);
    RUN(what_a_stalled_loop_could_not_follow_is_counted_and_said);
    RUN(both_lines_at_once_are_counted_and_said_but_not_in_a_flood);
}
