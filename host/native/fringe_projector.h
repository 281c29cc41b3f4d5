// The slide as annulus_pipe.wings.fringe.measure.projector has it (Alzuhiri 2022, 6.8): one phase for every direction
// of light, and the waveform that phase makes of it. tests/wings/fringe/test_projector.py holds both to each other.
#ifndef ANNULUS_FRINGE_PROJECTOR_H
#define ANNULUS_FRINGE_PROJECTOR_H

#include "mathematics.h"

#define HARMONICS 4    // pairs above the first: projector.HARMONICS_MAX
#define SLIDE_LEAST 4  // numbers of a slide without harmonics

typedef struct {
    bool rings, pure;  // pure: without harmonics
    double a, b, phase0, even[HARMONICS], odd[HARMONICS];
} Slide;

// numbers: kind, (a, b) or rate, phase0, then pairs of harmonics; at least SLIDE_LEAST.
INLINE Slide slide_of(const double* const numbers, const int64_t size)
{
    Slide out = {numbers[0] != 0.0, size < SLIDE_LEAST + 2, numbers[1], numbers[2], numbers[3], {0.0}, {0.0}};
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
