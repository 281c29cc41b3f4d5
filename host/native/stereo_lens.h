// A camera of a head as a row of numbers, and where it sees a point: the same place as `Camera.project`.
// annulus_pipe.stereo.lens writes the row.
#ifndef ANNULUS_STEREO_LENS_H
#define ANNULUS_STEREO_LENS_H

#include "mathematics.h"

#define LENS_NUMBERS 34  // model, fx, fy, cx, cy; then from ..
#define DISTORTION 5     // .. 12 numbers
#define ROTATION 17      // .. 9, from the head's frame
#define TRANSLATION 26   // .. 3, mm
#define GRID 29          // .. centre x, y, first sample px, samples a px, lines

typedef struct {
    double line, place;
} Seen;

// A point of the head's frame, mm -> the line it is seen on and the sample along it; NaN behind a pinhole.
INLINE Seen on_line(const double* const lens, const double px, const double py, const double pz)
{
    const double *const r = lens + ROTATION, *const t = lens + TRANSLATION, *const g = lens + GRID;
    const double* const d = lens + DISTORTION;
    const double x = r[0] * px + r[1] * py + r[2] * pz + t[0];
    const double y = r[3] * px + r[4] * py + r[5] * pz + t[1];
    const double z = r[6] * px + r[7] * py + r[8] * pz + t[2];
    double u, v;
    if (lens[0] == 0.0) {  // fisheye: Kannala and Brandt
        const double rho = sqrt(x * x + y * y);
        const double theta = arc_tangent(rho, z), t2 = theta * theta;
        const double bent = theta * (1.0 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3]))));
        const double scale = bent / (rho > 1e-12 ? rho : 1e-12);
        u = x * scale;
        v = y * scale;
    } else {  // pinhole, radial as a quotient, tangential, thin prism: OpenCV's model
        if (!(z > 1e-9)) {
            return (Seen){NOTHING, NOTHING};
        }
        const double a = x / z, b = y / z, q = a * a + b * b;
        const double radial = (1.0 + q * (d[0] + q * (d[1] + q * d[4]))) / (1.0 + q * (d[5] + q * (d[6] + q * d[7])));
        u = a * radial + 2.0 * d[2] * a * b + d[3] * (q + 2.0 * a * a) + q * (d[8] + q * d[9]);
        v = b * radial + d[2] * (q + 2.0 * b * b) + 2.0 * d[3] * a * b + q * (d[10] + q * d[11]);
    }
    u = lens[1] * u + lens[3] - g[0];
    v = lens[2] * v + lens[4] - g[1];
    const double line = arc_tangent(v, u) * (g[4] * (1.0 / TURN));
    return (Seen){line < 0.0 ? line + g[4] : line, (sqrt(u * u + v * v) - g[2]) * g[3]};
}

#endif
