// From reset to the main loop: vectors, memory, 100 MHz from the 12 MHz crystal.

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "../application.h"
#include "../board.h"
#include "../core/controller.h"
#include "../core/messages.h"
#include "hardware.h"
#include "registers.h"

extern uint32_t data_load[], data_start[], data_end[], bss_start[], bss_end[], stack_bottom[], stack_top[];

void reset_handler(void);

// Stands in the image for `annulus firmware info` and for whoever opens the file.
#define TEXT_OF(value) #value
#define TEXT(value) TEXT_OF(value)
__attribute__((section(".version"), used)) static const char version[] =
    "annulus rp2040 " ANNULUS_VERSION " " ANNULUS_GIT " protocol " TEXT(PROTOCOL_VERSION) " schema " TEXT(SCHEMA_HASH);
// Apart from the above, which older hosts read as it stands, and behind it: the loader knows the place of the other.
__attribute__((section(".level"), used)) static const char level[] = "annulus level " TEXT(LEVEL);

#define STACK_PAINT 0xA5A5A5A5U

static controller_t controller;

typedef void (*vector_t)(void);

__attribute__((section(".vectors"), used)) static const vector_t vectors[APPLICATION_SIZE_AT / 4U] = {
    [0] = (vector_t)(uintptr_t)stack_top,
    [1] = reset_handler,
    [2] = fault_handler,
    [3] = fault_handler,
    [11] = fault_handler,
    [14] = fault_handler,
    [15] = fault_handler,
    [16 + IRQ_TIMER0] = alarm_handler,
    [16 + IRQ_TIMER1] = stuck_handler,
    [16 + IRQ_USB] = usb_handler,
    [16 + IRQ_IO_BANK0] = pins_handler,
    [16 + IRQ_UART0] = serial_handler,
};

static void wait_for(const uint32_t address, const uint32_t bits)
{
    while ((REGISTER(address) & bits) != bits) {
    }
}

// VCO 12 MHz * 100 = 1.2 GHz, divided by both dividers.
static void start_pll(const uint32_t pll, const uint32_t reset, const uint32_t first, const uint32_t second)
{
    SET_BITS(RESETS_RESET) = reset;
    CLEAR_BITS(RESETS_RESET) = reset;
    wait_for(RESETS_DONE, reset);
    REGISTER(PLL_CS(pll)) = 1U;
    REGISTER(PLL_FBDIV(pll)) = 100U;
    CLEAR_BITS(PLL_PWR(pll)) = (1U << 0) | (1U << 5);  // power and VCO
    wait_for(PLL_CS(pll), 1U << 31);                   // locked
    REGISTER(PLL_PRIM(pll)) = (first << 16) | (second << 12);
    CLEAR_BITS(PLL_PWR(pll)) = 1U << 3;  // dividers
}

static void start_clocks(void)
{
    REGISTER(XOSC_CTRL) = 0xAA0U;  // 1..15 MHz
    REGISTER(XOSC_STARTUP) = 47U;  // 1 ms in units of 256 cycles
    SET_BITS(XOSC_CTRL) = 0xFABU << 12;
    wait_for(XOSC_STATUS, 1U << 31);
    REGISTER(CLK_SYS_CTRL) = 0U;  // from clk_ref while the PLL is set up
    wait_for(CLK_SYS_SELECTED, 1U << 0);
    REGISTER(CLK_REF_CTRL) = 2U;  // crystal
    wait_for(CLK_REF_SELECTED, 1U << 2);

    start_pll(PLL_SYS, RESET_PLL_SYS, 6U, 2U);  // 100 MHz
    start_pll(PLL_USB, RESET_PLL_USB, 5U, 5U);  // 48 MHz

    REGISTER(CLK_SYS_CTRL) = 0U << 5;         // its second source: the PLL
    REGISTER(CLK_SYS_CTRL) = (0U << 5) | 1U;  // take it
    wait_for(CLK_SYS_SELECTED, 1U << 1);
    REGISTER(CLK_PERI_CTRL) = 1U << 11;         // clk_sys, on
    REGISTER(CLK_USB_CTRL) = 1U << 11;          // the USB's PLL, on
    REGISTER(WATCHDOG_TICK) = (1U << 9) | 12U;  // 1 us for watchdog and timer
}

static void start_peripherals(void)
{
    // The boot loader may have left anything running; the flash is being read through the two QSPI blocks.
    SET_BITS(RESETS_RESET) = RESET_ALL & ~(RESET_IO_QSPI | RESET_PADS_QSPI | RESET_PLL_SYS | RESET_PLL_USB);
    const uint32_t wanted =
        RESET_DMA | RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_PIO0 | RESET_PIO1 | RESET_TIMER | RESET_UART0 | RESET_USB;
    CLEAR_BITS(RESETS_RESET) = wanted;
    wait_for(RESETS_DONE, wanted);
}

// What is no longer painted was used: the emulator reads how deep the stack went.
static void paint_stack(void)
{
    const uint32_t* here;
    __asm volatile("mov %0, sp" : "=r"(here));
    for (uint32_t* word = stack_bottom; word < here; word++) {
        *word = STACK_PAINT;
    }
}

__attribute__((noreturn)) void reset_handler(void)
{
    paint_stack();
    memcpy(data_start, data_load, (size_t)((uint8_t*)data_end - (uint8_t*)data_start));
    memset(bss_start, 0, (size_t)((uint8_t*)bss_end - (uint8_t*)bss_start));
    start_clocks();
    start_peripherals();
    identity_start();
    reset_start();
    pinuse_start();
    lines_start();
    time_start();
    crash_start(board_cause(), board_boot());
    lamps_start();
    microwave_start();
    turntable_start();
    usb_start();
    controller_start(&controller);
    for (;;) {
        controller_run(&controller);
        board_trail()->part = PART_USB;
        usb_run();
        crash_measure();
        if (!lines_waiting() && !microwave_hurries()) {
            time_sleep();
        }
    }
}
