// The RP2040 has no id of its own; its flash has one.

#include "flash.h"
#include "hardware.h"

void unique_id(uint32_t id[8])
{
    flash_select(8U);
    REGISTER(SSI_DATA) = FLASH_UNIQUE_ID;  // four bytes of nothing, eight of id
    for (uint32_t i = 0; i < 12U; i++) {
        REGISTER(SSI_DATA) = 0U;
    }
    flash_take(13U, id, 8U);
}
