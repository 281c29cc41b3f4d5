// The value of a rank among many, without sorting them: Hoare's selection, for either kind of float.
#ifndef ANNULUS_SELECTION_H
#define ANNULUS_SELECTION_H

#include "native.h"

// The value of that rank, from 0, among `size` without a NaN; reorders them. 0 of nothing.
#define SELECTION(NAME, TYPE)                                                                                          \
    static inline TYPE NAME(TYPE* const values, const int64_t size, const int64_t rank)                                \
    {                                                                                                                  \
        if (size <= 0) {                                                                                               \
            return (TYPE)0;                                                                                            \
        }                                                                                                              \
        int64_t low = 0, high = size - 1;                                                                              \
        while (low < high) {                                                                                           \
            const TYPE pivot = values[(low + high) / 2];                                                               \
            int64_t i = low, k = high;                                                                                 \
            while (i <= k) {                                                                                           \
                while (i < high && values[i] < pivot) {                                                                \
                    i++;                                                                                               \
                }                                                                                                      \
                while (k > low && values[k] > pivot) {                                                                 \
                    k--;                                                                                               \
                }                                                                                                      \
                if (i <= k) {                                                                                          \
                    const TYPE swapped = values[i];                                                                    \
                    values[i] = values[k];                                                                             \
                    values[k] = swapped;                                                                               \
                    i++;                                                                                               \
                    k--;                                                                                               \
                }                                                                                                      \
            }                                                                                                          \
            if (rank <= k) {                                                                                           \
                high = k;                                                                                              \
            } else if (rank >= i) {                                                                                    \
                low = i;                                                                                               \
            } else {                                                                                                   \
                break;                                                                                                 \
            }                                                                                                          \
        }                                                                                                              \
        return values[rank < size ? rank : size - 1];                                                                  \
    }

SELECTION(ranked, double)
SELECTION(ranked_f, float)

// Median, the upper one of two; reorders the values. 0 of nothing.
static inline double middle(double* const values, const int64_t size)
{
    return ranked(values, size, size / 2);
}

static inline float middle_f(float* const values, const int64_t size)
{
    return ranked_f(values, size, size / 2);
}

#endif
