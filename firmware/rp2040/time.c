// The controller's clock.

#include "../board.h"
#include "../core/messages.h"
#include "hardware.h"
#include "registers.h"

static uint32_t ticks;
static uint32_t systick;  // at the last look
static uint32_t before;

// SysTick counts down at clk_sys and wraps every 168 ms, later than the watchdog bites: somebody always looks in time.
static uint32_t tick_of(const uint32_t count)
{
    ticks += (systick - count) & 0xFFFFFFU;
    systick = count;
    return ticks;
}

uint32_t board_tick(void)
{
    return tick_of(REGISTER(SYSTICK_CVR));
}

// Two instructions of two cycles each, whatever the compiler does around them (Cortex-M0+ TRM 3.3: LDR and STR; on both
// the bus takes the second).
uint32_t time_of_write(const uint32_t address, const uint32_t value)
{
    uint32_t count;
    __asm volatile("cpsid i\n ldr %0, [%1]\n str %2, [%3]\n cpsie i"
                   : "=&l"(count)
                   : "l"(SYSTICK_CVR), "l"(value), "l"(address)
                   : "memory");
    return tick_of(count);
}

uint32_t time_before(void)
{
    return before;
}

// The loader started SysTick. Where that took longer than a turn of it, or was slower, less is said than was; started
// by a debugger, without the loader, nothing is known.
void time_begin(const bool by_loader)
{
    before = by_loader ? 0xFFFFFFU - REGISTER(SYSTICK_CVR) : 0U;
}

void time_start(void)
{
    REGISTER(SYSTICK_RVR) = 0xFFFFFFU;
    REGISTER(SYSTICK_CVR) = 0U;
    REGISTER(SYSTICK_CSR) = 5U;  // clk_sys, no interrupt
    systick = REGISTER(SYSTICK_CVR);
    ticks = 0;
}
