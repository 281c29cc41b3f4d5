// Who this board is: its boot byte, why it started, and its name.

#include "../board.h"
#include "../core/link.h"
#include "../core/messages.h"
#include "flash.h"
#include "hardware.h"
#include "registers.h"

static uint8_t boot;
static uint8_t cause;
static uint32_t nonce;

// Bits of the ring oscillator are neither fair nor independent. One is taken every microsecond, some six of its turns
// after the last, and 256 of them are folded into 16.
static uint16_t random_16(void)
{
    uint8_t bits[32] = {0};
    for (uint32_t i = 0; i < 8U * sizeof bits; i++) {
        const uint32_t began = REGISTER(TIMER_RAW_LOW);
        while (REGISTER(TIMER_RAW_LOW) == began) {
        }
        bits[i / 8U] = (uint8_t)((bits[i / 8U] << 1) | (REGISTER(ROSC_RANDOMBIT) & 1U));
    }
    return link_crc(bits, sizeof bits, 0U);
}

// Another byte than the one before, if anything remembers that: the scratch register through every reset, the memory
// even through a loss of power that was short.
static void find_cause(void)
{
    const uint32_t scratch = REGISTER(WATCHDOG_KEPT_CAUSE);
    const bool ran_before = (scratch & 0xFFFFFF00U) == SCRATCH_MAGIC;
    const bool by_host = (scratch & 0xFFU) == SCRATCH_BY_HOST;
    if (!ran_before || (REGISTER(WATCHDOG_REASON) == 0U)) {
        cause = BOOT_CAUSE_POWER_ON;
    } else {
        cause = by_host ? BOOT_CAUSE_HOST_RESET : BOOT_CAUSE_WATCHDOG;
    }
    uint8_t last = (uint8_t)REGISTER(WATCHDOG_KEPT_BOOT);
    boot = (ran_before || crash_knows_boot(&last)) ? (uint8_t)(last + 1U) : (uint8_t)nonce;
    REGISTER(WATCHDOG_KEPT_CAUSE) = SCRATCH_MAGIC;
    REGISTER(WATCHDOG_KEPT_BOOT) = boot;
}

uint8_t board_boot(void)
{
    return boot;
}

uint32_t board_nonce(void)
{
    return nonce;
}

uint8_t board_cause(void)
{
    return cause;
}

const uint8_t* board_name(void)
{
    static const uint8_t name[8] = BOARD_NAME;
    return name;
}

void identity_start(void)
{
    nonce = random_16();
    nonce = (nonce << 16) | random_16();
    find_cause();
}
