// Lamps: what fires after which edge, in ticks on the pins; what is refused; what is reported.

#include <string.h>

#include "bench.h"
#include "check.h"

static event_edge_t take_edge(void)
{
    event_edge_t edge = {.flags = 0xFF};
    const got_t* const got = bench_take(EVENT_EDGE);
    EXPECT(got != NULL);
    if (got != NULL) {
        event_edge_unpack(&edge, got->payload);
    }
    return edge;
}

static void start_scan(const uint8_t ratio)
{
    bench_start();
    const command_stage_t config = bench_config(1, ratio);
    bench_configure(&config);
    bench_arm(ARM_LAMPS);
    bench_forget();
}

static void outputs_are_low_from_reset_and_dark_until_armed(void)
{
    bench_start();
    const command_stage_t config = bench_config(1, 4);
    bench_configure(&config);
    bench_pass(10 * MS);
    for (int i = 0; i < 10; i++) {
        bench_edge(PERIOD);
        const event_edge_t edge = take_edge();
        EXPECT_EQ(edge.lamp, LAMP_DARK);
        EXPECT_EQ(edge.slot, 0);
        EXPECT_EQ(edge.flags, EDGE_DISARMED | ((i == 0) ? EDGE_FIRST : 0));
    }
    EXPECT_EQ(bench_rises(PIN_PROJECTOR) + bench_rises(PIN_LED) + bench_rises(PIN_MICROWAVE), 0);
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
}

static void every_ratio_fires_R_projector_flashes_then_one_led_to_the_tick(void)
{
    for (uint8_t ratio = 0; ratio <= 15; ratio++) {
        start_scan(ratio);
        for (uint8_t i = 0; i < 2 * (ratio + 1); i++) {
            bench_forget();
            const uint64_t edge = bench_edge(PERIOD);
            const bool led = i % (ratio + 1) == ratio;
            const uint8_t pin = led ? PIN_LED : PIN_PROJECTOR;
            EXPECT_EQ(bench_rise(pin, 0) - edge, led ? 4 * MS : 3 * MS);
            EXPECT_EQ(bench_fall(pin, 0) - bench_rise(pin, 0), led ? 5 * MS : 2 * MS);
            EXPECT_EQ(bench_rises(PIN_LED) + bench_rises(PIN_PROJECTOR), 1);
            const event_edge_t event = take_edge();
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
    bench_start();
    command_stage_t config = bench_config(1, 1);
    config.projector_width = 0;
    config.projector_delay = 39 * MS;  // not a flash, so no window to leave
    bench_configure(&config);
    bench_arm(ARM_LAMPS);
    for (int i = 0; i < 4; i++) {
        bench_edge(PERIOD);
        EXPECT_EQ(take_edge().lamp, (i % 2 == 0) ? LAMP_DARK : LAMP_LED);
    }
    EXPECT_EQ(bench_rises(PIN_PROJECTOR), 0);
    EXPECT_EQ(bench_rises(PIN_LED), 2);
}

static reply_stage_t stage(const command_stage_t* const config)
{
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_pack(config, payload);
    reply_stage_t reply;
    reply_stage_unpack(&reply, bench_command(COMMAND_STAGE, payload));
    return reply;
}

static void a_configuration_is_refused_as_a_whole_with_the_reason(void)
{
    bench_start();
    const command_stage_t good = bench_config(9, 4);
#define REFUSED(change, why, which)                                                                                    \
    do {                                                                                                               \
        command_stage_t config = good;                                                                                 \
        change;                                                                                                        \
        const reply_stage_t reply = stage(&config);                                                                    \
        EXPECT_EQ(reply.status, why);                                                                                  \
        EXPECT_EQ(reply.detail, which);                                                                                \
        EXPECT_EQ(bench_status().state& STATE_STAGED, 0);                                                              \
    } while (0)
    REFUSED(config.generation = 0, STATUS_OUT_OF_RANGE, 0);
    REFUSED(config.ratio = 16, STATUS_OUT_OF_RANGE, 1);
    REFUSED(config.frame_period = 2 * MS - 1, STATUS_OUT_OF_RANGE, 2);
    REFUSED(config.frame_period = 1000 * MS + 1, STATUS_OUT_OF_RANGE, 2);
    REFUSED(config.exposure = PERIOD + 1, STATUS_OUT_OF_RANGE, 3);
    REFUSED(config.readout = PERIOD + 1, STATUS_OUT_OF_RANGE, 4);
    REFUSED(config.tolerance = 0, STATUS_OUT_OF_RANGE, 5);
    REFUSED(config.tolerance = 501, STATUS_OUT_OF_RANGE, 5);
    REFUSED(config.host_timeout = 49, STATUS_OUT_OF_RANGE, 6);
    REFUSED(config.host_timeout = 5001, STATUS_OUT_OF_RANGE, 6);
    REFUSED(config.projector_width = 20 * MS + 1, STATUS_OUT_OF_RANGE, 8);
    REFUSED(config.led_width = 20 * MS + 1, STATUS_OUT_OF_RANGE, 10);
    REFUSED(config.projector_delay = 2 * MS - 1, STATUS_WINDOW, LAMP_PROJECTOR);
    REFUSED(config.projector_delay = 10 * MS + 1, STATUS_WINDOW, LAMP_PROJECTOR);
    REFUSED(config.projector_delay = 0xFFFFFFFF, STATUS_WINDOW, LAMP_PROJECTOR);
    REFUSED(config.led_delay = 1 * MS, STATUS_WINDOW, LAMP_LED);
    REFUSED(config.led_delay = 7 * MS + 1, STATUS_WINDOW, LAMP_LED);
    REFUSED(config.exposure = config.readout, STATUS_WINDOW, LAMP_PROJECTOR);  // no instant at which all rows expose
    // A global shutter leaves the window open, so the duty is what limits: 20 of 39 ms.
    REFUSED((config.frame_period = 39 * MS, config.exposure = 39 * MS, config.readout = 0, config.led_delay = 0,
             config.led_width = 20 * MS),
            STATUS_DUTY, LAMP_LED);
    REFUSED((config.frame_period = 39 * MS, config.exposure = 39 * MS, config.readout = 0, config.projector_delay = 0,
             config.projector_width = 20 * MS),
            STATUS_DUTY, LAMP_PROJECTOR);
    // The flash has to be over before the earliest edge that would be accepted: 2 % early is 39.2 ms.
    REFUSED((config.exposure = PERIOD, config.readout = 0, config.led_delay = 34 * MS + 200 * US + 1), STATUS_WINDOW,
            LAMP_LED);
    EXPECT_EQ(bench_status_of(COMMAND_COMMIT, (const uint8_t[]){9}), STATUS_BAD_STATE);
    EXPECT_EQ(bench_status().generation, 0);
}

static void the_window_is_where_all_rows_expose(void)
{
    bench_start();
    command_stage_t config = bench_config(9, 4);
    config.projector_delay = 2 * MS;  // exactly filling it
    config.projector_width = 10 * MS;
    const reply_stage_t reply = stage(&config);
    EXPECT_EQ(reply.status, STATUS_OK);
    EXPECT_EQ(reply.generation, 9);
    EXPECT_EQ(reply.window_open, 2 * MS);
    EXPECT_EQ(reply.window_close, 12 * MS);
    config.projector_delay += 1;
    EXPECT_EQ(stage(&config).status, STATUS_WINDOW);
    config.ratio = 0;  // LED only: the projector's numbers do not matter
    EXPECT_EQ(stage(&config).status, STATUS_OK);
    config.exposure = PERIOD;
    config.readout = 0;
    config.led_delay = 34 * MS + 200 * US;
    EXPECT_EQ(stage(&config).window_close, 39 * MS + 200 * US);
}

static void a_commit_needs_the_staged_generation(void)
{
    bench_start();
    EXPECT_EQ(bench_status_of(COMMAND_COMMIT, (const uint8_t[]){1}), STATUS_BAD_STATE);
    command_stage_t config = bench_config(3, 4);
    EXPECT_EQ(stage(&config).status, STATUS_OK);
    EXPECT(bench_status().state & STATE_STAGED);
    EXPECT_EQ(bench_status_of(COMMAND_COMMIT, (const uint8_t[]){4}), STATUS_BAD_STATE);
    EXPECT_EQ(bench_status().generation, 0);
    EXPECT_EQ(bench_status_of(COMMAND_COMMIT, (const uint8_t[]){3}), STATUS_OK);
    EXPECT_EQ(bench_status().generation, 3);
    EXPECT_EQ(bench_status().state & STATE_STAGED, 0);
    EXPECT_EQ(bench_status_of(COMMAND_COMMIT, (const uint8_t[]){3}), STATUS_BAD_STATE);
}

static void a_commit_while_armed_takes_force_at_slot_0_and_never_within_a_cycle(void)
{
    for (uint32_t at = 1; at <= 5; at++) {
        start_scan(4);
        for (uint32_t i = 0; i < at; i++) {
            bench_edge(PERIOD);
        }
        command_stage_t config = bench_config(2, 2);
        config.projector_width = 1 * MS;
        config.led_width = 1 * MS;
        bench_configure(&config);
        EXPECT_EQ(bench_status().generation, 1);
        config.generation = 7;
        EXPECT_EQ(stage(&config).status, STATUS_BAD_STATE);  // what waits must not change
        for (uint32_t i = at; i < 12; i++) {
            bench_edge(PERIOD);
        }
        // The cycle in which the commit came is finished; the flash after its last edge's successor is the first new
        // one.
        const uint32_t first_new = (at < 5) ? 5 : 10;
        for (uint32_t i = 0; i < 12; i++) {
            const event_edge_t edge = take_edge();
            const bool fresh = i >= first_new;
            EXPECT_EQ(edge.generation, fresh ? 2 : 1);
            EXPECT_EQ(edge.slot, fresh ? (i - first_new) % 3 : i % 5);
            EXPECT_EQ(edge.lamp, edge.slot == (fresh ? 2 : 4) ? LAMP_LED : LAMP_PROJECTOR);
            EXPECT_EQ(bench_fall((edge.lamp == LAMP_LED) ? PIN_LED : PIN_PROJECTOR, 0) != 0, 1);
        }
        event_configured_t configured;
        event_configured_unpack(&configured, bench_take(EVENT_CONFIGURED)->payload);
        EXPECT_EQ(configured.edge, first_new);
        EXPECT_EQ(configured.generation, 2);
        EXPECT_EQ(bench_count(EVENT_CONFIGURED), 0);
    }
}

static void a_commit_waiting_while_disarmed_takes_force_at_once(void)
{
    start_scan(4);
    bench_edge(PERIOD);
    const command_stage_t config = bench_config(2, 1);
    bench_configure(&config);
    EXPECT_EQ(bench_status().generation, 1);
    bench_arm(0);
    EXPECT_EQ(bench_status().generation, 2);
}

static void a_late_load_gives_a_dark_frame_a_fault_event_and_keeps_the_cycle(void)
{
    for (uint32_t stall_at = 0; stall_at < 5; stall_at++) {
        start_scan(4);
        for (uint32_t i = 0; i < 10; i++) {
            if (i == stall_at) {
                native_stall_cpu(60 * MS);  // this edge's flash is loaded, the next one's cannot be
            }
            bench_edge(PERIOD);
        }
        for (uint32_t i = 0; i < 10; i++) {
            const bool late = i == stall_at + 1;
            const event_edge_t edge = take_edge();
            EXPECT_EQ(edge.edge, i);
            EXPECT_EQ(edge.slot, i % 5);
            EXPECT_EQ(edge.flags & EDGE_LATE_LOAD, late ? EDGE_LATE_LOAD : 0);
            EXPECT_EQ(edge.lamp, late ? LAMP_DARK : (i % 5 == 4) ? LAMP_LED : LAMP_PROJECTOR);
            EXPECT_EQ(edge.width, late ? 0 : (i % 5 == 4) ? 5 * MS : 2 * MS);
        }
        EXPECT_EQ(bench_rises(PIN_PROJECTOR) + bench_rises(PIN_LED), 9);
        event_fault_t fault;
        event_fault_unpack(&fault, bench_take(EVENT_FAULT)->payload);
        EXPECT_EQ(fault.fault, FAULT_LATE_LOAD);
        EXPECT_EQ(fault.detail, stall_at + 1);
        const reply_status_t status = bench_status();
        EXPECT_EQ(status.late, 1);
        EXPECT_EQ(status.fault, FAULT_NONE);  // reported, does not latch
        EXPECT(status.state & STATE_LAMPS_ARMED);
    }
}

static void the_event_of_every_edge_tells_what_the_pins_did_whatever_the_stalls(void)
{
    start_scan(3);
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
        edges[count++] = bench_edge(PERIOD);
        while (bench_count(EVENT_EDGE) > 0U) {
            events[reported++] = take_edge();
        }
        bench_look();
        if (i % 100 == 99) {
            EXPECT(reported >= i - 2U);
        }
    }
    bench_pass(200 * MS);
    while (bench_count(EVENT_EDGE) > 0U) {
        events[reported++] = take_edge();
    }
    EXPECT_EQ(reported, count);
    size_t lit[2] = {0, 0};
    for (size_t i = 0; i < reported; i++) {
        EXPECT_EQ(events[i].tick, edges[i] - native_boot_tick());
        if (events[i].lamp != LAMP_DARK) {
            const bool led = events[i].lamp == LAMP_LED;
            EXPECT_EQ(bench_rise(led ? PIN_LED : PIN_PROJECTOR, lit[led]) - edges[i], events[i].delay);
            EXPECT_EQ(bench_fall(led ? PIN_LED : PIN_PROJECTOR, lit[led]) - edges[i],
                      events[i].delay + events[i].width);
            lit[led]++;
        }
    }
    EXPECT_EQ(bench_rises(PIN_LED), lit[1]);
    EXPECT_EQ(bench_rises(PIN_PROJECTOR), lit[0]);
    EXPECT(bench_status().late > 10U);
}

static void glitches_and_double_pulses_within_the_hold_off_fire_nothing(void)
{
    start_scan(4);
    for (int i = 0; i < 10; i++) {
        bench_pulse();
        bench_pass(1 * MS);
        bench_pulse();  // bounce
        bench_pass(38 * MS - 20 * US);
        bench_pulse();  // 39.0 ms: a hair before 39.2
        bench_pass(1 * MS - 10 * US);
    }
    EXPECT_EQ(bench_count(EVENT_EDGE), 10);
    for (int i = 0; i < 10; i++) {
        EXPECT_EQ(take_edge().slot, i % 5);
    }
    const reply_status_t status = bench_status();
    EXPECT_EQ(status.edges, 10);
    EXPECT_EQ(status.rejected, 20);
    EXPECT_EQ(status.period, PERIOD);
    EXPECT_EQ(bench_rises(PIN_PROJECTOR) + bench_rises(PIN_LED), 10);
}

static void an_interval_outside_the_tolerance_is_marked_irregular(void)
{
    start_scan(4);
    bench_edge(PERIOD);
    bench_edge(PERIOD + 800 * US);
    bench_edge(PERIOD + 800 * US + 1);
    bench_edge(PERIOD - 800 * US);
    bench_edge(2 * PERIOD);
    bench_edge(PERIOD);
    const uint8_t expected[] = {EDGE_FIRST, 0, 0, EDGE_IRREGULAR, 0, EDGE_IRREGULAR};
    for (size_t i = 0; i < sizeof expected; i++) {
        EXPECT_EQ(take_edge().flags, expected[i]);
    }
}

static void sync_is_found_after_two_edges_and_lost_within_three_periods(void)
{
    start_scan(4);
    bench_edge(PERIOD - 2 * MS);
    EXPECT_EQ(bench_count(EVENT_SYNC_FOUND), 0);
    EXPECT_EQ(bench_status().state & STATE_SYNCED, 0);  // takes the 2 ms
    const uint64_t last = bench_edge(1 * MS);
    event_sync_found_t found;
    event_sync_found_unpack(&found, bench_take(EVENT_SYNC_FOUND)->payload);
    EXPECT_EQ(found.edge, 1);
    EXPECT_EQ(found.tick, last - native_boot_tick());
    EXPECT(bench_status().state & STATE_SYNCED);
    while (native_tick() < last + 5 * PERIOD / 2) {
        bench_command(COMMAND_PING, NULL);
        if (native_tick() < last + 5 * PERIOD / 2) {
            EXPECT_EQ(bench_count(EVENT_SYNC_LOST), 0);
        }
    }
    bench_pass(last + 3 * PERIOD - native_tick());
    event_sync_lost_t lost;
    event_sync_lost_unpack(&lost, bench_take(EVENT_SYNC_LOST)->payload);
    EXPECT_EQ(lost.last_edge, 1);
    EXPECT(lost.tick - (uint32_t)(last - native_boot_tick()) <= 3 * PERIOD);
    EXPECT_EQ(bench_status().state & STATE_SYNCED, 0);
    bench_forget();
    bench_edge(PERIOD);
    EXPECT_EQ(take_edge().flags, EDGE_FIRST);
    bench_edge(PERIOD);
    EXPECT_EQ(take_edge().flags, 0);
    EXPECT_EQ(bench_count(EVENT_SYNC_FOUND), 1);
    EXPECT_EQ(bench_count(EVENT_SYNC_LOST), 0);
}

static void a_single_edge_that_stays_alone_is_forgotten_without_a_loss(void)
{
    start_scan(4);
    bench_edge(PERIOD);
    for (int i = 0; i < 100; i++) {
        bench_command(COMMAND_PING, NULL);
    }
    EXPECT_EQ(bench_count(EVENT_SYNC_LOST), 0);
    bench_edge(PERIOD);
    take_edge();
    EXPECT_EQ(take_edge().flags, EDGE_FIRST);
}

static void without_a_configuration_edges_are_reported_and_never_synced(void)
{
    bench_start();
    for (int i = 0; i < 5; i++) {
        bench_edge(PERIOD);
        const event_edge_t edge = take_edge();
        EXPECT_EQ(edge.flags, EDGE_DISARMED | ((i == 0) ? EDGE_FIRST : 0));
        EXPECT_EQ(edge.generation, 0);
    }
    EXPECT_EQ(bench_status().period, PERIOD);
    EXPECT_EQ(bench_count(EVENT_SYNC_FOUND), 0);
    bench_pass(3000 * MS);
    bench_edge(PERIOD);
    EXPECT_EQ(take_edge().flags, EDGE_DISARMED | EDGE_FIRST);
    EXPECT_EQ(bench_count(EVENT_SYNC_LOST), 0);
}

static void a_new_frame_period_has_to_be_found_again(void)
{
    start_scan(4);
    bench_edge(PERIOD);
    bench_edge(PERIOD);
    EXPECT_EQ(bench_count(EVENT_SYNC_FOUND), 1);
    bench_arm(0);
    command_stage_t config = bench_config(2, 4);
    config.frame_period = 2 * PERIOD;
    config.exposure = 2 * PERIOD - 2 * MS;
    bench_configure(&config);
    EXPECT_EQ(bench_status().state & STATE_SYNCED, 0);
    bench_forget();
    bench_edge(2 * PERIOD);
    bench_edge(2 * PERIOD);
    EXPECT_EQ(bench_count(EVENT_SYNC_FOUND), 1);
    EXPECT_EQ(bench_status().rejected, 0);  // the new hold-off came with the commit
}

static void arming_again_does_not_disturb_the_cycle_and_disarming_starts_it_anew(void)
{
    start_scan(4);
    bench_edge(PERIOD);
    bench_edge(PERIOD);
    bench_arm(ARM_LAMPS);
    bench_edge(PERIOD);
    bench_arm(0);
    bench_arm(ARM_LAMPS);
    bench_edge(PERIOD);
    const uint8_t slots[] = {0, 1, 2, 0};
    for (size_t i = 0; i < sizeof slots; i++) {
        EXPECT_EQ(take_edge().slot, slots[i]);
    }
}

static void disarming_ends_the_flash_at_once(void)
{
    start_scan(0);
    const uint64_t edge = bench_edge(5 * MS);
    EXPECT_EQ(native_pin(PIN_LED), 1);
    bench_arm(0);
    EXPECT_EQ(native_pin(PIN_LED), 0);
    EXPECT(bench_fall(PIN_LED, 0) - edge < 6 * MS);
    bench_pass(PERIOD - 7 * MS);
    bench_edge(PERIOD);
    take_edge();
    EXPECT_EQ(take_edge().flags, EDGE_DISARMED);
    EXPECT_EQ(bench_rises(PIN_LED), 1);
}

static void lamps_need_a_configuration(void)
{
    bench_start();
    EXPECT_EQ(bench_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_BAD_STATE);
    EXPECT_EQ(bench_status_of(COMMAND_ARM, (const uint8_t[]){4}), STATUS_OUT_OF_RANGE);
}

static void every_edge_carries_the_odometer_at_that_edge(void)
{
    start_scan(4);
    int32_t count = 0;
    uint8_t phase = 0;
    static const uint8_t gray[4] = {0, 2, 3, 1};  // A leads B
    for (int i = 0; i < 60; i++) {
        const int steps = (i < 30) ? i : -2 * i;
        for (int step = 0; step != steps; step += (steps > 0) ? 1 : -1) {
            phase = (uint8_t)((phase + ((steps > 0) ? 1 : 3)) % 4U);
            native_input(native_tick(), PIN_ODOMETER_A, gray[phase] >> 1);
            native_input(native_tick(), PIN_ODOMETER_B, gray[phase] & 1U);
            bench_pass(10);
        }
        count += steps;
        bench_edge(PERIOD);
        EXPECT_EQ(take_edge().odometer, count);
    }
    EXPECT_EQ(bench_status().odometer, count);
}

static void ticks_wrap_after_43_seconds_without_notice(void)
{
    bench_start();
    const command_stage_t config = bench_config(1, 4);
    bench_configure(&config);
    bench_pass(42800 * MS);
    bench_arm(ARM_LAMPS);
    uint64_t last = 0;
    for (uint32_t i = 0; i < 10; i++) {
        last = bench_edge(PERIOD);
        const event_edge_t edge = take_edge();
        EXPECT_EQ(edge.flags, (i == 0) ? EDGE_FIRST : 0);
        EXPECT_EQ(edge.tick, (uint32_t)last);
    }
    EXPECT(last > UINT32_MAX);
    EXPECT_EQ(bench_count(EVENT_SYNC_LOST), 0);
    EXPECT_EQ(bench_status().fault, FAULT_NONE);
}

static void the_fastest_frame_rate_keeps_every_event(void)
{
    bench_start();
    command_stage_t config = bench_config(1, 15);
    config.frame_period = 2 * MS;
    config.exposure = 1900 * US;
    config.readout = 1000 * US;
    config.projector_delay = config.led_delay = 100 * US;
    config.projector_width = config.led_width = 500 * US;
    bench_configure(&config);
    bench_arm(ARM_LAMPS);
    for (int i = 0; i < 500; i++) {
        bench_edge(2 * MS);
    }
    bench_pass(2 * MS);
    EXPECT_EQ(bench_count(EVENT_EDGE), 500);
    EXPECT_EQ(bench_status().overruns, 0);
    EXPECT_EQ(bench_status().late, 0);
}

void sequencer_tests(void)
{
    RUN(outputs_are_low_from_reset_and_dark_until_armed);
    RUN(every_ratio_fires_R_projector_flashes_then_one_led_to_the_tick);
    RUN(a_lamp_of_zero_width_stays_dark_and_keeps_its_slot);
    RUN(a_configuration_is_refused_as_a_whole_with_the_reason);
    RUN(the_window_is_where_all_rows_expose);
    RUN(a_commit_needs_the_staged_generation);
    RUN(a_commit_while_armed_takes_force_at_slot_0_and_never_within_a_cycle);
    RUN(a_commit_waiting_while_disarmed_takes_force_at_once);
    RUN(a_late_load_gives_a_dark_frame_a_fault_event_and_keeps_the_cycle);
    RUN(the_event_of_every_edge_tells_what_the_pins_did_whatever_the_stalls);
    RUN(glitches_and_double_pulses_within_the_hold_off_fire_nothing);
    RUN(an_interval_outside_the_tolerance_is_marked_irregular);
    RUN(sync_is_found_after_two_edges_and_lost_within_three_periods);
    RUN(a_single_edge_that_stays_alone_is_forgotten_without_a_loss);
    RUN(without_a_configuration_edges_are_reported_and_never_synced);
    RUN(a_new_frame_period_has_to_be_found_again);
    RUN(arming_again_does_not_disturb_the_cycle_and_disarming_starts_it_anew);
    RUN(disarming_ends_the_flash_at_once);
    RUN(lamps_need_a_configuration);
    RUN(every_edge_carries_the_odometer_at_that_edge);
    RUN(ticks_wrap_after_43_seconds_without_notice);
    RUN(the_fastest_frame_rate_keeps_every_event);
}
