// Density of a wall relative to plain wall: annulus_pipe.wings.joints.measure.density. The wall is taken at even depths
// from its inner to its outer surface; of each place along the circumference and depth a line along z through plain
// planes, least squares with what is wild left out, says what plain wall would show.
#include <math.h>

#include "native.h"

#define INSIDE 1.001  // samples off the last one: depths beyond it are its own
#define ROUNDS 3      // of the line: the first with all, then without what lies off the one before
#define PLANES 4      // plain ones, not wild, that a line needs
#define CELLS 64      // places whose lines are fitted at once: their sums stay in the nearest cache

// out[plane, angle, depth]: grey in the middles of equal parts of the wall.
DOOR void joints_wall(const float* const block, const double* const rho, const double* const inner,
                      const double* const outer, float* const out, const int64_t p, const int64_t j, const int64_t n,
                      const int64_t u)
{
    if (n < 2) {
        for (int64_t a = 0; a < p * j * u; a++) {
            out[a] = NAN;
        }
        return;
    }
    const double first = rho[0], per = 1.0 / (rho[1] - rho[0]), last = (double)n - INSIDE;
    for (int64_t a = 0; a < p * j; a++) {
        const float* const grey = block + a * n;
        const double part = (outer[a] - inner[a]) * per / (double)u, middle = (inner[a] - first) * per + 0.5 * part;
        for (int64_t b = 0; b < u; b++) {
            const double s = held(middle + (double)b * part, 0.0, last);
            const int64_t k = (int64_t)s;
            out[a * u + b] = (float)((double)grey[k] + (s - (double)k) * (double)(grey[k + 1] - grey[k]));
        }
    }
}

typedef struct {
    double count[CELLS], z[CELLS], zz[CELLS], grey[CELLS], z_grey[CELLS];
} Sums;

// One plane into the sums of so many cells; `wild` off their lines is left out.
INLINE void add_plane(Sums* const sums, const float* const grey, const double z, const double* const base,
                      const double* const slope, const double wild, const int64_t cells)
{
    for (int64_t i = 0; i < cells; i++) {
        const double value = (double)grey[i];
        const bool out = fabs(value - base[i] - slope[i] * z) > wild;
        sums->count[i] += out ? 0.0 : 1.0;
        sums->z[i] += out ? 0.0 : z;
        sums->zz[i] += out ? 0.0 : z * z;
        sums->grey[i] += out ? 0.0 : value;
        sums->z_grey[i] += out ? 0.0 : value * z;
    }
}

// base, slope [angle, depth]: of each cell its line's grey at z = 0, and per mm; 0 where too few planes are plain.
DOOR void joints_background(const float* const block, const double* const z, const bool* const plain,
                            const double spread, double* const base, double* const slope, const int64_t p,
                            const int64_t j, const int64_t u)
{
    const int64_t all = j * u;
    for (int64_t from = 0; from < all; from += CELLS) {
        const int64_t cells = least(CELLS, all - from);
        double a[CELLS] = {0.0}, b[CELLS] = {0.0};
        for (int64_t turn = 0; turn < ROUNDS; turn++) {
            Sums sums = {{0.0}, {0.0}, {0.0}, {0.0}, {0.0}};
            for (int64_t k = 0; k < p; k++) {
                if (plain[k]) {
                    add_plane(&sums, block + k * all + from, z[k], a, b, turn > 0 ? spread : HUGE_VAL, cells);
                }
            }
            for (int64_t i = 0; i < cells; i++) {
                const double n = sums.count[i], t = sums.z[i], det = n * sums.zz[i] - t * t;
                if (n >= PLANES && det > 0.0) {
                    a[i] = (sums.zz[i] * sums.grey[i] - t * sums.z_grey[i]) / det;
                    b[i] = (n * sums.z_grey[i] - t * sums.grey[i]) / det;
                }
            }
        }
        for (int64_t i = 0; i < cells; i++) {
            base[from + i] = a[i];
            slope[from + i] = b[i];
        }
    }
}

// In place: grey over its cell's line, less one.
DOOR void joints_relative(float* const block, const double* const z, const double* const base,
                          const double* const slope, const int64_t p, const int64_t j, const int64_t u)
{
    for (int64_t k = 0; k < p; k++) {
        float* const grey = block + k * j * u;
        for (int64_t i = 0; i < j * u; i++) {
            grey[i] = (float)((double)grey[i] / (base[i] + slope[i] * z[k]) - 1.0);
        }
    }
}
