// The rig from reset to its main loop. Everything that has a moment is played and recorded by machines of their own:
// the processor hurries nowhere. It runs from RAM all the same, as the controller's files that it shares do.

#include <string.h>

#include "../board.h"
#include "../core/link.h"
#include "../core/messages.h"
#include "../rp2040/clocks.h"
#include "../rp2040/hardware.h"
#include "../rp2040/registers.h"
#include "rig.h"

extern uint32_t image_load[], image_start_at[], image_end[], bss_start[], bss_end[], stack_top[];

void reset_handler(void);

__attribute__((section(".version"), used)) static const char version[] =
    "annulus-rig rp2040 " ANNULUS_VERSION " " ANNULUS_GIT;

typedef void (*vector_t)(void);

static void halt_handler(void)
{
    for (;;) {  // the watchdog bites
    }
}

__attribute__((section(".vectors"), used)) static const vector_t vectors[48] = {
    [0] = (vector_t)(uintptr_t)stack_top,
    [1] = reset_handler,
    [2] = halt_handler,
    [3] = halt_handler,
    [16 + IRQ_TIMER0] = alarm_handler,
    [16 + IRQ_USB] = usb_handler,
    [16 + IRQ_IO_BANK0] = bench_pins_handler,
    [16 + IRQ_UART0] = serial_handler,
};

static void start_peripherals(void)
{
    SET_BITS(RESETS_RESET) = RESET_ALL & ~(RESET_IO_QSPI | RESET_PADS_QSPI | RESET_PLL_SYS | RESET_PLL_USB);
    const uint32_t wanted =
        RESET_DMA | RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_PIO0 | RESET_PIO1 | RESET_TIMER | RESET_UART0 | RESET_USB;
    CLEAR_BITS(RESETS_RESET) = wanted;
    while ((REGISTER(RESETS_DONE) & wanted) != wanted) {
    }
}

// ---- from flash, where the second stage enters: the image into RAM, and there ----

__attribute__((section(".boot"), noreturn, used)) static void boot_handler(void)
{
    const volatile uint32_t* from = image_load;
    for (volatile uint32_t* to = image_start_at; to < (volatile uint32_t*)image_end; to++) {
        *to = *from++;
    }
    REGISTER(VECTORS) = (uint32_t)(uintptr_t)vectors;
    vectors[1]();
    for (;;) {
    }
}

__attribute__((section(".boot_vectors"), used)) static const vector_t boot_vectors[2] = {
    (vector_t)(uintptr_t)stack_top,
    boot_handler,
};

// ---- what the controller's files ask for, and the rig has in another form ----

// The nonce is nobody's here; a sum of its bits does.
uint16_t link_crc(const uint8_t* const bytes, const size_t size, const uint8_t last)
{
    uint32_t sum = last;
    for (size_t i = 0; i < size; i++) {
        sum = sum * 31U + bytes[i];
    }
    return (uint16_t)sum;
}

// Which board carries it is not asked, so that USB is used as it comes.
bool variant_vbus(void)
{
    return true;
}

bool variant_vbus_back(void)
{
    return true;
}

uint8_t board_kind(void)
{
    return BOARD_KIND_UNKNOWN;
}

bool pinuse_hurries(void)
{
    return false;
}

// The machines' reset leaves nothing driven.
void pinuse_darken(void)
{
}

bool crash_knows_boot(uint8_t* const boot)
{
    (void)boot;
    return false;
}

__attribute__((noreturn)) void reset_handler(void)
{
    memset(bss_start, 0, (size_t)((uint8_t*)bss_end - (uint8_t*)bss_start));
    if (clocks_start() != CLOCKS_RUN) {
        halt_handler();  // no crystal, or no PLL: nothing it measured would be true
    }
    start_peripherals();
    identity_start();
    serial_number_start();
    reset_start();
    bench_start();
    lines_start();
    time_start();
    sleep_start();
    usb_start();
    for (;;) {
        board_watchdog_kick();
        bench_run();
        talk_run();
        usb_run();
        if (!lines_waiting() && !talk_is_busy()) {
            sleep_round();
        }
    }
}
