// What wall_pose.c knows of each point: its error, how that changes with the pose, and sums of both over all points.
#ifndef ANNULUS_WALL_POSE_POINTS_H
#define ANNULUS_WALL_POSE_POINTS_H

#include "lanes.h"
#include "mathematics.h"
#include "selection.h"
#include "solving.h"

#define BLOCK 128  // points whose gradients stay in the fastest cache; times, not results
#define FREE 7     // rx, ry, tx, ty; mean, twofold cosine and sine of the radius beyond the nominal

typedef struct {
    int64_t size;
    const double *x, *y, *z;
    double *root, *error, *cu, *cv, *likely, *a, *b;  // (N,) each
    double *sums, *every, *trust, *far, *far_room;    // of patches: (P + 1, 2), (P + 1,), (P + 1,), (P,), (P,)
    int32_t* patch;
    int64_t rows, columns, cells_most;
    double radius, cauchy, sigma_of_mad;
    double pose[FREE];
    double seen[FREE * FREE], covariance[FREE * FREE];  // what the points know; its inverse times scale^2
} Fit;

typedef struct {
    double ca, sa, cb, sb;  // of rx and ry
} Turn;

INLINE double larger(const double a, const double b)
{
    return a > b ? a : b;
}

INLINE Turn turn_of(const double* const pose)
{
    Turn t;
    cosine_sine(pose[0], &t.ca, &t.sa);
    cosine_sine(pose[1], &t.cb, &t.sb);
    return t;
}

// Each point's error, and which way it lies from the axis, (cu, cv). R = Rx(rx) Ry(ry), q = R^T (p - T), r = |q_xy|.
static void errors(const double* const pose, const double radius, const double* const x, const double* const y,
                   const double* const z, double* const restrict error, double* const restrict cu,
                   double* const restrict cv, const int64_t size)
{
    const Turn t = turn_of(pose);
    const double tx = pose[2], ty = pose[3], mean = radius + pose[4], cosine = pose[5], sine = pose[6];
    for (int64_t n = 0; n < size; n++) {
        const double px = x[n] - tx, py = y[n] - ty, pz = z[n];
        const double u = t.cb * px + t.sb * (t.sa * py - t.ca * pz);
        const double v = t.ca * py + t.sa * pz;
        const double r = larger(sqrt(u * u + v * v), 1e-9), inverse = 1.0 / r;
        const double c = u * inverse, s = v * inverse;
        cu[n] = c;
        cv[n] = s;
        error[n] = r - mean - cosine * (c * c - s * s) - sine * (2.0 * c * s);  // Eq. 4.8
    }
}

static void look(const Fit* const fit, const int64_t n, const int64_t end)
{
    errors(fit->pose, fit->radius, fit->x + n, fit->y + n, fit->z + n, fit->error + n, fit->cu + n, fit->cv + n,
           end - n);
}

// Products of eight rows of a block with one another, added to the upper half of sums (8, 8): two rows by two at a
// time.
static void multiply(double (*const rows)[BLOCK], const int size, Lanes* const sums)
{
    for (int i = 0; i < 8; i += 2) {
        for (int j = i; j < 8; j += 2) {
            Lanes *const upper = sums + 8 * i + j, *const lower = upper + 8;
            add_products(upper, upper + 1, lower, lower + 1, rows[i], rows[i + 1], rows[j], rows[j + 1], size);
        }
    }
}

// Of a block of points, each one's gradient and error times the root of its weight: (8, B). How the twofold term turns
// with the pose is left out: it is small, and costs steps, not accuracy.
INLINE void gradients(const Fit* const fit, const Turn t, const int64_t first, const int size, const double* const used,
                      double (*const restrict rows)[BLOCK])
{
    const double tx = fit->pose[2], ty = fit->pose[3];
    const double *const x = fit->x + first, *const y = fit->y + first, *const z = fit->z + first;
    const double *const cu = fit->cu + first, *const cv = fit->cv + first, *const error = fit->error + first;
    for (int n = 0; n < size; n++) {
        const double px = x[n] - tx, py = y[n] - ty, pz = z[n], w = sqrt(used[n]);
        const double turned = t.sa * py - t.ca * pz, v = t.ca * py + t.sa * pz;
        const double wu = w * cu[n], wv = w * cv[n];
        rows[0][n] = wu * (t.sb * v) - wv * turned;
        rows[1][n] = wu * (t.cb * turned - t.sb * px);
        rows[2][n] = -wu * t.cb;
        rows[3][n] = -(wu * (t.sb * t.sa) + wv * t.ca);
        rows[4][n] = -w;
        rows[5][n] = -(wu * cu[n] - wv * cv[n]);
        rows[6][n] = -2.0 * (wu * cv[n]);
        rows[7][n] = w * error[n];
    }
    for (int n = size; n % LANES != 0; n++) {
        for (int i = 0; i < 8; i++) {
            rows[i][n] = 0.0;
        }
    }
}

// (7,) what is known beforehand, as precisions times scale^2.
static void prior_of(const Fit* const fit, const double scale, const double tilt, const double shape,
                     double* const prior)
{
    const double lean = scale / tilt, oval = scale / (shape * fit->radius);
    for (int i = 0; i < FREE; i++) {
        prior[i] = i < 2 ? lean * lean : i < 4 ? 0.0 : oval * oval;
    }
}

// Takes the pose a step on, by the sums of products; how far, in radians or parts of the radius, NaN where none is.
static double step(Fit* const fit, const Lanes* const sums, const double* const prior)
{
    double product[8][8], normal[FREE * FREE], moved[FREE], trace = 0.0;
    for (int i = 0; i < 8; i++) {
        for (int j = i; j < 8; j++) {
            product[i][j] = product[j][i] = added_up(&sums[8 * i + j]);
        }
        trace += product[i][i];
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

// Median of the sizes of errors, or of errors times roots, as a sigma.
static double robust_sigma(const Fit* const fit, const double* const root)
{
    for (int64_t n = 0; n < fit->size; n++) {
        fit->a[n] = fabs(root ? fit->error[n] * root[n] : fit->error[n]);
    }
    return fit->sigma_of_mad * middle(fit->a, fit->size);
}

#endif
