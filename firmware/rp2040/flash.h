// Erasing and programming flash by the boot ROM's own functions (RP2040 datasheet 2.8.3.1.3), and where what is in it.
//
// While that goes on the flash gives no code and no data: whoever calls runs from RAM, has interrupts off, and reads
// nothing of it. Inlined, because the loader shares no code with the application.

#ifndef ANNULUS_FLASH_H
#define ANNULUS_FLASH_H

#include <stddef.h>
#include <stdint.h>

#include "registers.h"

#define FLASH_START 0x10000000U
#define SECTOR_BYTES 4096U
#define PAGE_BYTES 256U

// From the start of flash. The first sector holds the second stage and the loader and is written over USB only. The
// loader on a board outlives many applications: these places never change.
#define APPLICATION_AT 0x1000U
#define RECORD_AT 0xF000U
#define STAGED_AT 0x10000U

// What the loader shall do, in the first page of a sector of its own. The last two words are programmed later, each
// once: a page may be programmed again where that only clears bits.
typedef struct {
    uint32_t magic;
    uint32_t crc;       // of the staged application
    uint32_t replaces;  // CRC of the one that ran when it was staged
    uint32_t check;     // CRC-32 of the three words before: a page half programmed is no record
    uint32_t begun;     // cleared once the application's head was erased
    uint32_t done;      // cleared when there is nothing more to do
} record_t;

#define RECORD_MAGIC 0x31445055U  // "UPD1"
#define RECORD_CHECKED_BYTES 12U
#define RECORD_UNTOUCHED 0xFFFFFFFFU

typedef struct {
    void (*connect)(void);
    void (*exit_xip)(void);
    void (*erase)(uint32_t at, size_t size, uint32_t block, uint8_t block_command);
    void (*program)(uint32_t at, const uint8_t* bytes, size_t size);
    void (*flush)(void);
    uint32_t second_stage[PAGE_BYTES / 4U];  // a copy, called to make the flash readable again as it was
} flash_t;

static inline __attribute__((always_inline)) uintptr_t rom_function(const uint32_t code)
{
    typedef uintptr_t (*lookup_t)(const uint16_t* table, uint32_t code);
    return ((lookup_t)(uintptr_t)rom_lookup)((const uint16_t*)(uintptr_t)rom_functions, code);
}

static inline __attribute__((always_inline)) void flash_prepare(flash_t* const flash)
{
    flash->connect = (void (*)(void))rom_function(ROM_CODE('I', 'F'));
    flash->exit_xip = (void (*)(void))rom_function(ROM_CODE('E', 'X'));
    flash->erase = (void (*)(uint32_t, size_t, uint32_t, uint8_t))rom_function(ROM_CODE('R', 'E'));
    flash->program = (void (*)(uint32_t, const uint8_t*, size_t))rom_function(ROM_CODE('R', 'P'));
    flash->flush = (void (*)(void))rom_function(ROM_CODE('F', 'C'));
    for (uint32_t i = 0; i < PAGE_BYTES / 4U; i++) {
        flash->second_stage[i] = REGISTER(FLASH_START + 4U * i);
    }
}

// Erase the sector at `at`, or program a page there from RAM.
static inline __attribute__((always_inline)) void flash_write(const flash_t* const flash, const uint32_t at,
                                                              const uint8_t* const page)
{
    flash->connect();
    flash->exit_xip();
    if (page == NULL) {
        flash->erase(at, SECTOR_BYTES, 1U << 16, 0xD8U);
    } else {
        flash->program(at, page, PAGE_BYTES);
    }
    flash->flush();
    ((void (*)(void))((uintptr_t)flash->second_stage | 1U))();  // Thumb
}

#endif
