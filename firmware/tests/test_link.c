// The wire: golden vectors, damage, repeats, events and their ring.

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rig.h"
#include "check.h"
#include "events.h"
#include "link.h"
#include "vectors.h"

static void every_golden_vector_is_reproduced(void)
{
    for (size_t i = 0; i < vector_count; i++) {
        const vector_t* const vector = &vectors[i];
        const layout_t* const layout = layout_of(vector->id);
        const bool is_event = (vector->id >= 0x80U) && (vector->id != NOTICE_GARBLED);
        uint8_t body[MAX_WIRE] = {vector->id};
        size_t length = 1;
        if (vector->id != NOTICE_GARBLED) {
            body[length++] = (uint8_t)vector->sequence;
        }
        if (is_event) {
            body[length++] = (uint8_t)(vector->sequence >> 8);
            body[length++] = vector->boot;
        }
        if (vector->reproduce != NULL) {
            EXPECT(vector->reproduce(body + length));
        }
        length += layout->length;
        EXPECT_EQ(length, vector->body_length);
        EXPECT(memcmp(body, vector->body, length) == 0);
        uint8_t wire[MAX_WIRE];
        const uint8_t wire_length = link_frame(body, length, layout->schema, wire);
        EXPECT_EQ(wire_length, vector->wire_length);
        EXPECT(memcmp(wire, vector->wire, wire_length) == 0);
        const size_t decoded = cobs_decode(wire, wire_length - 1U);
        EXPECT_EQ(decoded, length + 2U);
        EXPECT(memcmp(wire, body, length) == 0);
    }
}

static void every_command_vector_is_received(void)
{
    static link_t link;
    for (size_t i = 0; i < vector_count; i++) {
        if (vectors[i].id >= REPLY_BIT) {
            continue;
        }
        memset(&link, 0, sizeof link);
        command_t command;
        bool heard = false;
        bool complete = false;
        for (size_t at = 0; at < vectors[i].wire_length; at++) {
            complete = link_receive(&link, vectors[i].wire[at], &command, &heard);
        }
        EXPECT(complete && heard);
        EXPECT_EQ(command.layout->id, vectors[i].id);
        EXPECT_EQ(command.sequence, vectors[i].sequence);
        EXPECT(memcmp(command.payload, vectors[i].body + 2, command.layout->length) == 0);
    }
}

static void every_bad_frame_is_refused_counted_and_notified(void)
{
    for (size_t i = 0; i < bad_vector_count; i++) {
        rig_power_on();
        rig_pass(5 * MS);
        rig_raw(bad_vectors[i].wire, bad_vectors[i].wire_length);
        rig_pass(5 * MS);
        const got_t* const notice = rig_take(NOTICE_GARBLED);
        EXPECT(notice != NULL);
        if (notice != NULL) {
            EXPECT(notice->payload[0] >= 1U);
        } else {
            printf("not refused: %s\n", bad_vectors[i].name);
        }
        EXPECT(rig_status().bad_frames >= 1U);  // and the next frame is read again
    }
}

static void empty_frames_are_no_fault(void)
{
    rig_power_on();
    rig_raw((const uint8_t[]){0, 0, 0}, 3);
    rig_pass(5 * MS);
    EXPECT_EQ(rig_count(NOTICE_GARBLED), 0);
    EXPECT_EQ(rig_status().bad_frames, 0);
}

static void a_zero_code_byte_is_not_cobs(void)
{
    uint8_t bytes[] = {2, 5, 0, 7};
    EXPECT_EQ(cobs_decode(bytes, sizeof bytes), 0);
}

static void a_repeated_command_is_acknowledged_again_but_not_executed_again(void)
{
    rig_start();
    const command_stage_t config = rig_config(1, 4);
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_pack(&config, payload);
    rig_send(COMMAND_STAGE, 100, payload);
    rig_send(COMMAND_COMMIT, 101, (const uint8_t[]){1});
    rig_pass(3 * MS);
    EXPECT_EQ(rig_count(COMMAND_COMMIT + REPLY_BIT), 1);
    EXPECT_EQ(rig_count(EVENT_CONFIGURED), 1);
    for (int i = 0; i < 3; i++) {
        rig_send(COMMAND_COMMIT, 101, (const uint8_t[]){1});
    }
    rig_pass(5 * MS);
    EXPECT_EQ(rig_count(COMMAND_COMMIT + REPLY_BIT), 4);
    EXPECT_EQ(rig_count(EVENT_CONFIGURED), 1);
    for (int i = 0; i < 4; i++) {
        EXPECT_EQ(rig_take(REPLY_COMMIT)->payload[0], STATUS_OK);
    }
    // Same sequence, another body: a new command, and nothing is staged any more.
    rig_send(COMMAND_COMMIT, 101, (const uint8_t[]){2});
    // Same body, another sequence.
    rig_send(COMMAND_COMMIT, 102, (const uint8_t[]){1});
    rig_pass(5 * MS);
    EXPECT_EQ(rig_take(REPLY_COMMIT)->payload[0], STATUS_BAD_STATE);
    EXPECT_EQ(rig_take(REPLY_COMMIT)->payload[0], STATUS_BAD_STATE);
}

static void queries_are_always_fresh(void)
{
    rig_start();
    rig_send(COMMAND_PING, 9, NULL);
    rig_pass(5 * MS);
    rig_send(COMMAND_PING, 9, NULL);
    rig_pass(5 * MS);
    reply_ping_t first;
    reply_ping_t second;
    reply_ping_unpack(&first, rig_take(REPLY_PING)->payload);
    reply_ping_unpack(&second, rig_take(REPLY_PING)->payload);
    EXPECT(labs((long)(second.tick - first.tick) - (long)(5 * MS)) < (long)ROUND);
}

static void a_new_session_never_gets_an_old_answer(void)
{
    rig_start();
    rig_send(COMMAND_ARM, 0, (const uint8_t[]){ARM_MICROWAVE});
    rig_pass(2 * MS);
    EXPECT_EQ(rig_take(REPLY_ARM)->payload[2], ARM_MICROWAVE);
    rig_send(COMMAND_ARM, 1, (const uint8_t[]){0});
    uint8_t identify[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, identify);
    rig_send(COMMAND_IDENTIFY, 2, identify);
    rig_send(COMMAND_ARM, 0, (const uint8_t[]){ARM_MICROWAVE});  // the restarted host counts from zero again
    rig_pass(3 * MS);
    EXPECT((rig_status().state & STATE_MICROWAVE_ARMED) != 0U);
}

static void a_host_that_sends_more_than_there_is_room_for_answers_waits_and_loses_nothing(void)
{
    rig_start();
    // The line back is kept busy with 64 events while short commands pour in.
    native_stall_cpu(2 * MS);
    for (uint8_t i = 0; i < 26; i++) {
        rig_send(COMMAND_CLEAR, i, NULL);  // 7 bytes out, 9 bytes back
    }
    rig_pass(10 * MS);
    EXPECT_EQ(rig_count(REPLY_CLEAR), 26);
    EXPECT_EQ(rig_status().bad_frames, 0);
}

static void identify_says_who_and_locks_on_a_schema_mismatch(void)
{
    rig_power_on();
    rig_pass(1 * MS);
    EXPECT_EQ(rig_take(EVENT_BOOTED)->sequence, 0);
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    reply_identify_t reply;
    const uint32_t wrong[][2] = {{PROTOCOL_VERSION, SCHEMA_HASH ^ 1U}, {PROTOCOL_VERSION + 1U, SCHEMA_HASH}};
    for (size_t i = 0; i < 2U; i++) {
        command_identify_pack(&(command_identify_t){.protocol = (uint8_t)wrong[i][0], .schema = wrong[i][1]}, payload);
        reply_identify_unpack(&reply, rig_command(COMMAND_IDENTIFY, payload));
        EXPECT_EQ(reply.status, STATUS_SCHEMA);
        EXPECT_EQ(reply.schema, SCHEMA_HASH);
        EXPECT_EQ(reply.boot, 1);
        EXPECT_EQ(reply.tick_hz, 100000000);
        EXPECT_EQ(memcmp(reply.board, "native\0", 8), 0);
        EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_SCHEMA);
        const command_stage_t config = rig_config(1, 4);
        uint8_t stage[COMMAND_STAGE_LENGTH];
        command_stage_pack(&config, stage);
        EXPECT_EQ(rig_status_of(COMMAND_STAGE, stage), STATUS_SCHEMA);
        EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){1}), STATUS_SCHEMA);
        uint8_t pattern[COMMAND_PATTERN_LENGTH] = {1, 0, 1};
        EXPECT_EQ(rig_status_of(COMMAND_PATTERN, pattern), STATUS_SCHEMA);
        uint8_t move[COMMAND_MOVE_LENGTH];
        command_move_pack(&(command_move_t){.position = 3, .period = 10000}, move);
        EXPECT_EQ(rig_status_of(COMMAND_MOVE, move), STATUS_SCHEMA);
        EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){0}), STATUS_OK);  // disarming is always allowed
        EXPECT_EQ(rig_status().state & STATE_SCHEMA_OK, 0);                      // diagnostics go on
    }
}

static void a_reset_needs_its_magic_is_acknowledged_and_changes_the_boot_byte(void)
{
    rig_start();
    const command_stage_t config = rig_config(1, 0);
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    rig_edge(6 * MS);  // LED on from 4 to 9 ms
    EXPECT_EQ(native_pin(PIN_LED), 1);
    uint8_t payload[COMMAND_RESET_LENGTH] = {1, 2, 3, 4};
    EXPECT_EQ(rig_status_of(COMMAND_RESET, payload), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(native_pin(PIN_LED), 1);
    command_reset_pack(&(command_reset_t){.magic = RESET_MAGIC}, payload);
    rig_forget();
    rig_send(COMMAND_RESET, 77, payload);
    rig_send(COMMAND_PING, 78, NULL);  // too late: nothing is carried out after a reset
    rig_pass(5 * MS);
    EXPECT_EQ(rig_take(REPLY_RESET)->payload[0], STATUS_OK);
    EXPECT_EQ(native_pin(PIN_LED), 0);
    const got_t* const booted = rig_take(EVENT_BOOTED);
    EXPECT_EQ(booted->boot, 2);
    EXPECT_EQ(booted->payload[0], BOOT_CAUSE_HOST_RESET);
    EXPECT_EQ(rig_status().generation, 0);
}

static void the_boot_loader_is_entered_on_its_magic_with_outputs_low_and_never_while_anything_is_armed(void)
{
    rig_start();
    const command_stage_t config = rig_config(1, 0);
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    uint8_t payload[COMMAND_BOOTLOADER_LENGTH];
    command_bootloader_pack(&(command_bootloader_t){.magic = BOOTLOADER_MAGIC}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_BOOTLOADER, payload), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status().state & STATE_LAMPS_ARMED, STATE_LAMPS_ARMED);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){0}), STATUS_OK);
    uint8_t move[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = 30, .period = 100000, .hold = 1}, move);
    EXPECT_EQ(rig_status_of(COMMAND_MOVE, move), STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_BOOTLOADER, payload), STATUS_BAD_STATE);
    rig_pass(40 * MS);
    EXPECT_EQ(native_pin(PIN_ENABLE), 0);
    EXPECT_EQ(rig_status_of(COMMAND_BOOTLOADER, (const uint8_t[]){0, 0x7B, 0x5E, 0x7E}), STATUS_OUT_OF_RANGE);
    EXPECT(!native_in_bootloader());
    const uint8_t* const refused = rig_command(COMMAND_BOOTLOADER, payload);  // over the UART, and no USB host is there
    EXPECT_EQ(refused[0], STATUS_BAD_STATE);
    EXPECT_EQ(refused[1], BOOTLOADER_NEEDS_USB);
    EXPECT(!native_in_bootloader());
    native_usb_connect(true);
    rig_pass(MS);
    EXPECT_EQ(rig_status_of(COMMAND_BOOTLOADER, payload), STATUS_OK);
    EXPECT(native_in_bootloader());
    EXPECT_EQ(native_pin(PIN_ENABLE), 1);
    rig_forget();
    EXPECT(rig_command(COMMAND_PING, NULL) == NULL);
    native_power_on(2, BOOT_CAUSE_HOST_RESET);
    EXPECT(!native_in_bootloader());
    EXPECT(rig_command(COMMAND_PING, NULL) != NULL);
}

static void a_frame_cut_short_by_a_reset_does_not_spoil_the_next_one(void)
{
    rig_start();
    rig_send(COMMAND_STATUS, 1, NULL);
    rig_pass(20 * NATIVE_BYTE_TICKS);
    native_power_on(2, BOOT_CAUSE_POWER_ON);  // amid the reply
    uint8_t bytes[64];
    native_run_until(native_tick() + 1 * MS);
    const size_t size = native_serial_read(bytes, sizeof bytes);
    EXPECT_EQ(bytes[0], 0);  // ends it
    EXPECT_EQ(bytes[size - 1U], 0);
    EXPECT_EQ(cobs_decode(bytes + 1, size - 2U), 4U + EVENT_BOOTED_LENGTH + 2U);
    EXPECT_EQ(bytes[1], EVENT_BOOTED);
}

static uint16_t edge_sequence(const uint32_t edge)
{
    return (uint16_t)(edge + 1U);  // BOOTED came first
}

static const uint8_t* reread(const uint16_t first, const uint8_t count)
{
    uint8_t payload[COMMAND_REREAD_LENGTH];
    command_reread_pack(&(command_reread_t){.first = first, .count = count}, payload);
    return rig_command(COMMAND_REREAD, payload);
}

static void the_last_64_events_can_be_read_again_unchanged(void)
{
    rig_start();
    for (int i = 0; i < 100; i++) {
        rig_edge(3 * MS);
    }
    static got_t before[100];
    for (uint32_t i = 0; i < 100; i++) {
        before[i] = *rig_take(EVENT_EDGE);
        EXPECT_EQ(before[i].sequence, edge_sequence(i));
    }
    reply_reread_t reply;
    rig_forget();
    reply_reread_unpack(&reply, reread(edge_sequence(60), 20));
    EXPECT_EQ(reply.status, STATUS_OK);
    EXPECT_EQ(reply.first, edge_sequence(60));
    EXPECT_EQ(reply.count, 20);
    rig_pass(20 * MS);
    for (uint32_t i = 60; i < 80; i++) {
        const got_t* const again = rig_take(EVENT_EDGE);
        EXPECT_EQ(again->sequence, before[i].sequence);
        EXPECT_EQ(again->boot, before[i].boot);
        EXPECT(memcmp(again->payload, before[i].payload, EVENT_EDGE_LENGTH) == 0);
    }
    EXPECT_EQ(rig_count(EVENT_EDGE), 0);
    // 101 events were made, 37..100 are left: partly gone, wholly gone, not yet there, partly not yet there.
    reply_reread_unpack(&reply, reread(30, 10));
    EXPECT_EQ(reply.status, STATUS_OK);
    EXPECT_EQ(reply.first, 37);
    EXPECT_EQ(reply.count, 3);
    reply_reread_unpack(&reply, reread(36, 1));
    EXPECT_EQ(reply.status, STATUS_GONE);
    reply_reread_unpack(&reply, reread(10, 10));
    EXPECT_EQ(reply.status, STATUS_GONE);
    EXPECT_EQ(reply.count, 0);
    reply_reread_unpack(&reply, reread(500, 10));
    EXPECT_EQ(reply.status, STATUS_GONE);
    reply_reread_unpack(&reply, reread(101, 1));
    EXPECT_EQ(reply.status, STATUS_GONE);
    reply_reread_unpack(&reply, reread(99, 10));
    EXPECT_EQ(reply.status, STATUS_OK);
    EXPECT_EQ(reply.count, 2);
    reply_reread_unpack(&reply, reread(99, 0));
    EXPECT_EQ(reply.status, STATUS_OUT_OF_RANGE);
    EXPECT_EQ(reply.detail, 1);
    reply_reread_unpack(&reply, reread(99, 65));
    EXPECT_EQ(reply.status, STATUS_OUT_OF_RANGE);
}

static void events_survive_65536_of_them(void)
{
    rig_start();
    static events_t events;
    memset(&events, 0, sizeof events);
    for (uint32_t i = 0; i < 70000U; i++) {
        events_emit(&events, EVENT_TURNTABLE_DONE)[0] = (uint8_t)i;
        uint16_t sequence;
        const event_t* const event = events_next(&events, &sequence);
        EXPECT_EQ(sequence, (uint16_t)i);
        EXPECT_EQ(event->payload[0], (uint8_t)i);
    }
    reply_reread_t reply = {0};
    static rereads_t rereads;
    EXPECT_EQ(events_reread(&events, &rereads, &(command_reread_t){.first = 4390, .count = 64}, &reply), STATUS_OK);
    EXPECT_EQ(reply.first, 70000 - 65536 - 64);
    EXPECT_EQ(reply.count, 54);
}

static void an_overrun_is_counted_and_reported_once_there_is_room(void)
{
    static events_t events;
    memset(&events, 0, sizeof events);
    for (uint32_t i = 0; i < EVENT_RING + 10U; i++) {
        events_emit(&events, EVENT_TURNTABLE_DONE);
        events_run(&events, i);
    }
    EXPECT_EQ(events.overruns, 10);
    uint16_t sequence;
    events_next(&events, &sequence);
    EXPECT_EQ(sequence, 10);
    const event_t* event = NULL;
    do {
        event = events_next(&events, &sequence);
        events_run(&events, 1000);
    } while ((event != NULL) && (event->id != EVENT_FAULT));
    EXPECT_EQ(event->payload[4], FAULT_EVENT_OVERRUN);
    EXPECT_EQ(event->payload[5], 10);
    EXPECT(events_next(&events, &sequence) == NULL);
}

static void an_event_overwritten_while_it_waits_to_be_sent_again_is_skipped(void)
{
    static events_t events;
    memset(&events, 0, sizeof events);
    uint16_t sequence;
    for (uint32_t i = 0; i < EVENT_RING; i++) {
        events_emit(&events, EVENT_TURNTABLE_DONE);
        events_next(&events, &sequence);
    }
    reply_reread_t reply;
    static rereads_t rereads;
    EXPECT_EQ(events_reread(&events, &rereads, &(command_reread_t){.first = 0, .count = 3}, &reply), STATUS_OK);
    events_emit(&events, EVENT_TURNTABLE_DONE);
    events_emit(&events, EVENT_TURNTABLE_DONE);
    EXPECT(events_again(&events, &rereads, &sequence) != NULL);
    EXPECT_EQ(sequence, 2);  // 0 and 1 have left the ring
    EXPECT(events_again(&events, &rereads, &sequence) == NULL);
    events_next(&events, &sequence);
    EXPECT_EQ(sequence, EVENT_RING);
}

// Red while a second promise overwrote the first: 15 + 10 were promised and 10 came.
static void every_event_promised_comes_however_many_rereads_are_outstanding(void)
{
    rig_start();
    for (int i = 0; i < 60; i++) {
        rig_edge(3 * MS);
    }
    rig_forget();
    native_stall_cpu(2 * MS);
    for (uint8_t i = 0; i < REREADS_MAX; i++) {
        uint8_t payload[COMMAND_REREAD_LENGTH];
        command_reread_pack(&(command_reread_t){.first = edge_sequence(5U * i), .count = (uint8_t)(i + 1U)}, payload);
        rig_send(COMMAND_REREAD, i, payload);
    }
    rig_pass(60 * MS);
    uint32_t promised = 0;
    for (uint8_t i = 0; i < REREADS_MAX; i++) {
        reply_reread_t reply;
        reply_reread_unpack(&reply, rig_take(REPLY_REREAD)->payload);
        EXPECT_EQ(reply.status, STATUS_OK);
        promised += reply.count;
        for (uint32_t k = 0; k <= i; k++) {
            EXPECT_EQ(rig_take(EVENT_EDGE)->sequence, edge_sequence(5U * i + k));
        }
    }
    EXPECT_EQ(promised, 36);
    EXPECT_EQ(rig_count(EVENT_EDGE), 0);
}

// An old event that a session did not ask for is what tells it of another boot.
static void a_new_session_gets_no_event_that_the_one_before_asked_for(void)
{
    rig_start();
    for (int i = 0; i < 60; i++) {
        rig_edge(3 * MS);
    }
    rig_forget();
    native_stall_cpu(1 * MS);
    rig_send(COMMAND_REREAD, 1, (const uint8_t[]){1, 0, 60});
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, payload);
    rig_send(COMMAND_IDENTIFY, 2, payload);
    rig_pass(60 * MS);
    EXPECT_EQ(rig_count(REPLY_REREAD), 1);
    EXPECT(rig_count(EVENT_EDGE) <= 3U);  // those that were on their way
}

static void a_promise_that_cannot_be_kept_is_not_made(void)
{
    static events_t events;
    static rereads_t rereads;
    memset(&events, 0, sizeof events);
    memset(&rereads, 0, sizeof rereads);
    for (uint32_t i = 0; i < 20U; i++) {
        events_emit(&events, EVENT_TURNTABLE_DONE);
    }
    const command_reread_t two = {.first = 3, .count = 2};
    for (uint32_t i = 0; i < REREADS_MAX; i++) {
        reply_reread_t reply = {0};
        EXPECT_EQ(events_reread(&events, &rereads, &two, &reply), STATUS_OK);
    }
    reply_reread_t refused = {0};
    EXPECT_EQ(events_reread(&events, &rereads, &two, &refused), STATUS_BAD_STATE);
    EXPECT_EQ(refused.count, 0);
    uint16_t sequence;
    uint32_t sent = 0;
    while (events_again(&events, &rereads, &sequence) != NULL) {
        sent++;
    }
    EXPECT_EQ(sent, 2U * REREADS_MAX);
}

void link_tests(void)
{
    RUN(every_golden_vector_is_reproduced);
    RUN(every_command_vector_is_received);
    RUN(every_bad_frame_is_refused_counted_and_notified);
    RUN(empty_frames_are_no_fault);
    RUN(a_zero_code_byte_is_not_cobs);
    RUN(a_repeated_command_is_acknowledged_again_but_not_executed_again);
    RUN(queries_are_always_fresh);
    RUN(a_new_session_never_gets_an_old_answer);
    RUN(a_host_that_sends_more_than_there_is_room_for_answers_waits_and_loses_nothing);
    RUN(identify_says_who_and_locks_on_a_schema_mismatch);
    RUN(a_reset_needs_its_magic_is_acknowledged_and_changes_the_boot_byte);
    RUN(the_boot_loader_is_entered_on_its_magic_with_outputs_low_and_never_while_anything_is_armed);
    RUN(a_frame_cut_short_by_a_reset_does_not_spoil_the_next_one);
    RUN(the_last_64_events_can_be_read_again_unchanged);
    RUN(events_survive_65536_of_them);
    RUN(an_overrun_is_counted_and_reported_once_there_is_room);
    RUN(an_event_overwritten_while_it_waits_to_be_sent_again_is_skipped);
    RUN(every_event_promised_comes_however_many_rereads_are_outstanding);
    RUN(a_new_session_gets_no_event_that_the_one_before_asked_for);
    RUN(a_promise_that_cannot_be_kept_is_not_made);
}
