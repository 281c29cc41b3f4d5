// What a controller says of itself, and at which level it speaks.

#include <stdio.h>
#include <string.h>

#include "rig.h"
#include "check.h"
#include "events.h"
#include "link.h"

static reply_info_t info(const uint8_t level)
{
    reply_info_t reply;
    reply_info_unpack(&reply, rig_command(COMMAND_INFO, &level));
    return reply;
}

static reply_crash_t crash(void)
{
    reply_crash_t reply;
    reply_crash_unpack(&reply, rig_command(COMMAND_CRASH, NULL));
    return reply;
}

static reply_configuration_t configuration(void)
{
    reply_configuration_t reply;
    reply_configuration_unpack(&reply, rig_command(COMMAND_CONFIGURATION, NULL));
    return reply;
}

static uint8_t identify(void)
{
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, payload);
    return rig_status_of(COMMAND_IDENTIFY, payload);
}

static void info_says_version_number_and_what_is_known(void)
{
    rig_start();
    const reply_info_t reply = info(LEVEL);
    EXPECT_EQ(reply.status, STATUS_OK);
    EXPECT_EQ(reply.level, LEVEL);
    char version[16];
    snprintf(version, sizeof version, "%u.%u.%u", reply.major, reply.minor, reply.patch);
    EXPECT_EQ(strcmp(version, ANNULUS_VERSION), 0);
    for (size_t i = 0; i < sizeof reply.serial; i++) {
        EXPECT((reply.serial[i] >= '0') && (reply.serial[i] <= '9'));
    }
    for (uint8_t id = 0; id < REPLY_BIT; id++) {
        const bool said = ((reply.commands[id / 8U] >> (id % 8U)) & 1U) != 0U;
        EXPECT_EQ(said, layout_of(id) != NULL);
    }
    for (uint8_t bit = 0; bit < 32U; bit++) {
        EXPECT_EQ((reply.events >> bit) & 1U, layout_of((uint8_t)(0x80U + bit)) != NULL);
    }
    EXPECT_EQ(info(0).status, STATUS_OUT_OF_RANGE);
}

static void the_nonce_changes_with_every_boot_though_the_boot_byte_does_not(void)
{
    rig_start();
    uint32_t nonces[8];
    for (uint32_t i = 0; i < 8U; i++) {
        nonces[i] = info(LEVEL).nonce;
        EXPECT_EQ(info(LEVEL).nonce, nonces[i]);
        for (uint32_t k = 0; k < i; k++) {
            EXPECT(nonces[k] != nonces[i]);
        }
        native_power_on(1, BOOT_CAUSE_POWER_ON);
        rig_pass(1 * MS);
    }
}

static void the_configuration_in_force_is_read_back_whole(void)
{
    rig_start();
    reply_configuration_t back = configuration();
    EXPECT_EQ(back.generation, 0);
    EXPECT_EQ(back.crc, 0);
    EXPECT_EQ(info(LEVEL).configuration, 0);
    command_stage_t config = rig_config(7, 4);
    config.host_timeout = 321;
    rig_configure(&config);
    back = configuration();
    uint8_t asked[COMMAND_STAGE_LENGTH];
    command_stage_pack(&config, asked);
    const command_stage_t found = {.generation = back.generation,
                                   .ratio = back.ratio,
                                   .frame_period = back.frame_period,
                                   .exposure = back.exposure,
                                   .readout = back.readout,
                                   .tolerance = back.tolerance,
                                   .host_timeout = back.host_timeout,
                                   .projector_delay = back.projector_delay,
                                   .projector_width = back.projector_width,
                                   .led_delay = back.led_delay,
                                   .led_width = back.led_width};
    uint8_t in_force[COMMAND_STAGE_LENGTH];
    command_stage_pack(&found, in_force);
    EXPECT_EQ(memcmp(asked, in_force, sizeof asked), 0);
    EXPECT_EQ(back.crc, link_crc(asked, sizeof asked, layout_of(COMMAND_STAGE)->schema));
    EXPECT_EQ(info(LEVEL).configuration, back.crc);
    // Staged and waiting for slot 0, another one is not yet in force.
    rig_arm(ARM_LAMPS);
    rig_edge(PERIOD);
    rig_edge(PERIOD);
    config.generation = 8;
    rig_configure(&config);
    EXPECT_EQ(configuration().generation, 7);
    for (int i = 0; i < 5; i++) {
        rig_edge(PERIOD);
    }
    EXPECT_EQ(configuration().generation, 8);
}

static void a_stalled_loop_leaves_a_record_that_outlives_resets_but_not_the_power(void)
{
    rig_start();
    EXPECT_EQ(crash().kind, CRASH_NONE);
    EXPECT_EQ(crash().boots, 1);
    native_stall_cpu(60 * MS);
    rig_pass(70 * MS);
    EXPECT_EQ(crash().crashes, 0);
    const uint32_t longest = info(LEVEL).round_longest;
    EXPECT((longest >= 60 * MS) && (longest < 61 * MS));
    native_stall_cpu(200 * MS);
    rig_pass(300 * MS);
    reply_crash_t record = crash();
    EXPECT_EQ(record.kind, CRASH_STUCK);
    EXPECT_EQ(record.crashes, 1);
    EXPECT_EQ(record.boot, 1);
    EXPECT_EQ(record.boots, 2);
    EXPECT_EQ(record.command, COMMAND_INFO);
    EXPECT_EQ(record.round_longest, longest);
    EXPECT_EQ(info(LEVEL).crashes, 1);
    uint8_t payload[COMMAND_RESET_LENGTH];
    command_reset_pack(&(command_reset_t){.magic = RESET_MAGIC}, payload);
    rig_command(COMMAND_RESET, payload);
    rig_pass(10 * MS);
    record = crash();
    EXPECT_EQ(record.crashes, 1);
    EXPECT_EQ(record.boots, 3);
    native_power_on(9, BOOT_CAUSE_POWER_ON);
    rig_pass(1 * MS);
    EXPECT_EQ(crash().crashes, 0);
    EXPECT_EQ(crash().boots, 1);
}

// Of level 0 is nothing, so to a host of level 0 everything is new.
static void what_a_host_cannot_read_comes_as_a_fault_and_keeps_its_place(void)
{
    static const event_t edge = {.id = EVENT_EDGE, .payload = {1, 2, 3, 4, 5, 6, 7, 8, 9}};
    event_t said = events_at_level(&edge, 1);
    EXPECT_EQ(memcmp(&said, &edge, sizeof said), 0);
    said = events_at_level(&edge, 0);
    event_fault_t fault;
    event_fault_unpack(&fault, said.payload);
    EXPECT_EQ(said.id, EVENT_FAULT);
    EXPECT_EQ(fault.tick, 0x04030201);
    EXPECT_EQ(fault.fault, FAULT_NONE);
    EXPECT_EQ(fault.detail, EVENT_EDGE);
    for (uint8_t code = FAULT_NONE; code <= FAULT_LIMIT; code++) {
        EXPECT_EQ(events_fault_at_level(code, 1), code);
    }
    EXPECT_EQ(events_fault_at_level(FAULT_HOST_TIMEOUT, 0), FAULT_LIMIT);
    static const event_t odometer = {.id = EVENT_FAULT, .payload = {1, 0, 0, 0, FAULT_ODOMETER, 9}};
    said = events_at_level(&odometer, 1);
    event_fault_unpack(&fault, said.payload);
    EXPECT_EQ(fault.fault, FAULT_NONE);  // `limit` would have an old host disarm and clear
    EXPECT_EQ(fault.detail, FAULT_ODOMETER);
    said = events_at_level(&odometer, 2);
    EXPECT_EQ(memcmp(&said, &odometer, sizeof said), 0);
}

static void a_level_lasts_until_the_next_identify_of_its_line(void)
{
    rig_start();
    EXPECT_EQ(info(200).level, LEVEL);
    EXPECT_EQ(identify(), STATUS_OK);
    EXPECT_EQ(info(1).level, LEVEL);
}

static void counters_of_16_bits_stop_at_their_end(void)
{
    static link_t link;
    link_start(&link);
    static events_t events;
    for (uint32_t i = 0; i < UINT16_MAX + 2U * EVENT_RING; i++) {
        command_t command;
        bool alive = false;
        link_receive(&link, 1, &command, &alive);
        link_receive(&link, 0, &command, &alive);
        events_emit(&events, EVENT_BOOTED);
    }
    EXPECT_EQ(link.bad_frames, UINT16_MAX);
    EXPECT_EQ(events.overruns, UINT16_MAX);
}

void queries_tests(void)
{
    RUN(counters_of_16_bits_stop_at_their_end);
    RUN(info_says_version_number_and_what_is_known);
    RUN(the_nonce_changes_with_every_boot_though_the_boot_byte_does_not);
    RUN(the_configuration_in_force_is_read_back_whole);
    RUN(a_stalled_loop_leaves_a_record_that_outlives_resets_but_not_the_power);
    RUN(what_a_host_cannot_read_comes_as_a_fault_and_keeps_its_place);
    RUN(a_level_lasts_until_the_next_identify_of_its_line);
}
