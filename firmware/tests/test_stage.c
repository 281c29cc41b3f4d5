// The rotary stage.

#include "bench.h"
#include "check.h"

static reply_move_t move(const int32_t position, const uint32_t period, const uint8_t hold)
{
    uint8_t payload[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = position, .period = period, .hold = hold}, payload);
    reply_move_t reply;
    reply_move_unpack(&reply, bench_command(COMMAND_MOVE, payload));
    return reply;
}

static void the_stage_goes_to_absolute_positions_both_ways(void)
{
    bench_start();
    EXPECT_EQ(move(200, 10000, 0).status, STATUS_OK);
    EXPECT_EQ(native_pin(PIN_ENABLE), 0);
    EXPECT_EQ(native_pin(PIN_DIRECTION), 1);
    EXPECT(bench_status().state & STATE_STAGE_MOVING);
    EXPECT_EQ(move(0, 10000, 0).status, STATUS_BAD_STATE);
    bench_pass(20 * MS);
    EXPECT_EQ(bench_rises(PIN_STEP), 200);
    EXPECT_EQ(bench_rise(PIN_STEP, 199) - bench_rise(PIN_STEP, 0), 199 * 10000);
    event_stage_done_t done;
    event_stage_done_unpack(&done, bench_take(EVENT_STAGE_DONE)->payload);
    EXPECT_EQ(done.position, 200);
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
    EXPECT_EQ(move(-50, 20000, 1).position, 200);
    bench_pass(60 * MS);
    EXPECT_EQ(bench_status().stage, -50);
    EXPECT_EQ(native_pin(PIN_DIRECTION), 0);
    EXPECT_EQ(native_pin(PIN_ENABLE), 0);  // held
    EXPECT_EQ(bench_rises(PIN_STEP), 450);
    bench_forget();
    EXPECT_EQ(move(-50, 20000, 0).status, STATUS_OK);
    EXPECT_EQ(bench_count(EVENT_STAGE_DONE), 1);  // already there
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
}

static void a_move_out_of_range_is_refused(void)
{
    bench_start();
    EXPECT_EQ(move(1, 9999, 0).detail, 1);
    EXPECT_EQ(move(1, 10000, 2).detail, 2);
    bench_pass(5 * MS);
    EXPECT_EQ(bench_rises(PIN_STEP), 0);
}

void stage_tests(void)
{
    RUN(the_stage_goes_to_absolute_positions_both_ways);
    RUN(a_move_out_of_range_is_refused);
}
