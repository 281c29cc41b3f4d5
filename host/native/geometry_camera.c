// Where points lie in the image of a camera with one centre: OpenCV's models, in its formulas.
//
//   pinhole  (x, y) = (X/Z, Y/Z), Brown-Conrady with thin prism: q = x^2 + y^2,
//            x' = x (1 + k1 q + k2 q^2 + k3 q^3)/(1 + k4 q + k5 q^2 + k6 q^3) + 2 p1 x y + p2 (q + 2 x^2) + s1 q + s2
//            q^2 (1)
//   fisheye  angle t = atan2(|(X, Y)|, Z) to the axis, at t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)                 (2)

#include <string.h>

#include "mathematics.h"

static const double AHEAD_MM = 1e-9;  // of a pinhole: what is no farther ahead has no image
static const double ASIDE = 1e-12;    // of a fisheye's axis, mm: a point no farther off lies on it

typedef struct {
    double nearest;       // ahead, mm: what is less far has no pixel
    double lens[4];       // fx, fy, cx, cy
    double k[12];         // k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, of a fisheye k1 .. k4 in the first four
    double tilt[9];       // (3, 3): what a tilted sensor does to a pinhole's x' and y'
    bool fisheye, plain;  // plain: a pinhole whose k4, k5, k6 and tilt do nothing
} Lens;

// A copy: nothing that is written is one of its numbers, which a loop may then keep at hand.
INLINE Lens lens_of(const double nearest, const bool fisheye, const double* const lens, const double* const k,
                    const double* const tilt)
{
    Lens out = {.nearest = nearest, .fisheye = fisheye, .plain = !fisheye};
    memcpy(out.lens, lens, sizeof out.lens);
    memcpy(out.k, k, sizeof out.k);
    memcpy(out.tilt, tilt, sizeof out.tilt);
    for (int i = 0; i < 9; i++) {
        out.plain &= tilt[i] == (i % 4 ? 0.0 : 1.0);
    }
    out.plain &= k[5] == 0.0 && k[6] == 0.0 && k[7] == 0.0;
    return out;
}

// The pixel of a place x, y, z in the camera's frame.
INLINE void imaged(const double x, const double y, const double z, const Lens* const own, const bool fisheye,
                   const bool plain, double* const pixel)
{
    const double* const k = own->k;
    double u, v;
    if (fisheye) {
        const double aside = sqrt(x * x + y * y), t = arc_tangent(aside, z), q = t * t;
        const double at = t * (1.0 + q * (k[0] + q * (k[1] + q * (k[2] + q * k[3]))));  // Eq. 2
        const double far = fabs(z) > ASIDE ? fabs(z) : ASIDE;
        const double scale = aside > ASIDE ? at / aside : 1.0 / far;
        u = x * scale;
        v = y * scale;
    } else {
        const double over_x = x / z, over_y = y / z;
        const double a = z > AHEAD_MM ? over_x : NOTHING, b = z > AHEAD_MM ? over_y : NOTHING;
        const double q = a * a + b * b, across = 2.0 * a * b;
        const double wider = 1.0 + q * (k[0] + q * (k[1] + q * k[4]));
        const double part = plain ? wider : wider / (1.0 + q * (k[5] + q * (k[6] + q * k[7])));
        const double c = a * part + k[2] * across + k[3] * (q + 2.0 * a * a) + q * (k[8] + q * k[9]);  // Eq. 1
        const double d = b * part + k[2] * (q + 2.0 * b * b) + k[3] * across + q * (k[10] + q * k[11]);
        const double* const tilt = own->tilt;
        const double w = plain ? 1.0 : tilt[6] * c + tilt[7] * d + tilt[8];
        u = plain ? c : (tilt[0] * c + tilt[1] * d + tilt[2]) / w;
        v = plain ? d : (tilt[3] * c + tilt[4] * d + tilt[5]) / w;
    }
    pixel[0] = z < own->nearest ? NOTHING : u * own->lens[0] + own->lens[2];
    pixel[1] = z < own->nearest ? NOTHING : v * own->lens[1] + own->lens[3];
}

INLINE void points_imaged(const double* const points, const double* const turn, const double* const shift,
                          const Lens* const own, const bool fisheye, const bool plain, double* const out,
                          const int64_t n)
{
    for (int64_t i = 0; i < n; i++) {
        const double px = points[3 * i], py = points[3 * i + 1], pz = points[3 * i + 2];
        imaged(turn[0] * px + turn[1] * py + turn[2] * pz + shift[0],
               turn[3] * px + turn[4] * py + turn[5] * pz + shift[1],
               turn[6] * px + turn[7] * py + turn[8] * pz + shift[2], own, fisheye, plain, out + 2 * i);
    }
}

// Pixels (n, 2) of points (n, 3) that are at turn p + shift in the camera's frame; NaN of what is less than `nearest`
// ahead. lens, k, tilt: see Lens.
DOOR void projected(const double* const points, const double* const turn, const double* const shift,
                    const double nearest, const bool fisheye, const double* const lens, const double* const k,
                    const double* const tilt, double* const out, const int64_t n)
{
    const Lens own = lens_of(nearest, fisheye, lens, k, tilt);
    if (own.plain) {
        points_imaged(points, turn, shift, &own, false, true, out, n);
    } else {
        points_imaged(points, turn, shift, &own, fisheye, false, out, n);
    }
}

INLINE void rows_imaged(const double* const radius, const double* const right, const double* const down,
                        const double* const rows, const Lens* const own, const bool fisheye, const bool plain,
                        double* const out, const int64_t r, const int64_t a)
{
    for (int64_t row = 0; row < r; row++) {
        double of[9];
        memcpy(of, rows + 9 * row, sizeof of);
        const double* const far = radius + a * row;
        for (int64_t i = 0; i < a; i++) {
            const double x = far[i] * right[i], y = far[i] * down[i];
            imaged(of[0] * x + of[1] * y + of[6], of[2] * x + of[3] * y + of[7], of[4] * x + of[5] * y + of[8], own,
                   fisheye, plain, out + 2 * (a * row + i));
        }
    }
}

// The same of places round an axis, (r, a) by their radius: right, down (a,) of a radius of one; rows (r, 9) lead from
// there to the camera's frame, (3, 2) what right and down do and (3,) where the axis is.
DOOR void rows_projected(const double* const radius, const double* const right, const double* const down,
                         const double* const rows, const double nearest, const bool fisheye, const double* const lens,
                         const double* const k, const double* const tilt, double* const out, const int64_t r,
                         const int64_t a)
{
    const Lens own = lens_of(nearest, fisheye, lens, k, tilt);
    if (own.plain) {
        rows_imaged(radius, right, down, rows, &own, false, true, out, r, a);
    } else {
        rows_imaged(radius, right, down, rows, &own, fisheye, false, out, r, a);
    }
}
