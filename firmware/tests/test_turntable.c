// The turntable.

#include "rig.h"
#include "check.h"

#define LEAD (TURNTABLE_LEAD_MS * MS)
#define LAG (TURNTABLE_LAG_MS * MS)

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
    rig_pass(30 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 200);
    EXPECT_EQ(rig_rise(PIN_STEP, 199) - rig_rise(PIN_STEP, 0), 199 * 10000);
    event_turntable_done_t done;
    event_turntable_done_unpack(&done, rig_take(EVENT_TURNTABLE_DONE)->payload);
    EXPECT_EQ(done.position, 200);
    EXPECT_EQ(native_pin(PIN_ENABLE), 0);
    rig_pass(LAG);
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
    EXPECT_EQ(move(-50, 20000, 1).position, 200);
    rig_pass(60 * MS + LAG);
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

static void an_interlock_that_opens_takes_the_power_of_one_that_is_held(void)
{
    for (uint8_t hold = 0; hold < 2U; hold++) {
        rig_start();
        EXPECT_EQ(move(20, 10000, hold).status, STATUS_OK);
        rig_pass(10 * MS + LAG);
        EXPECT_EQ(native_pin(PIN_ENABLE), 1U - hold);
        native_input(native_tick(), PIN_INTERLOCK, 1);
        rig_pass(1 * MS);
        EXPECT_EQ(native_pin(PIN_ENABLE), 1);
        EXPECT_EQ(rig_status().fault, (hold != 0U) ? FAULT_INTERLOCK : FAULT_NONE);  // of what has no power it is none
        EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), (hold != 0U) ? STATUS_UNSAFE : STATUS_OK);
        native_input(native_tick(), PIN_INTERLOCK, 0);
        rig_pass(1 * MS);
        EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
        native_input(native_tick(), PIN_INTERLOCK, 1);
        rig_pass(1 * MS);
        EXPECT_EQ(rig_status().fault, FAULT_NONE);  // it is held no more
    }
}

static void configure(const uint8_t switches)
{
    uint8_t payload[COMMAND_TURNTABLE_LENGTH];
    command_turntable_pack(
        &(command_turntable_t){
            .lowest = -20000, .highest = 20000, .acceleration = 40000, .start_period = 200000, .switches = switches},
        payload);
    EXPECT_EQ(rig_status_of(COMMAND_TURNTABLE, payload), STATUS_OK);
    rig_forget();
}

static event_turntable_stopped_t take_stopped(void)
{
    event_turntable_stopped_t stopped = {.cause = 0};
    const got_t* const got = rig_take(EVENT_TURNTABLE_STOPPED);
    EXPECT(got != NULL);
    if (got != NULL) {
        event_turntable_stopped_unpack(&stopped, got->payload);
    }
    return stopped;
}

static void pass_alive(const uint64_t ticks)
{
    for (uint64_t passed = 0; passed < ticks; passed += 20 * MS) {
        rig_send(COMMAND_PING, (uint8_t)(passed / MS), NULL);
        rig_pass(20 * MS);
    }
}

static void a_ramp_is_monotone_and_never_faster_than_asked(void)
{
    rig_start();
    configure(0);
    EXPECT_EQ(move(3000, 12000, 0).status, STATUS_OK);
    pass_alive(800 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 3000);
    EXPECT_EQ(rig_count(EVENT_TURNTABLE_DONE), 1);
    EXPECT_EQ(rig_count(EVENT_TURNTABLE_STOPPED), 0);
    uint64_t before = 200000;
    uint64_t at = rig_rise(PIN_STEP, 0);
    for (size_t step = 1; step < 3000U; step++) {
        const uint64_t next = rig_rise(PIN_STEP, step);
        const uint64_t gap = next - at;
        EXPECT(gap >= 12000U);
        EXPECT((step < 1400U) ? gap <= before : (step > 1600U) ? gap >= before : gap == 12000U);
        before = gap;
        at = next;
    }
}

// Nothing stopped it: not disarming, not the interlock, not a fault.
static void it_brakes_when_told_and_ends_at_once_when_it_must(void)
{
    rig_start();
    configure(TURNTABLE_END_LOW);
    native_input(native_tick(), PIN_END_LOW, 0);
    EXPECT_EQ(move(15000, 12000, 0).status, STATUS_OK);
    pass_alive(200 * MS);
    const size_t before = rig_rises(PIN_STEP);
    EXPECT_EQ(rig_status_of(COMMAND_TURNTABLE_STOP, NULL), STATUS_OK);
    pass_alive(400 * MS);
    event_turntable_stopped_t stopped = take_stopped();
    EXPECT_EQ(stopped.position, rig_rises(PIN_STEP));
    EXPECT(rig_rises(PIN_STEP) - before > 700U);  // 8333^2 / 80000
    EXPECT(rig_rises(PIN_STEP) - before < 900U);
    EXPECT_EQ(stopped.cause, STOP_CAUSE_STOPPED);
    EXPECT_EQ(stopped.lost, 0);

    const int32_t stood = stopped.position;
    EXPECT_EQ(move(-15000, 12000, 0).status, STATUS_OK);
    pass_alive(40 * MS);
    native_input(native_tick() + 77, PIN_END_LOW, 1);
    native_input(native_tick() + 99, PIN_END_LOW, 0);
    pass_alive(400 * MS);
    stopped = take_stopped();
    EXPECT_EQ(stopped.cause, STOP_CAUSE_END_LOW);
    EXPECT_EQ(stopped.position, 2 * stood - (int32_t)rig_rises(PIN_STEP));

    rig_forget();
    EXPECT_EQ(move(-15000, 12000, 1).status, STATUS_OK);
    pass_alive(100 * MS);
    const uint64_t opens = native_tick() + 4321;
    native_input(opens, PIN_INTERLOCK, 1);
    rig_pass(20 * MS);
    EXPECT(rig_rise(PIN_STEP, rig_rises(PIN_STEP) - 1U) < opens + 200 * US);
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
    const int32_t left_at = stopped.position;
    stopped = take_stopped();
    EXPECT_EQ(stopped.cause, STOP_CAUSE_FAULT);
    EXPECT_EQ(stopped.lost, 1);
    EXPECT_EQ(stopped.position, left_at - (int32_t)rig_rises(PIN_STEP));
    EXPECT(rig_status().state & STATE_TURNTABLE_LOST);
    EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
    EXPECT_EQ(move(0, 12000, 0).status, STATUS_UNSAFE);
}

static void limits_hold_from_wherever_it_stands(void)
{
    rig_start();
    const int32_t far = (int32_t)TURNTABLE_POSITION_MAX_STEPS;
    EXPECT_EQ(move(1431655766, 10000, 0).status, STATUS_OUT_OF_RANGE);
    EXPECT_EQ(move(-far - 1, 10000, 0).status, STATUS_OUT_OF_RANGE);
    EXPECT_EQ(move(far, 10000, 0).status, STATUS_OK);
    uint8_t payload[COMMAND_TURNTABLE_LENGTH];
    command_turntable_pack(&(command_turntable_t){.highest = 60}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_TURNTABLE, payload), STATUS_BAD_STATE);
    rig_arm(0);
    rig_pass(2 * MS);
    EXPECT_EQ(take_stopped().cause, STOP_CAUSE_STOPPED);
    EXPECT_EQ(rig_status_of(COMMAND_TURNTABLE, payload), STATUS_OK);
    EXPECT_EQ(move(61, 10000, 0).status, STATUS_OUT_OF_RANGE);
    EXPECT_EQ(move(-1, 10000, 0).status, STATUS_OUT_OF_RANGE);
    EXPECT_EQ(move(60, 10000, 0).status, STATUS_OK);
}

static void stop_now(void)
{
    rig_send(COMMAND_TURNTABLE_STOP, 0x77, NULL);
}

static void a_switch_that_is_reached_lets_it_only_back(void)
{
    rig_start();
    configure(TURNTABLE_END_LOW | TURNTABLE_END_HIGH);
    native_input(native_tick(), PIN_END_LOW, 0);
    reply_move_t refused = move(10, 300000, 0);
    EXPECT_EQ(refused.status, STATUS_UNSAFE);
    EXPECT_EQ(refused.detail, STOP_CAUSE_END_HIGH);
    native_input(native_tick(), PIN_END_LOW, 1);
    native_input(native_tick(), PIN_END_HIGH, 0);
    refused = move(-10, 300000, 0);
    EXPECT_EQ(refused.status, STATUS_UNSAFE);
    EXPECT_EQ(refused.detail, STOP_CAUSE_END_LOW);
    rig_pass(10 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 0);
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
    EXPECT_EQ(move(10, 300000, 0).status, STATUS_OK);
    pass_alive(60 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 10);
}

static void slower_than_the_ramps_start_there_is_no_ramp(void)
{
    rig_start();
    configure(0);
    EXPECT_EQ(move(20, 300000, 0).status, STATUS_OK);
    pass_alive(80 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 20);
    for (size_t step = 1; step < 20U; step++) {
        EXPECT_EQ(rig_rise(PIN_STEP, step) - rig_rise(PIN_STEP, step - 1U), 300000);
    }
}

static void told_to_stop_before_its_first_step_it_makes_none(void)
{
    rig_start();
    configure(0);
    uint8_t payload[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = 1000, .period = 12000}, payload);
    rig_send(COMMAND_MOVE, 0x76, payload);
    stop_now();
    pass_alive(20 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 0);
    const event_turntable_stopped_t stopped = take_stopped();
    EXPECT_EQ(stopped.position, 0);
    EXPECT_EQ(stopped.cause, STOP_CAUSE_STOPPED);
    EXPECT_EQ(rig_status().state & STATE_TURNTABLE_MOVING, 0);
}

// A second reason neither takes the place of the first nor lets it brake any longer.
static void the_first_reason_is_told_and_the_nearer_end_counts(void)
{
    for (int again = 0; again < 3; again++) {
        rig_start();
        native_input(native_tick(), PIN_END_HIGH, 0);
        rig_pass(MS);
        configure(TURNTABLE_END_HIGH | ((again == 2) ? TURNTABLE_END_HARD : 0U));
        EXPECT_EQ(move(15000, 12000, 0).status, STATUS_OK);
        pass_alive(200 * MS);
        const size_t before = rig_rises(PIN_STEP);
        stop_now();
        pass_alive(60 * MS);
        if (again == 0) {
            stop_now();
        } else {
            native_input(native_tick(), PIN_END_HIGH, 1);
        }
        const size_t then = rig_rises(PIN_STEP);
        pass_alive(400 * MS);
        const event_turntable_stopped_t stopped = take_stopped();
        EXPECT_EQ(stopped.cause, STOP_CAUSE_STOPPED);
        EXPECT_EQ(stopped.position, rig_rises(PIN_STEP));
        EXPECT_EQ(stopped.lost, (again == 2) ? 1 : 0);
        if (again == 2) {
            EXPECT(rig_rises(PIN_STEP) - then <= 3U);
        } else {
            EXPECT(rig_rises(PIN_STEP) - before > 700U);
            EXPECT(rig_rises(PIN_STEP) - before < 900U);
        }
    }
}

static void a_hard_switch_ends_it_within_a_few_steps_either_way(void)
{
    for (int way = 0; way < 2; way++) {
        const uint8_t pin = (way == 0) ? PIN_END_LOW : PIN_END_HIGH;
        rig_start();
        native_input(native_tick(), PIN_END_LOW, 0);
        native_input(native_tick(), PIN_END_HIGH, 0);
        rig_pass(MS);
        configure(TURNTABLE_END_LOW | TURNTABLE_END_HIGH | TURNTABLE_END_HARD);
        EXPECT_EQ(move((way == 0) ? -15000 : 15000, 12000, 0).status, STATUS_OK);
        pass_alive(200 * MS);
        const size_t before = rig_rises(PIN_STEP);
        native_input(native_tick(), pin, 1);
        pass_alive(40 * MS);
        EXPECT(rig_rises(PIN_STEP) - before <= 3U);
        const event_turntable_stopped_t stopped = take_stopped();
        EXPECT_EQ(stopped.cause, (way == 0) ? STOP_CAUSE_END_LOW : STOP_CAUSE_END_HIGH);
        EXPECT_EQ(stopped.lost, 1);
    }
}

// Steps are lost by ending faster than the motor can start, and stay lost until somebody says where it stands.
static void steps_count_as_lost_only_after_an_end_at_speed(void)
{
    rig_start();
    configure(0);
    const uint64_t apart[] = {300000, 12000, 300000};
    for (size_t i = 0; i < sizeof apart / sizeof apart[0]; i++) {
        EXPECT_EQ(move((i == 1U) ? 15000 : -15000, (uint32_t)apart[i], 0).status, STATUS_OK);
        pass_alive(100 * MS);
        native_input(native_tick(), PIN_INTERLOCK, 1);
        pass_alive(20 * MS);
        const event_turntable_stopped_t stopped = take_stopped();
        EXPECT_EQ(stopped.cause, STOP_CAUSE_FAULT);
        EXPECT_EQ(stopped.lost, (i == 0U) ? 0 : 1);
        native_input(native_tick(), PIN_INTERLOCK, 0);
        rig_pass(MS);
        EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    }
    configure(0);
    EXPECT_EQ(rig_status().state & STATE_TURNTABLE_LOST, 0);
}

static void a_host_of_level_1_is_told_no_flag_it_does_not_know(void)
{
    rig_start();
    configure(0);
    EXPECT_EQ(move(15000, 12000, 0).status, STATUS_OK);
    pass_alive(100 * MS);
    native_input(native_tick(), PIN_INTERLOCK, 1);
    pass_alive(20 * MS);
    EXPECT_EQ(rig_status().state & STATE_TURNTABLE_LOST, STATE_TURNTABLE_LOST);
    uint8_t payload[COMMAND_INFO_LENGTH];
    command_info_pack(&(command_info_t){.level = 1}, payload);
    rig_command(COMMAND_INFO, payload);
    EXPECT_EQ(rig_status().state, STATE_INTERLOCK_OPEN | STATE_SCHEMA_OK);
    command_info_pack(&(command_info_t){.level = 2}, payload);
    rig_command(COMMAND_INFO, payload);
    EXPECT_EQ(rig_status().state, STATE_INTERLOCK_OPEN | STATE_SCHEMA_OK | STATE_TURNTABLE_LOST);
}

// The loop stood still, wherever it was, while the last steps were made: what came meanwhile finds the move over.
static void what_comes_after_the_last_step_changes_nothing(void)
{
    for (uint64_t after = 0; after < 100 * US; after += 9 * US) {
        for (int opens = 0; opens < 2; opens++) {
            rig_start();
            configure(0);
            EXPECT_EQ(move(5, 300000, 0).status, STATUS_OK);
            rig_pass(after);
            native_stall_cpu(40 * MS);
            rig_pass(20 * MS);
            if (opens == 0) {
                stop_now();
            } else {
                native_input(native_tick(), PIN_INTERLOCK, 1);
            }
            pass_alive(40 * MS);
            EXPECT_EQ(rig_rises(PIN_STEP), 5);
            EXPECT_EQ(rig_count(EVENT_TURNTABLE_STOPPED), 0);
            event_turntable_done_t done;
            event_turntable_done_unpack(&done, rig_take(EVENT_TURNTABLE_DONE)->payload);
            EXPECT_EQ(done.position, 5);
            EXPECT_EQ(rig_status().state & STATE_TURNTABLE_LOST, 0);
        }
    }
}

static void an_open_interlock_refuses_a_move_though_nothing_has_tripped(void)
{
    rig_start();
    native_input(native_tick(), PIN_INTERLOCK, 1);
    EXPECT_EQ(move(10, 10000, 0).status, STATUS_UNSAFE);
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
    EXPECT_EQ(rig_rises(PIN_STEP), 0);
    native_input(native_tick(), PIN_INTERLOCK, 0);
    EXPECT_EQ(move(10, 10000, 0).status, STATUS_OK);
}

static uint64_t last_step(void)
{
    return rig_fall(PIN_STEP, rig_rises(PIN_STEP) - 1U);
}

static void the_driver_has_time_to_wake_before_the_first_step(void)
{
    rig_start();
    rig_forget();
    EXPECT_EQ(move(5, 20000, 1).status, STATUS_OK);
    rig_pass(20 * MS);
    EXPECT(rig_rise(PIN_STEP, 0) - rig_fall(PIN_ENABLE, 0) >= LEAD);
    EXPECT(rig_rise(PIN_STEP, 0) - rig_fall(PIN_ENABLE, 0) < LEAD + 10 * US);
    EXPECT_EQ(rig_rise(PIN_STEP, 1) - rig_rise(PIN_STEP, 0), 20000);
    rig_pass(30000 * MS);  // so long that a tick is no measure of it
    rig_forget();
    EXPECT_EQ(move(-5, 20000, 0).status, STATUS_OK);  // powered already: half a period after its direction
    rig_pass(20 * MS);
    EXPECT(rig_rise(PIN_STEP, 0) - rig_fall(PIN_DIRECTION, 0) >= 10000);
    EXPECT(rig_rise(PIN_STEP, 0) - rig_fall(PIN_DIRECTION, 0) < 10000 + 10 * US);
    rig_pass(LAG);
    rig_forget();
    EXPECT_EQ(move(-5, 20000, 1).status, STATUS_OK);  // no step, but power
    EXPECT_EQ(move(0, 20000, 0).status, STATUS_OK);   // what is left of the lead
    rig_pass(20 * MS);
    EXPECT(rig_rise(PIN_STEP, 0) - rig_fall(PIN_ENABLE, 0) >= LEAD);
    EXPECT(rig_rise(PIN_STEP, 0) - rig_fall(PIN_ENABLE, 0) < LEAD + 10 * US);
}

static void the_rotor_comes_to_rest_before_its_power_goes(void)
{
    for (int ends = 0; ends < 4; ends++) {
        rig_start();
        native_input(native_tick(), PIN_END_HIGH, 0);
        rig_pass(MS);
        configure(TURNTABLE_END_HIGH | ((ends == 3) ? TURNTABLE_END_HARD : 0U));
        EXPECT_EQ(move((ends == 0) ? 100 : 2000, 50000, 0).status, STATUS_OK);
        pass_alive(100 * MS);
        if (ends == 1) {
            stop_now();
        } else if (ends > 1) {
            native_input(native_tick(), PIN_END_HIGH, 1);
        }
        pass_alive(200 * MS);
        EXPECT_EQ(rig_count(EVENT_TURNTABLE_DONE), 1);
        EXPECT(rig_rise(PIN_ENABLE, 0) - last_step() >= LAG);
        EXPECT(rig_rise(PIN_ENABLE, 0) - last_step() < LAG + 4 * ROUND);
    }
    rig_start();
    EXPECT_EQ(move(0, 10000, 0).status, STATUS_OK);
    rig_forget();
    EXPECT_EQ(move(10, 10000, 0).status, STATUS_OK);
    rig_pass(40 * MS);
    EXPECT_EQ(move(0, 10000, 0).status, STATUS_OK);  // meanwhile: at once, and the lag begins anew
    rig_pass(40 * MS);
    EXPECT_EQ(rig_rises(PIN_STEP), 20);
    EXPECT(rig_rise(PIN_STEP, 10) - rig_fall(PIN_DIRECTION, 0) < 5000 + 10 * US);
    EXPECT_EQ(rig_rises(PIN_ENABLE), 0);
    rig_pass(20 * MS);
    EXPECT(rig_rise(PIN_ENABLE, 0) - last_step() >= LAG);
    rig_forget();
    EXPECT_EQ(move(0, 10000, 0).status, STATUS_OK);  // already there: no power for nothing
    EXPECT_EQ(rig_fall(PIN_ENABLE, 0), 0);
    EXPECT_EQ(move(10, 10000, 0).status, STATUS_OK);
    rig_pass(20 * MS);
    const uint64_t opens = native_tick();
    native_input(opens, PIN_INTERLOCK, 1);
    rig_pass(MS);
    EXPECT(rig_rise(PIN_ENABLE, 0) - opens < 100 * US);  // at once
    EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
}

void turntable_tests(void)
{
    RUN(the_driver_has_time_to_wake_before_the_first_step);
    RUN(the_rotor_comes_to_rest_before_its_power_goes);
    RUN(the_turntable_goes_to_absolute_positions_both_ways);
    RUN(a_move_out_of_range_is_refused);
    RUN(a_ramp_is_monotone_and_never_faster_than_asked);
    RUN(it_brakes_when_told_and_ends_at_once_when_it_must);
    RUN(limits_hold_from_wherever_it_stands);
    RUN(a_switch_that_is_reached_lets_it_only_back);
    RUN(slower_than_the_ramps_start_there_is_no_ramp);
    RUN(told_to_stop_before_its_first_step_it_makes_none);
    RUN(the_first_reason_is_told_and_the_nearer_end_counts);
    RUN(a_hard_switch_ends_it_within_a_few_steps_either_way);
    RUN(steps_count_as_lost_only_after_an_end_at_speed);
    RUN(a_host_of_level_1_is_told_no_flag_it_does_not_know);
    RUN(what_comes_after_the_last_step_changes_nothing);
    RUN(an_interlock_that_opens_takes_the_power_of_one_that_is_held);
    RUN(an_open_interlock_refuses_a_move_though_nothing_has_tripped);
}
