// What every sighting of the wall is off a pipe of pieces, seen by heads that stand along it, and how that moves with
// every number of a piece and of a head: what the adjustment of a scan asks again and again.
//
// A head at chainage s stands where the centre line is there, turned by R = Rx(rx) Ry(ry) Rz(-roll) and aside by
// (tx, ty). A point v of its camera lies in space at o(s) + F(s) R^T (v - t), in pipe coordinates x, y, z after
// centreline.h, and is off the wall by
//     |(x, y)| - (r + taper (z - start) + a waves of two and of three round the clock).                             (1)
// Derivatives are differences: of a chain of arcs they are as good, and say the same as what is differed.

#include "centreline.h"

enum {
    OFFSET = 0,
    KINK = 2,
    CURVATURE = 4,
    RADIUS = 6,
    TAPER = 7,
    SHAPE = 8,
    START = 12,
    PIECE = 13
};  // adjustment.py
enum { RX, RY, TX, TY, ROLL, HEAD };
enum { BIAS = 3 };
static const double SMALLEST_MM = 1e-9;  // of a radius, to divide by
static const double STEEPEST = 1e4;      // of a derivative: a ray along the wall has none

typedef struct {
    double turn[9], x, y, z;  // from the camera's frame to space
    double tx, ty;            // aside, mm
    double since;             // piece that it stands in
    double unused;
} Head;

// Turns the direction ahead towards (x, y) by their length in radians (Rodrigues).
static void towards(const double tx, const double ty, double turn[9])
{
    const double angle = length_of(tx, ty), safe = angle > 1e-300 ? angle : 1e-300;
    const double x = tx / safe, y = ty / safe;
    double c, s;
    cosine_sine(held(angle, 0.0, 1e6), &c, &s);
    c -= 1.0;
    const double rows[9] = {1.0 + c * x * x, c * x * y, s * x,  c * x * y, 1.0 + c * y * y,
                            s * y,           -s * x,    -s * y, 1.0 + c};
    memcpy(turn, rows, sizeof rows);
}

// Where a length along a piece ends, and how it is turned there, in the frame of the piece's start.
static void along(const double bx, const double by, const double length, const double straight, double way[3],
                  double turn[9])
{
    const double k = length_of(bx, by);
    if (!(k > straight)) {
        const double same[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
        memcpy(turn, same, sizeof same);
        way[0] = way[1] = 0.0;
        way[2] = length;
        return;
    }
    double c, s, half_c, half_s;
    cosine_sine(held(k * length, -1e6, 1e6), &c, &s);
    cosine_sine(held(0.5 * k * length, -1e6, 1e6), &half_c, &half_s);
    const double aside = 2.0 * half_s * half_s / (k * k);
    way[0] = aside * bx;
    way[1] = aside * by;
    way[2] = s / k;
    towards(length * bx, length * by, turn);
}

static void product(const double a[9], const double b[9], double out[9])
{
    for (int64_t i = 0; i < 3; i++) {
        for (int64_t j = 0; j < 3; j++) {
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
        }
    }
}

// Pieces one after the other in space, each radius the one before it grown by its taper and stepped.
static void lay(const double* const numbers, const int64_t size, const double straight, Piece* const line,
                double* const radii)
{
    for (int64_t i = 0; i < size; i++) {
        const double* const now = numbers + PIECE * i;
        Piece* const piece = line + i;
        const double k = length_of(now[CURVATURE], now[CURVATURE + 1]);
        piece->starts = now[START];
        piece->k = k > straight ? k : 0.0;
        piece->bx = k > straight ? now[CURVATURE] / k : 0.0;
        piece->by = k > straight ? now[CURVATURE + 1] / k : 0.0;
        if (i == 0) {
            const double same[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
            memcpy(piece->frame, same, sizeof same);
            piece->x = piece->y = 0.0;
            piece->z = now[START];
            radii[0] = now[RADIUS];
            continue;
        }
        const double* const was = now - PIECE;
        const double length = now[START] - was[START];
        double way[3], turned[9], end[9], kink[9];
        along(was[CURVATURE], was[CURVATURE + 1], length, straight, way, turned);
        const double* const f = line[i - 1].frame;
        product(f, turned, end);
        towards(now[KINK], now[KINK + 1], kink);
        product(end, kink, piece->frame);
        const double ox = now[OFFSET], oy = now[OFFSET + 1];
        piece->x = line[i - 1].x + (f[0] * way[0] + f[1] * way[1] + f[2] * way[2]) + (end[0] * ox + end[1] * oy);
        piece->y = line[i - 1].y + (f[3] * way[0] + f[4] * way[1] + f[5] * way[2]) + (end[3] * ox + end[4] * oy);
        piece->z = line[i - 1].z + (f[6] * way[0] + f[7] * way[1] + f[8] * way[2]) + (end[6] * ox + end[7] * oy);
        radii[i] = radii[i - 1] + (now[RADIUS] + was[TAPER] * length);
    }
}

static void stand(const double* const numbers, const double* const heads, const double* const chainage,
                  const int64_t count, const Piece* const line, const int64_t size, const double straight,
                  Head* const out)
{
    int64_t own = 0;
    for (int64_t i = 0; i < count; i++) {
        const double s = chainage[i];
        while (own > 0 && s < line[own].starts) {
            own--;
        }
        while (own + 1 < size && s >= line[own + 1].starts) {
            own++;
        }
        const double *const piece = numbers + PIECE * own, *const f = line[own].frame, *const head = heads + HEAD * i;
        double way[3], turned[9], frame[9], ca, sa, cb, sb, cr, sr;
        along(piece[CURVATURE], piece[CURVATURE + 1], s - piece[START], straight, way, turned);
        product(f, turned, frame);
        cosine_sine(held(head[RX], -1e6, 1e6), &ca, &sa);
        cosine_sine(held(head[RY], -1e6, 1e6), &cb, &sb);
        cosine_sine(held(-head[ROLL], -1e6, 1e6), &cr, &sr);
        const double back[9] = {cb * cr,
                                ca * sr + sa * sb * cr,
                                sa * sr - ca * sb * cr,
                                -cb * sr,
                                ca * cr - sa * sb * sr,
                                sa * cr + ca * sb * sr,
                                sb,
                                -sa * cb,
                                ca * cb};  // R^T
        product(frame, back, out[i].turn);
        out[i].x = line[own].x + (f[0] * way[0] + f[1] * way[1] + f[2] * way[2]);
        out[i].y = line[own].y + (f[3] * way[0] + f[4] * way[1] + f[5] * way[2]);
        out[i].z = line[own].z + (f[6] * way[0] + f[7] * way[1] + f[8] * way[2]);
        out[i].tx = head[TX];
        out[i].ty = head[TY];
        out[i].since = (double)own;
    }
}

typedef struct {
    const double *points, *slide, *ways, *bias;
    const int64_t *ring, *frame;
    int64_t rings, heads;
} Sightings;

// Of one sighting, Eq. 1; where: x, y as a unit direction, chainage. `reached`: the last piece that has a say in it.
INLINE double residual(const Sightings* const seen, const int64_t n, const Head* const heads,
                       const double* const numbers, const Piece* const line, const double* const radii,
                       const int64_t size, double where[3], int64_t* const reached)
{
    const Head* const head = heads + most(0, least(seen->frame[n], seen->heads - 1));
    const double* const own_bias = seen->bias + BIAS * most(0, least(seen->ring[n], seen->rings - 1));
    const double *const p = seen->points + 3 * n, *const slide = seen->slide + 3 * n,
                        *const way = seen->ways + BIAS * n;
    const double off = own_bias[0] * way[0] + own_bias[1] * way[1] + own_bias[2] * way[2];
    const double a = p[0] - off * slide[0] - head->tx, b = p[1] - off * slide[1] - head->ty, c = p[2] - off * slide[2];
    const double* const t = head->turn;
    int64_t own = point_to_pipe(head->x + t[0] * a + t[1] * b + t[2] * c, head->y + t[3] * a + t[4] * b + t[5] * c,
                                head->z + t[6] * a + t[7] * b + t[8] * c, line, size, (int64_t)head->since, where);
    const int64_t came = own;
    const double z = where[2], far = length_of(where[0], where[1]), safe = far > SMALLEST_MM ? far : SMALLEST_MM;
    const double x = where[0] / safe, y = where[1] / safe;
    while (own > 0 && z < line[own].starts) {
        own--;
    }
    while (own + 1 < size && z >= line[own + 1].starts) {
        own++;
    }
    *reached = most(came, own);
    const double* const row = numbers + PIECE * own;
    const double twofold = x * x - y * y, quarter = 2.0 * x * y;
    double model = radii[own] + row[TAPER] * (z - row[START]) + row[SHAPE] * twofold + row[SHAPE + 1] * quarter;
    model += row[SHAPE + 2] * (x * twofold - y * quarter) + row[SHAPE + 3] * (x * quarter + y * twofold);
    where[0] = x;
    where[1] = y;
    return far - model;
}

// residual, chainage and direction across the pipe of sightings (n,). stands, line, radii: room to work in.
DOOR void wall_residuals(const double* const points, const double* const slide, const double* const ways,
                         const int64_t* const ring, const int64_t* const frame, const double* const bias,
                         const double* const heads, const double* const chainage, const double* const pieces,
                         const double straight, double* const stands, double* const line, double* const radii,
                         double* const residuals, double* const where, double* const direction, const int64_t n,
                         const int64_t r, const int64_t f, const int64_t p)
{
    if (p < 1 || f < 1 || r < 1) {
        return;
    }
    const Sightings seen = {points, slide, ways, bias, ring, frame, r, f};
    lay(pieces, p, straight, (Piece*)line, radii);
    stand(pieces, heads, chainage, f, (const Piece*)line, p, straight, (Head*)stands);
    for (int64_t i = 0; i < n; i++) {
        double at[3];
        int64_t reached;
        residuals[i] = residual(&seen, i, (const Head*)stands, pieces, (const Piece*)line, radii, p, at, &reached);
        direction[2 * i] = at[0];
        direction[2 * i + 1] = at[1];
        where[i] = at[2];
    }
}

// How residuals (n,) change with some numbers of the pieces, columns (c,) of (p, 13), by steps (c,), none below zero:
// of those sightings that reach the piece, the others know nothing of it. tried, reached: room.
DOOR void wall_by_pieces(const double* const points, const double* const slide, const double* const ways,
                         const int64_t* const ring, const int64_t* const frame, const double* const bias,
                         const double* const heads, const double* const chainage, const double* const pieces,
                         const double straight, double* const stands, double* const line, double* const radii,
                         const double* const residuals, const int64_t* const columns, const double* const steps,
                         double* const tried, int64_t* const reached, double* const out, const int64_t n,
                         const int64_t r, const int64_t f, const int64_t p, const int64_t c)
{
    if (p < 1 || f < 1 || r < 1) {
        return;
    }
    const Sightings seen = {points, slide, ways, bias, ring, frame, r, f};
    lay(pieces, p, straight, (Piece*)line, radii);
    stand(pieces, heads, chainage, f, (const Piece*)line, p, straight, (Head*)stands);
    for (int64_t i = 0; i < n; i++) {
        double at[3];
        residual(&seen, i, (const Head*)stands, pieces, (const Piece*)line, radii, p, at, reached + i);
    }
    for (int64_t j = 0; j < c; j++) {
        const int64_t column = most(0, least(columns[j], PIECE * p - 1)), own = column / PIECE;
        memcpy(tried, pieces, (size_t)(PIECE * p) * sizeof *pieces);
        tried[column] += steps[j];
        lay(tried, p, straight, (Piece*)line, radii);
        stand(tried, heads, chainage, f, (const Piece*)line, p, straight, (Head*)stands);
        for (int64_t i = 0; i < n; i++) {
            double at[3], moved = residuals[i];
            if (reached[i] >= own) {
                int64_t there;
                moved = residual(&seen, i, (const Head*)stands, tried, (const Piece*)line, radii, p, at, &there);
            }
            out[i * c + j] = (moved - residuals[i]) / steps[j];
        }
    }
}

// The same with the five numbers of each sighting's own head, steps (5,); tried (f, 5): room.
DOOR void wall_by_heads(const double* const points, const double* const slide, const double* const ways,
                        const int64_t* const ring, const int64_t* const frame, const double* const bias,
                        const double* const heads, const double* const chainage, const double* const pieces,
                        const double straight, double* const stands, double* const line, double* const radii,
                        const double* const residuals, const double* const steps, double* const tried,
                        double* const out, const int64_t n, const int64_t r, const int64_t f, const int64_t p)
{
    if (p < 1 || f < 1 || r < 1) {
        return;
    }
    const Sightings seen = {points, slide, ways, bias, ring, frame, r, f};
    lay(pieces, p, straight, (Piece*)line, radii);
    for (int64_t j = 0; j < HEAD; j++) {
        memcpy(tried, heads, (size_t)(f * HEAD) * sizeof *heads);
        for (int64_t i = 0; i < f; i++) {
            tried[HEAD * i + j] += steps[j];
        }
        stand(pieces, tried, chainage, f, (const Piece*)line, p, straight, (Head*)stands);
        for (int64_t i = 0; i < n; i++) {
            double at[3];
            int64_t reached;
            const double moved =
                residual(&seen, i, (const Head*)stands, pieces, (const Piece*)line, radii, p, at, &reached);
            const double slope = (moved - residuals[i]) / steps[j];
            out[HEAD * i + j] = slope > STEEPEST ? STEEPEST : slope < -STEEPEST ? -STEEPEST : slope;  // NaN stays
        }
    }
}
