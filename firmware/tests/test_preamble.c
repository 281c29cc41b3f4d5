// Optical preambles: what they light, when they come, and what ends them; read off the pins and told in the events.

#include "check.h"
#include "preamble.h"
#include "rig.h"

static event_edge_t edges[4096];

static reply_preamble_t order(const uint8_t length, const uint16_t interval, const uint8_t now)
{
    uint8_t payload[COMMAND_PREAMBLE_LENGTH];
    const command_preamble_t command = {.length = length, .interval = interval, .now = now};
    command_preamble_pack(&command, payload);
    reply_preamble_t reply;
    reply_preamble_unpack(&reply, rig_command(COMMAND_PREAMBLE, payload));
    return reply;
}

// Lamps armed at this ratio, with preambles; nothing left to take.
static void scan(const uint8_t ratio, const uint8_t length, const uint16_t interval)
{
    rig_start();
    const command_stage_t config = rig_config(1, ratio);
    rig_configure(&config);
    EXPECT_EQ(order(length, interval, 0).status, STATUS_OK);
    rig_arm(ARM_LAMPS);
    rig_forget();
}

// So many edges; each event's lamp is what the pins did. The events are in `edges`.
static void watch(const size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const size_t before[2] = {rig_rises(PIN_PROJECTOR), rig_rises(PIN_LED)};
        const uint64_t at = rig_edge(PERIOD);
        edges[i] = rig_take_edge();
        EXPECT_EQ(edges[i].tick, (uint32_t)(at - native_boot_tick()));
        EXPECT_EQ(rig_rises(PIN_PROJECTOR) - before[0], edges[i].lamp == LAMP_PROJECTOR);
        EXPECT_EQ(rig_rises(PIN_LED) - before[1], edges[i].lamp == LAMP_LED);
        if (edges[i].lamp != LAMP_DARK) {
            const uint8_t pin = (edges[i].lamp == LAMP_LED) ? PIN_LED : PIN_PROJECTOR;
            const size_t last = rig_rises(pin) - 1U;
            EXPECT_EQ(rig_rise(pin, last) - at, edges[i].delay);
            EXPECT_EQ(rig_fall(pin, last) - rig_rise(pin, last), edges[i].width);
        }
    }
}

static bool in_preamble(const event_edge_t* const edge)
{
    return (edge->flags & EDGE_PREAMBLE) != 0U;
}

static void without_one_ordered_everything_is_as_it_was(void)
{
    rig_scan(4);
    watch(40);
    for (size_t i = 0; i < 40U; i++) {
        EXPECT(!in_preamble(&edges[i]));
        EXPECT_EQ(edges[i].slot, i % 5U);
    }
}

static void one_begins_on_arming_and_then_the_cycle_begins_at_slot_0(void)
{
    for (uint8_t ratio = 0; ratio <= 15U; ratio++) {
        scan(ratio, 15, 0);
        watch(60);
        for (size_t i = 0; i < 60U; i++) {
            EXPECT_EQ(in_preamble(&edges[i]), i < 15U);
            EXPECT_EQ(edges[i].slot, (i < 15U) ? i : (i - 15U) % (ratio + 1U));
            EXPECT_EQ(edges[i].flags & ~(EDGE_PREAMBLE | EDGE_FIRST), 0);
        }
    }
}

static void it_lights_what_the_sequence_says_and_goes_on_where_the_last_one_ended(void)
{
    for (uint8_t ratio = 0; ratio <= 4U; ratio += 2U) {
        scan(ratio, 15, 3);
        preamble_t sequence;
        preamble_seed(&sequence, 0);
        bool found = false;
        watch(600);
        // The register is whatever it was seeded with: one of all its states tells every preamble of this boot.
        for (uint32_t seed = 1; (seed <= 0x7FFFU) && !found; seed++) {
            sequence.sequence = (uint16_t)seed;
            found = true;
            for (size_t i = 0; (i < 600U) && found; i++) {
                if (in_preamble(&edges[i])) {
                    found = edges[i].lamp == preamble_lamp(&sequence, ratio);
                    preamble_step(&sequence);
                }
            }
        }
        EXPECT(found);
        size_t lit[3] = {0, 0, 0};
        for (size_t i = 0; i < 600U; i++) {
            lit[edges[i].lamp] += in_preamble(&edges[i]);
        }
        EXPECT(lit[LAMP_DARK] > 20U);
        EXPECT(lit[LAMP_LED] > 20U);
        EXPECT((ratio == 0U) ? lit[LAMP_PROJECTOR] == 0U : lit[LAMP_PROJECTOR] > 40U);
    }
}

static void the_sequence_takes_every_state_but_0_before_it_repeats(void)
{
    preamble_t sequence;
    preamble_seed(&sequence, 0);
    const uint16_t first = sequence.sequence;
    uint32_t steps = 0;
    do {
        preamble_step(&sequence);
        steps++;
    } while ((sequence.sequence != first) && (steps < 0x10000U));
    EXPECT_EQ(steps, 0x7FFF);
    for (uint32_t nonce = 0; nonce < 0x20000U; nonce++) {
        preamble_seed(&sequence, nonce);
        EXPECT((sequence.sequence != 0U) && (sequence.sequence <= 0x7FFFU));
    }
}

static void one_comes_after_every_interval_of_lamp_cycles(void)
{
    scan(4, 7, 6);
    watch(37 * 8);
    for (size_t i = 0; i < 37U * 8U; i++) {
        const size_t place = i % 37U;  // 7 of a preamble, then 6 cycles of 5
        EXPECT_EQ(in_preamble(&edges[i]), place < 7U);
        EXPECT_EQ(edges[i].slot, (place < 7U) ? place : (place - 7U) % 5U);
    }
}

static void nobody_who_ordered_none_gets_one_however_long_it_scans(void)
{
    preamble_t never = {.config = {.length = 7}};
    preamble_t rare = {.config = {.length = 7, .interval = UINT16_MAX}};
    uint32_t due[2] = {0, 0};
    for (uint32_t cycle = 0; cycle < 3U * 65536U; cycle++) {
        due[0] += preamble_cycle(&never) ? 1U : 0U;
        if (preamble_cycle(&rare)) {
            due[1]++;
            rare.cycles = 0;  // as the sequencer begins it
        }
    }
    EXPECT_EQ(due[0], 0);
    EXPECT_EQ(due[1], 3);
}

static void an_order_begins_one_after_the_loaded_flash_and_one_that_runs_is_not_begun_anew(void)
{
    scan(4, 15, 0);
    watch(15 + 2);
    EXPECT_EQ(order(9, 0, 1).length, 9);
    watch(5);
    EXPECT(!in_preamble(&edges[0]));
    EXPECT_EQ(edges[0].slot, 2);
    EXPECT_EQ(edges[1].slot, 0);
    EXPECT_EQ(order(9, 0, 1).status, STATUS_OK);
    watch(7);
    for (size_t i = 0; i < 5U; i++) {
        EXPECT(in_preamble(&edges[i]));
        EXPECT_EQ(edges[i].slot, 4U + i);
    }
    EXPECT(!in_preamble(&edges[5]));
    EXPECT_EQ(edges[5].slot, 0);
}

static void an_order_within_a_flash_disturbs_neither_it_nor_the_next(void)
{
    scan(4, 15, 0);
    watch(15);
    const uint64_t edge = rig_edge(4 * MS);  // the projector is on from 3 to 5 ms
    const size_t last = rig_rises(PIN_PROJECTOR) - 1U;
    EXPECT_EQ(native_pin(PIN_PROJECTOR), 1);
    order(15, 0, 1);  // takes 2 ms
    EXPECT_EQ(rig_fall(PIN_PROJECTOR, last) - edge, 5 * MS);
    rig_pass(PERIOD - 6 * MS);
    rig_take_edge();
    watch(2);
    EXPECT_EQ(edges[0].slot, 1);
    EXPECT(in_preamble(&edges[1]));
}

static void an_order_of_none_leaves_the_cycle_alone(void)
{
    scan(4, 15, 0);
    watch(15 + 2);
    order(0, 0, 1);
    watch(5);
    for (size_t i = 0; i < 5U; i++) {
        EXPECT_EQ(edges[i].slot, (2U + i) % 5U);
    }
}

static void off_or_shorter_ends_one_that_runs(void)
{
    for (uint8_t length = 0; length <= 4U; length += 4U) {
        scan(4, 15, 0);
        watch(6);
        EXPECT_EQ(order(length, 0, 1).length, length);
        watch(3);
        EXPECT(in_preamble(&edges[0]));  // it was loaded
        EXPECT_EQ(edges[0].slot, 6);
        EXPECT(!in_preamble(&edges[1]));
        EXPECT_EQ(edges[1].slot, 0);
        EXPECT_EQ(edges[2].slot, 1);
    }
}

static void an_order_while_disarmed_lights_nothing_then_or_later(void)
{
    scan(4, 0, 0);
    rig_arm(0);
    EXPECT_EQ(order(15, 0, 1).status, STATUS_OK);
    EXPECT_EQ(order(0, 0, 1).status, STATUS_OK);
    rig_arm(ARM_LAMPS);
    order(15, 0, 0);
    watch(6);
    EXPECT(!in_preamble(&edges[5]));
    rig_arm(0);
    watch(3);
    for (size_t i = 0; i < 3U; i++) {
        EXPECT_EQ(edges[i].flags & ~EDGE_IRREGULAR, EDGE_DISARMED);
        EXPECT_EQ(edges[i].slot, 0);
    }
}

static void disarming_ends_one_and_arming_begins_another(void)
{
    scan(4, 15, 0);
    watch(6);
    rig_arm(0);
    watch(2);
    EXPECT_EQ(edges[1].flags, EDGE_DISARMED);
    rig_arm(ARM_LAMPS);
    watch(16);
    EXPECT(in_preamble(&edges[0]));
    EXPECT_EQ(edges[0].slot, 0);
    EXPECT(!in_preamble(&edges[15]));
}

static void a_commit_within_one_takes_force_at_the_slot_0_after_it(void)
{
    scan(4, 15, 0);
    watch(6);
    command_stage_t config = rig_config(2, 1);
    config.projector_width = 1 * MS;
    rig_configure(&config);
    watch(12);
    for (size_t i = 0; i < 12U; i++) {
        EXPECT_EQ(edges[i].generation, (i < 9U) ? 1 : 2);
    }
    EXPECT_EQ(edges[9].slot, 0);
    EXPECT_EQ(edges[9].width, 1 * MS);
}

static void a_late_load_within_one_uses_up_its_place(void)
{
    scan(4, 15, 0);
    watch(5);
    native_stall_cpu(60 * MS);
    for (size_t i = 0; i < 13U; i++) {
        rig_edge(PERIOD);
    }
    for (size_t i = 5; i < 18U; i++) {
        const event_edge_t edge = rig_take_edge();
        EXPECT_EQ(edge.flags & EDGE_LATE_LOAD, (i == 6U) ? EDGE_LATE_LOAD : 0);
        EXPECT_EQ(in_preamble(&edge), i < 15U);
        EXPECT_EQ(edge.slot, (i < 15U) ? i : i - 15U);
        EXPECT((i != 6U) || (edge.lamp == LAMP_DARK));
    }
}

static void a_lamp_of_zero_width_stays_dark_in_one(void)
{
    rig_start();
    command_stage_t config = rig_config(1, 4);
    config.led_width = 0;
    rig_configure(&config);
    order(63, 0, 0);
    rig_arm(ARM_LAMPS);
    watch(63);
    EXPECT_EQ(rig_rises(PIN_LED), 0);
    EXPECT(rig_rises(PIN_PROJECTOR) > 16U);
}

// Four LED flashes in a row at half of the shortest interval each: the duty over time lets every one through.
static void the_longest_flash_fires_at_every_edge_of_one(void)
{
    rig_start();
    command_stage_t config = rig_config(1, 1);
    config.tolerance = 500;
    config.readout = 20 * MS;
    config.projector_delay = config.led_delay = 2 * MS;
    config.projector_width = config.led_width = 10 * MS;
    rig_configure(&config);
    order(63, 1, 0);
    rig_arm(ARM_LAMPS);
    for (size_t i = 0; i < 1000U; i++) {
        rig_edge(20 * MS + 100);  // as early as one counts
        edges[i] = rig_take_edge();
    }
    EXPECT_EQ(rig_status().fault, FAULT_NONE);
    EXPECT_EQ(rig_status().late, 0);
    size_t longest = 0;
    size_t run = 0;
    for (size_t i = 0; i < 1000U; i++) {
        run = (edges[i].lamp == LAMP_LED) ? run + 1U : 0U;
        longest = (run > longest) ? run : longest;
    }
    EXPECT(longest >= 4U);
}

static uint8_t identify(void)
{
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, payload);
    return rig_status_of(COMMAND_IDENTIFY, payload);
}

static void whoever_identifies_has_none(void)
{
    scan(4, 15, 6);
    watch(5);
    EXPECT_EQ(identify(), STATUS_OK);
    watch(1);  // it was loaded
    watch(60);
    for (size_t i = 0; i < 60U; i++) {
        EXPECT(!in_preamble(&edges[i]));
        EXPECT_EQ(edges[i].slot, i % 5U);
    }
}

static void a_host_of_level_1_reads_of_none(void)
{
    scan(4, 15, 0);
    watch(5);
    EXPECT_EQ(identify(), STATUS_OK);
    rig_forget();
    EXPECT_EQ(rig_status_of(COMMAND_REREAD, (const uint8_t[]){0, 0, 64}), STATUS_OK);
    rig_pass(10 * MS);
    size_t seen = 0;
    for (const got_t* got = rig_take(EVENT_EDGE); got != NULL; got = rig_take(EVENT_EDGE)) {
        event_edge_t edge;
        event_edge_unpack(&edge, got->payload);
        EXPECT_EQ(edge.flags & ~edge_flags_at_level(1), 0);
        seen++;
    }
    EXPECT_EQ(seen, 5);
}

static void what_is_out_of_range_changes_nothing(void)
{
    rig_start();
    order(15, 6, 0);
    const reply_preamble_t longer = order(PREAMBLE_MAX + 1U, 9, 0);
    EXPECT_EQ(longer.status, STATUS_OUT_OF_RANGE);
    EXPECT_EQ(longer.detail, 0);
    EXPECT_EQ(longer.length, 15);
    EXPECT_EQ(longer.interval, 6);
    EXPECT_EQ(order(15, 6, 2).detail, 2);
    EXPECT_EQ(order(PREAMBLE_MAX, 9, 1).length, PREAMBLE_MAX);
}

static void an_onlooker_cannot_order_one(void)
{
    scan(4, 0, 0);
    native_usb_connect(true);
    rig_over_usb(true);
    EXPECT_EQ(order(15, 6, 1).status, STATUS_SCHEMA);
    rig_over_usb(false);
    EXPECT_EQ(rig_status().state & STATE_LAMPS_ARMED, STATE_LAMPS_ARMED);
    watch(5);
    EXPECT(!in_preamble(&edges[4]));
}

void preamble_tests(void)
{
    RUN(without_one_ordered_everything_is_as_it_was);
    RUN(one_begins_on_arming_and_then_the_cycle_begins_at_slot_0);
    RUN(it_lights_what_the_sequence_says_and_goes_on_where_the_last_one_ended);
    RUN(the_sequence_takes_every_state_but_0_before_it_repeats);
    RUN(one_comes_after_every_interval_of_lamp_cycles);
    RUN(nobody_who_ordered_none_gets_one_however_long_it_scans);
    RUN(an_order_begins_one_after_the_loaded_flash_and_one_that_runs_is_not_begun_anew);
    RUN(an_order_within_a_flash_disturbs_neither_it_nor_the_next);
    RUN(an_order_of_none_leaves_the_cycle_alone);
    RUN(off_or_shorter_ends_one_that_runs);
    RUN(an_order_while_disarmed_lights_nothing_then_or_later);
    RUN(disarming_ends_one_and_arming_begins_another);
    RUN(a_commit_within_one_takes_force_at_the_slot_0_after_it);
    RUN(a_late_load_within_one_uses_up_its_place);
    RUN(a_lamp_of_zero_width_stays_dark_in_one);
    RUN(the_longest_flash_fires_at_every_edge_of_one);
    RUN(whoever_identifies_has_none);
    RUN(a_host_of_level_1_reads_of_none);
    RUN(what_is_out_of_range_changes_nothing);
    RUN(an_onlooker_cannot_order_one);
}
