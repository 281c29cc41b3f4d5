// The application as it runs: in RAM, where nothing of it is ever written. A few bytes of it are looked at in every
// idle round, and then a few of its copy in flash: code that changed is not run any longer, and a copy that changed is
// told before the next start would find it.

#include "../application.h"
#include "../board.h"
#include "../core/messages.h"
#include "flash.h"
#include "hardware.h"

// A round: 8 us, or 20 from flash. 64 KiB take 0.2 s at 100 us a round, and as long again in flash.
#define LOOK_BYTES 32U

extern const uint32_t image_crc;  // its last word

static struct {
    uint32_t record;  // page of the newest, or RECORD_PAGES
    board_image_t state;
    bool in_flash;  // is what is being looked at
    uint32_t at;
    uint32_t crc;
} image;

uint32_t image_record(void)
{
    return image.record;
}

uint32_t image_slot(void)
{
    return image.state.slot;
}

bool image_confirmed(void)
{
    const bool was_on_trial = image.state.starts != 0U;
    image.state.starts = 0;
    return was_on_trial;
}

void board_image(board_image_t* const reported)
{
    *reported = image.state;
}

// Started by a debugger, without the loader: as if it were slot 0's.
void image_begin(const uint32_t mark, const uint32_t handover)
{
    const uint32_t word =
        (mark == HANDOVER_MARK) ? handover : HANDOVER(0U, 0U, (uint32_t)IMAGE_WHY_RECORDED, RECORD_PAGES);
    image.record = HANDOVER_PAGE(word);
    image.state = (board_image_t){.slot = (uint8_t)HANDOVER_SLOT(word),
                                  .starts = (uint8_t)HANDOVER_STARTS(word),
                                  .why = (uint8_t)HANDOVER_WHY(word),
                                  .flash = IMAGE_FLASH_UNCHECKED,
                                  .crc = image_crc};
    image.crc = CRC32_BEGIN;
}

void image_run(const bool flash_is_free)
{
    const uint32_t size = (uint32_t)((uintptr_t)&image_crc - (uintptr_t)image_start);
    const uint32_t left = size - image.at;
    const uint32_t bytes = (left < LOOK_BYTES) ? left : LOOK_BYTES;
    if (image.in_flash && flash_is_free) {
        uint32_t words[LOOK_BYTES / 4U];
        flash_read(SLOT_AT(image.state.slot) + image.at, words, bytes / 4U);
        image.crc = crc32_add(image.crc, (const uint8_t*)words, bytes);
    } else if (!image.in_flash) {
        image.crc = crc32_add(image.crc, image_start + image.at, bytes);
    } else {
        return;
    }
    image.at += bytes;
    if (image.at < size) {
        return;
    }
    const bool whole = crc32_end(image.crc) == image.state.crc;
    if (image.in_flash) {
        image.state.flash = whole ? IMAGE_FLASH_WHOLE : IMAGE_FLASH_DAMAGED;
    } else if (!whole) {
        crash_damaged();
    }
    image.in_flash = !image.in_flash;
    image.at = 0;
    image.crc = CRC32_BEGIN;
}
