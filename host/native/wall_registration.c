// How far a frame leans off the shape that all frames share: two shifts and two tilts of its points, by Tukey's
// biweight.
//
// A point of radius r at clock angle t, so far ahead of its head, is off the shape s by
//     r - (s0 + s1 cos t + s2 sin t + s3 cos 2t + s4 sin 2t) = (dx + gx ahead) x/r + (dy + gy ahead) y/r, (1)
// with cos t = -y/r and sin t = x/r. A weight is (1 - u^2)^2, so rows scaled by 1 - u^2 give the normal equations.

#include "lanes.h"
#include "selection.h"
#include "solving.h"

enum { SIZE = 4, SHAPE = 5, ROUNDS = 8, SWEEPS = 12 };
enum { SCALED = 0, VALUE = SIZE, NONE, DESIGN, EXCESS = DESIGN + SIZE, LEFT, WORK, ROWS };  // of the room

// Greatest over least of the sizes of the eigenvalues of a symmetric matrix (Jacobi's rotations); changes it.
static double condition(double a[SIZE][SIZE])
{
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        for (int p = 0; p < SIZE; p++) {
            for (int q = p + 1; q < SIZE; q++) {
                if (a[p][q] == 0.0) {
                    continue;
                }
                const double theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                const double t = (theta < 0.0 ? -1.0 : 1.0) / (fabs(theta) + sqrt(theta * theta + 1.0));
                const double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
                for (int k = 0; k < SIZE; k++) {
                    const double x = a[k][p], y = a[k][q];
                    a[k][p] = c * x - s * y;
                    a[k][q] = s * x + c * y;
                }
                for (int k = 0; k < SIZE; k++) {
                    const double x = a[p][k], y = a[q][k];
                    a[p][k] = c * x - s * y;
                    a[q][k] = s * x + c * y;
                }
            }
        }
    }
    double low = fabs(a[0][0]), high = low;
    for (int k = 1; k < SIZE; k++) {
        const double value = fabs(a[k][k]);
        low = value < low ? value : low;
        high = value > high ? value : high;
    }
    return high / low;
}

// Rows of the room from points (n, 3) that lie between the shape's first and last station; how many.
static int64_t lay(const float* const points, const int64_t n, const double z_mm, const double* const stations,
                   const double* const shape, const int64_t z, const double radius_mm, double* const room,
                   const int64_t m)
{
    const double step = (stations[z - 1] - stations[0]) / (double)most(z - 1, 1);
    int64_t size = 0, at = 0;
    for (int64_t i = 0; i < n; i++) {
        const double px = (double)points[3 * i], py = (double)points[3 * i + 1], pz = (double)points[3 * i + 2];
        if (!(pz >= stations[0] && pz <= stations[z - 1])) {
            continue;
        }
        at = z > 1 ? whole((pz - stations[0]) / step, 0, z - 2) : 0;
        while (at > 0 && pz < stations[at]) {
            at--;
        }
        while (at + 2 < z && pz >= stations[at + 1]) {
            at++;
        }
        const double between = z > 1 ? stations[at + 1] - stations[at] : 1.0, along = pz - stations[at];
        const double *const low = shape + SHAPE * at, *const high = shape + SHAPE * least(at + 1, z - 1);
        double s[SHAPE];
        for (int k = 0; k < SHAPE; k++) {
            s[k] = (high[k] - low[k]) / between * along + low[k];
        }
        const double radius = sqrt(px * px + py * py), x = px / radius, y = py / radius, c = -y;
        const double ahead = (pz - z_mm) / radius_mm;
        const double here = s[0] + s[1] * c + s[2] * x + s[3] * (c * c - x * x) + s[4] * (2.0 * c * x);
        room[DESIGN * m + size] = x;
        room[(DESIGN + 1) * m + size] = y;
        room[(DESIGN + 2) * m + size] = x * ahead;
        room[(DESIGN + 3) * m + size] = y * ahead;
        room[EXCESS * m + size] = radius - here;
        size++;
    }
    return size;
}

// The four numbers of Eq. 1, tilts in mm a radius, and `moves`, the 90th of a hundred of what they do to the points;
// returns 1, or 0 where the frame has none: fewer points than `needed` on the shape, an arc that does not tell them
// apart (condition), or fewer than half of them that agree. stations (z,), rising, mm; floor_mm: of the scale. room
// (13, m), m at least n rounded up to eights.
DOOR int64_t frame_correction(const float* const points, const double z_mm, const double* const stations,
                              const double* const shape, const double radius_mm, const double needed,
                              const double floor_mm, const double tukey, const double of_mad,
                              const double condition_most, double* const room, double* const found, double* const moves,
                              const int64_t n, const int64_t z, const int64_t m)
{
    if (z < 1 || m < (n + LANES - 1) / LANES * LANES) {
        return 0;
    }
    const int64_t size = lay(points, n, z_mm, stations, shape, z, radius_mm, room, m);
    if ((double)size < needed || size < 1) {
        return 0;
    }
    const int64_t filled = (size + LANES - 1) / LANES * LANES;
    for (int64_t row = 0; row < ROWS; row++) {
        for (int64_t i = size; i < filled; i++) {
            room[row * m + i] = 0.0;
        }
    }
    double *const design = room + DESIGN * m, *const excess = room + EXCESS * m, *const left = room + LEFT * m,
                  *const work = room + WORK * m;
    double fit[SIZE] = {0.0};
    int64_t agree = 0;
    for (int64_t i = 0; i < filled; i++) {
        room[NONE * m + i] = 0.0;
    }
    for (int round = 0; round < ROUNDS; round++) {
        for (int64_t i = 0; i < filled; i++) {
            left[i] = excess[i] - (design[i] * fit[0] + design[m + i] * fit[1] + design[2 * m + i] * fit[2] +
                                   design[3 * m + i] * fit[3]);
            work[i] = fabs(left[i]);
        }
        const double sigma = of_mad * halfway(work, size), scale = sigma > floor_mm ? sigma : floor_mm;
        const double by = 1.0 / (tukey * scale);
        agree = 0;
        for (int64_t i = 0; i < filled; i++) {
            const double u = left[i] * by, near = u * u < 1.0 ? 1.0 - u * u : 0.0;
            agree += i < size && near > 0.0;
            for (int k = 0; k < SIZE; k++) {
                room[k * m + i] = near * design[k * m + i];
            }
            room[VALUE * m + i] = near * excess[i];
        }
        Lanes squares[10], products[2 * SIZE];
        memset(squares, 0, sizeof squares);
        memset(products, 0, sizeof products);
        add_squares(squares, room, (int)m, (int)filled);
        add_products(products, room, room + VALUE * m, (int)m, (int)filled);
        double normal[SIZE][SIZE], turned[SIZE][SIZE];
        for (int i = 0, k = 0; i < SIZE; i++) {
            for (int j = i; j < SIZE; j++) {
                normal[i][j] = normal[j][i] = added_up(squares + k++);
            }
            fit[i] = added_up(products + 2 * i);
        }
        memcpy(turned, normal, sizeof normal);
        if (!(condition(turned) <= condition_most) || !factored(&normal[0][0], SIZE)) {
            return 0;
        }
        solved(&normal[0][0], SIZE, fit);
    }
    for (int64_t i = 0; i < size; i++) {
        work[i] =
            fabs(design[i] * fit[0] + design[m + i] * fit[1] + design[2 * m + i] * fit[2] + design[3 * m + i] * fit[3]);
    }
    const double at = 0.9 * (double)(size - 1);
    const int64_t rank = whole(at, 0, size - 1);
    const double low = ranked(work, size, rank), high = ranked(work, size, least(rank + 1, size - 1));
    *moves = low + (high - low) * (at - (double)rank);
    memcpy(found, fit, sizeof fit);
    return 2 * agree >= size;
}
