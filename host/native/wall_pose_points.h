// What wall_pose.c knows of each point: its error, how that changes with the pose, and sums of both over all points.
//
// Points lie in blocks, the last filled up with points of no weight: a loop over a block has no remainder, and what it
// reads and writes lies together.
#ifndef ANNULUS_WALL_POSE_POINTS_H
#define ANNULUS_WALL_POSE_POINTS_H

#include "lanes.h"
#include "mathematics.h"
#include "selection.h"
#include "solving.h"

#define BLOCK 64  // points; times, not results
#define FREE 7    // rx, ry, tx, ty; mean, twofold cosine and sine of the radius beyond the nominal
#define SUMS 36   // of products of seven gradients and an error with one another

typedef struct {
    double x[BLOCK], y[BLOCK], z[BLOCK];
    double root[BLOCK];           // of the weight, 1 on average
    double error[BLOCK];          // Eq. 4.8
    double cu[BLOCK], cv[BLOCK];  // which way it lies from the axis
    double likely[BLOCK];         // to be no wild one
    int32_t patch[BLOCK];         // of the wall
} Points;

typedef struct {
    int64_t size, blocks;
    Points* points;
    double* sizes;               // (N,)
    double *sums, *every;        // of patches: likely points and their errors, (P + 1, 2); all points, (P + 1,)
    double *trust, *far, *fars;  // of patches: how far to trust each, how many sigma off it is, (P + 1,)
    int64_t rows, columns, cells_most;
    double radius, cauchy, sigma_of_mad;
    double pose[FREE];
    double seen[FREE * FREE], covariance[FREE * FREE];  // what the points know; its inverse times scale^2
} Fit;

typedef struct {
    double ca, sa, cb, sb;  // of rx and ry
    double tx, ty, mean, cosine, sine;
} Place;

INLINE double larger(const double a, const double b)
{
    return a > b ? a : b;
}

ONCE Place place_of(const Fit* const fit)
{
    const double* const pose = fit->pose;
    Place p = {.tx = pose[2], .ty = pose[3], .mean = fit->radius + pose[4], .cosine = pose[5], .sine = pose[6]};
    cosine_sine(pose[0], &p.ca, &p.sa);
    cosine_sine(pose[1], &p.cb, &p.sb);
    return p;
}

// How many points of a block are no filling.
INLINE int64_t filled(const Fit* const fit, const int64_t block)
{
    return least(BLOCK, fit->size - block * BLOCK);
}

// Errors, and ways from the axis. R = Rx(rx) Ry(ry), q = R^T (p - T), r = |q_xy|.
ONCE void look_at(Points* const points, const Place p)
{
    for (int n = 0; n < BLOCK; n++) {
        const double px = points->x[n] - p.tx, py = points->y[n] - p.ty, pz = points->z[n];
        const double u = p.cb * px + p.sb * (p.sa * py - p.ca * pz);
        const double v = p.ca * py + p.sa * pz;
        const double r = larger(sqrt(u * u + v * v), 1e-9), inverse = 1.0 / r;
        const double c = u * inverse, s = v * inverse;
        points->cu[n] = c;
        points->cv[n] = s;
        points->error[n] = r - p.mean - p.cosine * (c * c - s * s) - p.sine * (2.0 * c * s);  // Eq. 4.8
    }
}

ONCE void look(const Fit* const fit)
{
    const Place p = place_of(fit);
    for (int64_t b = 0; b < fit->blocks; b++) {
        look_at(fit->points + b, p);
    }
}

// Products of the points' gradients and errors with one another, times their weights `used`, added to 36 sums: of the
// first four, of those with the next two, with the last two, and of the last four. How the twofold term turns with the
// pose is left out: it is small, and costs steps, not accuracy.
ONCE void add_gradients(const Points* const points, const Place p, const double* const used, Lanes* const sums)
{
    _Alignas(64) double rows[8][BLOCK];
    for (int n = 0; n < BLOCK; n++) {
        const double px = points->x[n] - p.tx, py = points->y[n] - p.ty, pz = points->z[n], w = sqrt(used[n]);
        const double turned = p.sa * py - p.ca * pz, v = p.ca * py + p.sa * pz;
        const double wu = w * points->cu[n], wv = w * points->cv[n];
        rows[0][n] = wu * (p.sb * v) - wv * turned;
        rows[1][n] = wu * (p.cb * turned - p.sb * px);
        rows[2][n] = -wu * p.cb;
        rows[3][n] = -(wu * (p.sb * p.sa) + wv * p.ca);
        rows[4][n] = -w;
        rows[5][n] = -(wu * points->cu[n] - wv * points->cv[n]);
        rows[6][n] = -2.0 * (wu * points->cv[n]);
        rows[7][n] = w * points->error[n];
    }
    add_squares(sums, rows[0], BLOCK, BLOCK);
    add_products(sums + 10, rows[0], rows[4], BLOCK, BLOCK);
    add_products(sums + 18, rows[0], rows[6], BLOCK, BLOCK);
    add_squares(sums + 26, rows[4], BLOCK, BLOCK);
}

// (7,) what is known beforehand, as precisions times scale^2.
ONCE void prior_of(const Fit* const fit, const double scale, const double tilt, const double shape, double* const prior)
{
    const double lean = scale / tilt, oval = scale / (shape * fit->radius);
    for (int i = 0; i < FREE; i++) {
        prior[i] = i < 2 ? lean * lean : i < 4 ? 0.0 : oval * oval;
    }
}

// Takes the pose a step on, by the sums of products; how far, in radians or parts of the radius, NaN where none is.
ONCE double step(Fit* const fit, const Lanes* const sums, const double* const prior)
{
    double product[8][8], normal[FREE * FREE], moved[FREE], trace = 0.0;
    for (int i = 0, square = 0; i < 4; i++) {
        for (int j = i; j < 4; j++, square++) {
            product[i][j] = product[j][i] = added_up(sums + square);
            product[4 + i][4 + j] = product[4 + j][4 + i] = added_up(sums + 26 + square);
        }
        for (int j = 4; j < 8; j++) {
            product[i][j] = product[j][i] = added_up(sums + 10 + 8 * (j / 6) + 2 * i + j % 2);
        }
        trace += product[i][i] + product[4 + i][4 + i];
    }
    for (int i = 0; i < FREE; i++) {
        const double size = i < 2 ? 1.0 : fit->radius;  // angles and lengths alike
        for (int j = 0; j < FREE; j++) {
            fit->seen[FREE * i + j] = product[i][j];
            normal[FREE * i + j] = product[i][j] * size * (j < 2 ? 1.0 : fit->radius);
        }
        normal[FREE * i + i] += prior[i] * size * size + 1e-12 * trace;
        moved[i] = (product[i][7] + prior[i] * fit->pose[i]) * size;
    }
    if (!factored(normal, FREE)) {
        return (double)NAN;
    }
    solved(normal, FREE, moved);
    double farthest = 0.0;
    for (int i = 0; i < FREE; i++) {
        farthest = larger(farthest, fabs(moved[i]));
        fit->pose[i] -= moved[i] * (i < 2 ? 1.0 : fit->radius);
    }
    return farthest;
}

// The sizes of all errors; weighted, of errors scaled to those of a usual point.
ONCE void measure(const Fit* const fit, const bool weighted)
{
    for (int64_t b = 0; b < fit->blocks; b++) {
        const Points* const points = fit->points + b;
        double* const restrict sizes = fit->sizes + b * BLOCK;
        for (int n = 0; n < BLOCK; n++) {
            sizes[n] = fabs(points->error[n] * (weighted ? points->root[n] : 1.0));
        }
    }
}

ONCE double robust_sigma(const Fit* const fit, const bool weighted)
{
    measure(fit, weighted);
    return fit->sigma_of_mad * middle(fit->sizes, fit->size);
}

// Whether the robust sigma is below a limit: more than half of the errors say so.
static bool robust_below(const Fit* const fit, const double limit)
{
    int64_t below = 0;
    measure(fit, false);
    for (int64_t n = 0; n < fit->size; n++) {
        below += fit->sigma_of_mad * fit->sizes[n] < limit;
    }
    return below > fit->size / 2;
}

#endif
