// The course of rings round an image: of each, the median of what is there among neighbouring directions.

#include "selection.h"

enum { MOST = 64 };  // neighbours on each side, bounds the room

// Medians (k, j) of curves (k, j), closed lines, over `around` neighbours on each side; untouched where fewer than
// `least` of them are there.
DOOR void course_medians(const double* const curve, const int64_t around_each, const int64_t least_there,
                         double* const out, const int64_t k, const int64_t j)
{
    const int64_t reach = most(0, least(least(around_each, MOST), (j - 1) / 2));
    for (int64_t ring = 0; ring < k; ring++) {
        for (int64_t at = 0; at < j; at++) {
            double window[2 * MOST + 1];
            int64_t n = 0;
            for (int64_t d = -reach; d <= reach; d++) {
                const double value = curve[ring * j + around(at + d, j)];
                if (value != value) {
                    continue;
                }
                int64_t i = n++;
                while (i > 0 && window[i - 1] > value) {
                    window[i] = window[i - 1];
                    i--;
                }
                window[i] = value;
            }
            if (n >= least_there && n > 0) {
                out[ring * j + at] = 0.5 * (window[(n - 1) / 2] + window[n / 2]);
            }
        }
    }
}
