// Frames of a head of several eyes in a pipe, and its light there: annulus_pipe.wings.fringe.measure.bore has the
// model.
#ifndef ANNULUS_FRINGE_HEAD_H
#define ANNULUS_FRINGE_HEAD_H

#include "fringe_camera.h"

// N frames; shading (e, 3, t) by eye: extent, logarithm of gain, of modulation.
typedef struct {
    const float* images;
    const double *lens, *cameras, *heads, *projectors, *slides, *shading;
    const int64_t* eye;
    int64_t h, w, s, e, t;
} Head;

// What is to be seen of a frame: its eye's number, and what is known of that.
typedef struct {
    int64_t eye;
    const double *lens, *camera, *head, *projector, *shading;
    Spline image;
    Slide slide;
    int64_t terms;
    double edge;  // least cosine of what is seen to the camera's axis, squared with its sign
} Shot;

INLINE Shot shot_of(const Head* const head, const int64_t k)
{
    const int64_t eye = least(most(head->eye[k], 0), head->e - 1);
    const double* const shading = head->shading + eye * 3 * head->t;
    return (Shot){
        .eye = eye,
        .lens = head->lens + 10 * k,
        .camera = head->cameras + 12 * k,
        .head = head->heads + 12 * k,
        .projector = head->projectors + 12 * k,
        .shading = shading,
        .image = {head->images + k * head->h * head->w, head->h, head->w},
        .slide = slide_of(head->slides + head->s * k, head->s),
        .terms = head->t,
        .edge = head->t > 2 ? shading[2] * fabs(shading[2]) : 0.0,
    };
}

// Grey levels of points in the camera's frame; NaN where not seen: outside of the image, or beyond the edge.
INLINE void seen_at(const Shot* const shot, const Row* const at, const double* const u, const double* const v,
                    const int64_t count, double* const grey)
{
    Numbers inside;
    for (int64_t i = 0; i < count; i++) {
        const double x = at->x[i], y = at->y[i], z = at->z[i];
        const bool beyond = z * fabs(z) < shot->edge * (x * x + y * y + z * z);
        inside[i] = beyond ? (double)NAN : u[i];
    }
    sample(&shot->image, inside, v, count, grey);
}

// The square of what one px is on the wall, mm^2 along the pipe, by a difference.
INLINE void scale_of(const Shot* const shot, const Row* const at, const double* const u, const double* const v,
                     const int64_t count, double* const squared)
{
    const double x = AHEAD_MM * shot->camera[2], y = AHEAD_MM * shot->camera[6], z = AHEAD_MM * shot->camera[10];
    Row ahead;
    Numbers across, down;
    for (int64_t i = 0; i < count; i++) {
        ahead.x[i] = at->x[i] + x;
        ahead.y[i] = at->y[i] + y;
        ahead.z[i] = at->z[i] + z;
    }
    see(shot->lens, &ahead, count, across, down);
    for (int64_t i = 0; i < count; i++) {
        const double du = across[i] - u[i], dv = down[i] - v[i];
        squared[i] = AHEAD_MM * AHEAD_MM / (du * du + dv * dv);
    }
}

// Gain of the light and of its modulation at places of the head's frame: exponentials of polynomials along the pipe,
// times 1, cos, sin of the direction.
INLINE void shade(const Shot* const shot, const Row* const at, const int64_t count, double* const gain,
                  double* const depth)
{
    const double* const level = shot->shading + shot->terms;
    const double* const swing = level + shot->terms;
    const double middle = shot->terms > 1 ? shot->shading[0] : 0.0, half = shot->terms > 1 ? shot->shading[1] : 1.0;
    Numbers t, c, s;
    for (int64_t i = 0; i < count; i++) {
        const double x = at->x[i], y = at->y[i], over = 1.0 / sqrt(x * x + y * y);
        t[i] = (at->z[i] - middle) / half;
        c[i] = x * over;
        s[i] = y * over;
        gain[i] = depth[i] = 0.0;
    }
    for (int64_t k = shot->terms - 3; k >= 0; k -= 3) {
        const double l0 = level[k], l1 = level[k + 1], l2 = level[k + 2];
        const double s0 = swing[k], s1 = swing[k + 1], s2 = swing[k + 2];
        for (int64_t i = 0; i < count; i++) {
            gain[i] = gain[i] * t[i] + (l0 + l1 * c[i] + l2 * s[i]);
            depth[i] = depth[i] * t[i] + (s0 + s1 * c[i] + s2 * s[i]);
        }
    }
    for (int64_t i = 0; i < count; i++) {
        gain[i] = exponential(gain[i]);
        depth[i] = exponential(depth[i]);
    }
}

// How phases change with height along the rays from an eye to points of a wall that stands across `normal`; and along
// the pipe. there: in the projector's frame, where the ray is the point less the eye.
INLINE void slopes(const Shot* const shot, const double* const eye, const Row* const at, const Row* const there,
                   const Row* const gradient, const Row* const normal, const int64_t count, double* const slope,
                   double* const along)
{
    const double* const pose = shot->projector;
    const double ex = eye[0], ey = eye[1], ez = eye[2], ax = pose[2], ay = pose[6], az = pose[10];
    const double x = pose[0] * ex + pose[1] * ey + ax * ez + pose[3];
    const double y = pose[4] * ex + pose[5] * ey + ay * ez + pose[7];
    const double z = pose[8] * ex + pose[9] * ey + az * ez + pose[11];
    for (int64_t i = 0; i < count; i++) {
        const double away =
            (at->x[i] - ex) * normal->x[i] + (at->y[i] - ey) * normal->y[i] + (at->z[i] - ez) * normal->z[i];
        const double gx = gradient->x[i], gy = gradient->y[i], gz = gradient->z[i];
        slope[i] = (gx * (there->x[i] - x) + gy * (there->y[i] - y) + gz * (there->z[i] - z)) / away;
        along[i] = gx * ax + gy * ay + gz * az;
    }
}

#endif
