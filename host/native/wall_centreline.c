// Points of space in pipe coordinates: across the centre line and along it.

#include "centreline.h"

// pieces (p, 16) as `Piece` has them; since (n,): the piece that each point is sought from.
DOOR void points_to_pipe(const double* const points, const int64_t* const since, const double* const pieces,
                         double* const out, const int64_t n, const int64_t p)
{
    for (int64_t i = 0; i < n && p > 0; i++) {
        point_to_pipe(points[3 * i], points[3 * i + 1], points[3 * i + 2], (const Piece*)pieces, p,
                      most(0, least(since[i], p - 1)), out + 3 * i);
    }
}
