// The turntable.

#include "rig.h"
#include "check.h"

static reply_move_t move(const int32_t position, const uint32_t period, const uint8_t hold)
{
    uint8_t payload[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = position, .period = period, .hold = hold}, payload);
    reply_move_t reply;
    reply_move_unpack(&reply, rig_command(COMMAND_MOVE, payload));
    return reply;
}

static void the_turntable_goes_to_absolute_positions_both_ways(void)
{
    rig_start();
    EXPECT_EQ(move(200, 10000, 0).status, STATUS_OK);
    EXPECT_EQ(native_pin(PIN_ENABLE), 0);
    EXPECT_EQ(native_pin(PIN_DIRECTION), 1);
    EXPECT(rig_status().state & STATE_TURNTABLE_MOVING);
    EXPECT_EQ(move(0, 10000, 0).status, STATUS_BAD_STATE);
    rig_pass(20 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 200);
    EXPECT_EQ(rig_rise(PIN_STEP, 199) - rig_rise(PIN_STEP, 0), 199 * 10000);
    event_turntable_done_t done;
    event_turntable_done_unpack(&done, rig_take(EVENT_TURNTABLE_DONE)->payload);
    EXPECT_EQ(done.position, 200);
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
    EXPECT_EQ(move(-50, 20000, 1).position, 200);
    rig_pass(60 * MS);
    EXPECT_EQ(rig_status().turntable, -50);
    EXPECT_EQ(native_pin(PIN_DIRECTION), 0);
    EXPECT_EQ(native_pin(PIN_ENABLE), 0);  // held
    EXPECT_EQ(rig_rises(PIN_STEP), 450);
    rig_forget();
    EXPECT_EQ(move(-50, 20000, 0).status, STATUS_OK);
    EXPECT_EQ(rig_count(EVENT_TURNTABLE_DONE), 1);  // already there
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
}

static void a_move_out_of_range_is_refused(void)
{
    rig_start();
    EXPECT_EQ(move(1, 9999, 0).detail, 1);
    EXPECT_EQ(move(1, 10000, 2).detail, 2);
    rig_pass(5 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 0);
}

void turntable_tests(void)
{
    RUN(the_turntable_goes_to_absolute_positions_both_ways);
    RUN(a_move_out_of_range_is_refused);
}
