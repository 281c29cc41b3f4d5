// At what height a flat, still surface of water makes the pipe's bottom appear where a ring was triangulated.
//
// A ray of the camera goes down to the surface, is bent there (Snell's law), and meets the bottom, a circle about z.
// The light that it sees comes from the lamp through the surface, bent as well, by a way that is found by halving. Its
// angle to the ring's axis is known; the height is where it is that, found by halving again. Eight points are solved
// for side by side: all of it is a fixed number of steps.

#include "mathematics.h"

enum { LANES = 8 };
static const double FAR_LEAST = 1e-9;  // of the lamp along the surface, to divide by

typedef struct {
    double eye[3][LANES], way[3][LANES], lamp[3][LANES], axis[3][LANES], radius[LANES];
} Sights;

// Cosine of the angle between a ring's axis and the light, as it leaves the lamp, that lights what a ray sees with the
// surface at `height`; NaN where the ray meets no bottom.
INLINE void cosine(const Sights* const at, const double height[LANES], const double index, const int64_t halvings,
                   double out[LANES])
{
    double qx[LANES], qz[LANES], above[LANES], below[LANES], far[LANES], low[LANES], high[LANES], dry[LANES];
    for (int64_t i = 0; i < LANES; i++) {
        const double down = (height[i] - at->eye[1][i]) / at->way[1][i];
        const double ax = at->eye[0][i] + down * at->way[0][i], az = at->eye[2][i] + down * at->way[2][i];
        const double wx = at->way[0][i] / index, wz = at->way[2][i] / index;
        const double wy = sqrt(1.0 - wx * wx - wz * wz);
        const double a = wx * wx + wy * wy;
        const double b = ax * wx + height[i] * wy;
        const double inside = b * b - a * (ax * ax + height[i] * height[i] - at->radius[i] * at->radius[i]);
        const double s = (sqrt(inside > 0.0 ? inside : 0.0) - b) / a;
        const double qy = height[i] + s * wy;
        qx[i] = ax + s * wx;
        qz[i] = az + s * wz;
        dry[i] = inside < 0.0 ? 1.0 : 0.0;
        const double x = qx[i] - at->lamp[0][i], z = qz[i] - at->lamp[2][i];
        far[i] = sqrt(x * x + z * z);
        above[i] = height[i] - at->lamp[1][i];
        below[i] = qy - height[i];
        low[i] = 0.0;
        high[i] = far[i];
    }
    // where light from the lamp enters the water so that it gets there: Snell's law along the surface
    for (int64_t step = 0; step < halvings; step++) {
        for (int64_t i = 0; i < LANES; i++) {
            const double u = 0.5 * (low[i] + high[i]), v = far[i] - u;
            const double in = u * sqrt(v * v + below[i] * below[i]);
            const double through = index * v * sqrt(u * u + above[i] * above[i]);
            low[i] = in < through ? u : low[i];
            high[i] = in < through ? high[i] : u;
        }
    }
    for (int64_t i = 0; i < LANES; i++) {
        const double part = low[i] / (far[i] > FAR_LEAST ? far[i] : FAR_LEAST);
        const double x = (qx[i] - at->lamp[0][i]) * part, y = above[i], z = (qz[i] - at->lamp[2][i]) * part;
        const double along = x * at->axis[0][i] + y * at->axis[1][i] + z * at->axis[2][i];
        out[i] = dry[i] > 0.0 ? (double)NAN : along / sqrt(x * x + y * y + z * z);
    }
}

// y of the surface (n,), NaN where none fits. points as triangulated without water, eyes, lamps and unit axes (n, 3);
// radius (n,) of the bottom. lowest: of a point's height above the bottom, how far above it the surface may be;
// shallow: of the radius, how far below eye and lamp it is at least.
DOOR void surface_heights(const double* const points, const double* const eyes, const double* const lamps,
                          const double* const axes, const double* const radius, const double index, const double lowest,
                          const double shallow, const int64_t halvings, double* const out, const int64_t n)
{
    for (int64_t begin = 0; begin < n; begin += LANES) {
        Sights at;
        double ring[LANES], low[LANES], high[LANES], at_low[LANES], at_high[LANES], at_middle[LANES], tried[LANES];
        double fits[LANES];
        for (int64_t i = 0; i < LANES; i++) {
            const int64_t own = least(begin + i, n - 1);
            const double *const p = points + 3 * own, *const eye = eyes + 3 * own, *const lamp = lamps + 3 * own,
                                *const axis = axes + 3 * own;
            const double dx = p[0] - eye[0], dy = p[1] - eye[1], dz = p[2] - eye[2];
            const double length = sqrt(dx * dx + dy * dy + dz * dz);
            const double vx = p[0] - lamp[0], vy = p[1] - lamp[1], vz = p[2] - lamp[2];
            for (int64_t k = 0; k < 3; k++) {
                at.eye[k][i] = eye[k];
                at.lamp[k][i] = lamp[k];
                at.axis[k][i] = axis[k];
            }
            at.way[0][i] = dx / length;
            at.way[1][i] = dy / length;
            at.way[2][i] = dz / length;
            at.radius[i] = radius[own];
            ring[i] = (vx * axis[0] + vy * axis[1] + vz * axis[2]) / sqrt(vx * vx + vy * vy + vz * vz);
            const double square = radius[own] * radius[own] - p[0] * p[0];
            const double bottom = sqrt(square > 0.0 ? square : 0.0);
            const double least_y = (eye[1] > lamp[1] ? eye[1] : lamp[1]) + shallow * radius[own];
            const double up = p[1] - lowest * (bottom - p[1]);
            low[i] = up > least_y ? up : least_y;
            high[i] = p[1];
            fits[i] = low[i] < high[i] && at.way[1][i] > 0.0 ? 1.0 : 0.0;
        }
        cosine(&at, low, index, halvings, at_low);
        cosine(&at, high, index, halvings, at_high);
        for (int64_t i = 0; i < LANES; i++) {
            at_low[i] -= ring[i];
            at_high[i] -= ring[i];
            fits[i] = at_low[i] * at_high[i] < 0.0 ? fits[i] : 0.0;
        }
        for (int64_t step = 0; step < halvings; step++) {
            for (int64_t i = 0; i < LANES; i++) {
                tried[i] = 0.5 * (low[i] + high[i]);
            }
            cosine(&at, tried, index, halvings, at_middle);
            for (int64_t i = 0; i < LANES; i++) {
                const bool beyond = (at_middle[i] - ring[i]) * at_low[i] > 0.0;
                low[i] = beyond ? tried[i] : low[i];
                high[i] = beyond ? high[i] : tried[i];
            }
        }
        for (int64_t i = 0; i < LANES && begin + i < n; i++) {
            out[begin + i] = fits[i] > 0.0 ? 0.5 * (low[i] + high[i]) : (double)NAN;
        }
    }
}
