// The serial number: what no other board has, in digits.

#include "../board.h"
#include "hardware.h"

static uint8_t serial_number[17];

void serial_number_start(void)
{
    static const uint8_t digits[] = "0123456789ABCDEF";
    uint32_t id[8];
    unique_id(id);
    for (uint32_t i = 0; i < 8U; i++) {
        serial_number[2U * i] = digits[(id[i] >> 4) & 0xFU];
        serial_number[2U * i + 1U] = digits[id[i] & 0xFU];
    }
}

const uint8_t* board_serial_number(void)
{
    return serial_number;
}
