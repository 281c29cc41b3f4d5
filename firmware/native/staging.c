// Keeps a new application that nothing starts: this board always runs the core it was linked with.

#include <string.h>

#include "hardware.h"

static uint8_t staged[UPDATE_MAX_BYTES + UPDATE_CHUNK_BYTES];

void board_update_write(const uint32_t offset, const uint8_t* const chunk)
{
    memcpy(staged + offset, chunk, UPDATE_CHUNK_BYTES);
}

const uint8_t* board_update_staged(void)
{
    return staged;
}

bool board_update_starts_at(const uint32_t entry)
{
    return entry != 0U;
}

void board_update_commit(void)
{
}
