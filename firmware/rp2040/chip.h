// The RP2040 where the RP2350 differs: its name, places and bits of registers, interrupts, boot ROM. Included by
// registers.h only. ../rp2350 has a file of the same name. Numbers: RP2040 datasheet.

#ifndef ANNULUS_CHIP_H
#define ANNULUS_CHIP_H

#include <stdbool.h>

#define BOARD_NAME "rp2040"

// ---- boot ROM (2.8.3); rp2040.ld says where ----
extern const uint16_t rom_functions;  // the table of functions
extern const uint16_t rom_lookup;     // the function that searches it
#define ROM_CODE(a, b) ((uint32_t)(a) | ((uint32_t)(b) << 8))

// Reset into the boot ROM, which comes up as the drive RPI-RP2 and as PICOBOOT and shows its activity on these pins.
static inline __attribute__((always_inline)) void rom_usb_boot(const uint32_t activity_pins)
{
    typedef void* (*lookup_t)(const uint16_t* table, uint32_t code);
    typedef void (*reset_to_usb_boot_t)(uint32_t activity_pins, uint32_t disabled_interfaces);
    const lookup_t lookup = (lookup_t)(uintptr_t)rom_lookup;
    const uint16_t* const functions = (const uint16_t*)(uintptr_t)rom_functions;
    const reset_to_usb_boot_t reset_to_usb_boot = (reset_to_usb_boot_t)lookup(functions, ROM_CODE('U', 'B'));
    reset_to_usb_boot(activity_pins, 0U);
}

// A Cortex-M0+ has no limit to its stack.
static inline __attribute__((always_inline)) void stack_unlimited(void)
{
}

// ---- flash (4.10) ----
#define SSI_CONTROL0 0x18000000U
#define SSI_ENABLE 0x18000008U
#define SSI_SELECT 0x18000010U
#define SSI_RECEIVED 0x18000024U
#define SSI_DATA 0x18000060U

// ---- clocks, resets (2.14 to 2.18) ----
#define RESETS 0x4000C000U
#define RESET_ADC (1U << 0)
#define RESET_DMA (1U << 2)
#define RESET_IO_BANK0 (1U << 5)
#define RESET_IO_QSPI (1U << 6)
#define RESET_PADS_BANK0 (1U << 8)
#define RESET_PADS_QSPI (1U << 9)
#define RESET_PIO0 (1U << 10)
#define RESET_PIO1 (1U << 11)
#define RESET_PLL_SYS (1U << 12)
#define RESET_PLL_USB (1U << 13)
#define RESET_TIMER (1U << 21)
#define RESET_UART0 (1U << 22)
#define RESET_USB (1U << 24)
#define RESET_ALL 0x01FFFFFFU

#define XOSC 0x40024000U
#define ROSC_RANDOMBIT 0x4006001CU
#define CLOCKS 0x40008000U
#define CLK_USB_CTRL 0x40008054U
#define CLK_ADC_CTRL 0x40008060U
#define PLL_SYS 0x40028000U
#define PLL_USB 0x4002C000U

#define PSM_WDSEL 0x40010008U
#define PSM_ALL_BUT_OSCILLATORS 0x0001FFFCU
#define WATCHDOG 0x40058000U
#define WATCHDOG_COUNTS_A_MS 2000U  // it counts down twice a microsecond: erratum RP2040-E1
// Outlive every reset but the loss of power. The boot ROM uses scratch registers 0, 1 and 4 to 7 for itself.
#define WATCHDOG_KEPT_CAUSE WATCHDOG_SCRATCH(2U)
#define WATCHDOG_KEPT_BOOT WATCHDOG_SCRATCH(3U)

// 1 us for watchdog and timer, once the crystal is clk_ref.
static inline __attribute__((always_inline)) void microseconds_start(void)
{
    REGISTER(0x4005802CU) = (1U << 9) | 12U;
}

// ---- time (4.6), interrupts (2.3.2) ----
#define TIMER 0x40054000U
#define TIMER_INTR 0x40054034U
#define TIMER_INTE 0x40054038U
#define IRQS 26U
enum { IRQ_TIMER0 = 0, IRQ_TIMER1 = 1, IRQ_USB = 5, IRQ_IO_BANK0 = 13, IRQ_UART0 = 20 };

// ---- pins (2.19, 2.3.1) ----
#define IO_BANK0 0x40014000U
#define OUT_INVERT (1U << 8)  // between the peripheral and the pad (2.19.6.1)
#define OUT_LOW (2U << 8)
#define OUT_HIGH (3U << 8)
#define OUT_ENABLED (3U << 12)  // whatever the peripheral says
#define IO_INTR0 0x400140F0U    // four bits a pin, pins 0..7; edges latch until written
#define IO_PROC0_INTE0 0x40014100U
#define IO_INTR1 0x400140F4U  // the same of pins 8..15
#define IO_PROC0_INTE1 0x40014104U
#define IO_INTR3 0x400140FCU  // of pins 24..29
#define IO_PROC0_INTE3 0x4001410CU
#define PADS_BANK0 0x4001C000U
#define PAD_INPUT_PULL_DOWN PAD_PULL_DOWN
#define VBUS_READS_TRUE true  // behind its divider of 5.6 kohm over 10 kohm
#define SIO_GPIO_OUT_SET 0xD0000014U
#define SIO_GPIO_OUT_CLEAR 0xD0000018U
#define SIO_GPIO_OE_SET 0xD0000024U

#define UART0 0x40034000U
#define ADC 0x4004C000U

// Three cycles of the USB's 48 MHz: 7 of the processor's.
#define USB_CYCLES_PASS "nop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop"

// ---- DMA (2.5) ----
#define DMA_ABORT 0x50000444U
#define DMA_BUSY (1U << 24)
#define DMA_QUIET (1U << 21)
#define DMA_REQUEST(dreq) ((uint32_t)(dreq) << 15)
#define DMA_CHAIN(channel) ((uint32_t)(channel) << 11)
#define DMA_CHAINED(control) (((control) >> 11) & 0xFU)
#define DMA_RING_WRITE (1U << 10)
#define DMA_RING(bits) ((uint32_t)(bits) << 6)
#define DMA_INCREMENT_WRITE (1U << 5)
#define DMA_COUNT_MAX UINT32_MAX

#endif
