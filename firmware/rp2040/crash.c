// What a crash leaves behind, in memory that no start clears: the watchdog resets the processor and leaves the RAM as
// it is. The core and the main loop write where they are as they go; when the loop stands still an alarm of its own
// writes down the processor's place shortly before the watchdog bites, and a hard fault does so at once. The next start
// makes a record of it.
//
// Nothing here is believed without the mark and the CRC: after a loss of power the memory is noise.

#include <string.h>

#include "../board.h"
#include "../core/link.h"
#include "../core/messages.h"
#include "../core/count.h"
#include "hardware.h"
#include "registers.h"

#define MARK 0x43724131U

// What the processor pushes when it takes an exception.
typedef struct {
    uint32_t r0, r1, r2, r3, r12, lr, pc, psr;
} frame_t;

__attribute__((section(".noinit"))) static struct {
    uint32_t mark;
    uint16_t crc;  // of `kept`
    struct {
        board_crash_t crash;
        uint8_t boot;  // byte of the boot that wrote this
    } kept;
    board_trail_t trail;  // of the boot under way
    struct {
        uint8_t kind;
        uint32_t rounds;  // of the trail at that moment: a loop that came back has gone on
        uint32_t pc, lr, psr;
    } place;
} memory;

extern uint32_t stack_bottom[], stack_top[];

static uint16_t crc_of_kept(void)
{
    return link_crc((const uint8_t*)&memory.kept, sizeof memory.kept, 0U);
}

bool crash_knows_boot(uint8_t* const boot)
{
    const bool knows = (memory.mark == MARK) && (memory.crc == crc_of_kept());
    if (knows) {
        *boot = memory.kept.boot;
    }
    return knows;
}

static void record(board_crash_t* const crash)
{
    const bool sure = (memory.place.kind == CRASH_HARD_FAULT) || (memory.place.kind == CRASH_DAMAGED);
    const bool known = sure || ((memory.place.kind == CRASH_STUCK) && (memory.place.rounds == memory.trail.rounds));
    count_one_more(&crash->crashes);
    crash->boot = crash->boots;
    crash->kind = sure ? memory.place.kind : CRASH_STUCK;
    crash->pc = known ? memory.place.pc : 0U;
    crash->lr = known ? memory.place.lr : 0U;
    crash->psr = known ? memory.place.psr : 0U;
    crash->trail = memory.trail;
}

void crash_start(const uint8_t cause, const uint8_t boot)
{
    uint8_t last;
    if ((cause == BOOT_CAUSE_POWER_ON) || !crash_knows_boot(&last)) {
        memset(&memory.kept, 0, sizeof memory.kept);
    } else if (cause == BOOT_CAUSE_WATCHDOG) {
        record(&memory.kept.crash);
    }
    count_one_more(&memory.kept.crash.boots);
    memory.kept.boot = boot;
    memory.crc = crc_of_kept();
    memory.mark = MARK;
    memory.trail = (board_trail_t){.part = PART_START, .command = BOARD_NO_COMMAND};
    memory.place.kind = CRASH_NONE;
    // The alarm goes before every other interrupt: one that never ends is found as well.
    for (uint32_t word = 0; word < (IRQS + 3U) / 4U; word++) {
        REGISTER(NVIC_PRIORITY(word)) = 0x40404040U;
    }
    REGISTER(NVIC_PRIORITY(0U)) = 0x40404040U & ~(0xFFU << (8U * IRQ_TIMER1));
    SET_BITS(TIMER_INTE) = 1U << 1;
    irq_enable(IRQ_TIMER1);
}

void crash_measure(void)
{
    const uint32_t took = board_tick() - memory.trail.tick;
    memory.trail.longest = (took > memory.trail.longest) ? took : memory.trail.longest;
    memory.trail.part = PART_SLEEP;
}

board_trail_t* board_trail(void)
{
    return &memory.trail;
}

const board_crash_t* board_crash(void)
{
    return &memory.kept.crash;
}

static void write_place(const uint8_t kind, const frame_t* const frame)
{
    const uintptr_t at = (uintptr_t)frame;
    const bool whole = (at >= (uintptr_t)stack_bottom) && (at + sizeof *frame <= (uintptr_t)stack_top);
    memory.place.kind = kind;
    memory.place.rounds = memory.trail.rounds;
    memory.place.pc = whole ? frame->pc : 0U;
    memory.place.lr = whole ? frame->lr : 0U;
    memory.place.psr = whole ? frame->psr : 0U;
}

// There is no way on: outputs off first, then a restart by the watchdog.
__attribute__((used)) static void faulted(const frame_t* const frame)
{
    outputs_off();
    write_place(CRASH_HARD_FAULT, frame);
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_TRIGGER;
    for (;;) {
    }
}

void crash_damaged(void)
{
    static const frame_t nowhere;
    interrupts_off();
    outputs_off();
    write_place(CRASH_DAMAGED, &nowhere);
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_TRIGGER;
    for (;;) {
    }
}

// The loop may yet come back in time; then this was nothing.
__attribute__((used)) static void stuck(const frame_t* const frame)
{
    REGISTER(TIMER_INTR) = 1U << 1;
    write_place(CRASH_STUCK, frame);
}

// The stack as the exception found it, for the functions above; `lr` says how to return.
__attribute__((naked)) void fault_handler(void)
{
    __asm volatile("mov r0, sp\n ldr r1, =faulted\n bx r1\n .pool");
}

__attribute__((naked)) void stuck_handler(void)
{
    __asm volatile("mov r0, sp\n ldr r1, =stuck\n bx r1\n .pool");
}
