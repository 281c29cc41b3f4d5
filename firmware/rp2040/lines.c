// The two lines to hosts: the UART here, USB in usb.c.

#include "../board.h"
#include "hardware.h"
#include "../pins.h"
#include "registers.h"

#define RECEIVED_MAX 512U  // power of two

static volatile uint8_t received[RECEIVED_MAX];  // written by the interrupt only
static volatile uint32_t received_in;
static uint32_t received_out;
static uint32_t bytes_taken;  // by the core, from either line

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
        irq_disable(IRQ_UART0);
        take_received();
        irq_enable(IRQ_UART0);
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

// Is there more for the core to fetch, or about to be? A host that was told to wait asks again some 20 us later, and
// later yet the longer it waits. Without room for answers nothing is taken, and more rounds would not help.
#define AWAKE_ROUNDS 8U  // after the last that took bytes; of 15 us or so
bool lines_waiting(void)
{
    static uint32_t taken_before;
    static uint32_t rounds;
    rounds = (bytes_taken != taken_before) ? 0U : rounds + 1U;
    taken_before = bytes_taken;
    return rounds < AWAKE_ROUNDS;
}

void lines_start(void)
{
    pin_use(PIN_UART_TX, FUNCTION_UART, PAD_DRIVE_4MA);
    pin_use(PIN_UART_RX, FUNCTION_UART, PAD_INPUT | PAD_SCHMITT | PAD_PULL_UP);
    REGISTER(UART_IBRD) = 6U;  // 100 MHz / (16 * 6.25) = 1 Mbaud exactly
    REGISTER(UART_FBRD) = 16U;
    REGISTER(UART_LCR_H) = (3U << 5) | (1U << 4);  // 8N1, FIFOs
    REGISTER(UART_IFLS) = 0U;                      // interrupt from four bytes on
    REGISTER(UART_CR) = (1U << 9) | (1U << 8) | 1U;
    REGISTER(UART_IMSC) = UART_RX_INTERRUPT;
    irq_enable(IRQ_UART0);
}
