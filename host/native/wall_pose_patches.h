// Patches of the wall, for wall_pose.c: damage hides within the noise of a point but not within that of a patch. Those
// whose mean is farther off than means usually are, and those where few points are likely, are not trusted.
#ifndef ANNULUS_WALL_POSE_PATCHES_H
#define ANNULUS_WALL_POSE_PATCHES_H

#include "wall_pose_points.h"

#define CELL_POINTS 12.0    // points of a patch of wall judged as a whole ..
#define CELL_OFF 4.0        // .. bad when its mean is so many sigma off ..
#define CELL_DOUBTED 1.0    // .. and beside a bad one already from here ..
#define CELL_SOUND 0.5      // .. or when fewer than this part of the points are likely, its own and those ..
#define CELL_BESIDE 7       // .. of so many patches around the pipe
#define COLUMNS_LEAST 8     // patches around the pipe
#define BEYOND 0.03         // of the length of wall seen; points farther off the ends than this are left out
#define LENGTH_SAMPLES 400  // points that say how long the wall is, a hundredth at either end left out

// Cuts the wall into patches, nearly square, of a dozen points each on average, and says which is each point's; what
// lies beyond is in none, the last.
static void cut(Fit* const fit, const double scale)
{
    const Turn t = turn_of(fit->pose);
    const int64_t size = fit->size;
    const double tx = fit->pose[2], ty = fit->pose[3];
    double* const along = fit->likely;
    int64_t total = 0;
    for (int64_t n = 0; n < size; n++) {
        along[n] = t.sb * (fit->x[n] - tx) - t.cb * (t.sa * (fit->y[n] - ty) - t.ca * fit->z[n]);
    }
    for (int64_t n = 0; n < size; n++) {
        fit->a[total] = along[n];
        total += fabs(fit->error[n] * fit->root[n]) < 3.0 * scale;  // wild points do not say how long the wall is
    }
    const int64_t every = most(1, total / LENGTH_SAMPLES), sampled = (total + every - 1) / every;
    for (int64_t i = 0; i < sampled; i++) {
        fit->b[i] = fit->a[i * every];
    }
    const double low = ranked(fit->b, sampled, sampled / 100);
    const double high = ranked(fit->b, sampled, sampled - 1 - sampled / 100);
    const double length = larger(high - low, 0.01 * fit->radius);
    const double side = sqrt(TURN * fit->radius * length * CELL_POINTS / (double)size);
    const int64_t columns = whole(rint(TURN * fit->radius / side), COLUMNS_LEAST, fit->cells_most);
    const int64_t rows = whole(rint(length / side), 1, fit->cells_most / columns);
    fit->rows = rows;
    fit->columns = columns;
    const double last_row = (double)(rows - 1), around_it = (double)columns, cells = (double)(rows * columns);
    const double inverse = 1.0 / length;
    for (int64_t n = 0; n < size; n++) {
        const double row = (along[n] - low) * inverse;
        const double turned = floor((arc_tangent(fit->cv[n], fit->cu[n]) * (1.0 / TURN) + 1.0) * around_it);
        const double column = held(turned >= around_it ? turned - around_it : turned, 0.0, around_it - 1.0);
        const double cell = held(floor(row * (double)rows), 0.0, last_row) * around_it + column;
        fit->patch[n] = (int32_t)((row >= -BEYOND) & (row <= 1.0 + BEYOND) ? cell : cells);
    }
    for (int64_t p = 0; p <= rows * columns; p++) {
        fit->every[p] = 0.0;
    }
    for (int64_t n = 0; n < size; n++) {
        fit->every[fit->patch[n]] += 1.0;
    }
}

// Each point's error, how likely it is no wild one, and for each patch the sums of likely points and of their errors.
static void weigh(Fit* const fit, const double scale, const double wild)
{
    double normal[BLOCK], off[BLOCK];
    const double inverse = 1.0 / scale, wildness = wild * scale / 0.4;
    double* const sums = fit->sums;
    for (int64_t p = 0; p < 2 * (fit->rows * fit->columns + 1); p++) {
        sums[p] = 0.0;
    }
    for (int64_t first = 0; first < fit->size; first += BLOCK) {
        const int64_t size = least(BLOCK, fit->size - first);
        look(fit, first, first + size);
        const double* const restrict error = fit->error + first, * const restrict root = fit->root + first;
        double* const restrict likely = fit->likely + first;
        for (int64_t n = 0; n < size; n++) {
            const double sigmas = error[n] * root[n] * inverse;
            normal[n] = exponential(-0.5 * (sigmas * sigmas));
        }
        for (int64_t n = 0; n < size; n++) {
            likely[n] = normal[n] / (normal[n] + wildness);
            off[n] = likely[n] * (error[n] * root[n]);
        }
        for (int64_t n = 0; n < size; n++) {
            double* const of_patch = sums + 2 * fit->patch[first + n];
            of_patch[0] += likely[n];
            of_patch[1] += off[n];
        }
    }
}

// How far to trust each patch, 0..1; how many times more patches' means vary than single points say. Mildly: a Cauchy
// weight, as long as the pose still leans on the damage itself.
static double judge(Fit* const fit, const double scale, const bool mildly)
{
    const int64_t rows = fit->rows, columns = fit->columns, cells = rows * columns;
    const double *const sums = fit->sums, *const every = fit->every;
    double *const trust = fit->trust, *const far = fit->far;
    int64_t counted = 0;
    bool sparse = false;
    for (int64_t p = 0; p < cells; p++) {
        const double count = sums[2 * p];
        const bool some = count > 1.0;
        trust[p] = 1.0;
        far[p] = some ? sums[2 * p + 1] / (scale * sqrt(some ? count : 1.0)) : 0.0;
        sparse |= count < CELL_SOUND * every[p];
    }
    for (int64_t p = 0; p < cells; p++) {
        fit->far_room[counted] = fabs(far[p]);
        counted += sums[2 * p] > 1.0;
    }
    trust[cells] = 0.0;
    if (counted < 8) {
        return 1.0;
    }
    const double unrest = larger(1.0, fit->sigma_of_mad * middle(fit->far_room, counted));
    for (int64_t p = 0; p < cells; p++) {
        far[p] /= unrest;
    }
    if (mildly) {
        for (int64_t p = 0; p < cells; p++) {
            const double off = far[p] / fit->cauchy;
            trust[p] = 1.0 / (1.0 + off * off);
        }
        return unrest;
    }
    for (int64_t row = 0; row < rows; row++) {
        for (int64_t column = 0; column < columns; column++) {
            const int64_t p = row * columns + column;
            if (fabs(far[p]) > CELL_OFF) {
                // The rim of the damage: like its neighbour, if less so.
                for (int64_t r = most(row - 1, 0); r < least(row + 2, rows); r++) {
                    for (int64_t c = column - 1; c <= column + 1; c++) {
                        const int64_t beside = r * columns + around(c, columns);
                        if (far[beside] * copysign(1.0, far[p]) > CELL_DOUBTED) {
                            trust[beside] = 0.0;
                        }
                    }
                }
            }
            if (sparse) {
                double likely = 0.0, there = 0.0;
                for (int64_t c = column - CELL_BESIDE / 2; c <= column + CELL_BESIDE / 2; c++) {
                    const int64_t beside = row * columns + around(c, columns);
                    likely += sums[2 * beside];
                    there += every[beside];
                }
                if (likely < CELL_SOUND * (there + 0.5 * CELL_BESIDE)) {
                    trust[p] = 0.0;
                }
            }
        }
    }
    return unrest;
}

#endif
