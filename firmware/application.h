// What an application looks like: to the loader that brings it to RAM, and to the update that replaces it. The loader
// on a board stays as it was flashed over USB, so nothing here may change for applications that come over a line.

#ifndef ANNULUS_APPLICATION_H
#define ANNULUS_APPLICATION_H

#include <stdbool.h>
#include <stdint.h>

#include "crc32.h"

// Vectors for every interrupt a Cortex-M0+ can have (a Cortex-M33 keeps its own behind them), then: its size in bytes,
// and its identity, "annulus rp2040 ..". At its end: room for a signature of all before it, which this loader does not
// look at, then the CRC-32 of all before that.
#define APPLICATION_SIZE_AT 192U
#define APPLICATION_NAME_AT 196U
#define APPLICATION_NAME_START 0x756E6E61U  // "annu", as a word
#define APPLICATION_SIGNATURE_BYTES 64U
#define APPLICATION_MIN_BYTES (APPLICATION_NAME_AT + 4U + 4U)

static inline __attribute__((always_inline)) uint32_t application_word(const uint8_t* const at)
{
    return (uint32_t)at[0] | ((uint32_t)at[1] << 8) | ((uint32_t)at[2] << 16) | ((uint32_t)at[3] << 24);
}

// Can an application have this size? `max`: room for it.
static inline __attribute__((always_inline)) bool application_fits(const uint32_t size, const uint32_t max)
{
    return (size >= APPLICATION_MIN_BYTES) && (size <= max) && (size % 4U == 0U);
}

#endif
