// Who this board is: its boot byte, why it started, its name and its serial number.

#include "hardware.h"

static uint8_t boot;
static uint8_t cause;
static uint32_t starts;  // in this world

void identity_begin(void)
{
    starts = 0;
}

void identity_start(const uint8_t given_boot, const uint8_t given_cause)
{
    boot = given_boot;
    cause = given_cause;
    starts++;
}

uint8_t board_boot(void)
{
    return boot;
}

uint8_t board_cause(void)
{
    return cause;
}

// Not random, so that the same calls give the same bytes; as little alike from boot to boot as if it were.
uint32_t board_nonce(void)
{
    uint32_t mixed = (starts << 8 | boot) * 0x9E3779B9U;
    mixed = (mixed ^ (mixed >> 15)) * 0x85EBCA6BU;
    return mixed ^ (mixed >> 13);
}

const uint8_t* board_serial_number(void)
{
    static const uint8_t digits[] = "0000000000000000";
    return digits;
}

uint8_t board_kind(void)
{
    return BOARD_KIND_UNKNOWN;
}

uint8_t board_vbus(void)
{
    return PRESENCE_UNKNOWN;
}

const uint8_t* board_name(void)
{
    static const uint8_t name[8] = "native";
    return name;
}
