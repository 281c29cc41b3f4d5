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
    const Place p = place_of(fit);
    double* const sizes = fit->sizes;
    int64_t total = 0;
    for (int64_t b = 0; b < fit->blocks; b++) {
        Points* const points = fit->points + b;
        double* const along = points->likely;
        for (int n = 0; n < BLOCK; n++) {
            along[n] = p.sb * (points->x[n] - p.tx) - p.cb * (p.sa * (points->y[n] - p.ty) - p.ca * points->z[n]);
        }
        for (int64_t n = 0, end = filled(fit, b); n < end; n++) {
            sizes[total] = along[n];
            total +=
                fabs(points->error[n] * points->root[n]) < 3.0 * scale;  // wild ones do not say how long the wall is
        }
    }
    const int64_t every = most(1, total / LENGTH_SAMPLES), sampled = (total + every - 1) / every;
    for (int64_t i = 0; i < sampled; i++) {
        sizes[i] = sizes[i * every];
    }
    const double low = ranked(sizes, sampled, sampled / 100);
    const double high = ranked(sizes, sampled, sampled - 1 - sampled / 100);
    const double length = larger(high - low, 0.01 * fit->radius);
    const double side = sqrt(TURN * fit->radius * length * CELL_POINTS / (double)fit->size);
    const int64_t columns = whole(rint(TURN * fit->radius / side), COLUMNS_LEAST, fit->cells_most);
    const int64_t rows = whole(rint(length / side), 1, fit->cells_most / columns), cells = rows * columns;
    fit->rows = rows;
    fit->columns = columns;
    const double around_it = (double)columns, inverse = 1.0 / length;
    for (int64_t i = 0; i <= cells; i++) {
        fit->every[i] = 0.0;
    }
    for (int64_t b = 0; b < fit->blocks; b++) {
        Points* const points = fit->points + b;
        for (int n = 0; n < BLOCK; n++) {
            const double row = (points->likely[n] - low) * inverse;
            const double turned = floor((arc_tangent(points->cv[n], points->cu[n]) * (1.0 / TURN) + 1.0) * around_it);
            const double column = held(turned >= around_it ? turned - around_it : turned, 0.0, around_it - 1.0);
            const double cell = held(floor(row * (double)rows), 0.0, (double)(rows - 1)) * around_it + column;
            points->patch[n] = (int32_t)((row >= -BEYOND) & (row <= 1.0 + BEYOND) ? cell : (double)cells);
        }
        for (int64_t n = filled(fit, b); n < BLOCK; n++) {
            points->patch[n] = (int32_t)cells;
        }
        for (int n = 0; n < BLOCK; n++) {
            fit->every[points->patch[n]] += 1.0;
        }
    }
}

// Each point's error, how likely it is no wild one, and for each patch the sums of likely points and of their errors.
static void weigh(Fit* const fit, const double scale, const double wild, const bool moved)
{
    double off[BLOCK];
    const Place p = place_of(fit);
    const double inverse = 1.0 / scale, wildness = wild * scale / 0.4;
    double* const sums = fit->sums;
    for (int64_t i = 0; i < 2 * (fit->rows * fit->columns + 1); i++) {
        sums[i] = 0.0;
    }
    for (int64_t b = 0; b < fit->blocks; b++) {
        Points* const points = fit->points + b;
        if (moved) {
            look_at(points, p);
        }
        for (int n = 0; n < BLOCK; n++) {
            const double scaled = points->error[n] * points->root[n], sigmas = scaled * inverse;
            const double normal = exponential(-0.5 * (sigmas * sigmas));
            points->likely[n] = normal / (normal + wildness);
            off[n] = points->likely[n] * scaled;
        }
        for (int n = 0; n < BLOCK; n++) {
            double* const of_patch = sums + 2 * points->patch[n];
            of_patch[0] += points->likely[n];
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
        fit->fars[counted] = fabs(far[p]);
        counted += sums[2 * p] > 1.0;
    }
    trust[cells] = 0.0;
    if (counted < 8) {
        return 1.0;
    }
    const double unrest = larger(1.0, fit->sigma_of_mad * middle(fit->fars, counted));
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
