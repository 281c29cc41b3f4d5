// From the loader to the main loop: memory, clocks. All of it runs from RAM.

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "../application.h"
#include "../board.h"
#include "../core/controller.h"
#include "../core/messages.h"
#include "../pins.h"
#include "clocks.h"
#include "flash.h"
#include "hardware.h"
#include "registers.h"

extern const uint32_t interrupt_vectors[];
extern uint32_t bss_start[], bss_end[], stack_bottom[], stack_top[];

void reset_handler(uint32_t mark, uint32_t handover);

// Stands in the image for `annulus firmware info` and for whoever opens the file.
#define TEXT_OF(value) #value
#define TEXT(value) TEXT_OF(value)
__attribute__((section(".version"), used)) static const char version[] =
    "annulus " BOARD_NAME " " ANNULUS_VERSION " " ANNULUS_GIT
    " protocol " TEXT(PROTOCOL_VERSION) " schema " TEXT(SCHEMA_HASH);
// Apart from the above, which older hosts read as it stands, and behind it: the loader knows the place of the other.
__attribute__((section(".level"), used)) static const char level[] = "annulus level " TEXT(LEVEL);

#define STACK_PAINT 0xA5A5A5A5U

static controller_t controller;

#define NO_PERIPHERALS 4U  // blinks, after those of clocks.h

// It cannot run: so often the light blinks, at some 2 Hz from a ring oscillator of 6 MHz, then it tries again. Every
// output is as the reset left it.
#define BLINK_LOOPS 150000U  // of ten cycles
#define GIVE_UP_MS 2000U     // for half a blink, on whatever clock there is
__attribute__((noreturn)) static void give_up(const uint32_t blinks)
{
    CLEAR_BITS(RESETS_RESET) = RESET_IO_BANK0 | RESET_PADS_BANK0;
    (void)clock_came(RESETS_DONE, RESET_IO_BANK0 | RESET_PADS_BANK0);
    pin_use(PIN_STATUS, FUNCTION_SIO, PAD_DRIVE_4MA);
    REGISTER(SIO_GPIO_OE_SET) = 1U << PIN_STATUS;
    for (uint32_t half = 0; half < 2U * (blinks + 1U); half++) {
        REGISTER((((half & 1U) == 0U) && (half < 2U * blinks)) ? SIO_GPIO_OUT_SET : SIO_GPIO_OUT_CLEAR) = 1U
                                                                                                          << PIN_STATUS;
        REGISTER(WATCHDOG_LOAD) = GIVE_UP_MS * WATCHDOG_COUNTS_A_MS;
        for (volatile uint32_t i = 0; i < BLINK_LOOPS; i++) {
        }
    }
    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_TRIGGER;
    for (;;) {
    }
}

static void start_clocks(void)
{
    const uint32_t missing = clocks_start();
    if (missing != CLOCKS_RUN) {
        give_up(missing);
    }
}

static void start_peripherals(void)
{
    // The boot loader may have left anything running; the flash is being spoken to through the two QSPI blocks.
    SET_BITS(RESETS_RESET) = RESET_ALL & ~(RESET_IO_QSPI | RESET_PADS_QSPI | RESET_PLL_SYS | RESET_PLL_USB);
    const uint32_t wanted =
        RESET_DMA | RESET_IO_BANK0 | RESET_PADS_BANK0 | RESET_PIO0 | RESET_PIO1 | RESET_TIMER | RESET_UART0 | RESET_USB;
    CLEAR_BITS(RESETS_RESET) = wanted;
    if (!clock_came(RESETS_DONE, wanted)) {
        give_up(NO_PERIPHERALS);
    }
    // Before any is used: some tables say that at reset a channel is chained to itself, some to channel 0, and
    // `dma_stop` stops whatever it is chained to.
    for (uint32_t channel = 0; channel < DMA_CHANNELS; channel++) {
        REGISTER(DMA_CTRL(channel)) = DMA_CHAIN(channel);
    }
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

// From the loader, which has the watchdog running: whatever does not come back is started anew.
__attribute__((noreturn)) void reset_handler(const uint32_t mark, const uint32_t handover)
{
    REGISTER(VECTORS) = (uint32_t)(uintptr_t)interrupt_vectors;
    paint_stack();
    memset(bss_start, 0, (size_t)((uint8_t*)bss_end - (uint8_t*)bss_start));
    image_begin(mark, handover);
    time_begin(mark == HANDOVER_MARK);
    start_clocks();
    start_peripherals();
    variant_prepare();  // settles while identity_start waits for random bits
    identity_start();
    serial_number_start();
    reset_start();
    pinuse_start();
    lines_start();
    time_start();
    sleep_start();
    crash_start(board_cause(), board_boot());
    lamps_start();
    microwave_start();
    turntable_start();
    camera_trigger_start();
    usb_start();
    controller_start(&controller);
    for (;;) {
        controller_run(&controller);
        board_trail()->part = PART_USB;
        usb_run();
        pinuse_run();
        crash_measure();
        if (!lines_waiting() && !microwave_hurries()) {
            image_run(staging_is_idle());
            sleep_round();
        }
    }
}
