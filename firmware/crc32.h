// CRC-32 of an application (IEEE 802.3, as zlib has it), bit by bit: it is taken when a new application has come and
// when the loader looks at one, never in a round that is in a hurry. Inlined, because the loader shares no code.

#ifndef ANNULUS_CRC32_H
#define ANNULUS_CRC32_H

#include <stdint.h>

static inline __attribute__((always_inline)) uint32_t crc32_of(const uint8_t* const bytes, const uint32_t size)
{
    uint32_t crc = 0xFFFFFFFFU;
    for (uint32_t i = 0; i < size; i++) {
        crc ^= bytes[i];
        for (uint32_t bit = 0; bit < 8U; bit++) {
            crc = (crc >> 1) ^ (0xEDB88320U & (0U - (crc & 1U)));
        }
    }
    return ~crc;
}

#endif
