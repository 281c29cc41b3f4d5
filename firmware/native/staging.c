// Keeps a new application that nothing starts: this board always runs the core it was linked with. It writes as fast as
// it is asked.

#include <string.h>

#include "hardware.h"

static uint8_t staged[UPDATE_MAX_BYTES + UPDATE_CHUNK_BYTES];

void board_image(board_image_t* const image)
{
    *image = (board_image_t){.flash = IMAGE_FLASH_WHOLE};
}

void board_image_confirm(void)
{
}

void board_update_write(const uint32_t offset, const uint8_t* const chunk)
{
    memcpy(staged + offset, chunk, UPDATE_CHUNK_BYTES);
}

bool board_update_run(void)
{
    return false;
}

void board_update_read(const uint32_t offset, uint8_t* const bytes, const uint32_t size)
{
    memcpy(bytes, staged + offset, size);
}

bool board_update_starts_at(const uint32_t entry)
{
    return entry != 0U;
}

void board_update_commit(const uint32_t crc, const uint8_t* const head)
{
    (void)crc;
    memcpy(staged + BOARD_UPDATE_HEAD_AT, head, UPDATE_CHUNK_BYTES);
}
