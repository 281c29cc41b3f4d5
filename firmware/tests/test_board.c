// The simulated board itself: what tests and twin rely on.

#include <string.h>

#include "../board.h"
#include "rig.h"
#include "check.h"

static void nothing_is_driven_before_power_comes(void)
{
    native_begin();
    native_input(1 * MS, PIN_SYNC, 0);
    EXPECT_EQ(native_serial_write((const uint8_t[]){1, 2, 0}, 3), 3);
    native_run_until(1000 * MS);
    native_transition_t transition;
    uint8_t byte;
    EXPECT_EQ(native_pins(&transition, 1), 0);
    EXPECT_EQ(native_serial_read(&byte, 1), 0);
    EXPECT_EQ(native_tick(), 1000 * MS);
}

static void a_byte_takes_ten_microseconds_each_way(void)
{
    native_begin();
    native_power_on(1, BOOT_CAUSE_POWER_ON);
    uint8_t bytes[64];
    native_run_until(NATIVE_BYTE_TICKS - 1U);
    EXPECT_EQ(native_serial_read(bytes, sizeof bytes), 0);
    native_run_until(3U * NATIVE_BYTE_TICKS + ROUND);
    EXPECT(native_serial_read(bytes, sizeof bytes) >= 3U);  // of BOOTED
    native_run_until(1 * MS);
    native_serial_read(bytes, sizeof bytes);
    rig_send(COMMAND_PING, 1, NULL);  // 6 bytes out, 12 bytes back
    native_run_until(1 * MS + 5 * NATIVE_BYTE_TICKS);
    EXPECT_EQ(native_serial_read(bytes, sizeof bytes), 0);
    native_run_until(1 * MS + 18 * NATIVE_BYTE_TICKS + ROUND);
    EXPECT_EQ(native_serial_read(bytes, sizeof bytes), 12);
}

static void inputs_may_be_scheduled_in_any_order(void)
{
    rig_start();
    const uint64_t from = native_tick();
    for (int i = 50; i > 0; i--) {
        native_input(from + (uint64_t)i * PERIOD, PIN_SYNC, 0);
        native_input(from + (uint64_t)i * PERIOD + 1, PIN_SYNC, 1);
    }
    rig_pass(51 * PERIOD);
    EXPECT_EQ(rig_status().edges, 50);
}

static void impossible_inputs_are_refused_and_counted(void)
{
    rig_start();
    EXPECT(!native_input(native_tick() - 1, PIN_SYNC, 0));
    EXPECT(!native_input(native_tick(), PIN_LED, 0));
    EXPECT(!native_input(native_tick(), PIN_SYNC, 2));
    native_lost_t lost;
    native_lost(&lost);
    EXPECT_EQ(lost.inputs, 3);
}

static void the_world_clock_goes_on_over_a_reset_and_the_controllers_does_not(void)
{
    rig_start();
    rig_pass(500 * MS);
    const uint64_t now = native_tick();
    native_power_on(9, BOOT_CAUSE_POWER_ON);
    EXPECT_EQ(native_tick(), now);
    EXPECT_EQ(native_boot_tick(), now);
    rig_pass(1 * MS);
    reply_ping_t ping;
    reply_ping_unpack(&ping, rig_command(COMMAND_PING, NULL));
    EXPECT(ping.tick < 2 * MS);
    EXPECT_EQ(rig_take(EVENT_BOOTED)->boot, 9);
}

static void more_edges_than_the_board_keeps_are_counted_as_refused(void)
{
    rig_start();
    native_stall_cpu(50 * MS);
    for (int i = 0; i < 20; i++) {
        rig_edge(2 * MS);
    }
    rig_pass(20 * MS);
    const reply_status_t status = rig_status();
    EXPECT_EQ(status.edges, 8);
    EXPECT_EQ(status.rejected, 12);
}

static void the_board_refuses_what_the_core_should_have_refused(void)
{
    rig_start();
    board_flash_t flash = {
        .tag = 1, .lamp = LAMP_LED, .delay_ticks = 10, .width_ticks = 20 * MS + 1, .holdoff_ticks = PERIOD};
    EXPECT(!board_flash_load(&flash));
    flash.width_ticks = 20 * MS;
    EXPECT(board_flash_load(&flash));
    flash.delay_ticks = 20 * MS + 1;
    EXPECT(!board_flash_load(&flash));
    flash.delay_ticks = 0;
    flash.holdoff_ticks = PERIOD - 1;  // more than its half
    EXPECT(!board_flash_load(&flash));
    uint32_t start;
    EXPECT_EQ(board_burst(&(board_burst_t){.length = 1, .repeat = 1, .period_ticks = 1000}, &start),
              BOARD_BURST_CUT);  // not enabled
}

void board_tests(void)
{
    RUN(nothing_is_driven_before_power_comes);
    RUN(a_byte_takes_ten_microseconds_each_way);
    RUN(inputs_may_be_scheduled_in_any_order);
    RUN(impossible_inputs_are_refused_and_counted);
    RUN(the_world_clock_goes_on_over_a_reset_and_the_controllers_does_not);
    RUN(more_edges_than_the_board_keeps_are_counted_as_refused);
    RUN(the_board_refuses_what_the_core_should_have_refused);
}
