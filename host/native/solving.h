// Small systems of equations whose matrix is symmetric and positive definite: Cholesky's L L^T, in rows of `size`.
#ifndef ANNULUS_SOLVING_H
#define ANNULUS_SOLVING_H

#include <math.h>

#include "native.h"

// Makes L, with the inverses of its diagonal, of the lower half; false where it is not positive definite.
ONCE bool factored(double* const matrix, const int size)
{
    for (int i = 0; i < size; i++) {
        double* const row = matrix + i * size;
        for (int j = 0; j <= i; j++) {
            const double* const other = matrix + j * size;
            double left = row[j];
            for (int k = 0; k < j; k++) {
                left -= row[k] * other[k];
            }
            if (j < i) {
                row[j] = left * other[j];
            } else if (left > 0.0) {
                row[i] = 1.0 / sqrt(left);
            } else {
                return false;
            }
        }
    }
    return true;
}

// Replaces the right side by the solution.
ONCE void solved(const double* const factor, const int size, double* const side)
{
    for (int i = 0; i < size; i++) {
        for (int k = 0; k < i; k++) {
            side[i] -= factor[i * size + k] * side[k];
        }
        side[i] *= factor[i * size + i];
    }
    for (int i = size - 1; i >= 0; i--) {
        for (int k = i + 1; k < size; k++) {
            side[i] -= factor[k * size + i] * side[k];
        }
        side[i] *= factor[i * size + i];
    }
}

#endif
