// The odometer between edges, and when the main loop cannot follow it.

#include <string.h>

#include "../quadrature.h"
#include "check.h"
#include "rig.h"

static uint8_t phase;

// So many steps, up or down, one every so many ticks from now on.
static void turn(const int steps, const uint64_t every)
{
    static const uint8_t gray[4] = {3, 1, 0, 2};  // A B from both pulled up: A falls first
    const uint64_t from = native_tick();
    for (int i = 0; i < ((steps > 0) ? steps : -steps); i++) {
        phase = (uint8_t)((phase + ((steps > 0) ? 1 : 3)) % 4U);
        native_input(from + (uint64_t)i * every, PIN_ODOMETER_A, gray[phase] >> 1);
        native_input(from + (uint64_t)i * every, PIN_ODOMETER_B, gray[phase] & 1U);
    }
}

static reply_health_t health(void)
{
    reply_health_t reply = {0};
    const uint8_t* const payload = rig_command(COMMAND_HEALTH, NULL);
    EXPECT(payload != NULL);
    if (payload != NULL) {
        reply_health_unpack(&reply, payload);
    }
    return reply;
}

static uint32_t told(void)
{
    const got_t* const event = rig_take(EVENT_FAULT);
    EXPECT(event != NULL);
    event_fault_t fault = {0};
    if (event != NULL) {
        event_fault_unpack(&fault, event->payload);
    }
    EXPECT_EQ(fault.fault, FAULT_ODOMETER);
    return fault.detail;
}

static void there_and_back_without_a_camera_reads_zero(void)
{
    rig_start();
    phase = 0;
    turn(600, 20 * US);
    rig_pass(13 * MS);
    turn(-600, 20 * US);
    rig_pass(13 * MS);
    EXPECT_EQ(rig_status().odometer, 0);
    EXPECT_EQ(health().odometer_lost, 0);
    EXPECT_EQ(rig_count(EVENT_FAULT), 0);
}

static void what_a_stalled_loop_could_not_follow_is_counted_and_said(void)
{
    rig_scan(0);
    phase = 0;
    native_stall_cpu(50 * MS);
    turn(1000, 40 * US);
    rig_pass(60 * MS);
    const reply_health_t counted = health();
    EXPECT(counted.odometer_lost >= 1000 - 512);
    EXPECT(counted.odometer_lost <= 1000 - 400);
    EXPECT_EQ(rig_count(EVENT_FAULT), 1);
    EXPECT_EQ(told(), counted.odometer_lost);
    const reply_status_t status = rig_status();
    EXPECT_EQ(status.odometer, (int32_t)(1000 - counted.odometer_lost));
    EXPECT_EQ(status.fault, FAULT_NONE);
    EXPECT_EQ(status.state & STATE_LAMPS_ARMED, STATE_LAMPS_ARMED);
    turn(-100, 20 * US);
    rig_pass(3 * MS);
    EXPECT_EQ(rig_status().odometer, (int32_t)(900 - counted.odometer_lost));
}

// Held anywhere in a round, also between the tick it began with and the look at what was missed.
static void no_loss_is_said_to_be_older_than_what_was_lost(void)
{
    for (uint64_t into = 0; into < NATIVE_ROUND_TICKS; into += 37) {
        rig_scan(0);
        phase = 0;
        rig_pass(into);
        native_stall_cpu(50 * MS);
        const uint32_t lost_from = (uint32_t)(native_tick() - native_boot_tick());
        turn(1000, 40 * US);
        rig_pass(60 * MS);
        const got_t* const event = rig_take(EVENT_FAULT);
        EXPECT(event != NULL);
        if (event != NULL) {
            event_fault_t fault = {0};
            event_fault_unpack(&fault, event->payload);
            EXPECT_EQ(fault.fault, FAULT_ODOMETER);
            EXPECT((int32_t)(fault.tick - lost_from) > 0);
        }
    }
}

static void both_lines_at_once_are_counted_and_said_but_not_in_a_flood(void)
{
    rig_start();
    for (uint8_t i = 0; i < 30; i++) {
        native_input(native_tick(), PIN_ODOMETER_A, i % 2U);
        native_input(native_tick(), PIN_ODOMETER_B, i % 2U);
        rig_pass(1 * MS);
    }
    rig_pass(110 * MS);
    EXPECT_EQ(health().odometer_impossible, 30);
    EXPECT_EQ(rig_count(EVENT_FAULT), 2);
    EXPECT_EQ(told(), 1);
    EXPECT_EQ(told(), 30);
    EXPECT_EQ(rig_status().odometer, 0);
}

// An encoder, or noise, that writes faster than the main loop reads: up, then down, some transitions at every look.
static struct {
    volatile uint8_t ring[QUADRATURE_KEPT];
    uint32_t written;
    int32_t place;
    uint32_t turns_at;
    uint32_t ends_at;
    uint32_t at_every_look;
} fast;

static void write_on(const uint32_t count)
{
    static const uint8_t states[4] = {3, 2, 0, 1};  // B A
    for (uint32_t i = 0; (i < count) && (fast.written < fast.ends_at); i++) {
        fast.place += (fast.written < fast.turns_at) ? 1 : -1;
        fast.ring[fast.written++ % QUADRATURE_KEPT] = states[(uint32_t)fast.place % 4U];
    }
}

static uint32_t look_at_the_fast(void)
{
    const uint32_t written = fast.written;
    write_on(fast.at_every_look);
    return written;
}

static void what_is_overwritten_while_it_is_read_is_counted(void)
{
    for (uint32_t at_every_look = 0; at_every_look < 700; at_every_look += 7) {
        for (uint32_t turns_at = 300; turns_at < 2000; turns_at += 100) {
            memset(&fast, 0, sizeof fast);
            fast.turns_at = turns_at;
            fast.ends_at = 2U * turns_at;
            fast.at_every_look = at_every_look;
            quadrature_t counted = {.state = 3};
            write_on(440);
            while (counted.decoded != fast.ends_at) {
                const uint32_t before = fast.written;
                quadrature_decode(&counted, fast.ring, fast.written, look_at_the_fast);
                write_on((fast.written == before) ? 1 : 0);
            }
            const uint32_t off = (uint32_t)((counted.position > 0) ? counted.position : -counted.position);
            EXPECT(off <= counted.lost);
            EXPECT_EQ(counted.impossible, 0);
        }
    }
}

static void an_impossible_transition_is_off_by_two(void)
{
    rig_start();
    phase = 0;
    turn(1, 1);
    turn(1, 1);  // within the same tick: two up, seen as one that goes nowhere
    rig_pass(1 * MS);
    EXPECT_EQ(health().odometer_impossible, 1);
    EXPECT_EQ(rig_status().odometer, 0);
    EXPECT_EQ(told(), 1);
}

void odometer_tests(void)
{
    RUN(there_and_back_without_a_camera_reads_zero);
    RUN(what_a_stalled_loop_could_not_follow_is_counted_and_said);
    RUN(no_loss_is_said_to_be_older_than_what_was_lost);
    RUN(both_lines_at_once_are_counted_and_said_but_not_in_a_flood);
    RUN(what_is_overwritten_while_it_is_read_is_counted);
    RUN(an_impossible_transition_is_off_by_two);
}
