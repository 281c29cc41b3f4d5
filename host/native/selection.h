// The value of a rank among many, without sorting them: quick selection, for either kind of float. Values are parted
// without a branch that depends on them, a third of the time of Hoare's way of parting.
#ifndef ANNULUS_SELECTION_H
#define ANNULUS_SELECTION_H

#include "native.h"

// The value of that rank, from 0, among `size` without a NaN; reorders them. 0 of nothing.
#define SELECTION(NAME, TYPE)                                                                                          \
    ONCE TYPE NAME(TYPE* const values, const int64_t size, const int64_t wanted)                                       \
    {                                                                                                                  \
        if (size <= 0) {                                                                                               \
            return (TYPE)0;                                                                                            \
        }                                                                                                              \
        const int64_t rank = least(wanted, size - 1);                                                                  \
        int64_t low = 0, high = size - 1;                                                                              \
        while (high - low >= 12) {                                                                                     \
            const TYPE a = values[low], b = values[(low + high) / 2], c = values[high];                                \
            const TYPE less = a < b ? a : b, more = a < b ? b : a, upper = more < c ? more : c;                        \
            const TYPE pivot = less > upper ? less : upper; /* of the three the middle one */                          \
            int64_t parted = low;                                                                                      \
            for (int64_t i = low; i <= high; i++) {                                                                    \
                const TYPE value = values[i];                                                                          \
                values[i] = values[parted];                                                                            \
                values[parted] = value;                                                                                \
                parted += value < pivot;                                                                               \
            }                                                                                                          \
            if (rank < parted) {                                                                                       \
                high = parted - 1;                                                                                     \
            } else if (parted > low) {                                                                                 \
                low = parted;                                                                                          \
            } else { /* the pivot is the least: its equals are taken off */                                            \
                for (int64_t i = low; i <= high; i++) {                                                                \
                    const TYPE value = values[i];                                                                      \
                    values[i] = values[parted];                                                                        \
                    values[parted] = value;                                                                            \
                    parted += value <= pivot;                                                                          \
                }                                                                                                      \
                if (rank < parted || parted == low) {                                                                  \
                    return pivot;                                                                                      \
                }                                                                                                      \
                low = parted;                                                                                          \
            }                                                                                                          \
        }                                                                                                              \
        for (int64_t i = low + 1; i <= high; i++) {                                                                    \
            const TYPE value = values[i];                                                                              \
            int64_t place = i;                                                                                         \
            while (place > low && values[place - 1] > value) {                                                         \
                values[place] = values[place - 1];                                                                     \
                place--;                                                                                               \
            }                                                                                                          \
            values[place] = value;                                                                                     \
        }                                                                                                              \
        return values[most(rank, 0)];                                                                                  \
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

// Median as numpy has it, of the two in the middle their mean; reorders the values. 0 of nothing.
#define HALFWAY(NAME, TYPE, MIDDLE, HALF)                                                                              \
    static inline TYPE NAME(TYPE* const values, const int64_t size)                                                    \
    {                                                                                                                  \
        const TYPE high = MIDDLE(values, size);                                                                        \
        if (size % 2 || size < 2) {                                                                                    \
            return high;                                                                                               \
        }                                                                                                              \
        TYPE low = values[0]; /* what lies before the middle is no greater */                                          \
        for (int64_t i = 1; i < size / 2; i++) {                                                                       \
            low = values[i] > low ? values[i] : low;                                                                   \
        }                                                                                                              \
        return HALF * (low + high);                                                                                    \
    }

HALFWAY(halfway, double, middle, 0.5)
HALFWAY(halfway_f, float, middle_f, 0.5F)

#endif
