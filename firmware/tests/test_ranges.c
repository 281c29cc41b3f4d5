// What every field may be: its last value is taken, the one beyond it is refused by the field's own index.

#include "check.h"
#include "rig.h"

#define FARTHEST ((uint32_t)TURNTABLE_POSITION_MAX_STEPS)

// Sets up a payload whose every field may be so.
static void ordinary(const uint8_t id, uint8_t* const payload)
{
    const command_stage_t stage = rig_config(1, 4);
    switch (id) {
    case COMMAND_STAGE:
        command_stage_pack(&stage, payload);
        break;
    case COMMAND_REREAD:
        command_reread_pack(&(command_reread_t){.count = 1}, payload);
        break;
    case COMMAND_PATTERN:
        command_pattern_pack(&(command_pattern_t){.length = 8, .chips = {1}}, payload);
        break;
    case COMMAND_BURST:
        command_burst_pack(&(command_burst_t){.code = BURST_CODE_SINGLE, .chip = 100, .repeat = 1, .period = 10000},
                           payload);
        break;
    case COMMAND_MOVE:
        command_move_pack(&(command_move_t){.position = 1, .period = 10000}, payload);
        break;
    case COMMAND_INFO:
        command_info_pack(&(command_info_t){.level = LEVEL}, payload);
        break;
    case COMMAND_TURNTABLE:
        command_turntable_pack(
            &(command_turntable_t){.lowest = -9, .highest = 9, .acceleration = 9, .start_period = 10000}, payload);
        break;
    case COMMAND_MEASURE:
        command_measure_pack(&(command_measure_t){.looks = 1, .pin = PIN_SYNC, .first = PIN_SYNC}, payload);
        break;
    case COMMAND_SAMPLES:
        command_samples_pack(&(command_samples_t){.latest = 0}, payload);
        break;
    case COMMAND_UPDATE_BEGIN:
        command_update_begin_pack(&(command_update_begin_t){.size = 1000, .board = "native"}, payload);
        break;
    default:
        EXPECT(false);
    }
}

// Sends one with `size` bytes at `at` put to `value`: is it refused because of this field?
static bool refuses(const uint8_t id, const uint8_t field, const uint8_t at, const uint8_t size, const uint32_t value)
{
    uint8_t payload[PAYLOAD_MAX];
    rig_start();
    ordinary(id, payload);
    for (uint8_t i = 0; i < size; i++) {
        payload[at + i] = (uint8_t)(value >> (8U * i));
    }
    const uint8_t* const reply = rig_command(id, payload);
    EXPECT(reply != NULL);
    return (reply != NULL) && (reply[0] == STATUS_OUT_OF_RANGE) && (reply[1] == field);
}

static void every_field_is_taken_up_to_its_limit_and_refused_beyond(void)
{
    static const struct {
        uint8_t id;
        uint8_t field;
        uint8_t at;
        uint8_t size;
        uint32_t last;
        uint32_t beyond;
    } limits[] = {
        {COMMAND_STAGE, 0, 0, 1, 1, 0},
        {COMMAND_STAGE, 1, 1, 1, 15, 16},
        {COMMAND_STAGE, 5, 14, 2, 1, 0},
        {COMMAND_STAGE, 5, 14, 2, 500, 501},
        {COMMAND_REREAD, 1, 2, 1, 1, 0},
        {COMMAND_REREAD, 1, 2, 1, 64, 65},
        {COMMAND_PATTERN, 0, 0, 2, 1, 0},
        {COMMAND_PATTERN, 0, 0, 2, 256, 257},
        {COMMAND_BURST, 0, 0, 1, 6, 7},
        {COMMAND_BURST, 2, 3, 2, 1, 0},
        {COMMAND_MOVE, 0, 0, 4, FARTHEST, FARTHEST + 1U},
        {COMMAND_MOVE, 0, 0, 4, 0U - FARTHEST, 0U - FARTHEST - 1U},
        {COMMAND_MOVE, 1, 4, 4, TURNTABLE_PERIOD_MIN_TICKS, TURNTABLE_PERIOD_MIN_TICKS - 1U},
        {COMMAND_MOVE, 2, 8, 1, 1, 2},
        {COMMAND_INFO, 0, 0, 1, 1, 0},
        {COMMAND_TURNTABLE, 0, 0, 4, 0U - FARTHEST, 0U - FARTHEST - 1U},
        {COMMAND_TURNTABLE, 0, 0, 4, FARTHEST, FARTHEST + 1U},
        {COMMAND_TURNTABLE, 1, 4, 4, FARTHEST, FARTHEST + 1U},
        {COMMAND_TURNTABLE, 1, 4, 4, (uint32_t)-9, (uint32_t)-10},  // `lowest`
        {COMMAND_TURNTABLE, 2, 8, 4, TURNTABLE_ACCELERATION_MAX, TURNTABLE_ACCELERATION_MAX + 1U},
        {COMMAND_TURNTABLE, 3, 12, 4, TURNTABLE_PERIOD_MIN_TICKS, TURNTABLE_PERIOD_MIN_TICKS - 1U},
        {COMMAND_TURNTABLE, 3, 12, 4, TURNTABLE_START_PERIOD_MAX_TICKS, TURNTABLE_START_PERIOD_MAX_TICKS + 1U},
        {COMMAND_TURNTABLE, 4, 16, 1, 7, 8},
        {COMMAND_MEASURE, 1, 2, 1, 29, 30},
        {COMMAND_MEASURE, 2, 3, 1, 1, 2},
        {COMMAND_MEASURE, 3, 4, 1, 26, 27},
        {COMMAND_SAMPLES, 0, 0, 1, 1, 2},
        {COMMAND_SAMPLES, 1, 1, 1, 56, 57},
        {COMMAND_UPDATE_BEGIN, 0, 0, 4, 256, 255},
        {COMMAND_UPDATE_BEGIN, 0, 0, 4, UPDATE_MAX_BYTES, UPDATE_MAX_BYTES + 1U},
    };
    for (size_t i = 0; i < sizeof limits / sizeof limits[0]; i++) {
        const uint8_t id = limits[i].id, field = limits[i].field, at = limits[i].at, size = limits[i].size;
        EXPECT_EQ(refuses(id, field, at, size, limits[i].last) ? (int)i : -1, -1);
        EXPECT_EQ(refuses(id, field, at, size, limits[i].beyond) ? (int)i : -1, i);
    }
}

void ranges_tests(void)
{
    RUN(every_field_is_taken_up_to_its_limit_and_refused_beyond);
}
