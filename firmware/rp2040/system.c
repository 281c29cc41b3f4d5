// Time, identity, watchdog, serial line, and the pins at rest.

#include <string.h>

#include "../board.h"
#include "../core/messages.h"
#include "hardware.h"
#include "pins.h"
#include "registers.h"

#define ROUND_US 100U
#define SCRATCH_MAGIC 0x616E6E00U  // SCRATCH2: this firmware ran before, and the low byte says why it ended
#define ENDED_BY_HOST 1U
#define RECEIVED_MAX 512U  // power of two

static uint8_t boot;
static char serial_number[17];
static uint8_t cause;
static uint32_t ticks;
static uint32_t systick;  // at the last look

static volatile uint8_t received[RECEIVED_MAX];  // written by the interrupt only
static volatile uint32_t received_in;
static uint32_t received_out;
static uint32_t bytes_taken;  // by the core, from either line

static volatile uint32_t sync_edges;
static volatile bool interlock_opened;

void pin_use(const uint32_t pin, const uint32_t function, const uint32_t pad)
{
    REGISTER(PAD(pin)) = pad;
    REGISTER(GPIO_CTRL(pin)) = function;
}

void pio_load(const uint32_t pio, const uint32_t first, const uint16_t* const program, const uint32_t length)
{
    for (uint32_t i = 0; i < length; i++) {
        REGISTER(PIO_MEMORY(pio, first + i)) = program[i];
    }
}

// ---- identity ----

static uint8_t random_byte(void)
{
    uint8_t byte = 0;
    for (uint32_t i = 0; i < 8U; i++) {
        byte = (uint8_t)((byte << 1) | (REGISTER(ROSC_RANDOMBIT) & 1U));
    }
    return byte;
}

// The scratch registers outlive every reset but the loss of power. The boot ROM uses 0, 1 and 4 to 7 for itself.
static void find_cause(void)
{
    const uint32_t scratch = REGISTER(WATCHDOG_SCRATCH2);
    const bool ran_before = (scratch & 0xFFFFFF00U) == SCRATCH_MAGIC;
    const bool by_host = (scratch & 0xFFU) == ENDED_BY_HOST;
    if (!ran_before || (REGISTER(WATCHDOG_REASON) == 0U)) {
        cause = BOOT_CAUSE_POWER_ON;
    } else {
        cause = by_host ? BOOT_CAUSE_HOST_RESET : BOOT_CAUSE_WATCHDOG;
    }
    boot = ran_before ? (uint8_t)(REGISTER(WATCHDOG_SCRATCH3) + 1U) : random_byte();
    REGISTER(WATCHDOG_SCRATCH2) = SCRATCH_MAGIC;
    REGISTER(WATCHDOG_SCRATCH3) = boot;
}

uint8_t board_boot(void)
{
    return boot;
}

uint8_t board_cause(void)
{
    return cause;
}

const uint8_t* board_name(void)
{
    static const uint8_t name[8] = "rp2040";
    return name;
}

// The flash's own unique id (command 4Bh, four bytes of nothing, eight of id): the RP2040 has none. While it is read
// the flash gives no code, so this runs from RAM and calls nothing. All 13 bytes wait in the FIFO before the flash is
// selected: it stays selected until the FIFO is empty. At the end all is as boot2.S left it.
__attribute__((noinline, long_call, section(".in_ram"))) static void read_flash_id(volatile uint8_t* const id)
{
    REGISTER(SSI_ENABLE) = 0U;
    REGISTER(SSI_CONTROL0) = 7U << 16;  // bytes, both ways at once
    REGISTER(SSI_SELECT) = 0U;
    REGISTER(SSI_ENABLE) = 1U;
    REGISTER(SSI_DATA) = 0x4BU;
    for (uint32_t i = 0; i < 12U; i++) {
        REGISTER(SSI_DATA) = 0U;
    }
    REGISTER(SSI_SELECT) = 1U;
    while (REGISTER(SSI_RECEIVED) < 13U) {
    }
    for (uint32_t i = 0; i < 13U; i++) {
        const uint8_t byte = (uint8_t)REGISTER(SSI_DATA);
        if (i >= 5U) {
            id[i - 5U] = byte;
        }
    }
    REGISTER(SSI_ENABLE) = 0U;
    REGISTER(SSI_CONTROL0) = 0x001F0300U;
    REGISTER(SSI_ENABLE) = 1U;
}

static void find_serial_number(void)
{
    static const char digits[16] = "0123456789ABCDEF";
    volatile uint8_t id[8];
    read_flash_id(id);
    for (uint32_t i = 0; i < 8U; i++) {
        serial_number[2U * i] = digits[id[i] >> 4];
        serial_number[2U * i + 1U] = digits[id[i] & 0xFU];
    }
}

const char* system_serial_number(void)
{
    return serial_number;
}

// ---- watchdog ----

void board_watchdog_kick(void)
{
    REGISTER(WATCHDOG_LOAD) = BOARD_WATCHDOG_MS * 2000U;  // counts down twice a microsecond: erratum RP2040-E1
    microwave_feed();
}

static void start_watchdog(void)
{
    CLEAR_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;
    REGISTER(PSM_WDSEL) = PSM_ALL_BUT_OSCILLATORS;
    board_watchdog_kick();
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;
}

void outputs_off(void)
{
    SET_BITS(RESETS_RESET) = RESET_PIO0 | RESET_PIO1;
}

void board_reset(void)
{
    outputs_off();
    REGISTER(WATCHDOG_SCRATCH2) = SCRATCH_MAGIC | ENDED_BY_HOST;
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_TRIGGER;
    for (;;) {
    }
}

// The ROM resets the chip by the watchdog and comes up as the drive RPI-RP2 and as PICOBOOT, GP25 showing its activity.
void board_bootloader(void)
{
    typedef void* (*lookup_t)(const uint16_t* table, uint32_t code);
    typedef void (*reset_to_usb_boot_t)(uint32_t activity_pins, uint32_t disabled_interfaces);
    outputs_off();
    interrupts_off();
    REGISTER(WATCHDOG_SCRATCH2) = SCRATCH_MAGIC | ENDED_BY_HOST;
    const lookup_t lookup = (lookup_t)(uintptr_t)rom_lookup;
    const uint16_t* const functions = (const uint16_t*)(uintptr_t)rom_functions;
    const reset_to_usb_boot_t reset_to_usb_boot = (reset_to_usb_boot_t)lookup(functions, ROM_CODE('U', 'B'));
    reset_to_usb_boot(1U << PIN_STATUS, 0U);
}

// ---- time ----

// SysTick counts down at clk_sys and wraps every 168 ms, later than the watchdog bites: somebody always looks in time.
uint32_t board_tick(void)
{
    const uint32_t now = REGISTER(SYSTICK_CVR);
    ticks += (systick - now) & 0xFFFFFFU;
    systick = now;
    return ticks;
}

static void start_time(void)
{
    REGISTER(SYSTICK_RVR) = 0xFFFFFFU;
    REGISTER(SYSTICK_CVR) = 0U;
    REGISTER(SYSTICK_CSR) = 5U;  // clk_sys, no interrupt
    systick = REGISTER(SYSTICK_CVR);
    ticks = 0;
}

void alarm_handler(void)
{
    REGISTER(TIMER_INTR) = 1U;
}

void system_sleep(void)
{
    static uint32_t taken_before;
    const bool busy = bytes_taken != taken_before;  // else there is no room for answers: more rounds would not help
    taken_before = bytes_taken;
    if (busy && ((received_in != received_out) || usb_has_received())) {
        return;  // one command a round: there is more
    }
    REGISTER(TIMER_ALARM0) = REGISTER(TIMER_RAW_LOW) + ROUND_US;
    __asm volatile("wfi");
}

// ---- serial line ----

static void take_received(void)
{
    while ((REGISTER(UART_FR) & UART_RX_EMPTY) == 0U) {
        const uint8_t byte = (uint8_t)REGISTER(UART_DR);
        if (received_in - received_out < RECEIVED_MAX) {
            received[received_in % RECEIVED_MAX] = byte;
            received_in = received_in + 1U;
        }
    }
}

void serial_handler(void)
{
    take_received();
}

// The interrupt comes with four bytes; fewer are fetched here.
static size_t uart_receive(uint8_t* const bytes, const size_t size)
{
    if (received_in == received_out) {
        REGISTER(NVIC_DISABLE) = 1U << IRQ_UART0;
        take_received();
        REGISTER(NVIC_ENABLE) = 1U << IRQ_UART0;
    }
    size_t given = 0;
    while ((given < size) && (received_out != received_in)) {
        bytes[given++] = received[received_out % RECEIVED_MAX];
        received_out++;
    }
    return given;
}

static size_t uart_transmit(const uint8_t* const bytes, const size_t size)
{
    size_t taken = 0;
    while ((taken < size) && ((REGISTER(UART_FR) & UART_TX_FULL) == 0U)) {
        REGISTER(UART_DR) = bytes[taken++];
    }
    return taken;
}

bool board_connected(const uint8_t line)
{
    return (line == LINE_UART) || usb_connected();
}

size_t board_receive(const uint8_t line, uint8_t* const bytes, const size_t size)
{
    const size_t given = (line == LINE_UART) ? uart_receive(bytes, size) : usb_receive(bytes, size);
    bytes_taken += given;
    return given;
}

size_t board_transmit(const uint8_t line, const uint8_t* const bytes, const size_t size)
{
    return (line == LINE_UART) ? uart_transmit(bytes, size) : usb_transmit(bytes, size);
}

bool board_transmitted(const uint8_t line)
{
    return (line == LINE_UART) ? ((REGISTER(UART_FR) & UART_BUSY) == 0U) : usb_transmitted();
}

static void start_serial(void)
{
    pin_use(PIN_UART_TX, FUNCTION_UART, PAD_DRIVE_4MA);
    pin_use(PIN_UART_RX, FUNCTION_UART, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    REGISTER(UART_IBRD) = 6U;  // 100 MHz / (16 * 6.25) = 1 Mbaud exactly
    REGISTER(UART_FBRD) = 16U;
    REGISTER(UART_LCR_H) = (3U << 5) | (1U << 4);  // 8N1, FIFOs
    REGISTER(UART_IFLS) = 0U;                      // interrupt from four bytes on
    REGISTER(UART_CR) = (1U << 9) | (1U << 8) | 1U;
    REGISTER(UART_IMSC) = UART_RX_INTERRUPT;
}

// ---- pins ----

// Counts what the sync follower may refuse, and remembers an interlock that opened however briefly.
void pins_handler(void)
{
    const uint32_t edges = REGISTER(IO_INTR0) & (EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK));
    REGISTER(IO_INTR0) = edges;
    if ((edges & EDGE_LOW(PIN_SYNC)) != 0U) {
        sync_edges = sync_edges + 1U;
    }
    if ((edges & EDGE_HIGH(PIN_INTERLOCK)) != 0U) {
        interlock_opened = true;
    }
}

uint32_t system_sync_edges(const uint32_t accepted)
{
    REGISTER(NVIC_DISABLE) = 1U << IRQ_IO_BANK0;
    if ((int32_t)(sync_edges - accepted) < 0) {
        sync_edges = accepted;
    }
    const uint32_t counted = sync_edges;
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
    return counted;
}

bool board_interlock_open(void)
{
    return ((REGISTER(SIO_GPIO_IN) >> PIN_INTERLOCK) & 1U) != 0U;
}

bool board_interlock_tripped(void)
{
    REGISTER(NVIC_DISABLE) = 1U << IRQ_IO_BANK0;
    const bool tripped = interlock_opened;
    interlock_opened = false;
    REGISTER(NVIC_ENABLE) = 1U << IRQ_IO_BANK0;
    return tripped;
}

void board_status_light(const bool on)
{
    REGISTER(on ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLEAR) = 1U << PIN_STATUS;
}

static void start_pins(void)
{
    // Levels before directions, directions before functions: no output ever shows anything but its level at rest.
    REGISTER(SIO_GPIO_OUT_CLEAR) = (1U << PIN_DIRECTION) | (1U << PIN_STATUS);
    REGISTER(SIO_GPIO_OUT_SET) = 1U << PIN_ENABLE;
    REGISTER(SIO_GPIO_OE_SET) = (1U << PIN_DIRECTION) | (1U << PIN_STATUS) | (1U << PIN_ENABLE);
    pin_use(PIN_DIRECTION, FUNCTION_SIO, PAD_DRIVE_4MA | PAD_PULL_DOWN);
    pin_use(PIN_ENABLE, FUNCTION_SIO, PAD_DRIVE_4MA | PAD_PULL_UP);
    pin_use(PIN_STATUS, FUNCTION_SIO, PAD_DRIVE_4MA | PAD_PULL_DOWN);
    pin_use(PIN_SYNC, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    pin_use(PIN_INTERLOCK, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    REGISTER(IO_INTR0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
    REGISTER(IO_PROC0_INTE0) = EDGE_LOW(PIN_SYNC) | EDGE_HIGH(PIN_INTERLOCK);
}

void system_start(void)
{
    find_cause();
    find_serial_number();
    start_watchdog();
    start_pins();
    start_serial();
    start_time();
    REGISTER(TIMER_INTR) = 1U;
    REGISTER(TIMER_INTE) = 1U;
    REGISTER(NVIC_ENABLE) = (1U << IRQ_TIMER0) | (1U << IRQ_IO_BANK0) | (1U << IRQ_UART0);
}
