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

// Adds the products of rows with one another, each `size` values, a multiple of LANES, and `stride` from the next: of
// four rows among themselves to ten sums, 00 01 02 03 11 12 13 22 23 33, or of four with two others to eight, a0 a1 b0
// .. So many that what is read is used three times, so few that a processor holds them all.
INLINE void add_squares(Lanes* const sums, const double* const rows, const int stride, const int size)
{
    for (int k = 0; k < PARTS; k++) {
        Part s[10];
        for (int i = 0; i < 10; i++) {
            s[i] = sums[i].part[k];
        }
        for (int n = AT_ONCE * k; n < size; n += LANES) {
            const Part a = part_at(rows + n), b = part_at(rows + stride + n);
            const Part c = part_at(rows + 2 * stride + n), d = part_at(rows + 3 * stride + n);
            s[0] += a * a;
            s[1] += a * b;
            s[2] += a * c;
            s[3] += a * d;
            s[4] += b * b;
            s[5] += b * c;
            s[6] += b * d;
            s[7] += c * c;
            s[8] += c * d;
            s[9] += d * d;
        }
        for (int i = 0; i < 10; i++) {
            sums[i].part[k] = s[i];
        }
    }
}

INLINE void add_products(Lanes* const sums, const double* const rows, const double* const others, const int stride,
                         const int size)
{
    for (int k = 0; k < PARTS; k++) {
        Part s[8];
        for (int i = 0; i < 8; i++) {
            s[i] = sums[i].part[k];
        }
        for (int n = AT_ONCE * k; n < size; n += LANES) {
            const Part a = part_at(others + n), b = part_at(others + stride + n);
            for (int i = 0; i < 4; i++) {
                const Part r = part_at(rows + i * stride + n);
                s[2 * i] += r * a;
                s[2 * i + 1] += r * b;
            }
        }
        for (int i = 0; i < 8; i++) {
            sums[i].part[k] = s[i];
        }
    }
}

INLINE double added_up(const Lanes* const sum)
{
    double s[LANES];
    memcpy(s, sum, sizeof s);
    return ((s[0] + s[4]) + (s[2] + s[6])) + ((s[1] + s[5]) + (s[3] + s[7]));
}

#endif
