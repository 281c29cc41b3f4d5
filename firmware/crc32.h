// CRC-32 of an application (IEEE 802.3, as zlib has it), four bits at a time. Inlined, because the loader shares no
// code.

#ifndef ANNULUS_CRC32_H
#define ANNULUS_CRC32_H

#include <stdint.h>

#define CRC32_BEGIN 0xFFFFFFFFU

// Of what goes before, as CRC32_BEGIN or the last call left it, and these; crc32_end makes the CRC of it.
static inline __attribute__((always_inline)) uint32_t crc32_add(uint32_t crc, const uint8_t* const bytes,
                                                                const uint32_t size)
{
    static const uint32_t of_nibble[16] = {0x00000000U, 0x1DB71064U, 0x3B6E20C8U, 0x26D930ACU, 0x76DC4190U, 0x6B6B51F4U,
                                           0x4DB26158U, 0x5005713CU, 0xEDB88320U, 0xF00F9344U, 0xD6D6A3E8U, 0xCB61B38CU,
                                           0x9B64C2B0U, 0x86D3D2D4U, 0xA00AE278U, 0xBDBDF21CU};
    for (uint32_t i = 0; i < size; i++) {
        crc ^= bytes[i];
        crc = (crc >> 4) ^ of_nibble[crc & 0xFU];
        crc = (crc >> 4) ^ of_nibble[crc & 0xFU];
    }
    return crc;
}

static inline __attribute__((always_inline)) uint32_t crc32_end(const uint32_t crc)
{
    return ~crc;
}

static inline __attribute__((always_inline)) uint32_t crc32_of(const uint8_t* const bytes, const uint32_t size)
{
    return crc32_end(crc32_add(CRC32_BEGIN, bytes, size));
}

#endif
