// The slide as annulus_pipe.wings.fringe.measure.projector has it (Alzuhiri 2022, 6.6, 6.8): the direction in which
// light leaves it for a place, its phase there, and the waveform that phase makes of it.
// tests/wings/fringe/test_projector.py holds both to each other.
#ifndef ANNULUS_FRINGE_PROJECTOR_H
#define ANNULUS_FRINGE_PROJECTOR_H

#include "mathematics.h"

#define HARMONICS 4     // pairs above the first: projector.HARMONICS_MAX
#define SLIDE_LEAST 13  // numbers of a slide without harmonics: projector.PLAIN
#define BOUNCES 8       // Newton's steps to where a mirror sends light on: the last changes it by less than 1e-12 rad

typedef struct {
    bool rings, pure, plain;  // pure: without harmonics; plain: neither distortion nor mirror
    double a, b, phase0, k1, k2, p1, p2, k3;
    double ux, uy, uz, away, radius;  // of the mirror: direction and distance of its centre, mm; radius 0: none
    double even[HARMONICS], odd[HARMONICS];
} Slide;

// numbers: kind, (a, b) or rate, phase0; OpenCV's k1 k2 p1 p2 k3; the mirror's centre and radius; pairs of harmonics.
INLINE Slide slide_of(const double* const numbers, const int64_t size)
{
    const double* const lens = numbers + 4;
    const double* const mirror = numbers + 9;
    const double away = sqrt(mirror[0] * mirror[0] + mirror[1] * mirror[1] + mirror[2] * mirror[2]);
    const double over = away > 0.0 ? 1.0 / away : 0.0;
    Slide out = {
        .rings = numbers[0] != 0.0,
        .pure = size < SLIDE_LEAST + 2,
        .a = numbers[1],
        .b = numbers[2],
        .phase0 = numbers[3],
        .k1 = lens[0],
        .k2 = lens[1],
        .p1 = lens[2],
        .p2 = lens[3],
        .k3 = lens[4],
        .ux = mirror[0] * over,
        .uy = mirror[1] * over,
        .uz = mirror[2] * over,
        .away = away,
        .radius = mirror[3],
    };
    out.plain = out.radius == 0.0;
    for (int64_t k = 0; k < 5; k++) {
        out.plain = out.plain && lens[k] == 0.0;
    }
    for (int64_t k = 0; k < least((size - SLIDE_LEAST) / 2, HARMONICS); k++) {
        out.even[k] = numbers[SLIDE_LEAST + 2 * k];
        out.odd[k] = numbers[SLIDE_LEAST + 2 * k + 1];
    }
    return out;
}

// Phase at a place of the projector's frame, and how it changes per mm along x, y, z.
typedef struct {
    double phase, x, y, z;
} Lit;

// phase = (a x + b y) / z + phase0
INLINE Lit stripes(const Slide* const slide, const double x, const double y, const double z)
{
    const double inverse = 1.0 / z, ratio = (slide->a * x + slide->b * y) * inverse;
    return (Lit){ratio + slide->phase0, slide->a * inverse, slide->b * inverse, -ratio * inverse};
}

// phase = a z / hypot(x, y) + phase0
INLINE Lit rings(const Slide* const slide, const double x, const double y, const double z)
{
    const double squared = x * x + y * y, rate = slide->a / sqrt(squared), across = -rate * z / squared;
    return (Lit){rate * z + slide->phase0, across * x, across * y, rate};
}

// .. of light that leaves along (x, y, z) through a lens which shows the slide's point (a', b') there, as a camera's
// lens puts it (Brown and Conrady, as OpenCV has it).
INLINE Lit lensed(const Slide* const slide, const double x, const double y, const double z)
{
    const double inverse = 1.0 / z, p = x * inverse, q = y * inverse, r2 = p * p + q * q;
    const double radial = 1.0 + r2 * (slide->k1 + r2 * (slide->k2 + r2 * slide->k3));
    const double bend = slide->k1 + r2 * (2.0 * slide->k2 + 3.0 * r2 * slide->k3);
    const double p1 = slide->p1, p2 = slide->p2;
    const double across = p * radial + 2.0 * p1 * p * q + p2 * (r2 + 2.0 * p * p);
    const double down = q * radial + p1 * (r2 + 2.0 * q * q) + 2.0 * p2 * p * q;
    const double mixed = 2.0 * p * q * bend + 2.0 * p1 * p + 2.0 * p2 * q;
    const double along_p = radial + 2.0 * p * p * bend + 2.0 * p1 * q + 6.0 * p2 * p;
    const double along_q = radial + 2.0 * q * q * bend + 6.0 * p1 * q + 2.0 * p2 * p;
    double phase, by_across, by_down;
    if (slide->rings) {
        const double squared = across * across + down * down, rate = slide->a / sqrt(squared);
        phase = z > 0.0 ? rate : -rate;
        by_across = -phase * across / squared;
        by_down = -phase * down / squared;
    } else {
        phase = slide->a * across + slide->b * down;
        by_across = slide->a;
        by_down = slide->b;
    }
    const double by_p = by_across * along_p + by_down * mixed, by_q = by_across * mixed + by_down * along_q;
    return (Lit){phase + slide->phase0, by_p * inverse, by_q * inverse, -(by_p * p + by_q * q) * inverse};
}

// .. of light that a convex ball sends to (x, y, z). In the plane of slide, ball and place, s along the way to the
// ball's middle and t across: light leaves at the angle theta, meets the ball at the angle alpha from there to the
// slide, and goes back at theta + 2 alpha. alpha is where that ray passes through the place; the phase's gradient
// follows from alpha's.
INLINE Lit mirrored(const Slide* const slide, const double x, const double y, const double z)
{
    const double ux = slide->ux, uy = slide->uy, uz = slide->uz, d = slide->away, r = slide->radius;
    const double s = x * ux + y * uy + z * uz, ax = x - s * ux, ay = y - s * uy, az = z - s * uz;
    const double t = sqrt(ax * ax + ay * ay + az * az), over = 1.0 / (t > 1e-9 ? t : 1e-9);
    const double wx = ax * over, wy = ay * over, wz = az * over;
    const double near = d - r, image = near + near * r / (2.0 * near + r);  // the ball's image of the slide
    const double widest = arc_tangent(sqrt(d * d - r * r), r);              // alpha of a ray that grazes the ball
    double alpha = held(arc_tangent(t, image - s) / (2.0 + r / near), 0.0, 0.99 * widest);
    double cos_theta = 1.0, sin_theta = 0.0, cos_psi = 1.0, sin_psi = 0.0, turn = 1.0, slope = 1.0;
    for (int64_t k = 0; k < BOUNCES; k++) {
        double c, e;
        cosine_sine(alpha, &c, &e);
        const double ms = d - r * c, mt = r * e, square = ms * ms + mt * mt, one = 1.0 / sqrt(square);
        const double c2 = c * c - e * e, e2 = 2.0 * c * e;
        cos_theta = ms * one;
        sin_theta = mt * one;
        cos_psi = cos_theta * c2 - sin_theta * e2;
        sin_psi = sin_theta * c2 + cos_theta * e2;
        const double far = (t - mt) * sin_psi - (s - ms) * cos_psi;
        turn = (r * d * c - r * r) / square;
        slope = -r * (cos_psi * c + sin_psi * e) - (turn + 2.0) * far;
        const double miss = (s - ms) * sin_psi + (t - mt) * cos_psi;
        alpha = held(alpha - miss / slope, 0.0, widest);
    }
    const Lit own = lensed(slide, cos_theta * ux + sin_theta * wx, cos_theta * uy + sin_theta * wy,
                           cos_theta * uz + sin_theta * wz);
    const double swept =
        (own.x * wx + own.y * wy + own.z * wz) * cos_theta - (own.x * ux + own.y * uy + own.z * uz) * sin_theta;
    const double by_s = -swept * turn * sin_psi / slope, by_t = -swept * turn * cos_psi / slope;
    // round the way to the ball: v = u x w
    const double vx = uy * wz - uz * wy, vy = uz * wx - ux * wz, vz = ux * wy - uy * wx;
    const double by_v = (own.x * vx + own.y * vy + own.z * vz) * sin_theta * over;
    return (Lit){own.phase, by_s * ux + by_t * wx + by_v * vx, by_s * uy + by_t * wy + by_v * vy,
                 by_s * uz + by_t * wz + by_v * vz};
}

// The waveform at a phase, of amplitude 1, its slope, and the first harmonic's other half.
typedef struct {
    double crest, steep, sine;
} Wave;

INLINE Wave pure_wave(const double phase)
{
    double c, s;
    cosine_sine(phase, &c, &s);
    return (Wave){c, -s, s};
}

INLINE Wave full_wave(const Slide* const slide, const double phase)
{
    Wave out = pure_wave(phase);
    const double c = out.crest, s = out.sine;
    double ck = c, sk = s;
    for (int64_t k = 0; k < HARMONICS; k++) {
        const double next = ck * c - sk * s;
        sk = sk * c + ck * s;
        ck = next;
        out.crest += slide->even[k] * ck + slide->odd[k] * sk;
        out.steep += (double)(k + 2) * (slide->odd[k] * ck - slide->even[k] * sk);
    }
    return out;
}

#endif
