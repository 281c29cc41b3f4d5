// Small systems of equations solved: Gauss, the greatest pivot of each column first.
#ifndef ANNULUS_ELIMINATION_H
#define ANNULUS_ELIMINATION_H

#include <math.h>

#include "native.h"

// Turns a (size, size) and its right sides b (size, sides) into the solutions, in b; false where a has no inverse. Both
// in order of memory, both changed.
INLINE bool eliminate(double* const a, double* const b, const int64_t size, const int64_t sides)
{
    for (int64_t column = 0; column < size; column++) {
        int64_t pivot = column;
        for (int64_t row = column + 1; row < size; row++) {
            if (fabs(a[row * size + column]) > fabs(a[pivot * size + column])) {
                pivot = row;
            }
        }
        const double greatest = a[pivot * size + column];
        if (!(fabs(greatest) > 0.0)) {
            return false;
        }
        for (int64_t k = 0; k < size; k++) {
            const double kept = a[column * size + k];
            a[column * size + k] = a[pivot * size + k];
            a[pivot * size + k] = kept;
        }
        for (int64_t k = 0; k < sides; k++) {
            const double kept = b[column * sides + k];
            b[column * sides + k] = b[pivot * sides + k];
            b[pivot * sides + k] = kept;
        }
        for (int64_t row = column + 1; row < size; row++) {
            const double part = a[row * size + column] / greatest;
            for (int64_t k = column; k < size; k++) {
                a[row * size + k] -= part * a[column * size + k];
            }
            for (int64_t k = 0; k < sides; k++) {
                b[row * sides + k] -= part * b[column * sides + k];
            }
        }
    }
    for (int64_t row = size - 1; row >= 0; row--) {
        for (int64_t k = 0; k < sides; k++) {
            double left = b[row * sides + k];
            for (int64_t column = row + 1; column < size; column++) {
                left -= a[row * size + column] * b[column * sides + k];
            }
            b[row * sides + k] = left / a[row * size + row];
        }
    }
    return true;
}

#endif
