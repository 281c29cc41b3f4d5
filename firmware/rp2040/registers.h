// The registers as far as this firmware touches them, where RP2040 and RP2350 agree; what they do not agree on is in
// chip.h, of the chip that is built for. Names and numbers, and sections unless said otherwise: RP2040 datasheet.

#ifndef ANNULUS_REGISTERS_H
#define ANNULUS_REGISTERS_H

#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t*)(uintptr_t)(address))

// Aliases of every APB and AHB register that set or clear the written bits in one access (2.1.2).
#define SET_ADDRESS(address) ((address) + 0x2000U)
#define SET_BITS(address) REGISTER(SET_ADDRESS(address))
#define CLEAR_BITS(address) REGISTER((address) + 0x3000U)

#include <chip.h>

// ---- clocks, resets (2.14 to 2.18) ----
#define RESETS_RESET RESETS
#define RESETS_DONE (RESETS + 0x08U)

#define XOSC_CTRL XOSC
#define XOSC_STATUS (XOSC + 0x04U)
#define XOSC_STARTUP (XOSC + 0x0CU)

#define CLK_REF_CTRL (CLOCKS + 0x30U)
#define CLK_REF_SELECTED (CLOCKS + 0x38U)
#define CLK_SYS_CTRL (CLOCKS + 0x3CU)
#define CLK_SYS_SELECTED (CLOCKS + 0x44U)
#define CLK_PERI_CTRL (CLOCKS + 0x48U)

#define PLL_CS(pll) (pll)
#define PLL_PWR(pll) ((pll) + 0x04U)
#define PLL_FBDIV(pll) ((pll) + 0x08U)
#define PLL_PRIM(pll) ((pll) + 0x0CU)

#define WATCHDOG_CTRL WATCHDOG
#define WATCHDOG_LOAD (WATCHDOG + 0x04U)
#define WATCHDOG_REASON (WATCHDOG + 0x08U)
#define WATCHDOG_SCRATCH(number) (WATCHDOG + 0x0CU + 4U * (number))
#define WATCHDOG_ENABLE (1U << 30)
#define WATCHDOG_TRIGGER (1U << 31)

// ---- time (4.6, and the processor's SysTick) ----
#define TIMER_ALARM0 (TIMER + 0x10U)
#define TIMER_ALARM1 (TIMER + 0x14U)
#define TIMER_RAW_LOW (TIMER + 0x28U)
#define SYSTICK_CSR 0xE000E010U
#define SYSTICK_RVR 0xE000E014U
#define SYSTICK_CVR 0xE000E018U
#define VECTORS 0xE000ED08U                                // VTOR
#define NVIC_ENABLE(irq) (0xE000E100U + (irq) / 32U * 4U)  // irq_enable, irq_disable of hardware.h write them
#define NVIC_DISABLE(irq) (0xE000E180U + (irq) / 32U * 4U)
#define NVIC_PRIORITY(word) (0xE000E400U + 4U * (word))  // of four interrupts; 00h goes before 40h

// ---- pins (2.19, 2.3.1) ----
#define GPIO_CTRL(pin) (IO_BANK0 + 0x04U + 8U * (pin))
enum { FUNCTION_UART = 2, FUNCTION_SIO = 5, FUNCTION_PIO0 = 6, FUNCTION_PIO1 = 7, FUNCTION_NONE = 31 };
#define IN_INVERT (1U << 16)  // between the pad and everybody who looks at it
#define EDGE_LOW(pin) (4U << (4U * (pin)))
#define EDGE_HIGH(pin) (8U << (4U * (pin)))
#define PAD(pin) (PADS_BANK0 + 0x04U + 4U * (pin))
#define PAD_OUTPUT_DISABLE 0x80U
#define PAD_INPUT 0x40U
#define PAD_DRIVE_4MA 0x10U
#define PAD_PULL_UP 0x08U
#define PAD_PULL_DOWN 0x04U  // of an output; of an input: PAD_INPUT_PULL_DOWN
#define PAD_SCHMITT 0x02U
#define SIO_GPIO_IN 0xD0000004U

// ---- ADC (4.9) ----
#define ADC_CS ADC
#define ADC_RESULT (ADC + 0x04U)
#define ADC_ENABLE (1U << 0)
#define ADC_START_ONCE (1U << 2)
#define ADC_READY (1U << 8)
#define ADC_INPUT(input) ((uint32_t)(input) << 12)

// ---- UART (4.2) ----
#define UART_DR UART0
#define UART_FR (UART0 + 0x18U)
#define UART_IBRD (UART0 + 0x24U)
#define UART_FBRD (UART0 + 0x28U)
#define UART_LCR_H (UART0 + 0x2CU)
#define UART_CR (UART0 + 0x30U)
#define UART_IFLS (UART0 + 0x34U)
#define UART_IMSC (UART0 + 0x38U)
#define UART_BUSY (1U << 3)
#define UART_RX_EMPTY (1U << 4)
#define UART_TX_FULL (1U << 5)
#define UART_RX_INTERRUPT (1U << 4)

// ---- USB (4.1) ----
#define USB_DPSRAM 0x50100000U                                         // first the setup packet
#define USB_ENDPOINT_CONTROL(endpoint) (USB_DPSRAM + 4U * (endpoint))  // from endpoint 1 on; in, then out
#define USB_BUFFER_CONTROL(endpoint) (USB_DPSRAM + 0x80U + 4U * (endpoint))
#define ENDPOINT_ENABLE (1U << 31)
#define ENDPOINT_INTERRUPT (1U << 29)  // with every buffer
#define ENDPOINT_BULK (2U << 26)
#define ENDPOINT_INTERRUPT_TYPE (3U << 26)
#define BUFFER_FULL (1U << 15)
#define BUFFER_DATA1 (1U << 13)
#define BUFFER_STALL (1U << 11)
#define BUFFER_AVAILABLE (1U << 10)
#define BUFFER_LENGTH 0x3FFU
#define USB_ADDRESS 0x50110000U
#define USB_MAIN_CTRL 0x50110040U
#define USB_SOF_RD 0x50110048U  // number of the last frame
#define USB_SIE_CTRL 0x5011004CU
#define SIE_PULL_UP (1U << 16)  // D+: a device is there
#define USB_SIE_STATUS 0x50110050U
#define SIE_SUSPENDED (1U << 4)
#define SIE_RESUME (1U << 11)
#define SIE_SETUP (1U << 17)
#define SIE_BUS_RESET (1U << 19)
#define USB_BUFF_STATUS 0x50110058U
#define USB_EP_ABORT 0x50110060U
#define USB_EP_ABORT_DONE 0x50110064U
#define USB_EP_STALL_ARM 0x50110068U
#define USB_MUXING 0x50110074U
#define USB_POWER 0x50110078U
#define USB_INTE 0x50110090U
#define USB_INT_BUFFER (1U << 4)
#define USB_INT_BUS_RESET (1U << 12)
#define USB_INT_SUSPEND (1U << 14)
#define USB_INT_RESUME (1U << 15)
#define USB_INT_SETUP (1U << 16)

// ---- DMA (2.5) ----
#define DMA_READ(channel) (0x50000000U + 0x40U * (channel))
#define DMA_WRITE(channel) (0x50000004U + 0x40U * (channel))
#define DMA_COUNT(channel) (0x50000008U + 0x40U * (channel))
#define DMA_CTRL_TRIGGER(channel) (0x5000000CU + 0x40U * (channel))
#define DMA_CTRL(channel) (0x50000010U + 0x40U * (channel))
#define DMA_INCREMENT_READ (1U << 4)
#define DMA_WORDS (2U << 2)
#define DMA_PRIORITY (1U << 1)
#define DMA_ENABLE (1U << 0)
#define DREQ_ALWAYS 0x3FU
#define DREQ_PIO_TX(pio, machine) (8U * (pio) + (machine))
#define DREQ_PIO_RX(pio, machine) (8U * (pio) + 4U + (machine))

// ---- PIO (3) ----
#define PIO0 0x50200000U
#define PIO1 0x50300000U
#define PIO_CTRL(pio) (pio)
#define PIO_FSTAT(pio) ((pio) + 0x004U)
#define PIO_FLEVEL(pio) ((pio) + 0x00CU)
#define PIO_TX(pio, machine) ((pio) + 0x010U + 4U * (machine))
#define PIO_RX(pio, machine) ((pio) + 0x020U + 4U * (machine))
#define PIO_MEMORY(pio, index) ((pio) + 0x048U + 4U * (index))
#define PIO_EXECCTRL(pio, machine) ((pio) + 0x0CCU + 0x18U * (machine))
#define PIO_SHIFTCTRL(pio, machine) ((pio) + 0x0D0U + 0x18U * (machine))
#define PIO_ADDRESS(pio, machine) ((pio) + 0x0D4U + 0x18U * (machine))
#define PIO_INSTRUCTION(pio, machine) ((pio) + 0x0D8U + 0x18U * (machine))
#define PIO_PINCTRL(pio, machine) ((pio) + 0x0DCU + 0x18U * (machine))
#define PIO_MACHINE(machine) (1U << (machine))
#define PIO_RESTART(machine) (1U << (4U + (machine)))
#define FSTAT_RX_EMPTY(machine) (1U << (8U + (machine)))
#define EXEC_WRAP(bottom, top) (((uint32_t)(top) << 12) | ((uint32_t)(bottom) << 7))
#define EXEC_JUMP_PIN(pin) ((uint32_t)(pin) << 24)
#define SHIFT_OUT_RIGHT (1U << 19)
#define SHIFT_AUTOPUSH (1U << 16)
#define PINS_SET(base, count) (((uint32_t)(count) << 26) | ((uint32_t)(base) << 5))
#define PINS_OUT(base, count) (((uint32_t)(count) << 20) | (uint32_t)(base))
#define PINS_IN(base) ((uint32_t)(base) << 15)

// Instructions (3.4). No side-set anywhere, so the five bits 12:8 are all delay.
#define DELAY(cycles) ((cycles) << 8)
#define JMP(to) (0x0000U | (to))
#define JMP_X_DEC(to) (0x0040U | (to))
#define JMP_NOT_Y(to) (0x0060U | (to))
#define JMP_Y_DEC(to) (0x0080U | (to))
#define JMP_X_NOT_Y(to) (0x00A0U | (to))
#define JMP_PIN(to) (0x00C0U | (to))
#define WAIT_PIN_LOW(pin) (0x2000U | (pin))
#define WAIT_PIN_HIGH(pin) (0x2080U | (pin))
#define WAIT_FLAG(flag) (0x20C0U | (flag))  // and clear it
#define IN_PINS(count) (0x4000U | (count))
#define OUT_PINS(count) (0x6000U | (count))
#define OUT_X(count) (0x6020U | (count))
#define OUT_Y(count) (0x6040U | (count))
#define PUSH_NO_BLOCK 0x8000U
#define PULL_NO_BLOCK 0x8080U
#define PULL 0x80A0U
#define MOV_PINS_OSR 0xA007U
#define MOV_PINS_NULL 0xA003U
#define MOV_OSR_PINS 0xA0E0U
#define MOV_X_OSR 0xA027U
#define MOV_X_ISR 0xA026U
#define MOV_Y_OSR 0xA047U
#define MOV_Y_X 0xA041U
#define MOV_Y_NOT_NULL 0xA04BU
#define MOV_ISR_X 0xA0C1U
#define MOV_ISR_Y 0xA0C2U
#define MOV_ISR_OSR 0xA0C7U
#define MOV_ISR_NULL 0xA0C3U
#define FLAG_SET(flag) (0xC000U | (flag))
#define FLAG_CLEAR(flag) (0xC040U | (flag))
#define SET_PINS(value) (0xE000U | (value))
#define SET_DIRECTIONS(value) (0xE080U | (value))

#endif
