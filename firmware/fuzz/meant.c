// Commands as a host that means well would send them.

#include <string.h>

#include "../application.h"
#include "../board.h"
#include "fuzz.h"

#define APPLICATION_BYTES 256U

// An application that the native board would take for one of its own.
static const uint8_t* application(void)
{
    static uint8_t made[APPLICATION_BYTES];
    memset(made, 1, sizeof made);  // its vectors lead somewhere
    const uint32_t size = APPLICATION_BYTES;
    memcpy(made + APPLICATION_SIZE_AT, (const uint8_t[]){(uint8_t)size, (uint8_t)(size >> 8), 0, 0}, 4);
    memcpy(made + APPLICATION_NAME_AT, "annulus native 0.1.0", 20);
    const uint32_t crc = crc32_of(made, APPLICATION_BYTES - 4U);
    for (uint32_t i = 0; i < 4U; i++) {
        made[APPLICATION_BYTES - 4U + i] = (uint8_t)(crc >> (8U * i));
    }
    return made;
}

static void stage(const uint8_t* const bytes, uint8_t* const payload)
{
    const uint32_t period = FRAME_PERIOD_MIN_TICKS + 2000U * bytes[0];
    const uint32_t open = (bytes[1] & 1U) * (period / 4U);
    command_stage_pack(&(command_stage_t){.generation = 1U + bytes[2] % 3U,
                                          .ratio = bytes[3] % 5U,
                                          .frame_period = period,
                                          .exposure = period - open,
                                          .readout = period / 4U,
                                          .tolerance = 1U + bytes[4],
                                          .host_timeout = (bytes[5] == 0U) ? 0U : HOST_TIMEOUT_MIN_MS + bytes[5],
                                          .projector_delay = open + 100U * bytes[6],
                                          .projector_width = 400U * bytes[7],
                                          .led_delay = open + 100U * bytes[8],
                                          .led_width = 400U * bytes[9]},
                       payload);
}

static void burst(const uint8_t* const bytes, uint8_t* const payload)
{
    command_burst_pack(&(command_burst_t){.code = bytes[0] % (BURST_CODE_MANCHESTER2 + 1U),
                                          .chip = CHIP_MIN_TICKS + bytes[1],
                                          .repeat = 1U + bytes[2],
                                          .period = BURST_PERIOD_MIN_TICKS + 4000U * bytes[3],
                                          .trigger_offset = (int8_t)bytes[4]},
                       payload);
}

static void turntable(const uint8_t* const bytes, uint8_t* const payload)
{
    command_turntable_pack(&(command_turntable_t){.lowest = -8 * (int32_t)bytes[0],
                                                  .highest = 8 * (int32_t)bytes[1],
                                                  .acceleration = 1000U * bytes[2],
                                                  .start_period = TURNTABLE_PERIOD_MIN_TICKS + 1000U * bytes[3],
                                                  .switches = bytes[4] % 8U},
                           payload);
}

void meant_payload(const layout_t* const layout, const uint8_t bytes[const PAYLOAD_MAX],
                   uint8_t payload[const PAYLOAD_MAX])
{
    memcpy(payload, bytes, PAYLOAD_MAX);
    switch (layout->id) {
    case COMMAND_IDENTIFY:
        command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, payload);
        break;
    case COMMAND_RESET:
        command_reset_pack(&(command_reset_t){.magic = RESET_MAGIC}, payload);
        break;
    case COMMAND_BOOTLOADER:
        command_bootloader_pack(&(command_bootloader_t){.magic = BOOTLOADER_MAGIC}, payload);
        break;
    case COMMAND_STAGE:
        stage(bytes, payload);
        break;
    case COMMAND_COMMIT:
        command_commit_pack(&(command_commit_t){.generation = 1U + bytes[0] % 3U}, payload);
        break;
    case COMMAND_ARM:
        command_arm_pack(&(command_arm_t){.outputs = bytes[0] % 4U}, payload);
        break;
    case COMMAND_SLIDES:
        command_slides_pack(&(command_slides_t){.generation = 1U + bytes[0] % 3U, .count = 1U + bytes[1] % SLIDES_MAX},
                            payload);
        break;
    case COMMAND_PREAMBLE:
        command_preamble_pack(&(command_preamble_t){.length = bytes[0] % (PREAMBLE_MAX + 1U),
                                                    .interval = bytes[1] % 4U,
                                                    .now = bytes[2] & 1U},
                              payload);
        break;
    case COMMAND_BURST:
        burst(bytes, payload);
        break;
    case COMMAND_PATTERN:
        payload[0] = 1U + bytes[0] % 8U;  // chips, and none past them
        payload[1] = 0;
        memset(payload + 2, 0, layout->length - 2U);
        payload[2] = (uint8_t)(bytes[1] & ((1U << payload[0]) - 1U));
        break;
    case COMMAND_TURNTABLE:
        turntable(bytes, payload);
        break;
    case COMMAND_MOVE:
        command_move_pack(&(command_move_t){.position = 8 * (int8_t)bytes[0],
                                            .period = TURNTABLE_PERIOD_MIN_TICKS + 100U * bytes[1],
                                            .hold = bytes[2] & 1U},
                          payload);
        break;
    case COMMAND_UPDATE_BEGIN: {
        command_update_begin_t begin = {.size = APPLICATION_BYTES,
                                        .crc = application_word(application() + APPLICATION_BYTES - 4U)};
        memcpy(begin.board, "native", sizeof "native" - 1U);
        command_update_begin_pack(&begin, payload);
        break;
    }
    case COMMAND_UPDATE_DATA: {
        command_update_data_t data = {.offset =
                                          (bytes[0] % (APPLICATION_BYTES / UPDATE_CHUNK_BYTES)) * UPDATE_CHUNK_BYTES};
        memcpy(data.chunk, application() + data.offset, sizeof data.chunk);
        command_update_data_pack(&data, payload);
        break;
    }
    default:
        break;
    }
}
