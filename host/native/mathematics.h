// Functions that the C library has too, but not with the same bits on every machine: its own are chosen by processor.
// Each is one formula without a branch that a vector could not take, of sums and products in a fixed order. How far
// each is off, and of which numbers, is asked by tests/unit/numeric/test_mathematics.py. NaN is NaN.
#ifndef ANNULUS_MATHEMATICS_H
#define ANNULUS_MATHEMATICS_H

#include <math.h>
#include <string.h>

#include "native.h"

#define PI 3.14159265358979323846
#define TURN 6.28318530717958647692

// e^x within 1.6 units of the last place; 0 below -708, e^709 above 709. x = k ln 2 + r, |r| <= ln 2 / 2, and the
// polynomial of 11th degree that is nearest to e^r there, 2e-17 off; by pairs, not one term after the other: a vector's
// terms then wait for one another a third as long.
INLINE double exponential(const double x)
{
    const double above = x < -708.0 ? -708.0 : x, bound = above > 709.0 ? 709.0 : above;
    // A sum with 1.5 * 2^52 is whole, and has the whole number in its lowest bits: k + 1023, an exponent.
    const double whole_of = 6755399441055744.0 + 1023.0;
    const double shifted = bound * 1.44269504088896340736 + whole_of;
    const double k = shifted - whole_of;
    const double r = (bound - k * 6.93147180369123816490e-01) - k * 1.90821492927058770002e-10;
    const double q = r * r, q2 = q * q;
    const double low = r + q * (0.5000000000000001 + r * 0.16666666666666669);
    const double next =
        (0.041666666666624115 + r * 0.008333333333330008) + q * (0.0013888888917216408 + r * 0.00019841269863204688);
    const double high = (2.4801521293233496e-05 + r * 2.755726829368387e-06) +
                        q * (2.7620089364682327e-07 + r * 2.5100446932005955e-08);
    const double p = 1.0 + ((low + q2 * next) + (q2 * q2) * high);
    uint64_t bits;
    memcpy(&bits, &shifted, sizeof bits);
    bits <<= 52;
    double power;
    memcpy(&power, &bits, sizeof power);
    return x < -708.0 ? 0.0 : p * power;
}

// Cosine and sine of any angle below 1e6 rad, to 5e-16 and 2^-53 of the angle: Taylor's series within a quarter turn of
// the nearest half turn.
INLINE void cosine_sine(const double angle, double* const cosine, double* const sine)
{
    const double halves = floor(angle * (1.0 / PI) + 0.5);
    const double x = (angle - halves * 3.14159265358979311600) - halves * 1.22464679914735317636e-16;
    const double q = x * x;
    double c = 1.0 / 2432902008176640000.0;
    c = c * q - 1.0 / 6402373705728000.0;
    c = c * q + 1.0 / 20922789888000.0;
    c = c * q - 1.0 / 87178291200.0;
    c = c * q + 1.0 / 479001600.0;
    c = c * q - 1.0 / 3628800.0;
    c = c * q + 1.0 / 40320.0;
    c = c * q - 1.0 / 720.0;
    c = c * q + 1.0 / 24.0;
    c = c * q - 0.5;
    c = c * q + 1.0;
    double s = -1.0 / 121645100408832000.0;
    s = s * q + 1.0 / 355687428096000.0;
    s = s * q - 1.0 / 1307674368000.0;
    s = s * q + 1.0 / 6227020800.0;
    s = s * q - 1.0 / 39916800.0;
    s = s * q + 1.0 / 362880.0;
    s = s * q - 1.0 / 5040.0;
    s = s * q + 1.0 / 120.0;
    s = s * q - 1.0 / 6.0;
    s = s * q + 1.0;
    const double half = halves * 0.5;
    const double sign = half == floor(half) ? 1.0 : -1.0;
    *cosine = sign * c;
    *sine = sign * (x * s);
}

// Arc tangent of y / x in the quadrant of (x, y), within 3.5 units of the last place; 0 of (0, 0), and -0 is 0. Of
// finite numbers whose greater is 0 or between 1e-290 and 8e307, in size; NaN where one is infinite. The lesser over
// the greater, taken off the tangent of the nearest of 0, pi/8 and pi/4, and Taylor's series of what is left.
INLINE double arc_tangent(const double y, const double x)
{
    const double ay = fabs(y), ax = fabs(x);
    const double greater = ay > ax ? ay : ax, lesser = ay > ax ? ax : ay;
    // tan(pi/8) = sqrt 2 - 1; halves of the steps lie at tan(pi/16) and tan(3 pi/16)
    const bool far = lesser > 0.66817863791929892 * greater, near = lesser > 0.19891236737965800 * greater;
    const double tangent = far ? 1.0 : near ? 0.41421356237309505 : 0.0;
    const double base = far ? 0.78539816339744831 : near ? 0.39269908169872415 : 0.0;
    const double below = greater + tangent * lesser;
    const double t = (lesser - tangent * greater) / (below > 0.0 ? below : 1.0);
    const double q = t * t;
    const double q2 = q * q, q4 = q2 * q2;
    const double low = (-1.0 / 3.0 + q * (1.0 / 5.0)) + q2 * (-1.0 / 7.0 + q * (1.0 / 9.0));
    const double next = (-1.0 / 11.0 + q * (1.0 / 13.0)) + q2 * (-1.0 / 15.0 + q * (1.0 / 17.0));
    const double high = -1.0 / 19.0 + q * (1.0 / 21.0);
    const double p = (low + q4 * next) + (q4 * q4) * high;
    const double angle = base + (t + t * (q * p));
    const double eighth = ay > ax ? 1.57079632679489662 - angle : angle;
    const double half = x < 0.0 ? PI - eighth : eighth;
    return y < 0.0 ? -half : half;
}

#endif
