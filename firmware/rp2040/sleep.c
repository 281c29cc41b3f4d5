// The sleep between two rounds of the main loop.

#include "hardware.h"
#include "registers.h"

#define ROUND_US 100U

void sleep_start(void)
{
    REGISTER(TIMER_INTR) = 1U;
    SET_BITS(TIMER_INTE) = 1U;
    irq_enable(IRQ_TIMER0);
}

void alarm_handler(void)
{
    REGISTER(TIMER_INTR) = 1U;
}

// With interrupts off: one that is pending ends the sleep all the same. Else a storm of them between setting the alarm
// and sleeping would outlast the alarm, and nothing would wake the loop before the timer came round.
void sleep_round(void)
{
    interrupts_off();
    if (!pinuse_hurries()) {
        REGISTER(TIMER_ALARM0) = REGISTER(TIMER_RAW_LOW) + ROUND_US;
        __asm volatile("wfi");
    }
    interrupts_on();
}
