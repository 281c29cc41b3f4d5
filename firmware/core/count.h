// Counters of 16 bits, as the wire has them, stop at their end: one that began anew would say that little had happened.

#ifndef ANNULUS_COUNT_H
#define ANNULUS_COUNT_H

#include <stdint.h>

#define COUNT_MAX UINT16_MAX  // this many or more

static inline void count_one_more(uint16_t* const counter)
{
    if (*counter < COUNT_MAX) {
        (*counter)++;
    }
}

#endif
