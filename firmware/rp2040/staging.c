// Where a new application is kept: flash behind the running one. The loader takes it from there (loader.c).

#include <string.h>

#include "../application.h"
#include "../board.h"
#include "../core/messages.h"
#include "flash.h"
#include "hardware.h"

#define ERASE_MAX_MS 1000U  // the chip's maker says 400

static const uint8_t* flash_at(const uint32_t at)
{
    return (const uint8_t*)(uintptr_t)(FLASH_START + at);
}

__attribute__((noinline, long_call, section(".in_ram"))) static void
write_from_ram(const flash_t* const flash, const uint32_t at, const uint8_t* const page)
{
    flash_write(flash, at, page);
}

// The watchdog is given time for the slowest erase; the round after this one takes it back.
static void write(const uint32_t at, const uint8_t* const page)
{
    flash_t flash;
    flash_prepare(&flash);
    interrupts_off();
    const uint32_t since = time_before_blindness();
    REGISTER(WATCHDOG_LOAD) = ERASE_MAX_MS * 2000U;
    write_from_ram(&flash, at, page);
    time_after_blindness(since);
    interrupts_on();
}

// A page is programmed in pieces, each with ones around it: no buffer in RAM, and nothing to lose.
static void write_piece(const uint32_t at, const void* const piece, const size_t size)
{
    uint8_t page[PAGE_BYTES];
    memset(page, 0xFF, sizeof page);
    memcpy(page + at % PAGE_BYTES, piece, size);
    write(at - at % PAGE_BYTES, page);
}

void board_update_write(const uint32_t offset, const uint8_t* const chunk)
{
    if (offset % SECTOR_BYTES == 0U) {
        write(STAGED_AT + offset, NULL);
    }
    write_piece(STAGED_AT + offset, chunk, UPDATE_CHUNK_BYTES);
}

const uint8_t* board_update_staged(void)
{
    return flash_at(STAGED_AT);
}

bool board_update_starts_at(const uint32_t entry)
{
    return ((entry & 1U) != 0U) && (entry - FLASH_START - APPLICATION_AT < UPDATE_MAX_BYTES);
}

void board_update_commit(void)
{
    record_t record = {.magic = RECORD_MAGIC,
                       .crc = application_crc(flash_at(STAGED_AT)),
                       .replaces = application_crc(flash_at(APPLICATION_AT)),
                       .begun = RECORD_UNTOUCHED,
                       .done = RECORD_UNTOUCHED};
    record.check = crc32_of((const uint8_t*)&record, RECORD_CHECKED_BYTES);
    write(RECORD_AT, NULL);
    write_piece(RECORD_AT, &record, sizeof record);
}
