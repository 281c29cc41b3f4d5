// The id that was burnt into this RP2350 as it was made: rows CHIPID0 to 3 of its OTP (datasheet 13.9), most
// significant byte first, as the boot ROM gives it over USB.

#include "../rp2040/hardware.h"
#include "../rp2040/registers.h"

void unique_id(uint32_t id[8])
{
    for (uint32_t i = 0; i < 8U; i++) {
        const uint32_t byte = 7U - i;
        id[i] = (REGISTER(OTP_DATA + (byte & 4U)) >> (8U * (byte & 3U))) & 0xFFU;
    }
}
