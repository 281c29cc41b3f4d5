// From the second stage to the application, and an application that came over a line into its place.
//
// It lives in the first sector of flash, which only USB writes, and shares nothing with the application but
// application.h and the record: whatever happens to that, this runs. It does its work from RAM, all of which is free.
//
// The application is copied over the old one, which must not run half: until the copy was read back whole the record
// stays, and every start begins the copy anew, whatever power did. A start that finds a whole application other than
// the one to be replaced, or one after its head had been erased, leaves it alone: the copy is finished, or somebody
// flashed the board over USB meanwhile.

#include <stdbool.h>

#include "../application.h"
#include "../core/messages.h"
#include "flash.h"

#define TRIES 3U  // of a copy, before the board waits for somebody with USB

#define IN_FLASH __attribute__((section(".loader.text"), noinline, used))
#define IN_RAM __attribute__((section(".loader_ram.text"), noinline, used))

extern uint32_t loader_load[], loader_start[], loader_end[], stack_top[];

void loader_enter(void);
bool loader_copy(void);

typedef void (*entry_t)(void);
__attribute__((section(".loader.vectors"), used)) static const entry_t vectors[2] = {(entry_t)(uintptr_t)stack_top,
                                                                                     loader_enter};

#define APPLICATION ((const uint8_t*)(uintptr_t)(FLASH_START + APPLICATION_AT))
#define STAGED ((const uint8_t*)(uintptr_t)(FLASH_START + STAGED_AT))
#define RECORD_START ((const uint8_t*)(uintptr_t)(FLASH_START + RECORD_AT))
#define RECORD (*(const volatile record_t*)(uintptr_t)(FLASH_START + RECORD_AT))

// From the second stage, with nothing set up but the flash. Enters the application as a reset would.
IN_FLASH void loader_enter(void)
{
    bool startable = application_is_there(APPLICATION);
    if ((RECORD.magic == RECORD_MAGIC) && (RECORD.check == crc32_of(RECORD_START, RECORD_CHECKED_BYTES)) &&
        (RECORD.done == RECORD_UNTOUCHED)) {
        const volatile uint32_t* from = loader_load;
        for (volatile uint32_t* to = loader_start; to < loader_end; to++) {
            *to = *from++;
        }
        startable = ((bool (*)(void))((uintptr_t)loader_copy | 1U))();
    }
    if (!startable) {  // the ROM waits on USB
        ((void (*)(uint32_t, uint32_t))rom_function(ROM_CODE('U', 'B')))(0U, 0U);
    }
    REGISTER(VECTORS) = FLASH_START + APPLICATION_AT;
    __asm volatile("msr msp, %0\n bx %1" ::"r"(application_word(APPLICATION)), "r"(application_word(APPLICATION + 4)));
    __builtin_unreachable();
}

IN_RAM static void clear_word(const flash_t* const flash, const volatile uint32_t* const word)
{
    uint32_t page[PAGE_BYTES / 4U];
    for (uint32_t i = 0; i < PAGE_BYTES / 4U; i++) {
        page[i] = (word == (const volatile uint32_t*)&RECORD + i) ? 0U : RECORD_UNTOUCHED;
    }
    flash_write(flash, RECORD_AT, (const uint8_t*)page);
}

IN_RAM static void copy_sector(const flash_t* const flash, const uint32_t at)
{
    flash_write(flash, APPLICATION_AT + at, NULL);
    for (uint32_t page = at; page < at + SECTOR_BYTES; page += PAGE_BYTES) {
        uint32_t words[PAGE_BYTES / 4U];
        for (uint32_t i = 0; i < PAGE_BYTES / 4U; i++) {
            words[i] = REGISTER(FLASH_START + STAGED_AT + page + 4U * i);
        }
        flash_write(flash, APPLICATION_AT + page, (const uint8_t*)words);
    }
}

IN_RAM static bool is_whole(const uint8_t* const application)
{
    return application_is_whole(application, UPDATE_MAX_BYTES);
}

// The head comes last and goes first: without it nothing is started, even if the record should be lost.
IN_RAM static void copy(const flash_t* const flash)
{
    flash_write(flash, APPLICATION_AT, NULL);
    if (RECORD.begun == RECORD_UNTOUCHED) {
        clear_word(flash, &RECORD.begun);
    }
    const uint32_t size = application_word(STAGED + APPLICATION_SIZE_AT);
    for (uint32_t at = (size - 1U) / SECTOR_BYTES * SECTOR_BYTES; at > 0U; at -= SECTOR_BYTES) {
        copy_sector(flash, at);
    }
    copy_sector(flash, 0U);
}

// Is there a whole application afterwards? If not, the record stays for the next start.
IN_RAM bool loader_copy(void)
{
    flash_t flash;
    flash_prepare(&flash);
    CLEAR_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;
    __asm volatile("cpsid i" ::: "memory");
    bool runs = is_whole(APPLICATION);
    const bool old = runs && (RECORD.begun == RECORD_UNTOUCHED) && (application_crc(APPLICATION) == RECORD.replaces);
    if ((!runs || old) && is_whole(STAGED) && (application_crc(STAGED) == RECORD.crc)) {
        runs = false;
        for (uint32_t tries = 0; (tries < TRIES) && !runs; tries++) {
            copy(&flash);
            runs = is_whole(APPLICATION);
        }
    }
    if (runs) {
        clear_word(&flash, &RECORD.done);
    }
    __asm volatile("cpsie i" ::: "memory");
    return runs;
}
