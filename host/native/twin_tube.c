// Where a ray leaves a pipe of pieces: straight, bent or tapered ones with beads at their joints, bores into the side,
// and the wall's relief.
//
// A place lies in one piece, has a chainage there and two coordinates across; it is in the pipe while the distance from
// the axis is less than the radius at that chainage and clock angle, or in an opening's bore. Rays march by what is
// free for certain, by 0.3 mm where relief is near, and what is left is found by secant and halving.

#include "twin_tube.h"

static const double STEP_MM = 0.3;     // shortest step: what no relief is shorter than
static const double NORMAL_MM = 0.15;  // over which a wall's slope is taken
static const double MET_MM = 1e-3;     // off the wall, a third of what its map resolves
enum { SECANTS = 3, TRIES = 12 };      // where it steps the secant does not come near: then halves

// Piece and coordinates of a place; those across in axes carried along the pipe without twist.
INLINE Spot locate(const Tube* const tube, const Point place, const int64_t hint)
{
    int64_t i = hint;
    bool forward = false;
    for (;;) {
        const Piece* const piece = tube->pieces + i;
        const Point p = from_to(piece->origin, place);
        double u = times(piece->across, p), v = times(piece->down, p), s = times(piece->on, p);
        if (piece->bend > 0.0) {
            const double aside = u * piece->dx + v * piece->dy, beside = v * piece->dx - u * piece->dy;
            const double out = piece->bend - aside;
            const double inner = piece->bend - sqrt(out * out + s * s);
            s = piece->bend * arc_tangent(s, out);
            u = inner * piece->dx - beside * piece->dy;
            v = inner * piece->dy + beside * piece->dx;
        }
        if (s > piece->length && i + 1 < tube->piece_count) {
            i++;
            forward = true;
        } else if (s < 0.0 && i > 0 && !forward) {
            i--;
        } else {
            return (Spot){i, piece->start + s, u, v, 0.0};
        }
    }
}

// How far beads stand into the pipe at a chainage, mm.
INLINE double standing(const double* const beads, const int64_t count, const double s)
{
    double highest = 0.0;
    for (const double* bead = beads; bead < beads + 4 * count; bead += 4) {
        const double quarter = bead[2] / 4.0, off = fabs(s - bead[0]);
        if (off < 2.0 * quarter) {
            const double arm = (off - quarter) / quarter;
            const double roll = bead[1] * root(1.0 - arm * arm), notch = bead[1] - bead[3];
            const double here = off < quarter && notch > roll ? notch : roll;
            highest = here > highest ? here : highest;
        }
    }
    return highest;
}

double map_column(const Tube* const tube, const double u, const double v)
{
    const double column = arc_tangent(u, -v) * (tube->numbers.map_columns / TURN);
    return column < 0.0 ? column + tube->numbers.map_columns : column;
}

INLINE Spot place_in(const Tube* const tube, const Point place, const int64_t hint)
{
    Spot spot = locate(tube, place, hint);
    const Piece* const piece = tube->pieces + spot.piece;
    double wall = piece->radius + piece->slope * (spot.s - piece->start);
    wall -= standing(tube->beads, tube->bead_count, spot.s);
    const double row = (spot.s - tube->numbers.first) * tube->numbers.a_mm;
    if (row >= 0.0 && row < (double)tube->rows && tube->rough[(int64_t)row] != 0) {
        const float map_row = (float)spot.s * (float)tube->numbers.map_rows_a_mm;
        wall += (double)wall_at(&tube->map, (float)map_column(tube, spot.u, spot.v), map_row);
    }
    spot.out = sqrt(spot.u * spot.u + spot.v * spot.v) - wall;
    for (const double* bore = tube->bores; bore < tube->bores + 8 * tube->bore_count; bore += 8) {
        const Point p = from_to((Point){bore[0], bore[1], bore[2]}, place);
        const double t = p.x * bore[3] + p.y * bore[4] + p.z * bore[5];
        if (t > 0.0) {
            const double side = root(times(p, p) - t * t) - bore[6], end = t - bore[7];
            const double out = side > end ? side : end;
            spot.out = out < spot.out ? out : spot.out;
        }
    }
    return spot;
}

Spot spot_at(const Tube* const tube, const Point place, const int64_t hint)
{
    return place_in(tube, place, hint);
}

// Range (mm) along a unit ray from inside to where it leaves the pipe, and the piece there; `far` where it does not
// before. piece : where it starts.
double leaves(const Tube* const tube, const Point start, const Point way, const double far, int64_t* const piece)
{
    const TubeNumbers* const numbers = &tube->numbers;
    double at = 0.0, inside = 0.0, outside = -1.0, above = 0.0,
           below = 0.0;  // last range in the pipe, first out of it,
    int64_t tries = 0;   // and how far out both are
    while (at < far) {
        const Spot spot = place_in(tube, beyond(start, way, at), *piece);
        *piece = spot.piece;
        if (spot.out >= 0.0) {
            outside = at;
            above = spot.out;
        } else {
            inside = at;
            below = spot.out;
        }
        if (outside >= 0.0) {
            if (fabs(spot.out) < MET_MM || tries == TRIES) {
                return at;
            }
            tries++;
            at = tries <= SECANTS ? (inside * above - outside * below) / (above - below) : 0.5 * (inside + outside);
            continue;
        }
        const int64_t row = whole((spot.s - numbers->first) * numbers->a_mm, 0, tube->rows - 1);
        const double rho = sqrt(spot.u * spot.u + spot.v * spot.v);
        // how fast the ray can leave the axis: in a bend the axis turns while it goes, too
        double rate = 1.0;
        if (tube->piece_count == 1 || tube->pieces[spot.piece].bend == 0.0) {
            const double along = times(tube->pieces[spot.piece].on, way);
            const double straight = root(1.0 - along * along) + numbers->turn_rate;
            rate = straight < 1.0 ? straight : 1.0;
        }
        const double leap = (tube->leap[row] - rho) / rate;
        double step = leap < numbers->leap_mm ? leap : numbers->leap_mm;
        if (step < STEP_MM) {
            step = held((tube->near[row] - rho) / rate, STEP_MM, numbers->near_mm);
        }
        at += step;
    }
    return far;
}

// Unit vector out of the pipe at a place of its wall.
Point normal_at(const Tube* const tube, const Point p, const int64_t hint)
{
    const double h = NORMAL_MM;
    const double x =
        place_in(tube, (Point){p.x + h, p.y, p.z}, hint).out - place_in(tube, (Point){p.x - h, p.y, p.z}, hint).out;
    const double y =
        place_in(tube, (Point){p.x, p.y + h, p.z}, hint).out - place_in(tube, (Point){p.x, p.y - h, p.z}, hint).out;
    const double z =
        place_in(tube, (Point){p.x, p.y, p.z + h}, hint).out - place_in(tube, (Point){p.x, p.y, p.z - h}, hint).out;
    const double scale = 1.0 / sqrt(x * x + y * y + z * z + 1e-18);
    return (Point){x * scale, y * scale, z * scale};
}

DOOR void twin_beads(const double* const beads, const double* const stations, double* const out, const int64_t b,
                     const int64_t n)
{
    for (int64_t k = 0; k < n; k++) {
        out[k] = standing(beads, b, stations[k]);
    }
}

// As `leaves` says it, of one ray.
DOOR double twin_leaves(const double* const course, const double* const pieces, const double* const beads,
                        const double* const bores, const float* const deviation, const uint8_t* const rough,
                        const double* const near, const double* const leap, const double* const start,
                        const double* const way, const double far, const int64_t q, const int64_t b, const int64_t o,
                        const int64_t r, const int64_t p, const int64_t y)
{
    const Tube tube = tube_of(course, pieces, beads, bores, deviation, rough, near, leap, q, b, o, r, p, y);
    int64_t piece = 0;
    return leaves(&tube, (Point){start[0], start[1], start[2]}, (Point){way[0], way[1], way[2]}, far, &piece);
}
