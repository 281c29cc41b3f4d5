// The flash: where what is in it, and its commands. Nothing of it is read in place once the application runs from RAM,
// so no command needs interrupts off, and whoever erases need not wait. Inlined, because the loader shares no code with
// the application, and runs this from RAM.

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
// sector after sector. The newest whole one counts; without any it is slot 0. The last three words are programmed
// later: bits are only ever cleared.
typedef struct {
    uint32_t magic;
    uint32_t sequence;   // the highest is the newest
    uint32_t slot;       // 0, 1
    uint32_t crc;        // of the application there
    uint32_t check;      // CRC-32 of the four words before: a page half programmed is no record
    uint32_t starts;     // byte k is cleared before its start number k that is not yet confirmed
    uint32_t confirmed;  // cleared by the application, once a host understood it
    uint32_t last;       // as `starts`, of those after it was given up and there was no other
} record_t;

#define RECORD_MAGIC 0x32445055U  // "UPD2"
#define RECORD_CHECKED_BYTES 16U
#define RECORD_UNTOUCHED 0xFFFFFFFFU
_Static_assert(RECORDS_AT + RECORD_SECTORS * SECTOR_BYTES == LOADER_SPARE_AT, "nothing between lies bare");
#define RECORD_PAGES (RECORD_SECTORS * SECTOR_BYTES / PAGE_BYTES)
#define TRIAL_STARTS 3U  // unconfirmed ones before the other application is taken again

// What the loader hands to the application: r0 this mark, r1 a word of these.
#define HANDOVER_MARK 0x64616F4CU  // "Load"
#define HANDOVER(slot, starts, why, page) ((slot) | ((starts) << 4) | ((why) << 8) | ((page) << 16))
#define HANDOVER_SLOT(word) ((word)&1U)
#define HANDOVER_STARTS(word) (((word) >> 4) & 0xFU)  // unconfirmed so far, this one included; 0: confirmed
#define HANDOVER_WHY(word) (((word) >> 8) & 0xFU)     // IMAGE_WHY_*
#define HANDOVER_PAGE(word) ((word) >> 16)            // of the newest record; RECORD_PAGES: there is none

#define FLASH_READ_MAX 60U  // bytes in one go: what 16 frames of an RP2040 hold
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

#include <flash_bus.h>  // how a chip gives these commands

#endif
