// The RP2350 (its Arm cores, in Secure state) where the RP2040 differs: its name, places and bits of registers,
// interrupts, boot ROM. Included by ../rp2040/registers.h only. Numbers and sections: RP2350 datasheet; errata: its
// appendix E.

#ifndef ANNULUS_CHIP_H
#define ANNULUS_CHIP_H

#include <stdbool.h>

#define BOARD_NAME "rp2350"

#define RESETS 0x40020000U  // 7.5.3
#define RESET_ADC (1U << 0)
#define RESET_DMA (1U << 2)
#define RESET_IO_BANK0 (1U << 6)
#define RESET_IO_QSPI (1U << 7)
#define RESET_PADS_BANK0 (1U << 9)
#define RESET_PADS_QSPI (1U << 10)
#define RESET_PIO0 (1U << 11)
#define RESET_PIO1 (1U << 12)
#define RESET_PLL_SYS (1U << 14)
#define RESET_PLL_USB (1U << 15)
#define RESET_SYSCFG (1U << 20)
#define RESET_TIMER (1U << 23)  // TIMER0
#define RESET_UART0 (1U << 26)
#define RESET_USB (1U << 28)
#define RESET_ALL 0x1FFFFFFFU

// ---- boot ROM (5.4); rp2350.ld says where ----
extern const uint16_t rom_lookup;  // the function that searches its table
#define ROM_CODE(a, b) ((uint32_t)(a) | ((uint32_t)(b) << 8))
#define ROM_ARM_SECURE 0x4U
#define REBOOT_TO_USB 0x2U
#define REBOOT_NEVER_RETURNS 0x100U
#define REBOOT_LIGHT 0x20U  // the second parameter is a pin

// Reset into the boot ROM, which comes up as the drive RP2350 and as PICOBOOT and shows its activity on the lowest of
// these pins, if there is one. It keeps what it is told in scratch registers 2 to 7, and writes to SYSCFG (5.4.8.24).
static inline __attribute__((always_inline)) void rom_usb_boot(const uint32_t activity_pins)
{
    typedef void* (*lookup_t)(uint32_t code, uint32_t mask);
    typedef int (*reboot_t)(uint32_t flags, uint32_t delay_ms, uint32_t p0, uint32_t p1);
    CLEAR_BITS(RESETS) = RESET_SYSCFG;
    const reboot_t reboot = (reboot_t)((lookup_t)(uintptr_t)rom_lookup)(ROM_CODE('R', 'B'), ROM_ARM_SECURE);
    const bool lit = activity_pins != 0U;
    reboot(REBOOT_TO_USB | REBOOT_NEVER_RETURNS, 1U, lit ? REBOOT_LIGHT : 0U,
           lit ? (uint32_t)__builtin_ctz(activity_pins) : 0U);
}

// The boot ROM has a limit for its own stack, which lies above every other.
static inline __attribute__((always_inline)) void stack_unlimited(void)
{
    __asm volatile("msr msplim, %0" ::"r"(0U));
}

// ---- flash (12.14.6) ----
#define QMI_DIRECT_CSR 0x400D0000U
#define QMI_DIRECT_TX 0x400D0004U
#define QMI_DIRECT_RX 0x400D0008U

// ---- identity (13.9) ----
#define OTP_DATA 0x40130000U  // two rows of 16 bits a word, corrected

// ---- clocks (8), power-on state machine (7.3), watchdog (12.9) ----
#define XOSC 0x40048000U
#define ROSC_RANDOMBIT 0x400E8020U
#define CLOCKS 0x40010000U
#define CLK_USB_CTRL 0x40010060U
#define CLK_ADC_CTRL 0x4001006CU
#define PLL_SYS 0x40050000U
#define PLL_USB 0x40058000U

#define PSM_WDSEL 0x40018008U
#define PSM_ALL_BUT_OSCILLATORS 0x01FFFFF2U  // nor the processors' cold reset, which is the debugger's: as the boot ROM
#define WATCHDOG 0x400D8000U
#define WATCHDOG_COUNTS_A_MS 1000U  // RP2040-E1 is mended
// Outlive every reset but the loss of power. The boot ROM uses scratch registers 2 to 7 for itself.
#define WATCHDOG_KEPT_CAUSE WATCHDOG_SCRATCH(0U)
#define WATCHDOG_KEPT_BOOT WATCHDOG_SCRATCH(1U)

// 1 us for watchdog and timer each, once the crystal is clk_ref (8.5).
static inline __attribute__((always_inline)) void microseconds_start(void)
{
    REGISTER(0x4010801CU) = 12U;  // TIMER0
    REGISTER(0x40108018U) = 1U;
    REGISTER(0x40108034U) = 12U;  // watchdog
    REGISTER(0x40108030U) = 1U;
}

// ---- time (12.8), interrupts (3.2) ----
#define TIMER 0x400B0000U
#define TIMER_INTR 0x400B003CU
#define TIMER_INTE 0x400B0040U
#define IRQS 52U
enum { IRQ_TIMER0 = 0, IRQ_TIMER1 = 1, IRQ_USB = 14, IRQ_IO_BANK0 = 21, IRQ_UART0 = 33 };

// ---- pins (9.11, 3.1.11) ----
#define IO_BANK0 0x40028000U
#define OUT_INVERT (1U << 12)  // between the peripheral and the pad
#define OUT_LOW (2U << 12)
#define OUT_HIGH (3U << 12)
#define OUT_ENABLED (3U << 14)  // whatever the peripheral says
#define IO_INTR0 0x40028230U    // four bits a pin, pins 0..7; edges latch until written
#define IO_PROC0_INTE0 0x40028248U
#define IO_INTR1 0x40028234U  // the same of pins 8..15
#define IO_PROC0_INTE1 0x4002824CU
#define IO_INTR3 0x4002823CU  // of pins 24..31
#define IO_PROC0_INTE3 0x40028254U
// A pad is isolated from reset until its register is written without bit 8 (9.7): every write here does that.
#define PADS_BANK0 0x40038000U
// An input's own pull-down can not pull: the pad holds itself at some 2.2 V, erratum RP2350-E9. 8.2 kohm outside can.
#define PAD_INPUT_PULL_DOWN 0U
#define VBUS_READS_TRUE false  // nor can 10 kohm, which are all there is on a Pico 2 whose plug is out
#define SIO_GPIO_OUT_SET 0xD0000018U
#define SIO_GPIO_OUT_CLEAR 0xD0000020U
#define SIO_GPIO_OE_SET 0xD0000038U

#define UART0 0x40070000U
#define ADC 0x400A0000U

// Three cycles of the USB's 48 MHz: 7 of the processor's, which may take two of these in one.
#define USB_CYCLES_PASS                                                                                                \
    "nop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\n"                                                     \
    "nop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop\nnop"

// ---- DMA (12.6) ----
#define DMA_ABORT 0x50000464U
#define DMA_BUSY (1U << 26)
#define DMA_QUIET (1U << 23)
#define DMA_REQUEST(dreq) ((uint32_t)(dreq) << 17)
#define DMA_CHAIN(channel) ((uint32_t)(channel) << 13)
#define DMA_CHAINED(control) (((control) >> 13) & 0xFU)
#define DMA_RING_WRITE (1U << 12)
#define DMA_RING(bits) ((uint32_t)(bits) << 8)
#define DMA_INCREMENT_WRITE (1U << 6)
#define DMA_COUNT_MAX 0x0FFFFFFFU  // the four bits above say what happens at the end: 0, nothing

#endif
