// Ways to stop: the watchdog, a restart, the boot loader. Every output goes dark first.

#include "../board.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

#define STUCK_US (BOARD_WATCHDOG_MS * 800U)  // without a kick: where the main loop is, is written down before it bites

void board_watchdog_kick(void)
{
    REGISTER(WATCHDOG_LOAD) = BOARD_WATCHDOG_MS * WATCHDOG_COUNTS_A_MS;
    REGISTER(TIMER_ALARM1) = REGISTER(TIMER_RAW_LOW) + STUCK_US;
}

void outputs_off(void)
{
    pinuse_darken();
    SET_BITS(RESETS_RESET) = RESET_DMA;  // first: it feeds the machines, and a block in reset answers nobody
    REGISTER(SIO_GPIO_OUT_SET) = 1U << PIN_ENABLE;
    SET_BITS(RESETS_RESET) = RESET_PIO0 | RESET_PIO1;
}

void board_reset(void)
{
    outputs_off();
    REGISTER(WATCHDOG_KEPT_CAUSE) = SCRATCH_MAGIC | SCRATCH_BY_HOST;
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_TRIGGER;
    for (;;) {
    }
}

bool board_bootloader_reachable(void)
{
    return usb_hosted();
}

// The ROM resets the chip by the watchdog and comes up as a drive and as PICOBOOT, GP25 showing its activity.
void board_bootloader(void)
{
    outputs_off();
    interrupts_off();
    REGISTER(WATCHDOG_KEPT_CAUSE) = SCRATCH_MAGIC | SCRATCH_BY_HOST;
    rom_usb_boot((board_kind() == BOARD_KIND_PICO_W) ? 0U : 1U << PIN_STATUS);
}

void reset_start(void)
{
    CLEAR_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;
    REGISTER(PSM_WDSEL) = PSM_ALL_BUT_OSCILLATORS;
    board_watchdog_kick();
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;
}
