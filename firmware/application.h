// What an application looks like in flash, to the loader that starts it and to the update that replaces it. The loader
// on a board stays as it was flashed over USB, so nothing here may change for applications that come over a line.

#ifndef ANNULUS_APPLICATION_H
#define ANNULUS_APPLICATION_H

#include <stdbool.h>
#include <stdint.h>

#include "crc32.h"

// Vectors for every interrupt a Cortex-M0+ can have, then: its size in bytes, and its identity, "annulus rp2040 ..".
// The last word is the CRC-32 of all before it.
#define APPLICATION_SIZE_AT 192U
#define APPLICATION_NAME_AT 196U
#define APPLICATION_NAME_START 0x756E6E61U  // "annu", as a word

static inline __attribute__((always_inline)) uint32_t application_word(const uint8_t* const at)
{
    return (uint32_t)at[0] | ((uint32_t)at[1] << 8) | ((uint32_t)at[2] << 16) | ((uint32_t)at[3] << 24);
}

// Is there one that could be started at all? Cheap: what is behind its head is taken on trust.
static inline __attribute__((always_inline)) bool application_is_there(const uint8_t* const application)
{
    return application_word(application + APPLICATION_NAME_AT) == APPLICATION_NAME_START;
}

// The same, every byte as it was built. `max`: room for it there.
static inline __attribute__((always_inline)) bool application_is_whole(const uint8_t* const application,
                                                                       const uint32_t max)
{
    const uint32_t size = application_word(application + APPLICATION_SIZE_AT);
    if (!application_is_there(application) || (size > max) || (size % 4U != 0U) || (size <= APPLICATION_NAME_AT)) {
        return false;
    }
    return crc32_of(application, size - 4U) == application_word(application + size - 4U);
}

// Tells two whole ones apart.
static inline __attribute__((always_inline)) uint32_t application_crc(const uint8_t* const application)
{
    return application_word(application + application_word(application + APPLICATION_SIZE_AT) - 4U);
}

#endif
