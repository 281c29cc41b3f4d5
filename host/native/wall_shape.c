// The shape of one station of a pipe, r = s0 + s1 cos t + s2 sin t + s3 cos 2t + s4 sin 2t, fitted to the radii of its
// columns by Tukey's biweight while the scale shrinks (graduated non-convexity), and how well it is known.
//
// Where nobody looked the shape is expected to stay near its circle: a weak measurement K of centre and ovality, as
// much of it as was not seen. Normal equations of a round at scale s, w = (1 - (left / (TUKEY s))^2)^2:
//     (A^T W A + s^2 K) x = A^T W r.                                                                                (1)
// A fit is begun from the shape usual in this pipe and, where most columns do not show that, from plain least squares
// too; of the two the one that fewer columns contradict is kept.

#include "elimination.h"
#include "mathematics.h"
#include "selection.h"

enum { SIZE = 5, LANES = 8, ROUNDS = 12 };
static const double SHRINKS = 0.8;    // of the scale, the next round's at most
static const double COUNTED = 0.3;    // of what was seen: a round that fewer of count in is the last
static const double SEEN = 0.4;       // of the columns: fewer cannot carry five numbers
static const double AGREE = 0.5;      // of what was seen: so many near the usual shape, and it is this one's
static const double RIDGE = 1e-9;     // of the normal equations' diagonal: they always have an inverse
static const double RADIUS_MM = 1.0;  // at least, to divide by

// What was seen of a station, column by column; `left` and `work` are room.
typedef struct {
    double *wave[SIZE - 1], *radius, *left, *work, *weight;
    int64_t size;
    double tukey, of_mad, least;
} Station;

static double lane_sum(const double lanes[LANES])
{
    return ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7]));
}

// Sum of a b c over all columns; b and c may be null: ones.
INLINE double sum_of(const double* const a, const double* const b, const double* const c, const int64_t size)
{
    double lanes[LANES] = {0};
    int64_t n = 0;
    for (; n + LANES <= size; n += LANES) {
        for (int64_t i = 0; i < LANES; i++) {
            lanes[i] += a[n + i] * (b ? b[n + i] : 1.0) * (c ? c[n + i] : 1.0);
        }
    }
    for (int64_t i = 0; n < size; n++, i++) {
        lanes[i] += a[n] * (b ? b[n] : 1.0) * (c ? c[n] : 1.0);
    }
    return lane_sum(lanes);
}

// Writes what a fit leaves of the radii.
static void leave(const Station* const at, const double fit[SIZE])
{
    for (int64_t n = 0; n < at->size; n++) {
        at->left[n] = at->radius[n] - (fit[0] + at->wave[0][n] * fit[1] + at->wave[1][n] * fit[2] +
                                       at->wave[2][n] * fit[3] + at->wave[3][n] * fit[4]);
        at->work[n] = fabs(at->left[n]);
    }
}

// A^T W A and A^T W r of the weights.
static void normal_of(const Station* const at, double normal[SIZE * SIZE], double right[SIZE])
{
    const double* const w = at->weight;
    normal[0] = sum_of(w, 0, 0, at->size);
    right[0] = sum_of(w, at->radius, 0, at->size);
    for (int64_t i = 1; i < SIZE; i++) {
        right[i] = sum_of(w, at->wave[i - 1], at->radius, at->size);
        normal[i * SIZE] = normal[i] = sum_of(w, at->wave[i - 1], 0, at->size);
        for (int64_t j = 1; j <= i; j++) {
            normal[i * SIZE + j] = normal[j * SIZE + i] = sum_of(w, at->wave[i - 1], at->wave[j - 1], at->size);
        }
    }
}

// How many of the columns still have weight at a scale; writes the weights.
static int64_t weigh(const Station* const at, const double scale)
{
    int64_t counted = 0;
    for (int64_t n = 0; n < at->size; n++) {
        const double u = at->left[n] / (at->tukey * scale);
        const double near = 1.0 - u * u;
        counted += fabs(u) < 1.0;
        at->weight[n] = fabs(u) < 1.0 ? near * near : 0.0;
    }
    return counted;
}

static bool solved(double normal[SIZE * SIZE], double right[SIZE], const double square, const double kept[SIZE * SIZE])
{
    for (int64_t i = 0; i < SIZE * SIZE; i++) {
        normal[i] += square * kept[i];
    }
    for (int64_t i = 0; i < SIZE; i++) {
        normal[i * SIZE + i] += RIDGE;
    }
    return eliminate(normal, right, SIZE, 1);
}

// Eq. 1 from a start on, in place.
static void graduated(const Station* const at, double fit[SIZE], const double kept[SIZE * SIZE])
{
    leave(at, fit);
    const double first = at->of_mad * middle(at->work, at->size);
    double scale = first > at->least ? first : at->least;
    for (int64_t round = 0; round < ROUNDS; round++) {
        double normal[SIZE * SIZE], right[SIZE];
        if ((double)weigh(at, scale) < COUNTED * (double)at->size) {
            break;
        }
        normal_of(at, normal, right);
        if (!solved(normal, right, scale * scale, kept)) {
            break;
        }
        memcpy(fit, right, sizeof right);
        leave(at, fit);
        const double rest = at->of_mad * middle(at->work, at->size);
        const double shrunk = rest < SHRINKS * scale ? rest : SHRINKS * scale;
        scale = shrunk > at->least ? shrunk : at->least;
    }
}

// Robust sigma of what a fit leaves.
static double rest_of(const Station* const at, const double fit[SIZE])
{
    leave(at, fit);
    return at->of_mad * halfway(at->work, at->size);
}

// K of columns that were not seen, in units of 1 / (sigma^2 alike): one unit for each of centre and ovality where
// nothing was. basis (a, 5), line (a,).
static void keep_round(const double* const basis, const double* const line, const int64_t a, const double sigma,
                       const double radius, const double alike, const double round, double kept[SIZE * SIZE])
{
    const double part = sigma / (round * (radius > RADIUS_MM ? radius : RADIUS_MM));
    const double weight = 2.0 * alike / (double)a * (part * part);
    memset(kept, 0, SIZE * SIZE * sizeof *kept);
    for (int64_t n = 0; n < a; n++) {
        if (isfinite(line[n])) {
            continue;
        }
        for (int64_t i = 1; i < SIZE; i++) {
            for (int64_t j = 1; j < SIZE; j++) {
                kept[i * SIZE + j] += basis[n * SIZE + i] * basis[n * SIZE + j];
            }
        }
    }
    for (int64_t i = 0; i < SIZE * SIZE; i++) {
        kept[i] *= weight;
    }
}

// The columns of a line that were seen, in room (9, a).
static Station station(const double* const basis, const double* const line, const int64_t a, double* const room,
                       const double tukey, const double of_mad, const double least)
{
    Station at = {{room, room + a, room + 2 * a, room + 3 * a},
                  room + 4 * a,
                  room + 5 * a,
                  room + 6 * a,
                  room + 7 * a,
                  0,
                  tukey,
                  of_mad,
                  least};
    for (int64_t n = 0; n < a; n++) {
        if (isfinite(line[n])) {
            for (int64_t i = 1; i < SIZE; i++) {
                at.wave[i - 1][at.size] = basis[n * SIZE + i];
            }
            at.radius[at.size++] = line[n];
        }
    }
    return at;
}

// Of one station; NaN where too little was seen.
static void fit_of(const Station* const at, const double* const basis, const double* const line, const int64_t a,
                   const double usual[SIZE], const double near_mm, const double alike, const double round,
                   double fit[SIZE])
{
    double kept[SIZE * SIZE], normal[SIZE * SIZE], right[SIZE], begun[SIZE];
    const bool is_usual =
        isfinite(usual[0]) && isfinite(usual[1]) && isfinite(usual[2]) && isfinite(usual[3]) && isfinite(usual[4]);
    memcpy(at->work, at->radius, (size_t)at->size * sizeof *at->work);
    const double centre = halfway(at->work, at->size);
    keep_round(basis, line, a, 1.0, centre, alike, round, kept);
    if (is_usual) {  // the pipe's shape changes slowly: where half of the columns still show it, the rest is a defect
        memcpy(begun, usual, sizeof begun);
        leave(at, begun);
        begun[0] += halfway(memcpy(at->work, at->left, (size_t)at->size * sizeof *at->work), at->size);
        graduated(at, begun, kept);
        leave(at, begun);
        int64_t agree = 0;
        for (int64_t n = 0; n < at->size; n++) {
            agree += at->work[n] < near_mm;
        }
        if ((double)agree >= AGREE * (double)at->size) {
            memcpy(fit, begun, sizeof begun);
            return;
        }
    }
    for (int64_t n = 0; n < at->size; n++) {
        at->work[n] = fabs(at->radius[n] - centre);
        at->weight[n] = 1.0;
    }
    const double spread = at->of_mad * halfway(at->work, at->size);
    const double rest = spread > at->least ? spread : at->least;
    normal_of(at, normal, right);
    if (!solved(normal, right, rest * rest, kept)) {
        memset(right, 0, sizeof right);
    }
    memcpy(fit, right, sizeof right);
    graduated(at, fit, kept);
    if (!is_usual) {
        return;
    }
    const double own = rest_of(at, fit), other = rest_of(at, begun), lesser = other < own ? other : own;
    const double end = at->tukey * (lesser > at->least ? lesser : at->least);
    double cost[2];
    for (int64_t k = 0; k < 2; k++) {
        leave(at, k ? begun : fit);
        for (int64_t n = 0; n < at->size; n++) {
            const double u = at->left[n] / end;
            at->work[n] = u * u < 1.0 ? u * u : 1.0;
        }
        cost[k] = sum_of(at->work, 0, 0, at->size);
    }
    if (cost[1] < cost[0]) {
        memcpy(fit, begun, sizeof begun);
    }
}

// Shapes (c, 5) of lines (c, a) of radii, NaN where not seen; NaN where too little was. usual (5,): of this pipe, or
// NaN. near_mm: so near it is the usual one; least: of the scale, mm; the rest as Python has it. room (8, a).
DOOR void fit_shapes(const double* const lines, const double* const basis, const double* const usual,
                     const double near_mm, const double least, const double alike, const double round,
                     const double tukey, const double of_mad, double* const room, double* const fits, const int64_t c,
                     const int64_t a)
{
    for (int64_t k = 0; k < c; k++) {
        const Station at = station(basis, lines + k * a, a, room, tukey, of_mad, least);
        double* const fit = fits + k * SIZE;
        if (a < 1 || (double)at.size / (double)a < SEEN) {
            fit[0] = fit[1] = fit[2] = fit[3] = fit[4] = (double)NAN;
        } else {
            fit_of(&at, basis, lines + k * a, a, usual, near_mm, alike, round, fit);
        }
    }
}

// Covariances (c, 5, 5) of those fits, mm^2; left as they are where a fit is NaN. together: columns that count as one.
DOOR void shape_covariances(const double* const lines, const double* const basis, const double* const fits,
                            const double least, const double together, const double round, const double tukey,
                            const double of_mad, double* const room, double* const out, const int64_t c,
                            const int64_t a)
{
    for (int64_t k = 0; k < c; k++) {
        const double* const fit = fits + k * SIZE;
        if (!isfinite(fit[0])) {
            continue;
        }
        const Station at = station(basis, lines + k * a, a, room, tukey, of_mad, least);
        double normal[SIZE * SIZE], kept[SIZE * SIZE], right[SIZE], unit[SIZE * SIZE] = {0};
        const double rest = rest_of(&at, fit), sigma = rest > least ? rest : least;
        weigh(&at, sigma);
        normal_of(&at, normal, right);
        keep_round(basis, lines + k * a, a, sigma, fit[0], together, round, kept);
        const double independent = normal[0] / together;  // the sum of the weights
        for (int64_t i = 0; i < SIZE * SIZE; i++) {
            normal[i] += kept[i];
        }
        for (int64_t i = 0; i < SIZE; i++) {
            normal[i * SIZE + i] += RIDGE;
            unit[i * SIZE + i] = 1.0;
        }
        eliminate(normal, unit, SIZE, SIZE);
        // five of them went into the fit: what is left looks small
        const double took = independent / (independent - SIZE > 1.0 ? independent - SIZE : 1.0);
        for (int64_t i = 0; i < SIZE * SIZE; i++) {
            out[k * SIZE * SIZE + i] = sigma * sigma * together * took * unit[i];
        }
    }
}

// Medians (m, k) of the columns of values (n, k) from row `first` (m,) up to `last`; NaN passed over, NaN of nothing.
// room (n,).
DOOR void running_medians(const double* const values, const int64_t* const first, const int64_t* const last,
                          double* const room, double* const out, const int64_t n, const int64_t k, const int64_t m)
{
    for (int64_t i = 0; i < m; i++) {
        const int64_t low = most(0, first[i]), high = least(last[i], n);
        for (int64_t j = 0; j < k; j++) {
            int64_t size = 0;
            for (int64_t row = low; row < high; row++) {
                const double value = values[row * k + j];
                room[size] = value;
                size += isfinite(value) ? 1 : 0;
            }
            out[i * k + j] = size ? halfway(room, size) : (double)NAN;
        }
    }
}
