// What a camera of a fringe head sees of points, and what light they stand in. Points go in rows, a block of them
// before one frame, so that a vector takes several at once.
#ifndef ANNULUS_FRINGE_CAMERA_H
#define ANNULUS_FRINGE_CAMERA_H

#include <float.h>

#include "fringe_projector.h"

#define BLOCK 64       // points: what a round over all frames needs of them stays in the nearest cache
#define ROUNDS 12      // of Gauss and Newton; what has not settled by then does not
#define STEP_RAD 1.0   // of phase, of one of their steps: its tangent is good for about a radian
#define PIVOT 1e-7     // of a diagonal element: rounding of float32 images
#define AHEAD_MM 0.01  // a difference in place of the lens's derivative

// What became of a point, as track.py numbers it.
enum { GOOD, TOO_FEW, UNMODULATED, UNDETERMINED, UNSETTLED };

typedef double Numbers[BLOCK];

typedef struct {
    Numbers x, y, z;
} Row;

INLINE bool finite(const double value)
{
    return fabs(value) <= DBL_MAX;
}

// World points in a frame (3, 4).
INLINE void place(const double* const pose, const Row* const from, const int64_t count, Row* const to)
{
    const double r00 = pose[0], r01 = pose[1], r02 = pose[2], tx = pose[3];
    const double r10 = pose[4], r11 = pose[5], r12 = pose[6], ty = pose[7];
    const double r20 = pose[8], r21 = pose[9], r22 = pose[10], tz = pose[11];
    for (int64_t i = 0; i < count; i++) {
        const double x = from->x[i], y = from->y[i], z = from->z[i];
        to->x[i] = r00 * x + r01 * y + r02 * z + tx;
        to->y[i] = r10 * x + r11 * y + r12 * z + ty;
        to->z[i] = r20 * x + r21 * y + r22 * z + tz;
    }
}

// Pixels of points in the camera's frame. lens: kind (0 pinhole, 1 fisheye), fx, fy, cx, cy, and OpenCV's k1 k2 p1 p2
// k3, or k1..k4. NaN behind a pinhole.
INLINE void see(const double* const lens, const Row* const at, const int64_t count, double* const u, double* const v)
{
    const double fx = lens[1], fy = lens[2], cx = lens[3], cy = lens[4];
    const double k1 = lens[5], k2 = lens[6], p1 = lens[7], p2 = lens[8], k3 = lens[9];
    if (lens[0] == 0.0) {
        for (int64_t i = 0; i < count; i++) {
            const double over = at->z[i] > 0.0 ? 1.0 / at->z[i] : (double)NAN;
            const double a = at->x[i] * over, b = at->y[i] * over, r2 = a * a + b * b;
            const double radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
            u[i] = fx * (a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)) + cx;
            v[i] = fy * (b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b) + cy;
        }
        return;
    }
    for (int64_t i = 0; i < count; i++) {
        const double x = at->x[i], y = at->y[i], rho = sqrt(x * x + y * y), theta = arc_tangent(rho, at->z[i]);
        const double t2 = theta * theta, angle = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (p1 + t2 * p2))));
        const double scale = angle / (rho > 1e-12 ? rho : 1e-12);
        u[i] = fx * scale * x + cx;
        v[i] = fy * scale * y + cy;
    }
}

// An image as coefficients of a cubic B-spline.
typedef struct {
    const float* at;
    int64_t height, width;
} Spline;

typedef float Four __attribute__((vector_size(16)));

INLINE Four four(const float* const at)
{
    Four out;
    memcpy(&out, at, sizeof out);
    return out;
}

typedef float Taps[BLOCK][4];

// The four weights of a cubic B-spline at a fraction of a pixel.
INLINE void spread_over(const float f, float* const taps)
{
    const float p = 1.0f - f, sixth = 1.0f / 6.0f;
    const float before = sixth * p * p * p, beyond = sixth * f * f * f;
    const float own = sixth * (4.0f + 3.0f * f * f * (f - 2.0f));
    taps[0] = before;
    taps[1] = own;
    taps[2] = 1.0f - before - own - beyond;
    taps[3] = beyond;
}

// Grey levels at pixels, each of 4 x 4 coefficients; NaN outside, and beside one that is NaN.
INLINE void sample(const Spline* const image, const double* const u, const double* const v, const int64_t count,
                   double* const grey)
{
    const double right = (double)(image->width - 2), low = (double)(image->height - 2);
    Taps across, down;
    for (int64_t i = 0; i < count; i++) {
        spread_over((float)(u[i] - floor(u[i])), across[i]);
        spread_over((float)(v[i] - floor(v[i])), down[i]);
    }
    for (int64_t i = 0; i < count; i++) {
        if (!(u[i] >= 1.0 && v[i] >= 1.0 && u[i] < right && v[i] < low)) {
            grey[i] = (double)NAN;
            continue;
        }
        const float* const corner = image->at + ((int64_t)v[i] - 1) * image->width + (int64_t)u[i] - 1;
        const Four upper = down[i][0] * four(corner) + down[i][1] * four(corner + image->width);
        const Four lower = down[i][2] * four(corner + 2 * image->width) + down[i][3] * four(corner + 3 * image->width);
        const Four all = (upper + lower) * four(across[i]);
        grey[i] = (double)((all[0] + all[2]) + (all[1] + all[3]));
    }
}

// Phase of points in the projector's frame, and its gradient.
INLINE void light(const Slide* const slide, const Row* const at, const int64_t count, double* const phase,
                  Row* const gradient)
{
    const Slide own = *slide;
    for (int64_t i = 0; !own.plain && i < count; i++) {
        const double x = at->x[i], y = at->y[i], z = at->z[i];
        const Lit one = own.radius > 0.0 ? mirrored(&own, x, y, z) : lensed(&own, x, y, z);
        phase[i] = one.phase;
        gradient->x[i] = one.x;
        gradient->y[i] = one.y;
        gradient->z[i] = one.z;
    }
    if (!own.plain) {
        return;
    }
    if (own.rings) {
        for (int64_t i = 0; i < count; i++) {
            const Lit one = rings(&own, at->x[i], at->y[i], at->z[i]);
            phase[i] = one.phase;
            gradient->x[i] = one.x;
            gradient->y[i] = one.y;
            gradient->z[i] = one.z;
        }
        return;
    }
    for (int64_t i = 0; i < count; i++) {
        const Lit one = stripes(&own, at->x[i], at->y[i], at->z[i]);
        phase[i] = one.phase;
        gradient->x[i] = one.x;
        gradient->y[i] = one.y;
        gradient->z[i] = one.z;
    }
}

// What the light is of its mean and amplitude at phases: its crest, its slope, and the first harmonic's other half.
INLINE void waves(const Slide* const slide, const double* const phase, const int64_t count, double* const crest,
                  double* const steep, double* const sine)
{
    const Slide own = *slide;
    for (int64_t i = 0; own.pure && i < count; i++) {
        const Wave one = pure_wave(phase[i]);
        crest[i] = one.crest;
        steep[i] = one.steep;
        sine[i] = one.sine;
    }
    for (int64_t i = 0; !own.pure && i < count; i++) {
        const Wave one = full_wave(&own, phase[i]);
        crest[i] = one.crest;
        steep[i] = one.steep;
        sine[i] = one.sine;
    }
}

// One over the variance of a grey level I, which is noise . (1, I, I^2).
INLINE double weight_of(const double* const noise, const double grey)
{
    const double light = grey > 0.0 ? grey : 0.0;
    return 1.0 / (noise[0] + light * (noise[1] + light * noise[2]));
}

#endif
