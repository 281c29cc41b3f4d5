// Who this board is: its boot byte, why it started and its name.

#include "hardware.h"

static uint8_t boot;
static uint8_t cause;

void identity_start(const uint8_t given_boot, const uint8_t given_cause)
{
    boot = given_boot;
    cause = given_cause;
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
    static const uint8_t name[8] = "native";
    return name;
}
