// What must go dark, how fast, and that it stays dark until somebody clears it.

#include <string.h>

#include "../board.h"
#include "rig.h"
#include "check.h"

static const uint8_t both = ARM_LAMPS | ARM_MICROWAVE;

static void start_armed(const uint8_t outputs)
{
    rig_start();
    command_stage_t config = rig_config(1, 0);
    config.host_timeout = 200;
    rig_configure(&config);
    rig_arm(outputs);
    rig_forget();
}

static void an_opening_interlock_darkens_the_microwave_within_one_chip_without_the_core(void)
{
    for (uint64_t phase = 0; phase < 2500; phase += 37) {
        start_armed(both);
        EXPECT_EQ(rig_start_train(10000), STATUS_OK);
        rig_edge(5 * MS);  // the LED shines
        EXPECT_EQ(native_pin(PIN_LED), 1);
        native_stall_cpu(10 * MS);  // the core would be far too late
        const uint64_t opens = native_tick() + phase;
        native_input(opens, PIN_INTERLOCK, 1);
        native_run_until(opens + 50);  // one chip
        EXPECT_EQ(native_pin(PIN_MICROWAVE), 0);
        EXPECT_EQ(native_pin(PIN_TRIGGER), 0);
        native_input(opens + 1 * MS, PIN_INTERLOCK, 0);  // closing it again starts nothing
        rig_pass(PERIOD);
        EXPECT_EQ(native_pin(PIN_LED), 0);
        rig_look();
        native_transition_t late[16];
        EXPECT_EQ(native_pins(late, 16), 0);
        EXPECT(rig_fall(PIN_MICROWAVE, rig_rises(PIN_MICROWAVE) - 1U) <= opens + 50);
        EXPECT_EQ(rig_take_fault().fault, FAULT_INTERLOCK);
        event_burst_done_t done;
        event_burst_done_unpack(&done, rig_take(EVENT_BURST_DONE)->payload);
        EXPECT_EQ(done.fault, FAULT_INTERLOCK);
        EXPECT(done.done > 0U);
        EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
        EXPECT_EQ(rig_status().state & (STATE_LAMPS_ARMED | STATE_MICROWAVE_ARMED | STATE_BURST_RUNNING), 0);
    }
}

static void an_open_interlock_refuses_the_microwave_but_not_the_lamps(void)
{
    rig_start();
    native_input(native_tick(), PIN_INTERLOCK, 1);
    const command_stage_t config = rig_config(1, 0);
    rig_configure(&config);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, &both), STATUS_UNSAFE);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_MICROWAVE}), STATUS_UNSAFE);
    EXPECT_EQ(rig_status().state & (STATE_LAMPS_ARMED | STATE_MICROWAVE_ARMED), 0);  // refused as a whole
    EXPECT(rig_status().state & STATE_INTERLOCK_OPEN);
    rig_arm(ARM_LAMPS);  // a head without microwave has nothing to close
    EXPECT(rig_status().state & STATE_LAMPS_ARMED);
    EXPECT_EQ(rig_count(EVENT_FAULT), 0);
}

static void an_interlock_fault_is_cleared_only_once_it_is_closed(void)
{
    start_armed(both);
    EXPECT_EQ(rig_start_train(65535), STATUS_OK);
    native_input(native_tick(), PIN_INTERLOCK, 1);
    rig_pass(1 * MS);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_UNSAFE);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_UNSAFE);
    EXPECT_EQ(rig_start_train(1), STATUS_UNSAFE);
    native_input(native_tick(), PIN_INTERLOCK, 0);
    rig_pass(1 * MS);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_UNSAFE);  // latched
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    EXPECT_EQ(rig_status().state & (STATE_LAMPS_ARMED | STATE_MICROWAVE_ARMED), 0);  // nothing is armed by it
    rig_arm(both);
    rig_forget();
    EXPECT_EQ(rig_start_train(1), STATUS_OK);
    rig_pass(1 * MS);
    EXPECT_EQ(rig_take(EVENT_BURST_DONE)->payload[EVENT_BURST_DONE_LENGTH - 1U], FAULT_NONE);
}

static void an_interlock_that_opens_while_nothing_is_armed_is_no_fault(void)
{
    rig_start();
    native_input(native_tick(), PIN_INTERLOCK, 1);
    native_input(native_tick() + 1 * MS, PIN_INTERLOCK, 0);
    rig_pass(2 * MS);
    rig_arm(ARM_MICROWAVE);
    rig_pass(10 * MS);
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
}

static void a_silent_host_disarms_and_latches(void)
{
    const uint16_t timeouts[] = {200, 0};  // 0 = the default of 500
    for (size_t i = 0; i < 2U; i++) {
        rig_start();
        command_stage_t config = rig_config(1, 0);
        config.host_timeout = timeouts[i];
        rig_configure(&config);
        rig_arm(both);
        EXPECT_EQ(rig_start_train(65535), STATUS_OK);
        const uint64_t limit = ((timeouts[i] == 0) ? 500 : timeouts[i]) * MS;
        const uint64_t from = native_tick();
        rig_forget();
        while (native_tick() < from + limit - 2 * MS) {
            rig_pulse();  // edges are not the host
            rig_pass(990 * US);
        }
        EXPECT_EQ(rig_count(EVENT_FAULT), 0);
        rig_pass(3 * MS);
        const event_fault_t fault = rig_take_fault();
        EXPECT_EQ(fault.fault, FAULT_HOST_TIMEOUT);
        EXPECT(fault.detail > limit);
        EXPECT_EQ(native_pin(PIN_LED) + native_pin(PIN_MICROWAVE), 0);
        rig_forget();
        rig_edge(PERIOD);
        rig_edge(PERIOD);
        EXPECT_EQ(rig_rises(PIN_LED) + rig_rises(PIN_MICROWAVE), 0);
        EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_UNSAFE);
        EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
        rig_arm(ARM_LAMPS);
    }
}

static void any_valid_frame_keeps_the_host_alive_and_garbage_does_not(void)
{
    start_armed(ARM_LAMPS);
    for (uint8_t i = 0; i < 100; i++) {
        rig_send(COMMAND_ARM, 3, (const uint8_t[]){ARM_LAMPS});  // a repeat counts as well
        rig_pass(10 * MS);
    }
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
    for (int i = 0; i < 30; i++) {
        rig_raw((const uint8_t[]){3, 2, 7, 0}, 4);
        rig_pass(10 * MS);
    }
    EXPECT_EQ(rig_status().fault, FAULT_HOST_TIMEOUT);
}

static void a_silent_host_is_nothing_to_a_controller_at_rest(void)
{
    rig_start();
    rig_pass(60000 * MS);
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
    EXPECT_EQ(rig_count(EVENT_FAULT), 0);
}

static void the_watchdog_restarts_a_hung_controller_dark_and_latched(void)
{
    start_armed(both);
    EXPECT_EQ(rig_start_train(65535), STATUS_OK);
    rig_edge(5 * MS);
    EXPECT_EQ(native_pin(PIN_LED), 1);
    native_stall_cpu(10000 * MS);
    rig_pass(120 * MS);
    EXPECT_EQ(native_pin(PIN_LED) + native_pin(PIN_MICROWAVE), 0);
    rig_forget();
    rig_edge(PERIOD);
    EXPECT_EQ(rig_rises(PIN_LED) + rig_rises(PIN_MICROWAVE), 0);
    const reply_status_t status = rig_status();
    EXPECT_EQ(status.fault, FAULT_WATCHDOG);
    EXPECT_EQ(status.generation, 0);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
}

static void a_restart_by_the_watchdog_says_so(void)
{
    rig_start();
    native_stall_cpu(10000 * MS);
    rig_pass(120 * MS);
    const got_t* const booted = rig_take(EVENT_BOOTED);
    EXPECT_EQ(booted->boot, 2);
    EXPECT_EQ(booted->sequence, 0);
    EXPECT_EQ(booted->payload[0], BOOT_CAUSE_WATCHDOG);
    EXPECT_EQ(rig_take_fault().fault, FAULT_WATCHDOG);
}

static void an_output_the_board_refuses_latches_a_limit_fault(void)
{
    start_armed(ARM_LAMPS);
    native_refuse_next();
    rig_edge(PERIOD);  // the load after this edge is refused, which also ends the flash being timed
    EXPECT_EQ(rig_take_fault().fault, FAULT_LIMIT);
    EXPECT_EQ(rig_status().state & STATE_LAMPS_ARMED, 0);
    rig_edge(PERIOD);
    EXPECT_EQ(rig_rises(PIN_LED), 0);

    start_armed(both);
    native_refuse_next();
    EXPECT_EQ(rig_start_train(1), STATUS_DUTY);
    rig_pass(1 * MS);
    EXPECT_EQ(rig_status().fault, FAULT_LIMIT);
    EXPECT_EQ(rig_status().state & (STATE_LAMPS_ARMED | STATE_MICROWAVE_ARMED), 0);
}

// At any moment of the round that takes the command, too: it is refused, or it begins and is cut.
static void an_interlock_that_opens_while_a_train_is_asked_for_leaves_the_microwave_dark(void)
{
    size_t refused = 0;
    size_t begun = 0;
    for (uint64_t after = 150 * US; after < 350 * US; after += US / 2U) {
        start_armed(ARM_MICROWAVE);
        const uint64_t opens = native_tick() + after;
        native_input(opens, PIN_INTERLOCK, 1);
        const uint8_t status = rig_start_train(65535);
        EXPECT((status == STATUS_OK) || (status == STATUS_UNSAFE));
        begun += (status == STATUS_OK) ? 1U : 0U;
        refused += (status == STATUS_UNSAFE) ? 1U : 0U;
        EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
        EXPECT_EQ(rig_status().state & (STATE_MICROWAVE_ARMED | STATE_BURST_RUNNING), 0);
        EXPECT_EQ(native_pin(PIN_MICROWAVE), 0);
        const size_t rises = rig_rises(PIN_MICROWAVE);
        EXPECT((rises == 0U) || ((status == STATUS_OK) && (rig_rise(PIN_MICROWAVE, rises - 1U) < opens)));
    }
    EXPECT(refused > 10U);
    EXPECT(begun > 10U);
}

static void the_first_fault_stays_latched(void)
{
    start_armed(both);
    EXPECT_EQ(rig_start_train(65535), STATUS_OK);
    native_input(native_tick(), PIN_INTERLOCK, 1);
    rig_pass(300 * MS);
    EXPECT_EQ(rig_status().fault, FAULT_INTERLOCK);
}

// A train and a move at once: the cut train's end is found in the very round in which the move is still to be reported.
static uint64_t fall_silent(const uint64_t open_interlock)
{
    start_armed(ARM_MICROWAVE);
    uint8_t payload[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = 100000, .period = 100000}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_MOVE, payload), STATUS_OK);
    EXPECT_EQ(rig_start_train(60000), STATUS_OK);
    rig_forget();
    if (open_interlock != 0U) {
        native_input(native_boot_tick() + open_interlock, PIN_INTERLOCK, 1);
    }
    rig_pass(250 * MS);
    const size_t faults = rig_count(EVENT_FAULT);
    EXPECT_EQ(faults, 1);
    return rig_take_fault().tick;
}

static void a_fault_is_told_once_and_the_first_stays_with_a_train_and_a_move(void)
{
    const uint64_t silent = fall_silent(0U);
    EXPECT_EQ(rig_status().fault, FAULT_HOST_TIMEOUT);
    for (uint64_t before = 0; before < 11000U; before += 61U) {
        fall_silent(silent - before);
        const uint8_t fault = rig_status().fault;
        EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), (fault == FAULT_INTERLOCK) ? STATUS_UNSAFE : STATUS_OK);
        if (before >= 6000U) {
            EXPECT_EQ(fault, FAULT_INTERLOCK);  // opened a round before the host was given up
        }
    }
}

static void another_schema_takes_the_outputs_away(void)
{
    start_armed(both);
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = 1}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_IDENTIFY, payload), STATUS_SCHEMA);
    EXPECT_EQ(rig_status().state & (STATE_LAMPS_ARMED | STATE_MICROWAVE_ARMED), 0);
}

static void outputs_are_armed_one_by_one(void)
{
    start_armed(both);
    rig_arm(ARM_MICROWAVE);
    EXPECT_EQ(rig_status().state & (STATE_LAMPS_ARMED | STATE_MICROWAVE_ARMED), STATE_MICROWAVE_ARMED);
    rig_arm(ARM_LAMPS);
    EXPECT_EQ(rig_status().state & (STATE_LAMPS_ARMED | STATE_MICROWAVE_ARMED), STATE_LAMPS_ARMED);
    EXPECT_EQ(native_pin(PIN_STATUS), 1);
    rig_arm(0);
    EXPECT_EQ(native_pin(PIN_STATUS), 0);
}

static void a_main_loop_that_is_late_darkens_the_microwave_long_before_the_watchdog(void)
{
    start_armed(both);
    EXPECT_EQ(rig_start_train(10000), STATUS_OK);
    rig_pass(5 * MS);
    rig_look();
    const size_t before = rig_rises(PIN_MICROWAVE);
    const uint64_t late = native_tick();
    native_stall_cpu(10 * MS);
    rig_pass(15 * MS);
    rig_look();
    EXPECT_EQ(native_pin(PIN_MICROWAVE), 0);
    EXPECT(rig_rises(PIN_MICROWAVE) > before);
    EXPECT(rig_fall(PIN_MICROWAVE, rig_rises(PIN_MICROWAVE) - 1U) <= late + BOARD_STARVED_MS * MS);
    EXPECT_EQ(rig_take_fault().fault, FAULT_WATCHDOG);
    event_burst_done_t done;
    event_burst_done_unpack(&done, rig_take(EVENT_BURST_DONE)->payload);
    EXPECT_EQ(done.fault, FAULT_WATCHDOG);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, &both), STATUS_UNSAFE);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, &both), STATUS_OK);
}

void safety_tests(void)
{
    RUN(a_main_loop_that_is_late_darkens_the_microwave_long_before_the_watchdog);
    RUN(an_opening_interlock_darkens_the_microwave_within_one_chip_without_the_core);
    RUN(an_open_interlock_refuses_the_microwave_but_not_the_lamps);
    RUN(an_interlock_fault_is_cleared_only_once_it_is_closed);
    RUN(an_interlock_that_opens_while_nothing_is_armed_is_no_fault);
    RUN(a_silent_host_disarms_and_latches);
    RUN(any_valid_frame_keeps_the_host_alive_and_garbage_does_not);
    RUN(a_silent_host_is_nothing_to_a_controller_at_rest);
    RUN(the_watchdog_restarts_a_hung_controller_dark_and_latched);
    RUN(a_restart_by_the_watchdog_says_so);
    RUN(an_output_the_board_refuses_latches_a_limit_fault);
    RUN(an_interlock_that_opens_while_a_train_is_asked_for_leaves_the_microwave_dark);
    RUN(the_first_fault_stays_latched);
    RUN(a_fault_is_told_once_and_the_first_stays_with_a_train_and_a_move);
    RUN(another_schema_takes_the_outputs_away);
    RUN(outputs_are_armed_one_by_one);
}
