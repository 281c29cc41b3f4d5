// Where points lie in the image of a camera with one centre: OpenCV's models, in its formulas.
//
//   pinhole  (x, y) = (X/Z, Y/Z), Brown-Conrady with thin prism: q = x^2 + y^2,
//            x' = x (1 + k1 q + k2 q^2 + k3 q^3)/(1 + k4 q + k5 q^2 + k6 q^3) + 2 p1 x y + p2 (q + 2 x^2) + s1 q + s2
//            q^2 (1)
//   fisheye  angle t = atan2(|(X, Y)|, Z) to the axis, at t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)                 (2)

#include "mathematics.h"

static const double AHEAD_MM = 1e-9;  // of a pinhole: what is no farther ahead has no image
static const double ASIDE = 1e-12;    // of a fisheye's axis, mm: a point no farther off lies on it

// Pixels (n, 2) of points (n, 3) that are at turn p + shift in the camera's frame; NaN of what is less than `nearest`
// ahead. lens: fx, fy, cx, cy; k: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, of a fisheye k1 .. k4 in the
// first four. tilt (3, 3): what a tilted sensor does to a pinhole's x' and y'.
DOOR void projected(const double* const points, const double* const turn, const double* const shift,
                    const double nearest, const bool fisheye, const double* const lens, const double* const k,
                    const double* const tilt, double* const out, const int64_t n)
{
    for (int64_t i = 0; i < n; i++) {
        const double px = points[3 * i], py = points[3 * i + 1], pz = points[3 * i + 2];
        const double x = turn[0] * px + turn[1] * py + turn[2] * pz + shift[0];
        const double y = turn[3] * px + turn[4] * py + turn[5] * pz + shift[1];
        const double z = turn[6] * px + turn[7] * py + turn[8] * pz + shift[2];
        double u, v;
        if (fisheye) {
            const double aside = sqrt(x * x + y * y), t = arc_tangent(aside, z), q = t * t;
            const double at = t * (1.0 + q * (k[0] + q * (k[1] + q * (k[2] + q * k[3]))));  // Eq. 2
            const double far = fabs(z) > ASIDE ? fabs(z) : ASIDE;
            const double scale = aside > ASIDE ? at / aside : 1.0 / far;
            u = x * scale;
            v = y * scale;
        } else {
            const double a = z > AHEAD_MM ? x / z : NOTHING, b = z > AHEAD_MM ? y / z : NOTHING;
            const double q = a * a + b * b, across = 2.0 * a * b;
            const double part = (1.0 + q * (k[0] + q * (k[1] + q * k[4]))) / (1.0 + q * (k[5] + q * (k[6] + q * k[7])));
            const double c = a * part + k[2] * across + k[3] * (q + 2.0 * a * a) + q * (k[8] + q * k[9]);  // Eq. 1
            const double d = b * part + k[2] * (q + 2.0 * b * b) + k[3] * across + q * (k[10] + q * k[11]);
            const double w = tilt[6] * c + tilt[7] * d + tilt[8];
            u = (tilt[0] * c + tilt[1] * d + tilt[2]) / w;
            v = (tilt[3] * c + tilt[4] * d + tilt[5]) / w;
        }
        out[2 * i] = z < nearest ? NOTHING : u * lens[0] + lens[2];
        out[2 * i + 1] = z < nearest ? NOTHING : v * lens[1] + lens[3];
    }
}
