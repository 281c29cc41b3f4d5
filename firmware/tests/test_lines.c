// Two hosts on two lines: who commands, who hears, and what happens when one goes.

#include <string.h>

#include "rig.h"
#include "check.h"

static uint8_t identify(void)
{
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, payload);
    return rig_status_of(COMMAND_IDENTIFY, payload);
}

static void start_on_usb(void)
{
    rig_start();
    native_usb_connect(true);
    rig_pass(1 * MS);
    rig_over_usb(true);
    EXPECT_EQ(identify(), STATUS_OK);
    rig_forget();
}

static const uint8_t* reread(const uint16_t first, const uint8_t count)
{
    uint8_t payload[COMMAND_REREAD_LENGTH];
    command_reread_pack(&(command_reread_t){.first = first, .count = count}, payload);
    return rig_command(COMMAND_REREAD, payload);
}

static void replies_go_where_the_command_came_from_and_events_to_who_identified_last(void)
{
    start_on_usb();
    rig_edge(3 * MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 1);
    rig_over_usb(false);
    rig_forget();
    EXPECT(rig_command(COMMAND_PING, NULL) != NULL);
    rig_edge(3 * MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 0);
    EXPECT_EQ(reread(0, 3)[0], STATUS_OK);  // whoever asks again is answered where he asked
    EXPECT_EQ(rig_count(EVENT_BOOTED), 1);
    EXPECT_EQ(rig_count(EVENT_EDGE), 2);
    rig_forget();
    EXPECT_EQ(identify(), STATUS_OK);
    rig_edge(3 * MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 1);
    rig_forget();
    rig_over_usb(true);
    rig_pass(1 * MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 1);  // the second; the third went where the last identify came from
}

// Red while one line's reread took the other's place: neither of the UART's five came.
static void events_asked_for_on_one_line_come_there_whatever_the_other_asks(void)
{
    start_on_usb();
    for (int i = 0; i < 12; i++) {
        rig_edge(3 * MS);
    }
    rig_forget();
    native_stall_cpu(1 * MS);
    uint8_t payload[COMMAND_REREAD_LENGTH];
    command_reread_pack(&(command_reread_t){.first = 6, .count = 7}, payload);
    rig_send(COMMAND_REREAD, 50, payload);
    rig_over_usb(false);
    command_reread_pack(&(command_reread_t){.first = 1, .count = 5}, payload);
    rig_send(COMMAND_REREAD, 51, payload);
    rig_pass(10 * MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 5);
    EXPECT_EQ(rig_take(EVENT_EDGE)->sequence, 1);
    rig_forget();
    rig_over_usb(true);
    rig_pass(10 * MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 7);
    EXPECT_EQ(rig_take(EVENT_EDGE)->sequence, 6);
}

static void only_the_line_that_identified_last_changes_anything(void)
{
    start_on_usb();
    rig_over_usb(false);
    const command_stage_t config = rig_config(1, 0);
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_pack(&config, payload);
    EXPECT_EQ(rig_status_of(COMMAND_STAGE, payload), STATUS_SCHEMA);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, &config.generation), STATUS_SCHEMA);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_MICROWAVE}), STATUS_SCHEMA);
    uint8_t pattern[COMMAND_PATTERN_LENGTH];
    command_pattern_pack(&(command_pattern_t){.length = 1, .chips = {1}}, pattern);
    EXPECT_EQ(rig_status_of(COMMAND_PATTERN, pattern), STATUS_SCHEMA);
    uint8_t move[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = 3, .period = 10000}, move);
    EXPECT_EQ(rig_status_of(COMMAND_MOVE, move), STATUS_SCHEMA);
    EXPECT_EQ(rig_status_of(COMMAND_TURNTABLE, (const uint8_t[COMMAND_TURNTABLE_LENGTH]){0}), STATUS_SCHEMA);
    EXPECT_EQ(rig_status_of(COMMAND_MEASURE, (const uint8_t[COMMAND_MEASURE_LENGTH]){1}), STATUS_SCHEMA);
    EXPECT_EQ(rig_status().state & STATE_SCHEMA_OK, 0);

    rig_over_usb(true);
    EXPECT_EQ(rig_status().state & STATE_SCHEMA_OK, STATE_SCHEMA_OK);
    rig_arm(ARM_MICROWAVE);
    rig_over_usb(false);
    uint8_t burst[COMMAND_BURST_LENGTH];
    command_burst_pack(&(command_burst_t){.code = BURST_CODE_SINGLE, .chip = 50, .repeat = 1, .period = 20000}, burst);
    EXPECT_EQ(rig_status_of(COMMAND_BURST, burst), STATUS_SCHEMA);
    EXPECT_EQ(identify(), STATUS_BAD_STATE);  // the other host is at work
    EXPECT_EQ(rig_status().state & STATE_SCHEMA_OK, 0);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){0}), STATUS_OK);  // anybody may darken it
    EXPECT_EQ(identify(), STATUS_OK);
    EXPECT_EQ(rig_status().state & STATE_SCHEMA_OK, STATE_SCHEMA_OK);
}

static void a_host_that_looks_on_keeps_nothing_alight(void)
{
    start_on_usb();
    const command_stage_t config = rig_config(1, 0);
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    rig_over_usb(false);
    for (int i = 0; i < 49; i++) {
        EXPECT(rig_command(COMMAND_PING, NULL) != NULL);
        rig_pass(8 * MS);
    }
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
    rig_pass(10 * MS);
    EXPECT_EQ(rig_status().fault, FAULT_HOST_TIMEOUT);
}

static void a_host_unplugged_while_armed_darkens_everything_at_once_and_is_back_in_under_a_second(void)
{
    start_on_usb();
    const command_stage_t config = rig_config(1, 0);
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    rig_edge(6 * MS);
    EXPECT_EQ(native_pin(PIN_LED), 1);
    rig_raw((const uint8_t[]){7, 7, 7}, 3);  // amid a frame
    rig_pass(5 * NATIVE_BYTE_TICKS);
    native_usb_connect(false);
    rig_pass(NATIVE_ROUND_TICKS);
    EXPECT_EQ(native_pin(PIN_LED), 0);
    rig_over_usb(false);
    for (int i = 0; i < 70; i++) {
        rig_edge(3 * MS);  // their events are sent to nobody, and wait for nobody
    }
    native_usb_connect(true);
    rig_over_usb(true);
    rig_pass(1 * MS);
    EXPECT_EQ(identify(), STATUS_OK);
    const reply_status_t status = rig_status();
    EXPECT_EQ(status.fault, FAULT_HOST_TIMEOUT);
    EXPECT_EQ(status.overruns, 0);
    EXPECT_EQ(status.bad_frames, 0);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    rig_arm(ARM_LAMPS);
    rig_pass(PERIOD);
    rig_edge(6 * MS);
    EXPECT_EQ(native_pin(PIN_LED), 1);
}

static void a_reset_waits_for_its_acknowledgement_but_not_for_ever(void)
{
    start_on_usb();
    rig_over_usb(false);
    uint8_t payload[COMMAND_RESET_LENGTH];
    command_reset_pack(&(command_reset_t){.magic = RESET_MAGIC}, payload);
    native_usb_hold(true);  // the other host is there and fetches nothing
    rig_over_usb(true);
    rig_send(COMMAND_PING, 1, NULL);
    rig_over_usb(false);
    rig_pass(1 * MS);
    const uint64_t before = native_boot_tick();
    rig_send(COMMAND_RESET, 2, payload);
    rig_pass(90 * MS);
    EXPECT_EQ(native_boot_tick(), before);
    rig_pass(20 * MS);
    EXPECT(native_boot_tick() > before);
}

void lines_tests(void)
{
    RUN(replies_go_where_the_command_came_from_and_events_to_who_identified_last);
    RUN(events_asked_for_on_one_line_come_there_whatever_the_other_asks);
    RUN(only_the_line_that_identified_last_changes_anything);
    RUN(a_host_that_looks_on_keeps_nothing_alight);
    RUN(a_host_unplugged_while_armed_darkens_everything_at_once_and_is_back_in_under_a_second);
    RUN(a_reset_waits_for_its_acknowledgement_but_not_for_ever);
}
