// A new application over the line: what is taken, what is refused, and that nothing can be armed meanwhile.

#include <string.h>

#include "../application.h"
#include "check.h"
#include "rig.h"

#define SIZE 1000U

static uint8_t made[1024];

static void put_word(const uint32_t at, const uint32_t word)
{
    for (uint32_t i = 0; i < 4U; i++) {
        made[at + i] = (uint8_t)(word >> (8U * i));
    }
}

static void seal(void)
{
    put_word(SIZE - 4U, crc32_of(made, SIZE - 4U));
}

static void make(void)
{
    memset(made, 0xFF, sizeof made);
    for (uint32_t i = 0; i < SIZE; i++) {
        made[i] = (uint8_t)(i * 7U);
    }
    put_word(APPLICATION_SIZE_AT, SIZE);
    memcpy(made + APPLICATION_NAME_AT, "annulus native 0.1.0", 20);
    seal();
}

static reply_update_begin_t begin(const uint32_t size, const uint32_t crc, const char* const board)
{
    command_update_begin_t command = {.size = size, .crc = crc};
    memcpy(command.board, board, strlen(board));
    uint8_t payload[COMMAND_UPDATE_BEGIN_LENGTH];
    command_update_begin_pack(&command, payload);
    reply_update_begin_t reply;
    reply_update_begin_unpack(&reply, rig_command(COMMAND_UPDATE_BEGIN, payload));
    return reply;
}

static reply_update_begin_t begin_ours(void)
{
    return begin(SIZE, application_word(made + SIZE - 4U), "native");
}

static reply_update_data_t data(const uint32_t offset)
{
    command_update_data_t command = {.offset = offset};
    memcpy(command.chunk, made + offset % SIZE, UPDATE_CHUNK_BYTES);
    uint8_t payload[COMMAND_UPDATE_DATA_LENGTH];
    command_update_data_pack(&command, payload);
    reply_update_data_t reply;
    reply_update_data_unpack(&reply, rig_command(COMMAND_UPDATE_DATA, payload));
    return reply;
}

static void send(const uint32_t from, const uint32_t to)
{
    for (uint32_t offset = from; offset < to; offset += UPDATE_CHUNK_BYTES) {
        const reply_update_data_t reply = data(offset);
        EXPECT_EQ(reply.status, STATUS_OK);
        EXPECT_EQ(reply.next, offset + UPDATE_CHUNK_BYTES);
    }
}

static void end_is(const uint8_t status, const uint8_t detail)
{
    const uint8_t* const reply = rig_command(COMMAND_UPDATE_END, NULL);
    EXPECT_EQ(reply[0], status);
    EXPECT_EQ(reply[1], detail);
}

static void a_whole_application_restarts_the_controller(void)
{
    rig_start();
    make();
    EXPECT_EQ(begin_ours().status, STATUS_OK);
    send(0, SIZE);
    rig_forget();
    end_is(STATUS_OK, 0);
    rig_pass(5 * MS);
    EXPECT_EQ(rig_take(EVENT_BOOTED)->payload[0], BOOT_CAUSE_HOST_RESET);
}

static void an_update_that_broke_off_goes_on_and_another_begins_anew(void)
{
    rig_start();
    make();
    begin_ours();
    send(0, 320);
    EXPECT_EQ(begin_ours().next, 320);
    EXPECT_EQ(data(0).next, 320);
    EXPECT_EQ(data(384).status, STATUS_BAD_STATE);
    EXPECT_EQ(data(384).detail, UPDATE_REFUSAL_INCOMPLETE);
    EXPECT_EQ(data(7).status, STATUS_BAD_STATE);
    end_is(STATUS_BAD_STATE, UPDATE_REFUSAL_INCOMPLETE);
    EXPECT_EQ(begin(SIZE, 1, "native").next, 0);
    EXPECT_EQ(begin_ours().next, 0);
    send(0, SIZE);
    EXPECT_EQ(data(SIZE / 32U * 32U + 32U).next, SIZE / 32U * 32U + 32U);  // past the end: nothing is written
    end_is(STATUS_OK, 0);
}

static void what_is_damaged_or_foreign_is_refused(void)
{
    static const struct {
        uint32_t at;
        uint8_t flip;
        bool sealed;
        uint8_t refusal;
    } cases[] = {
        {500, 4, false, UPDATE_REFUSAL_DAMAGED},
        {APPLICATION_SIZE_AT, 4, true, UPDATE_REFUSAL_DAMAGED},
        {APPLICATION_NAME_AT, 1, true, UPDATE_REFUSAL_DAMAGED},
        {APPLICATION_NAME_AT + 5U, 1, true, UPDATE_REFUSAL_FOREIGN},
        {APPLICATION_NAME_AT + 9U, 1, true, UPDATE_REFUSAL_FOREIGN},
        {APPLICATION_NAME_AT + 14U, 1, true, UPDATE_REFUSAL_FOREIGN},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        rig_start();
        make();
        made[cases[i].at] ^= cases[i].flip;
        if (cases[i].sealed) {
            seal();
        }
        begin(SIZE, application_word(made + SIZE - 4U), "native");
        send(0, SIZE);
        end_is(STATUS_BAD_STATE, cases[i].refusal);
        end_is(STATUS_BAD_STATE, UPDATE_REFUSAL_NOT_NOW);
        EXPECT_EQ(rig_count(EVENT_BOOTED), 0);
    }
    rig_start();
    make();
    memset(made + 4, 0, 4);  // it would start nowhere
    seal();
    begin_ours();
    send(0, SIZE);
    end_is(STATUS_BAD_STATE, UPDATE_REFUSAL_FOREIGN);
    rig_start();
    make();
    begin(SIZE, application_word(made + SIZE - 4U) ^ 1U, "native");  // whole, but another than was announced
    send(0, SIZE);
    end_is(STATUS_BAD_STATE, UPDATE_REFUSAL_DAMAGED);
}

static void an_update_is_refused_out_of_range_or_while_anything_is_armed_or_moves(void)
{
    rig_start();
    make();
    EXPECT_EQ(begin(SIZE, 1, "rp2040").status, STATUS_OUT_OF_RANGE);
    EXPECT_EQ(begin(SIZE, 1, "rp2040").detail, 2);
    EXPECT_EQ(begin(UPDATE_MAX_BYTES + 1U, 1, "native").detail, 0);
    EXPECT_EQ(data(0).detail, UPDATE_REFUSAL_NOT_NOW);
    const command_stage_t config = rig_config(1, 0);
    rig_configure(&config);
    rig_arm(ARM_LAMPS);
    EXPECT_EQ(begin_ours().status, STATUS_BAD_STATE);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){0}), STATUS_OK);
    uint8_t move[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = 30, .period = 100000}, move);
    EXPECT_EQ(rig_status_of(COMMAND_MOVE, move), STATUS_OK);
    EXPECT_EQ(begin_ours().status, STATUS_BAD_STATE);
}

static void nothing_is_armed_or_moved_while_an_update_is_under_way(void)
{
    rig_start();
    make();
    const command_stage_t config = rig_config(1, 0);
    rig_configure(&config);
    begin_ours();
    uint8_t move[COMMAND_MOVE_LENGTH];
    command_move_pack(&(command_move_t){.position = 30, .period = 100000}, move);
    EXPECT_EQ(rig_status_of(COMMAND_MOVE, move), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){0}), STATUS_OK);
    rig_pass(4000 * MS);
    send(0, 32);  // not given up: heard from again
    rig_pass(4900 * MS);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_BAD_STATE);
    rig_pass(200 * MS);
    EXPECT_EQ(rig_status_of(COMMAND_ARM, (const uint8_t[]){ARM_LAMPS}), STATUS_OK);
    EXPECT_EQ(data(32).status, STATUS_BAD_STATE);
}

static void an_update_belongs_to_the_session_and_needs_no_common_schema(void)
{
    rig_start();
    make();
    native_usb_connect(true);
    rig_over_usb(true);
    rig_pass(MS);
    EXPECT_EQ(begin_ours().status, STATUS_SCHEMA);
    EXPECT_EQ(data(0).status, STATUS_SCHEMA);
    end_is(STATUS_SCHEMA, 0);
    uint8_t other[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH ^ 1U}, other);
    EXPECT_EQ(rig_status_of(COMMAND_IDENTIFY, other), STATUS_SCHEMA);
    EXPECT_EQ(begin_ours().status, STATUS_OK);
    send(0, SIZE);
    end_is(STATUS_OK, 0);
    rig_over_usb(false);
}

void update_tests(void)
{
    RUN(a_whole_application_restarts_the_controller);
    RUN(an_update_that_broke_off_goes_on_and_another_begins_anew);
    RUN(what_is_damaged_or_foreign_is_refused);
    RUN(an_update_is_refused_out_of_range_or_while_anything_is_armed_or_moves);
    RUN(nothing_is_armed_or_moved_while_an_update_is_under_way);
    RUN(an_update_belongs_to_the_session_and_needs_no_common_schema);
}
