// Long sums that are fast, and the same bits on every processor: eight partial sums, each of every eighth product,
// added up in one order at the end. How many of the eight one register holds is the processor's affair and changes no
// bit.
#ifndef ANNULUS_LANES_H
#define ANNULUS_LANES_H

#include <string.h>

#include "native.h"

#define LANES 8  // partial sums; what is summed is filled up with zeros to a multiple of these

#if defined(__AVX512F__)
#define AT_ONCE 8
#elif defined(__AVX__)
#define AT_ONCE 4
#else
#define AT_ONCE 2
#endif
#define PARTS (LANES / AT_ONCE)

typedef double Part __attribute__((vector_size(8 * AT_ONCE)));
typedef struct {
    Part part[PARTS];
} Lanes;

INLINE Part part_at(const double* const values)
{
    Part out;
    memcpy(&out, values, sizeof out);
    return out;
}

INLINE void add(Lanes* const sum, const double* const values)
{
    for (int k = 0; k < PARTS; k++) {
        sum->part[k] += part_at(values + AT_ONCE * k);
    }
}

// Adds to four sums the products of values of a0 and a1 with those of b0 and b1, `size` of them, a multiple of LANES.
INLINE void add_products(Lanes* const s00, Lanes* const s01, Lanes* const s10, Lanes* const s11, const double* const a0,
                         const double* const a1, const double* const b0, const double* const b1, const int size)
{
    Lanes t00 = *s00, t01 = *s01, t10 = *s10, t11 = *s11;  // in registers
    for (int n = 0; n < size; n += LANES) {
        for (int k = 0; k < PARTS; k++) {
            const int at = n + AT_ONCE * k;
            const Part p0 = part_at(a0 + at), p1 = part_at(a1 + at), q0 = part_at(b0 + at), q1 = part_at(b1 + at);
            t00.part[k] += p0 * q0;
            t01.part[k] += p0 * q1;
            t10.part[k] += p1 * q0;
            t11.part[k] += p1 * q1;
        }
    }
    *s00 = t00;
    *s01 = t01;
    *s10 = t10;
    *s11 = t11;
}

INLINE double added_up(const Lanes* const sum)
{
    double s[LANES];
    memcpy(s, sum, sizeof s);
    return ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
}

#endif
