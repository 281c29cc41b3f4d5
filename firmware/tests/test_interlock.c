// The interlock's second, antivalent input: what it takes away, and when the two are a fault of their own.

#include "../board.h"
#include "rig.h"
#include "check.h"

static const uint8_t second = INTERLOCK_ANTIVALENT;

static void close_both(void)
{
    rig_start();
    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 1);
    EXPECT_EQ(rig_status_of(COMMAND_INTERLOCK, &second), STATUS_OK);
    rig_forget();
}

static uint8_t inputs_now(void)
{
    reply_hardware_t reply;
    reply_hardware_unpack(&reply, rig_command(COMMAND_HARDWARE, NULL));
    return reply.interlock;
}

static void either_input_of_the_interlock_cuts_the_microwave_without_the_core(void)
{
    static const struct {
        uint8_t pin, unsafe;
    } inputs[] = {{PIN_INTERLOCK, 1}, {PIN_INTERLOCK_ANTIVALENT, 0}};
    for (size_t i = 0; i < 2U; i++) {
        close_both();
        rig_arm(ARM_MICROWAVE);
        EXPECT_EQ(rig_start_train(65535), STATUS_OK);
        native_stall_cpu(10 * MS);
        const uint64_t opens = native_tick() + 12345;
        native_input(opens, inputs[i].pin, inputs[i].unsafe);
        native_run_until(opens + 50);
        EXPECT_EQ(native_pin(PIN_MICROWAVE), 0);
        native_input(opens + MS, inputs[i].pin, 1U - inputs[i].unsafe);
        rig_pass(PERIOD);
        EXPECT_EQ(rig_take_fault().fault, FAULT_INTERLOCK);
        EXPECT_EQ(inputs_now(), INTERLOCK_ANTIVALENT);
        EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    }
}

static void inputs_that_contradict_each_other_for_long_latch_a_fault_of_their_own(void)
{
    close_both();
    native_input(native_tick(), PIN_INTERLOCK, 1);
    rig_pass((INTERLOCK_DISAGREE_MS - 1U) * MS);
    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 0);  // a relay that changes over
    rig_pass(20 * MS);
    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 1);
    rig_pass((INTERLOCK_DISAGREE_MS - 1U) * MS);
    native_input(native_tick(), PIN_INTERLOCK, 0);
    rig_pass(20 * MS);
    EXPECT_EQ(rig_count(EVENT_FAULT), 0);

    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 0);  // a wire that broke
    rig_pass((INTERLOCK_DISAGREE_MS + 1U) * MS);
    const event_fault_t fault = rig_take_fault();
    EXPECT_EQ(fault.fault, FAULT_INTERLOCK_DISAGREES);
    EXPECT_EQ(fault.detail, INTERLOCK_ANTIVALENT | INTERLOCK_ANTIVALENT_OPEN);
    EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK_DISAGREES);
    EXPECT(rig_status().state & STATE_INTERLOCK_OPEN);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_MICROWAVE}), STATUS_UNSAFE);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_UNSAFE);
    native_input(native_tick(), PIN_INTERLOCK, 1);  // agreed, but on open
    rig_pass(MS);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_UNSAFE);
    native_input(native_tick(), PIN_INTERLOCK, 0);
    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 1);
    rig_pass(MS);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    rig_pass(20 * MS);
    EXPECT_EQ(rig_count(EVENT_FAULT), 0);
}

// In whatever part of a round the main loop stood still: it took the tick at which that round began for the one at
// which they came to disagree, and a relay that changed over was a fault.
static void a_main_loop_held_up_does_not_make_a_contradiction_longer(void)
{
    for (uint64_t phase = 0; phase < 110U * US; phase += 97U) {
        close_both();
        rig_pass(phase);
        native_stall_cpu(3 * MS);
        const uint64_t opens = native_tick() + 3 * MS - 10U;
        native_input(opens, PIN_INTERLOCK_ANTIVALENT, 0);
        native_input(opens + (INTERLOCK_DISAGREE_MS * MS) - 50U * US, PIN_INTERLOCK_ANTIVALENT, 1);
        rig_pass(20 * MS);
        EXPECT_EQ(rig_count(EVENT_FAULT), 0);
    }
}

static void a_contradiction_behind_another_fault_is_told_and_holds_up_clear(void)
{
    close_both();
    rig_arm(ARM_MICROWAVE);
    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 0);
    rig_pass((INTERLOCK_DISAGREE_MS + 1U) * MS);
    EXPECT_EQ(rig_take_fault().fault, FAULT_INTERLOCK);
    EXPECT_EQ(rig_take_fault().fault, FAULT_INTERLOCK_DISAGREES);
    EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);  // the first cause stays
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_UNSAFE);
    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 1);
    rig_pass(MS);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);

    rig_power_on();
    close_both();
    rig_arm(ARM_MICROWAVE);
    rig_pass(HOST_TIMEOUT_DEFAULT_MS * MS + 2 * MS);
    EXPECT_EQ(rig_take_fault().fault, FAULT_HOST_TIMEOUT);
    native_input(native_tick(), PIN_INTERLOCK, 1);
    rig_pass((INTERLOCK_DISAGREE_MS + 1U) * MS);
    EXPECT_EQ(rig_take_fault().fault, FAULT_INTERLOCK_DISAGREES);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_UNSAFE);
    EXPECT_EQ(rig_status_of(COMMAND_INTERLOCK, (const uint8_t[]){0}), STATUS_OK);  // somebody takes it out of use
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
}

static void a_host_of_an_earlier_level_is_told_of_an_open_interlock(void)
{
    close_both();
    rig_command(COMMAND_INFO, (const uint8_t[]){2});
    native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 0);
    rig_pass((INTERLOCK_DISAGREE_MS + 1U) * MS);
    const event_fault_t fault = rig_take_fault();
    EXPECT_EQ(fault.fault, FAULT_INTERLOCK);
    EXPECT_EQ(fault.detail, FAULT_INTERLOCK_DISAGREES);
    EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
}

static void the_interlocks_inputs_are_chosen_at_rest_by_who_commands(void)
{
    rig_start();
    rig_pass(20 * MS);  // GP13 is low, and nobody looks
    EXPECT_EQ(inputs_now(), 0);
    EXPECT_EQ(rig_count(EVENT_FAULT), 0);
    EXPECT_EQ(rig_status_of(COMMAND_INTERLOCK, (const uint8_t[]){2}), STATUS_OUT_OF_RANGE);
    rig_arm(ARM_MICROWAVE);
    EXPECT_EQ(rig_status_of(COMMAND_INTERLOCK, &second), STATUS_BAD_STATE);
    EXPECT_EQ(inputs_now(), 0);
    rig_arm(0);
    uint8_t identify[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = 1}, identify);
    rig_command(COMMAND_IDENTIFY, identify);
    EXPECT_EQ(rig_status_of(COMMAND_INTERLOCK, &second), STATUS_SCHEMA);
    EXPECT_EQ(inputs_now(), 0);
}

// At every moment of the round that carries the command out: it forgot an opening that had come since the round began,
// and a motor that is held kept its power.
static void an_opening_beside_the_command_takes_a_held_motors_power_however_short(void)
{
    uint8_t move[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = 3, .period = 20000, .hold = 1}, move);
    for (uint64_t phase = 0; phase < 24U * US; phase += 23U) {
        rig_start();
        native_input(native_tick(), PIN_INTERLOCK_ANTIVALENT, 1);
        EXPECT_EQ(rig_status_of(COMMAND_MOVE, move), STATUS_OK);
        rig_pass(20 * MS);
        EXPECT_EQ(native_pin(PIN_ENABLE), 0);
        const uint64_t round = native_tick() + 200U * US;
        native_stall_cpu(200U * US);
        native_input(round + phase, PIN_INTERLOCK, 1);
        native_input(round + phase + 10U, PIN_INTERLOCK, 0);
        rig_send(COMMAND_INTERLOCK, 0x81, &second);
        rig_pass(MS);
        EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
        EXPECT_EQ(native_pin(PIN_ENABLE), 1);
    }
}

void interlock_tests(void)
{
    RUN(an_opening_beside_the_command_takes_a_held_motors_power_however_short);
    RUN(either_input_of_the_interlock_cuts_the_microwave_without_the_core);
    RUN(inputs_that_contradict_each_other_for_long_latch_a_fault_of_their_own);
    RUN(a_main_loop_held_up_does_not_make_a_contradiction_longer);
    RUN(a_contradiction_behind_another_fault_is_told_and_holds_up_clear);
    RUN(a_host_of_an_earlier_level_is_told_of_an_open_interlock);
    RUN(the_interlocks_inputs_are_chosen_at_rest_by_who_commands);
}
