// The flash: where what is in it, and its commands, given by hand over the SSI (RP2040 datasheet 4.10). Nothing of it
// is read in place once the application runs from RAM, so no command needs interrupts off, and whoever erases need not
// wait. Inlined, because the loader shares no code with the application, and runs this from RAM.
//
// A command is put into the FIFO before the flash is selected; it stays selected until the FIFO is empty. So a
// transaction has 16 frames at most, and no gap.

#ifndef ANNULUS_FLASH_H
#define ANNULUS_FLASH_H

#include <stdbool.h>
#include <stdint.h>

#include "registers.h"

// From the start of flash. The first sector holds the second stage and the loader and is written over USB only, as is
// what is kept free for a larger loader: one that checks signatures, say. The loader on a board outlives many
// applications: these places never change.
#define SLOT_BYTES 0x10000U
#define SLOT_AT(slot) (((slot) == 0U) ? 0x01000U : 0x20000U)
#define RECORDS_AT 0x11000U
#define RECORD_SECTORS 2U
#define LOADER_SPARE_AT 0x13000U  // .. 0x20000

#define SECTOR_BYTES 4096U
#define PAGE_BYTES 256U

// Which application starts, and whether it has shown what it can: a page of its own for each update, page after page,
// sector after sector. The newest whole one counts; without any it is slot 0. The last two words are programmed later:
// bits are only ever cleared.
typedef struct {
    uint32_t magic;
    uint32_t sequence;   // the highest is the newest
    uint32_t slot;       // 0, 1
    uint32_t crc;        // of the application there
    uint32_t check;      // CRC-32 of the four words before: a page half programmed is no record
    uint32_t starts;     // byte k is cleared before its start number k that is not yet confirmed
    uint32_t confirmed;  // cleared by the application, once a host understood it
    uint32_t spare;
} record_t;

#define RECORD_MAGIC 0x32445055U  // "UPD2"
#define RECORD_CHECKED_BYTES 16U
#define RECORD_UNTOUCHED 0xFFFFFFFFU
#define RECORD_PAGES (RECORD_SECTORS * SECTOR_BYTES / PAGE_BYTES)
#define TRIAL_STARTS 3U  // unconfirmed ones before the other application is taken again

// What the loader hands to the application: r0 this mark, r1 a word of these.
#define HANDOVER_MARK 0x64616F4CU  // "Load"
#define HANDOVER(slot, starts, why, page) ((slot) | ((starts) << 4) | ((why) << 8) | ((page) << 16))
#define HANDOVER_SLOT(word) ((word)&1U)
#define HANDOVER_STARTS(word) (((word) >> 4) & 0xFU)  // unconfirmed so far, this one included; 0: confirmed
#define HANDOVER_WHY(word) (((word) >> 8) & 0xFU)     // IMAGE_WHY_*
#define HANDOVER_PAGE(word) ((word) >> 16)            // of the newest record; RECORD_PAGES: there is none

#define FLASH_FRAMES_MAX 16U
#define FLASH_READ_MAX 60U  // bytes in one go
#define FLASH_PROGRAM_MAX 32U

enum {
    FLASH_PROGRAM = 0x02,
    FLASH_READ = 0x03,
    FLASH_STATUS = 0x05,
    FLASH_WRITE_ENABLE = 0x06,
    FLASH_ERASE_SECTOR = 0x20,
    FLASH_UNIQUE_ID = 0x4B
};
#define FLASH_BUSY 1U  // of the status

// One transaction begins: `count` frames of `bits`.
static inline __attribute__((always_inline)) void flash_select(const uint32_t bits)
{
    REGISTER(SSI_ENABLE) = 0U;
    REGISTER(SSI_CONTROL0) = (bits - 1U) << 16;  // as many out as in; at 25 MHz, as boot2.S left it
    REGISTER(SSI_SELECT) = 0U;
    REGISTER(SSI_ENABLE) = 1U;
}

// And ends: what came in for the last `wanted` of its frames. A FIFO that never fills leaves ones, as an absent flash.
#define FLASH_PATIENCE 10000U  // looks; a transaction takes 21 us at most
static inline __attribute__((always_inline)) void flash_take(const uint32_t count, uint32_t* const in,
                                                             const uint32_t wanted)
{
    REGISTER(SSI_SELECT) = 1U;
    for (uint32_t looks = 0; (REGISTER(SSI_RECEIVED) < count) && (looks < FLASH_PATIENCE); looks++) {
    }
    for (uint32_t i = 0; i < count; i++) {
        const uint32_t frame = REGISTER(SSI_DATA);
        if (i + wanted >= count) {
            in[i + wanted - count] = frame;
        }
    }
}

static inline __attribute__((always_inline)) bool flash_is_busy(void)
{
    uint32_t status = 0;
    flash_select(8U);
    REGISTER(SSI_DATA) = FLASH_STATUS;
    REGISTER(SSI_DATA) = 0U;
    flash_take(2U, &status, 1U);
    return (status & FLASH_BUSY) != 0U;
}

static inline __attribute__((always_inline)) void flash_write_enable(void)
{
    uint32_t nothing;
    flash_select(8U);
    REGISTER(SSI_DATA) = FLASH_WRITE_ENABLE;
    flash_take(1U, &nothing, 0U);
}

// Begin to erase a sector: 45 ms, 400 at worst (W25Q16JV).
static inline __attribute__((always_inline)) void flash_erase(const uint32_t at)
{
    uint32_t nothing;
    flash_write_enable();
    flash_select(32U);
    REGISTER(SSI_DATA) = ((uint32_t)FLASH_ERASE_SECTOR << 24) | at;
    flash_take(1U, &nothing, 0U);
}

static inline __attribute__((always_inline)) uint32_t flash_swapped(const uint32_t word)
{
    return (word >> 24) | ((word >> 8) & 0xFF00U) | ((word << 8) & 0xFF0000U) | (word << 24);
}

// Begin to program words of one page, FLASH_PROGRAM_MAX bytes at most: 0.4 ms, 3 at worst.
static inline __attribute__((always_inline)) void flash_program(const uint32_t at, const uint32_t* const words,
                                                                const uint32_t count)
{
    uint32_t nothing;
    flash_write_enable();
    flash_select(32U);
    REGISTER(SSI_DATA) = ((uint32_t)FLASH_PROGRAM << 24) | at;
    for (uint32_t i = 0; i < count; i++) {
        REGISTER(SSI_DATA) = flash_swapped(words[i]);
    }
    flash_take(1U + count, &nothing, 0U);
}

// Words of it, FLASH_READ_MAX bytes at most.
static inline __attribute__((always_inline)) void flash_read(const uint32_t at, uint32_t* const words,
                                                             const uint32_t count)
{
    flash_select(32U);
    REGISTER(SSI_DATA) = ((uint32_t)FLASH_READ << 24) | at;
    for (uint32_t i = 0; i < count; i++) {
        REGISTER(SSI_DATA) = 0U;
    }
    flash_take(1U + count, words, count);
    for (uint32_t i = 0; i < count; i++) {
        words[i] = flash_swapped(words[i]);
    }
}

#endif
