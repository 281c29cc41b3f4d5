// Lamps: what fires after which edge, in ticks on the pins; what is refused; what is reported.

#include <string.h>

#include "rig.h"
#include "check.h"

static void outputs_are_low_from_reset_and_dark_until_armed(void)
{
    rig_start();
    const command_stage_t config = rig_config(1, 4);
    rig_configure(&config);
    rig_pass(10 * MS);
    for (int i = 0; i < 10; i++) {
        rig_edge(PERIOD);
        const event_edge_t edge = rig_take_edge();
        EXPECT_EQ(edge.lamp, LAMP_DARK);
        EXPECT_EQ(edge.slot, 0);
        EXPECT_EQ(edge.flags, EDGE_DISARMED | ((i == 0) ? EDGE_FIRST : 0));
    }
    EXPECT_EQ(rig_rises(PIN_PROJECTOR) + rig_rises(PIN_LED) + rig_rises(PIN_MICROWAVE), 0);
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
}

static void every_ratio_fires_R_projector_flashes_then_one_led_to_the_tick(void)
{
    for (uint8_t ratio = 0; ratio <= 15; ratio++) {
        rig_scan(ratio);
        for (uint8_t i = 0; i < 2 * (ratio + 1); i++) {
            rig_forget();
            const uint64_t edge = rig_edge(PERIOD);
            const bool led = i % (ratio + 1) == ratio;
            const uint8_t pin = led ? PIN_LED : PIN_PROJECTOR;
            EXPECT_EQ(rig_rise(pin, 0) - edge, led ? 4 * MS : 3 * MS);
            EXPECT_EQ(rig_fall(pin, 0) - rig_rise(pin, 0), led ? 5 * MS : 2 * MS);
            EXPECT_EQ(rig_rises(PIN_LED) + rig_rises(PIN_PROJECTOR), 1);
            const event_edge_t event = rig_take_edge();
            EXPECT_EQ(event.edge, i);
            EXPECT_EQ(event.tick, edge - native_boot_tick());
            EXPECT_EQ(event.slot, i % (ratio + 1));
            EXPECT_EQ(event.lamp, led ? LAMP_LED : LAMP_PROJECTOR);
            EXPECT_EQ(event.delay, led ? 4 * MS : 3 * MS);
            EXPECT_EQ(event.width, led ? 5 * MS : 2 * MS);
            EXPECT_EQ(event.generation, 1);
            EXPECT_EQ(event.flags, (i == 0) ? EDGE_FIRST : 0);
        }
    }
}

static void a_lamp_of_zero_width_stays_dark_and_keeps_its_slot(void)
{
    rig_start();
    command_stage_t config = rig_config(1, 1);
    config.projector_width = 0;
    config.projector_delay = 39 * MS;  // not a flash, so no window to leave
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    for (int i = 0; i < 4; i++) {
        rig_edge(PERIOD);
        EXPECT_EQ(rig_take_edge().lamp, (i % 2 == 0) ? LAMP_DARK : LAMP_LED);
    }
    EXPECT_EQ(rig_rises(PIN_PROJECTOR), 0);
    EXPECT_EQ(rig_rises(PIN_LED), 2);
}

static void a_late_load_gives_a_dark_frame_a_fault_event_and_keeps_the_cycle(void)
{
    for (uint32_t stall_at = 0; stall_at < 5; stall_at++) {
        rig_scan(4);
        for (uint32_t i = 0; i < 10; i++) {
            if (i == stall_at) {
                native_stall_cpu(60 * MS);  // this edge's flash is loaded, the next one's cannot be
            }
            rig_edge(PERIOD);
        }
        for (uint32_t i = 0; i < 10; i++) {
            const bool late = i == stall_at + 1;
            const event_edge_t edge = rig_take_edge();
            EXPECT_EQ(edge.edge, i);
            EXPECT_EQ(edge.slot, i % 5);
            EXPECT_EQ(edge.flags & EDGE_LATE_LOAD, late ? EDGE_LATE_LOAD : 0);
            EXPECT_EQ(edge.lamp, late ? LAMP_DARK : (i % 5 == 4) ? LAMP_LED : LAMP_PROJECTOR);
            EXPECT_EQ(edge.width, late ? 0 : (i % 5 == 4) ? 5 * MS : 2 * MS);
        }
        EXPECT_EQ(rig_rises(PIN_PROJECTOR) + rig_rises(PIN_LED), 9);
        event_fault_t fault;
        event_fault_unpack(&fault, rig_take(EVENT_FAULT)->payload);
        EXPECT_EQ(fault.fault, FAULT_LATE_LOAD);
        EXPECT_EQ(fault.detail, stall_at + 1);
        const reply_status_t status = rig_status();
        EXPECT_EQ(status.late, 1);
        EXPECT_EQ(status.fault, FAULT_NONE);  // reported, does not latch
        EXPECT(status.state & STATE_LAMPS_ARMED);
    }
}

static void the_event_of_every_edge_tells_what_the_pins_did_whatever_the_stalls(void)
{
    rig_scan(3);
    uint32_t random = 12345;
    static uint64_t edges[400];
    size_t count = 0;
    static event_edge_t events[400];
    size_t reported = 0;
    for (size_t i = 0; i < 400; i++) {
        random = random * 1664525U + 1013904223U;
        if ((i % 5U == 0U) && (random >> 24 < 160U)) {      // never two within the watchdog's patience
            native_stall_cpu((random & 0xFFFFU) * 130ULL);  // up to 85 ms
        }
        edges[count++] = rig_edge(PERIOD);
        while (rig_count(EVENT_EDGE) > 0U) {
            events[reported++] = rig_take_edge();
        }
        rig_look();
        if (i % 100 == 99) {
            EXPECT(reported >= i - 2U);
        }
    }
    rig_pass(200 * MS);
    while (rig_count(EVENT_EDGE) > 0U) {
        events[reported++] = rig_take_edge();
    }
    EXPECT_EQ(reported, count);
    size_t lit[2] = {0, 0};
    for (size_t i = 0; i < reported; i++) {
        EXPECT_EQ(events[i].tick, edges[i] - native_boot_tick());
        if (events[i].lamp != LAMP_DARK) {
            const bool led = events[i].lamp == LAMP_LED;
            EXPECT_EQ(rig_rise(led ? PIN_LED : PIN_PROJECTOR, lit[led]) - edges[i], events[i].delay);
            EXPECT_EQ(rig_fall(led ? PIN_LED : PIN_PROJECTOR, lit[led]) - edges[i], events[i].delay + events[i].width);
            lit[led]++;
        }
    }
    EXPECT_EQ(rig_rises(PIN_LED), lit[1]);
    EXPECT_EQ(rig_rises(PIN_PROJECTOR), lit[0]);
    EXPECT(rig_status().late > 10U);
}

static void glitches_and_double_pulses_within_the_hold_off_fire_nothing(void)
{
    rig_scan(4);
    for (int i = 0; i < 10; i++) {
        rig_pulse();
        rig_pass(1 * MS);
        rig_pulse();  // bounce
        rig_pass(38 * MS - 20 * US);
        rig_pulse();  // 39.0 ms: a hair before 39.2
        rig_pass(1 * MS - 10 * US);
    }
    EXPECT_EQ(rig_count(EVENT_EDGE), 10);
    for (int i = 0; i < 10; i++) {
        EXPECT_EQ(rig_take_edge().slot, i % 5);
    }
    const reply_status_t status = rig_status();
    EXPECT_EQ(status.edges, 10);
    EXPECT_EQ(status.rejected, 20);
    EXPECT_EQ(status.period, PERIOD);
    EXPECT_EQ(rig_rises(PIN_PROJECTOR) + rig_rises(PIN_LED), 10);
}

static void an_interval_outside_the_tolerance_is_marked_irregular(void)
{
    rig_scan(4);
    rig_edge(PERIOD);
    rig_edge(PERIOD + 800 * US);
    rig_edge(PERIOD + 800 * US + 1);
    rig_edge(PERIOD - 800 * US);
    rig_edge(2 * PERIOD);
    rig_edge(PERIOD);
    const uint8_t expected[] = {EDGE_FIRST, 0, 0, EDGE_IRREGULAR, 0, EDGE_IRREGULAR};
    for (size_t i = 0; i < sizeof expected; i++) {
        EXPECT_EQ(rig_take_edge().flags, expected[i]);
    }
}

static void sync_is_found_after_two_edges_and_lost_within_three_periods(void)
{
    rig_scan(4);
    rig_edge(PERIOD - 2 * MS);
    EXPECT_EQ(rig_count(EVENT_SYNC_FOUND), 0);
    EXPECT_EQ(rig_status().state & STATE_SYNCED, 0);  // takes the 2 ms
    const uint64_t last = rig_edge(1 * MS);
    event_sync_found_t found;
    event_sync_found_unpack(&found, rig_take(EVENT_SYNC_FOUND)->payload);
    EXPECT_EQ(found.edge, 1);
    EXPECT_EQ(found.tick, last - native_boot_tick());
    EXPECT(rig_status().state & STATE_SYNCED);
    while (native_tick() < last + 5 * PERIOD / 2) {
        rig_command(COMMAND_PING, NULL);
        if (native_tick() < last + 5 * PERIOD / 2) {
            EXPECT_EQ(rig_count(EVENT_SYNC_LOST), 0);
        }
    }
    rig_pass(last + 3 * PERIOD - native_tick());
    event_sync_lost_t lost;
    event_sync_lost_unpack(&lost, rig_take(EVENT_SYNC_LOST)->payload);
    EXPECT_EQ(lost.last_edge, 1);
    EXPECT(lost.tick - (uint32_t)(last - native_boot_tick()) <= 3 * PERIOD);
    EXPECT_EQ(rig_status().state & STATE_SYNCED, 0);
    rig_forget();
    rig_edge(PERIOD);
    EXPECT_EQ(rig_take_edge().flags, EDGE_FIRST);
    rig_edge(PERIOD);
    EXPECT_EQ(rig_take_edge().flags, 0);
    EXPECT_EQ(rig_count(EVENT_SYNC_FOUND), 1);
    EXPECT_EQ(rig_count(EVENT_SYNC_LOST), 0);
}

static void a_single_edge_that_stays_alone_is_forgotten_without_a_loss(void)
{
    rig_scan(4);
    rig_edge(PERIOD);
    for (int i = 0; i < 100; i++) {
        rig_command(COMMAND_PING, NULL);
    }
    EXPECT_EQ(rig_count(EVENT_SYNC_LOST), 0);
    rig_edge(PERIOD);
    rig_take_edge();
    EXPECT_EQ(rig_take_edge().flags, EDGE_FIRST);
}

// An edge stamped after its round's `now` once looked 43 s old. Edges come at every phase of the rounds.
static void an_edge_in_the_middle_of_a_round_loses_no_sync(void)
{
    rig_start();
    command_stage_t config = rig_config(1, 4);
    config.frame_period = 2 * MS;
    config.exposure = 2 * MS;
    config.readout = 0;
    config.projector_width = 0;
    config.led_width = 0;
    rig_configure(&config);
    for (uint32_t i = 0; i < 5000U; i++) {
        rig_edge(2 * MS + (i * 7919U) % 20011U);
        if (i % 100U == 0U) {
            EXPECT_EQ(rig_count(EVENT_SYNC_LOST), 0);
            rig_forget();
        }
    }
}

static void without_a_configuration_edges_are_reported_and_never_synced(void)
{
    rig_start();
    for (int i = 0; i < 5; i++) {
        rig_edge(PERIOD);
        const event_edge_t edge = rig_take_edge();
        EXPECT_EQ(edge.flags, EDGE_DISARMED | ((i == 0) ? EDGE_FIRST : 0));
        EXPECT_EQ(edge.generation, 0);
    }
    EXPECT_EQ(rig_status().period, PERIOD);
    EXPECT_EQ(rig_count(EVENT_SYNC_FOUND), 0);
    rig_pass(3000 * MS);
    rig_edge(PERIOD);
    EXPECT_EQ(rig_take_edge().flags, EDGE_DISARMED | EDGE_FIRST);
    EXPECT_EQ(rig_count(EVENT_SYNC_LOST), 0);
}

static void a_new_frame_period_has_to_be_found_again(void)
{
    rig_scan(4);
    rig_edge(PERIOD);
    rig_edge(PERIOD);
    EXPECT_EQ(rig_count(EVENT_SYNC_FOUND), 1);
    rig_arm(0);
    command_stage_t config = rig_config(2, 4);
    config.frame_period = 2 * PERIOD;
    config.exposure = 2 * PERIOD - 2 * MS;
    rig_configure(&config);
    EXPECT_EQ(rig_status().state & STATE_SYNCED, 0);
    rig_forget();
    rig_edge(2 * PERIOD);
    rig_edge(2 * PERIOD);
    EXPECT_EQ(rig_count(EVENT_SYNC_FOUND), 1);
    EXPECT_EQ(rig_status().rejected, 0);  // the new hold-off came with the commit
}

static void arming_again_does_not_disturb_the_cycle_and_disarming_starts_it_anew(void)
{
    rig_scan(4);
    rig_edge(PERIOD);
    rig_edge(PERIOD);
    rig_arm(ARM_LAMPS);
    rig_edge(PERIOD);
    rig_arm(0);
    rig_arm(ARM_LAMPS);
    rig_edge(PERIOD);
    const uint8_t slots[] = {0, 1, 2, 0};
    for (size_t i = 0; i < sizeof slots; i++) {
        EXPECT_EQ(rig_take_edge().slot, slots[i]);
    }
}

static void disarming_ends_the_flash_at_once(void)
{
    rig_scan(0);
    const uint64_t edge = rig_edge(5 * MS);
    EXPECT_EQ(native_pin(PIN_LED), 1);
    rig_arm(0);
    EXPECT_EQ(native_pin(PIN_LED), 0);
    EXPECT(rig_fall(PIN_LED, 0) - edge < 6 * MS);
    rig_pass(PERIOD - 7 * MS);
    rig_edge(PERIOD);
    rig_take_edge();
    EXPECT_EQ(rig_take_edge().flags, EDGE_DISARMED);
    EXPECT_EQ(rig_rises(PIN_LED), 1);
}

static void lamps_need_a_configuration(void)
{
    rig_start();
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){4}), STATUS_OUT_OF_RANGE);
}

static void every_edge_carries_the_odometer_at_that_edge(void)
{
    rig_scan(4);
    int32_t count = 0;
    uint8_t phase = 2;                            // both pulled up
    static const uint8_t gray[4] = {0, 2, 3, 1};  // A leads B
    for (int i = 0; i < 60; i++) {
        const int steps = (i < 30) ? i : -2 * i;
        for (int step = 0; step != steps; step += (steps > 0) ? 1 : -1) {
            phase = (uint8_t)((phase + ((steps > 0) ? 1 : 3)) % 4U);
            native_input(native_tick(), PIN_ODOMETER_A, gray[phase] >> 1);
            native_input(native_tick(), PIN_ODOMETER_B, gray[phase] & 1U);
            rig_pass(10);
        }
        count += steps;
        rig_edge(PERIOD);
        EXPECT_EQ(rig_take_edge().odometer, count);
    }
    EXPECT_EQ(rig_status().odometer, count);
}

static void ticks_wrap_after_43_seconds_without_notice(void)
{
    rig_start();
    const command_stage_t config = rig_config(1, 4);
    rig_configure(&config);
    rig_pass(42800 * MS);
    rig_arm(ARM_LAMPS);
    uint64_t last = 0;
    for (uint32_t i = 0; i < 10; i++) {
        last = rig_edge(PERIOD);
        const event_edge_t edge = rig_take_edge();
        EXPECT_EQ(edge.flags, (i == 0) ? EDGE_FIRST : 0);
        EXPECT_EQ(edge.tick, (uint32_t)last);
    }
    EXPECT(last > UINT32_MAX);
    EXPECT_EQ(rig_count(EVENT_SYNC_LOST), 0);
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
}

static void the_fastest_frame_rate_keeps_every_event(void)
{
    rig_start();
    command_stage_t config = rig_config(1, 15);
    config.frame_period = 2 * MS;
    config.exposure = 1900 * US;
    config.readout = 1000 * US;
    config.projector_delay = config.led_delay = 100 * US;
    config.projector_width = config.led_width = 500 * US;
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    for (int i = 0; i < 500; i++) {
        rig_edge(2 * MS);
    }
    rig_pass(2 * MS);
    EXPECT_EQ(rig_count(EVENT_EDGE), 500);
    EXPECT_EQ(rig_status().overruns, 0);
    EXPECT_EQ(rig_status().late, 0);
}

// Disarmed over one line and armed over the other, as nearly at once as can be, about an edge: which is of the cycle
// before, or the first of the new one, and the new one begins at slot 0.
static void begins_at_slot_0(const uint8_t preamble)
{
    uint8_t payload[COMMAND_PREAMBLE_LENGTH];
    command_preamble_pack(&(command_preamble_t){.length = preamble}, payload);
    const uint8_t nothing = 0;
    const uint8_t lamps = ARM_LAMPS;
    for (uint64_t phase = 0; phase < 130U * US; phase += 31U) {  // of the two rounds that carry them out
        rig_start();
        native_usb_connect(true);
        rig_over_usb(true);
        rig_identify();
        const command_stage_t config = rig_config(1, 4);
        rig_configure(&config);
        EXPECT_EQ(rig_status_of(COMMAND_PREAMBLE, payload), STATUS_OK);
        rig_arm(ARM_LAMPS);
        for (size_t i = 0; i < preamble + 3U; i++) {
            rig_edge(PERIOD);
        }
        rig_forget();
        const uint64_t round = native_tick() + 200U * US;
        native_stall_cpu(200U * US);
        native_input(round + phase, PIN_SYNC, 0);
        native_input(round + phase + 10U * US, PIN_SYNC, 1);
        rig_over_usb(false);
        rig_send(COMMAND_ARM, 0x81, &nothing);
        rig_over_usb(true);
        rig_send(COMMAND_ARM, 0x82, &lamps);
        rig_pass(PERIOD);
        const event_edge_t at = rig_take_edge();
        const bool is_disarmed = (at.flags & EDGE_DISARMED) != 0U;
        const bool is_first = (at.slot == 0U) && !is_disarmed;
        EXPECT(!is_disarmed || ((at.flags & EDGE_PREAMBLE) == 0U));
        for (uint8_t i = is_first ? 1U : 0U; i < 3U; i++) {
            rig_edge(PERIOD);
            EXPECT_EQ(rig_take_edge().slot, i);
        }
    }
}

static void a_cycle_begins_at_slot_0_whatever_edge_came_as_it_was_armed(void)
{
    begins_at_slot_0(0);
    begins_at_slot_0(5);
}

void sequencer_tests(void)
{
    RUN(outputs_are_low_from_reset_and_dark_until_armed);
    RUN(every_ratio_fires_R_projector_flashes_then_one_led_to_the_tick);
    RUN(a_lamp_of_zero_width_stays_dark_and_keeps_its_slot);
    RUN(a_late_load_gives_a_dark_frame_a_fault_event_and_keeps_the_cycle);
    RUN(the_event_of_every_edge_tells_what_the_pins_did_whatever_the_stalls);
    RUN(glitches_and_double_pulses_within_the_hold_off_fire_nothing);
    RUN(an_interval_outside_the_tolerance_is_marked_irregular);
    RUN(sync_is_found_after_two_edges_and_lost_within_three_periods);
    RUN(a_single_edge_that_stays_alone_is_forgotten_without_a_loss);
    RUN(an_edge_in_the_middle_of_a_round_loses_no_sync);
    RUN(without_a_configuration_edges_are_reported_and_never_synced);
    RUN(a_new_frame_period_has_to_be_found_again);
    RUN(arming_again_does_not_disturb_the_cycle_and_disarming_starts_it_anew);
    RUN(disarming_ends_the_flash_at_once);
    RUN(lamps_need_a_configuration);
    RUN(every_edge_carries_the_odometer_at_that_edge);
    RUN(ticks_wrap_after_43_seconds_without_notice);
    RUN(the_fastest_frame_rate_keeps_every_event);
    RUN(a_cycle_begins_at_slot_0_whatever_edge_came_as_it_was_armed);
}
