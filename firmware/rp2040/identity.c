// Who this board is: its boot byte, why it started, its name and its serial number.

#include "../board.h"
#include "../core/messages.h"
#include "hardware.h"
#include "registers.h"

static uint8_t boot;
static uint8_t cause;
static char serial_number[17];

static uint8_t random_byte(void)
{
    uint8_t byte = 0;
    for (uint32_t i = 0; i < 8U; i++) {
        byte = (uint8_t)((byte << 1) | (REGISTER(ROSC_RANDOMBIT) & 1U));
    }
    return byte;
}

// The boot ROM uses scratch registers 0, 1 and 4 to 7 for itself.
static void find_cause(void)
{
    const uint32_t scratch = REGISTER(WATCHDOG_SCRATCH2);
    const bool ran_before = (scratch & 0xFFFFFF00U) == SCRATCH_MAGIC;
    const bool by_host = (scratch & 0xFFU) == SCRATCH_BY_HOST;
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

const char* identity_serial_number(void)
{
    return serial_number;
}

void identity_start(void)
{
    find_cause();
    find_serial_number();
}
