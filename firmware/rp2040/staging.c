// A new application is kept in the slot of flash that does not run, and the loader is told of it in the records
// (flash.h). The flash works by itself: what is asked for here begins at once, and each round looks whether it is done.

#include <stddef.h>
#include <string.h>

#include "../application.h"
#include "../board.h"
#include "../core/messages.h"
#include "../ticks.h"
#include "flash.h"
#include "hardware.h"

// A flash that says it is busy for longer is taken as done: what was written is read back anyway.
#define FLASH_TICKS_MAX ((int32_t)TICK_HZ)  // 1 s; the chip's maker says 0.4 for a sector

_Static_assert(UPDATE_CHUNK_BYTES <= FLASH_PROGRAM_MAX, "a chunk is programmed at once");

static struct {
    bool works;
    uint32_t since;
    bool programs;  // once the erase is done
    uint32_t at;
    uint32_t words[FLASH_PROGRAM_MAX / 4U];
    bool confirms;  // once the flash is free
    bool commits;   // the same
    uint32_t crc;   // of what it commits
} staging;

static uint32_t page_at(const uint32_t page)
{
    return RECORDS_AT + page * PAGE_BYTES;
}

static uint32_t slot_beside(void)
{
    return SLOT_AT(1U - image_slot());
}

static void begins(void)
{
    staging.works = true;
    staging.since = board_tick();
}

static void schedule(const uint32_t at, const void* const bytes, const uint32_t size)
{
    staging.at = at;
    memset(staging.words, 0xFF, sizeof staging.words);
    memcpy(staging.words, bytes, size);
    staging.programs = true;
}

// A page that is no record and yet not blank was left half programmed: it is passed over. The first of a sector erases
// that sector, whose records are the oldest; the newest is in the other one.
static void write_record(const uint32_t crc)
{
    record_t record = {.sequence = 0};
    uint32_t page = image_record();
    if (page < RECORD_PAGES) {
        flash_read(page_at(page), (uint32_t*)&record, sizeof record / 4U);
    } else {
        page = RECORD_PAGES - 1U;  // the first one goes to page 0
    }
    const uint32_t sequence = record.sequence + 1U;
    bool blank;
    do {
        page = (page + 1U) % RECORD_PAGES;
        flash_read(page_at(page), (uint32_t*)&record, sizeof record / 4U);
        blank = true;
        for (uint32_t i = 0; i < sizeof record / 4U; i++) {
            blank = blank && (((const uint32_t*)&record)[i] == RECORD_UNTOUCHED);
        }
    } while (!blank && (page % (SECTOR_BYTES / PAGE_BYTES) != 0U));
    if (!blank) {
        flash_erase(page_at(page));
        begins();
    }
    record = (record_t){.magic = RECORD_MAGIC,
                        .sequence = sequence,
                        .slot = 1U - image_slot(),
                        .crc = crc,
                        .starts = RECORD_UNTOUCHED,
                        .confirmed = RECORD_UNTOUCHED,
                        .last = RECORD_UNTOUCHED};
    record.check = crc32_of((const uint8_t*)&record, RECORD_CHECKED_BYTES);
    schedule(page_at(page), &record, sizeof record);
}

bool board_update_run(void)
{
    if (staging.works && (ticks_since(board_tick(), staging.since) < FLASH_TICKS_MAX) && flash_is_busy()) {
        return true;
    }
    staging.works = false;
    if (!staging.programs && staging.commits) {
        staging.commits = false;
        write_record(staging.crc);
    } else if (!staging.programs && staging.confirms) {
        staging.confirms = false;
        const uint32_t clear = 0;
        schedule(page_at(image_record()) + (uint32_t)offsetof(record_t, confirmed), &clear, sizeof clear);
    }
    if (staging.programs && !staging.works) {
        staging.programs = false;
        flash_program(staging.at, staging.words, FLASH_PROGRAM_MAX / 4U);
        begins();
    }
    return staging.works;
}

bool staging_is_idle(void)
{
    return !staging.works && !staging.programs && !staging.commits;
}

void board_image_confirm(void)
{
    staging.confirms = image_confirmed() || staging.confirms;
}

void board_update_write(const uint32_t offset, const uint8_t* const chunk)
{
    const uint32_t at = slot_beside() + offset;
    if (offset % SECTOR_BYTES == 0U) {
        flash_erase(at);
        begins();
    }
    schedule(at, chunk, UPDATE_CHUNK_BYTES);
}

void board_update_read(const uint32_t offset, uint8_t* const bytes, const uint32_t size)
{
    uint32_t words[UPDATE_CHUNK_BYTES / 4U];
    flash_read(slot_beside() + offset, words, size / 4U);
    memcpy(bytes, words, size);
}

bool board_update_starts_at(const uint32_t entry)
{
    return ((entry & 1U) != 0U) && (entry - (uint32_t)(uintptr_t)image_start < UPDATE_MAX_BYTES);
}

// Its head goes last, and then the record: what was not committed is never whole.
void board_update_commit(const uint32_t crc, const uint8_t* const head)
{
    schedule(slot_beside() + BOARD_UPDATE_HEAD_AT, head, UPDATE_CHUNK_BYTES);
    staging.crc = crc;
    staging.commits = true;
}
