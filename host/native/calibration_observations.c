// Vectors of one camera of a head turned and moved into the head's own frame.

#include "native.h"

// In place, of those vectors (n, 3, 3) whose camera (n,) is `number`: turn (3, 3) v + shift.
DOOR void place_vectors(const int64_t* const camera, const int64_t number, const double* const turn,
                        const double* const shift, double* const vectors, const int64_t n)
{
    for (int64_t i = 0; i < n; i++) {
        if (camera[i] != number) {
            continue;
        }
        for (int64_t k = 0; k < 3; k++) {
            double* const v = vectors + 9 * i + 3 * k;
            const double x = v[0], y = v[1], z = v[2];
            for (int64_t a = 0; a < 3; a++) {
                v[a] = turn[3 * a] * x + turn[3 * a + 1] * y + turn[3 * a + 2] * z + shift[a];
            }
        }
    }
}
