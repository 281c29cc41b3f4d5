// The pipe's centre line as loops see it: a chain of straight and bent pieces, and the way from space to it.
//
// A piece is an arc of a circle of curvature k towards the unit direction (bx, by) of its own frame, or straight. A
// point in that frame lies at x towards it, its arm to the circle's centre 1/k - x; turned back about that centre by
// the angle atan2(z, arm), it lies in the plane of the piece's beginning, and that angle over k is how far along it
// was.
#ifndef ANNULUS_CENTRELINE_H
#define ANNULUS_CENTRELINE_H

#include "mathematics.h"

typedef struct {
    double starts, x, y, z;  // chainage where it begins, and that place in space, mm
    double frame[9];         // columns across, across and ahead there
    double bx, by, k;        // where it bends to, 1/mm; k = 0 of a straight one
} Piece;

INLINE double length_of(const double x, const double y)
{
    return sqrt(x * x + y * y);
}

// x, y across the line and the chainage of a point in space, sought from a piece on; returns the piece it is found by.
INLINE int64_t point_to_pipe(const double px, const double py, const double pz, const Piece* const pieces,
                             const int64_t size, const int64_t since, double out[3])
{
    for (int64_t own = since;; own++) {
        const Piece* const piece = pieces + own;
        const double* const f = piece->frame;
        const double dx = px - piece->x, dy = py - piece->y, dz = pz - piece->z;
        double x = dx * f[0] + dy * f[3] + dz * f[6];
        double y = dx * f[1] + dy * f[4] + dz * f[7];
        double z = dx * f[2] + dy * f[5] + dz * f[8];
        if (piece->k > 0.0) {
            const double radius = 1.0 / piece->k;
            const double towards = piece->bx * x + piece->by * y;
            const double arm = radius - towards;
            const double change = radius - length_of(arm, z) - towards;
            x += change * piece->bx;
            y += change * piece->by;
            z = arc_tangent(z, arm) * radius;
        }
        z += piece->starts;
        out[0] = x;
        out[1] = y;
        out[2] = z;
        if (!(own + 1 < size && z > pieces[own + 1].starts)) {
            return own;
        }
    }
}

#endif
