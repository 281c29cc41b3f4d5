// From the second stage to an application: which one, whether it is whole, and to RAM with it.
//
// It lives in the first sector of flash, which only USB writes, and shares nothing with the application but
// application.h, flash.h and what it hands over: whatever happens to that, this runs. The watchdog runs from here on,
// so an application that hangs before its first line is started anew, and after TRIAL_STARTS times without a host that
// understood it, the other one is. No application runs whose CRC is wrong; without any the boot ROM waits on USB.

#include <stdbool.h>
#include <stddef.h>

#include "../application.h"
#include "../core/messages.h"
#include "clocks.h"
#include "flash.h"

#define LOADER_WATCHDOG_MS 500U  // for the application's way to its own, which takes 1
#define PROGRAM_LOOKS 50000U     // of 2 us or more; a page takes 3 ms at worst

#define IN_FLASH __attribute__((section(".loader.text"), noinline, used))
#define IN_RAM __attribute__((section(".loader_ram.text"), noinline, used))

extern uint32_t loader_load[], loader_start[], loader_end[], loader_stack_top[], application_start[];

void loader_enter(void);
void loader_run(void);

typedef void (*entry_t)(void);
__attribute__((section(".loader.vectors"), used)) static const entry_t vectors[2] = {
    (entry_t)(uintptr_t)loader_stack_top, loader_enter};

static void watchdog_kick(void)
{
    REGISTER(WATCHDOG_LOAD) = LOADER_WATCHDOG_MS * WATCHDOG_COUNTS_A_MS;
}

// From the second stage, with nothing set up but the flash. Without a crystal all this takes sixteen times as long.
IN_FLASH void loader_enter(void)
{
    microseconds_start();
    REGISTER(PSM_WDSEL) = PSM_ALL_BUT_OSCILLATORS;
    watchdog_kick();
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;
    (void)clocks_start();
    REGISTER(SYSTICK_RVR) = 0xFFFFFFU;  // for the application, which asks how long everything has been dark
    REGISTER(SYSTICK_CVR) = 0U;
    REGISTER(SYSTICK_CSR) = 5U;
    const volatile uint32_t* from = loader_load;
    for (volatile uint32_t* to = loader_start; to < loader_end; to++) {
        *to = *from++;
    }
    ((void (*)(void))((uintptr_t)loader_run | 1U))();
    __builtin_unreachable();
}

IN_RAM static void read(const uint32_t at, uint32_t* const words, const uint32_t bytes)
{
    for (uint32_t done = 0; done < bytes; done += FLASH_READ_MAX) {
        const uint32_t left = bytes - done;
        flash_read(at + done, words + done / 4U, ((left < FLASH_READ_MAX) ? left : FLASH_READ_MAX) / 4U);
    }
}

IN_RAM static uint32_t crc_of(const void* const bytes, const uint32_t size)
{
    return crc32_of(bytes, size);
}

static uint32_t page_at(const uint32_t page)
{
    return RECORDS_AT + page * PAGE_BYTES;
}

// The newest record, and its page. RECORD_PAGES: there is none.
IN_RAM static uint32_t find_record(record_t* const newest)
{
    uint32_t found = RECORD_PAGES;
    for (uint32_t page = 0; page < RECORD_PAGES; page++) {
        record_t record;
        read(page_at(page), (uint32_t*)&record, sizeof record);
        const bool whole = (record.magic == RECORD_MAGIC) && (record.slot < 2U) &&
                           (record.check == crc_of(&record, RECORD_CHECKED_BYTES));
        if (whole && ((found == RECORD_PAGES) || ((int32_t)(record.sequence - newest->sequence) > 0))) {
            *newest = record;
            found = page;
        }
    }
    return found;
}

// Which start is this, by a word of the newest record (`counted`) that lies `offset` bytes into it? TRIAL_STARTS + 1:
// one too many, also where the flash does not keep what is counted.
IN_RAM static uint32_t count_start(const uint32_t counted, const uint32_t page, const uint32_t offset)
{
    uint32_t start = 1U;
    while ((start <= TRIAL_STARTS) && (((counted >> (8U * (start - 1U))) & 0xFFU) != 0xFFU)) {
        start++;
    }
    if (start <= TRIAL_STARTS) {
        const uint32_t used = RECORD_UNTOUCHED << (8U * start);
        const uint32_t word = page_at(page) + offset;
        flash_program(word, &used, 1U);
        for (uint32_t looks = 0; flash_is_busy() && (looks < PROGRAM_LOOKS); looks++) {
        }
        uint32_t kept;
        read(word, &kept, sizeof kept);
        start = ((kept & ~used) == 0U) ? start : TRIAL_STARTS + 1U;
    }
    return start;
}

IN_RAM static bool is_for_this_board(const uint8_t* const name)
{
    static const char ours[] = "annulus " BOARD_NAME " ";
    bool same = true;
    for (uint32_t i = 0; i < sizeof ours - 1U; i++) {
        same = same && (name[i] == (uint8_t)ours[i]);
    }
    return same;
}

// Is there a whole application in this slot, and in RAM now? With this CRC, unless any will do.
IN_RAM static bool load(const uint32_t slot, const bool any, const uint32_t crc)
{
    const uint32_t at = SLOT_AT(slot);
    uint32_t head[5];  // size, and sixteen letters of the name
    read(at + APPLICATION_SIZE_AT, head, sizeof head);
    const uint32_t size = head[0];
    if (!application_fits(size, SLOT_BYTES) || !is_for_this_board((const uint8_t*)&head[1])) {
        return false;
    }
    watchdog_kick();
    read(at, application_start, size);
    watchdog_kick();
    const uint32_t kept = application_start[size / 4U - 1U];
    const uint32_t entry = application_start[1] - (uint32_t)(uintptr_t)application_start;
    return (crc_of(application_start, size - 4U) == kept) && (any || (crc == kept)) && (entry < size);
}

IN_RAM __attribute__((noreturn)) static void start(const uint32_t handover)
{
    watchdog_kick();
    REGISTER(VECTORS) = (uint32_t)(uintptr_t)application_start;
    stack_unlimited();
    register uint32_t mark __asm("r0") = HANDOVER_MARK;
    register uint32_t word __asm("r1") = handover;
    __asm volatile("msr msp, %2\n bx %3" ::"r"(mark), "r"(word), "r"(application_start[0]), "r"(application_start[1]));
    __builtin_unreachable();
}

IN_RAM __attribute__((noreturn)) void loader_run(void)
{
    record_t record;
    const uint32_t page = find_record(&record);
    if (page < RECORD_PAGES) {
        const uint32_t starts =
            (record.confirmed == 0U) ? 0U : count_start(record.starts, page, (uint32_t)offsetof(record_t, starts));
        if ((starts <= TRIAL_STARTS) && load(record.slot, false, record.crc)) {
            start(HANDOVER(record.slot, starts, IMAGE_WHY_RECORDED, page));
        }
        if (load(1U - record.slot, true, 0U)) {
            const uint32_t why = (starts > TRIAL_STARTS) ? IMAGE_WHY_GIVEN_UP : IMAGE_WHY_DAMAGED;
            start(HANDOVER(1U - record.slot, 0U, why, page));
        }
        // Given up, but there is no other: three more, and then the ROM, which answers at least over USB.
        const bool last = count_start(record.last, page, (uint32_t)offsetof(record_t, last)) <= TRIAL_STARTS;
        if (last && load(record.slot, false, record.crc)) {
            start(HANDOVER(record.slot, TRIAL_STARTS, IMAGE_WHY_RECORDED, page));
        }
    } else if (load(0U, true, 0U)) {  // as USB left it; what is in the other slot is older than that
        start(HANDOVER(0U, 0U, IMAGE_WHY_RECORDED, page));
    }
    CLEAR_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;
    rom_usb_boot(0U);
    __builtin_unreachable();
}
