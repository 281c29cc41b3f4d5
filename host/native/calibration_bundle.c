// The loops over a bundle's observations: what an error is, how it moves with every unknown, the normal equations.
//
// An observation lies on a line of its image. Along that line the ring's image is sought, in pixels, by Newton's
// method: the angle about the cone's axis at which the wall's point seen there lies, less the cone's half-angle, is
// zero. Nothing is linearised about the place where the slit was seen. Ray and wall meet after Alzuhiri 2022, App. A.1,
// Eq. .8 and .9, in the pipe's own axes and with half of its b:
//     a s^2 + 2 b s + c = 0.                                                                                        (1)

#include "mathematics.h"

enum { ROWS = 17, MORE = 16, STEPS = 6 };
static const double STEP_MOST_PX = 20.0;   // of Newton's, each way
static const double SETTLED_PX = 1e-4;     // a step less than this is the last
static const double SLOPE_LEAST = 1e-9;    // rad a px: a flatter line has no place
static const double SINE_LEAST = 1e-9;     // of the angle to the axis: on it there is no direction
static const double SQUARE_LEAST = 1e-12;  // of the axis ahead

typedef struct {
    const double *cone, *pose, *turn, *correction;
    double radius, step_px;
    int64_t sectors;  // of the correction, 0 of none
} Unknowns;

// One ring's offset (rad) and shift (mm), (2, n), where the direction d runs from its vertex: see RingCorrection.
static void correction_at(const double* const correction, const int64_t n, const double dx, const double dy,
                          const double dz, const double ax, const double ay, const double az, double* const offset,
                          double* const shift)
{
    // along e1 = camera x less its part along the axis, and e2 = axis x e1; both of length sqrt(1 - ax^2)
    const double first = dx - ax * (dx * ax + dy * ay + dz * az);
    const double second = az * dy - ay * dz;
    const double turn = arc_tangent(second, first) / TURN;
    const double at = (turn - floor(turn)) * (double)n;
    const int64_t i = whole(at, 0, n - 1);
    const double part = at - (double)i;
    const int64_t j = (i + 1) % n;
    *offset = correction[i] + part * (correction[j] - correction[i]);
    *shift = correction[n + i] + part * (correction[n + j] - correction[n + i]);
}

// Angle about the cone's axis of the wall's point seen at `at`, less the cone's half-angle there, and its slope along
// the line; NaN where ray, wall and cone do not meet. In `more`, unless it is null, its gradient: axis x y, vertex x y
// z, rx, ry, tx, ty, radius, the camera's turn and its centre.
static double angle_off(const double* const rays, const double* const origins, const double at,
                        const Unknowns* const of, double* const slope, double* const more)
{
    const double step = of->step_px, part = at / step, radius = of->radius;
    const double c[3] = {0.5 * part * (part - 1.0), 1.0 - part * part,
                         0.5 * part * (part + 1.0)};                                     // Lagrange's parabola
    const double d[3] = {(part - 0.5) / step, -2.0 * part / step, (part + 0.5) / step};  // .. and its slope
    double w[3], u[3], o[3], v[3];
    for (int64_t k = 0; k < 3; k++) {
        w[k] = c[0] * rays[k] + c[1] * rays[3 + k] + c[2] * rays[6 + k];
        u[k] = d[0] * rays[k] + d[1] * rays[3 + k] + d[2] * rays[6 + k];
        o[k] = c[0] * origins[k] + c[1] * origins[3 + k] + c[2] * origins[6 + k];
        v[k] = d[0] * origins[k] + d[1] * origins[3 + k] + d[2] * origins[6 + k];
    }
    *slope = (double)NAN;
    // the wall: rows 0 and 1 of R^T are what counts across the pipe
    const double ca = of->turn[0], sa = of->turn[1], cb = of->turn[2], sb = of->turn[3];
    const double r00 = cb, r01 = sb * sa, r02 = -sb * ca, r11 = ca, r12 = sa;
    const double qx = o[0] - of->pose[2], qy = o[1] - of->pose[3];
    const double qu = r00 * qx + r01 * qy + r02 * o[2], qv = r11 * qy + r12 * o[2];
    const double wu = r00 * w[0] + r01 * w[1] + r02 * w[2], wv = r11 * w[1] + r12 * w[2];
    const double square = wu * wu + wv * wv, half = qu * wu + qv * wv, rest = qu * qu + qv * qv - radius * radius;
    const double under = half * half - square * rest;  // Eq. 1
    if (!(under > 0.0) || !(square > 0.0)) {
        return (double)NAN;
    }
    const double s = (sqrt(under) - half) / square;
    if (!(s > 0.0)) {
        return (double)NAN;
    }
    const double x = o[0] + s * w[0], y = o[1] + s * w[1], z = o[2] + s * w[2];
    const double cu = (qu + s * wu) / radius, cv = (qv + s * wv) / radius;
    const double nx = r00 * cu, ny = r01 * cu + r11 * cv, nz = r02 * cu + r12 * cv;  // outwards, across the wall
    const double against = nx * w[0] + ny * w[1] + nz * w[2];
    // the cone
    const double ax = of->cone[1], ay = of->cone[2], ahead = 1.0 - ax * ax - ay * ay;
    const double az = sqrt(ahead > SQUARE_LEAST ? ahead : SQUARE_LEAST);
    double dx = x - of->cone[3], dy = y - of->cone[4], dz = z - of->cone[5];
    const double far = sqrt(dx * dx + dy * dy + dz * dz);
    dx /= far;
    dy /= far;
    dz /= far;
    const double cosine = dx * ax + dy * ay + dz * az;
    const double mx = dy * az - dz * ay, my = dz * ax - dx * az, mz = dx * ay - dy * ax;
    const double sine = sqrt(mx * mx + my * my + mz * mz);
    if (!(sine > SINE_LEAST)) {
        return (double)NAN;
    }
    double value;
    if (of->sectors > 0) {
        double offset, shift;
        correction_at(of->correction, of->sectors, dx, dy, dz, ax, ay, az, &offset, &shift);
        value = arc_tangent(sine * far, cosine * far - shift) - of->cone[0] - offset;
    } else {
        value = arc_tangent(sine, cosine) - of->cone[0];
    }
    // how the angle turns when the wall's point moves
    const double by = far * sine;
    const double gx = (cosine * dx - ax) / by, gy = (cosine * dy - ay) / by, gz = (cosine * dz - az) / by;
    const double along = gx * w[0] + gy * w[1] + gz * w[2];
    // how the point moves with the place on the line: its ray turns, and it stays on the wall
    const double px = v[0] + s * u[0], py = v[1] + s * u[1], pz = v[2] + s * u[2];
    const double slide = -(nx * px + ny * py + nz * pz) / against;
    *slope = gx * px + gy * py + gz * pz + along * slide;
    if (more) {
        const double tx = x - of->pose[2], ty = y - of->pose[3];
        const double turned = sa * ty - ca * z, straight = ca * ty + sa * z;
        const double push = along / against;  // mm across the wall -> angle
        // the ray moves with its camera, and its point stays on the wall
        const double hx = gx - push * nx, hy = gy - push * ny, hz = gz - push * nz;
        more[0] = -(dx - dz * ax / az) / sine;
        more[1] = -(dy - dz * ay / az) / sine;
        more[2] = -gx;
        more[3] = -gy;
        more[4] = -gz;
        more[5] = -push * (cu * sb * straight + cv * (ca * z - sa * ty));
        more[6] = -push * (cu * (cb * turned - sb * tx));
        more[7] = push * nx;
        more[8] = push * ny;
        more[9] = push;
        more[10] = s * (w[1] * hz - w[2] * hy);
        more[11] = s * (w[2] * hx - w[0] * hz);
        more[12] = s * (w[0] * hy - w[1] * hx);
        more[13] = hx;
        more[14] = hy;
        more[15] = hz;
    }
    return value;
}

// Of observations (n,), their rays and where those start (n, 3, 3): `places`, where the ring's image crosses the line,
// kept from call to call; `middles`, how far beyond its slit's middle that is, found again where `width` is given;
// `error`, px, NaN where nothing meets; `rows` (n, l), how the place moves with half-angle, axis x y, vertex x y z, rx,
// ry, tx, ty, radius, the camera's turn about its centre and its centre; columns beyond those are left alone. step_px:
// between the rays of a line; probe_px: step of the differences for a slit's middle; reach_px: a ring is no farther
// off.
DOOR void bundle_errors(const int64_t* const frame, const int64_t* const ring, const double* const rays,
                        const double* const origins, const double* const width, const double* const cones,
                        const double* const poses, const double* const turns, const double radius,
                        const double* const correction, const double step_px, const double probe_px,
                        const double reach_px, double* const places, double* const middles, double* const error,
                        double* const rows, const int64_t n, const int64_t k, const int64_t f, const int64_t s,
                        const int64_t l)
{
    if (k < 1 || f < 1 || l < ROWS) {
        return;
    }
    for (int64_t i = 0; i < n; i++) {
        const int64_t own = most(0, least(ring[i], k - 1)), at_frame = most(0, least(frame[i], f - 1));
        const Unknowns of = {
            cones + 6 * own, poses + 4 * at_frame, turns + 4 * at_frame, correction + 2 * s * own, radius, step_px, s};
        const double *const lines = rays + 9 * i, *const starts = origins + 9 * i;
        double at = places[i], slope, more[MORE];  // px from the slit, outwards positive
        bool good = true;
        for (int64_t turn = 0; turn < STEPS; turn++) {
            const double value = angle_off(lines, starts, at, &of, &slope, NULL);
            if (!(fabs(slope) > SLOPE_LEAST)) {
                good = false;
                break;
            }
            const double step = value / slope;
            at -= held(step, -STEP_MOST_PX, STEP_MOST_PX);
            if (fabs(at) > reach_px || fabs(step) < SETTLED_PX) {
                break;
            }
        }
        if (!good || !(fabs(at) < reach_px)) {
            error[i] = (double)NAN;
            places[i] = 0.0;
            continue;
        }
        places[i] = at;
        if (width) {
            middles[i] = 0.0;
            if (width[i] > 0.0) {
                // the cone lies at the middle of the edges' angles, not of their pixels (see triangulate.ring_optics)
                double before, after;
                const double low = angle_off(lines, starts, at - probe_px, &of, &before, NULL);
                const double high = angle_off(lines, starts, at + probe_px, &of, &after, NULL);
                middles[i] = (after - before) / (high - low) * width[i] * width[i] / 8.0;
            }
        }
        angle_off(lines, starts, at, &of, &slope, more);
        error[i] = middles[i] - at;
        if (!(fabs(error[i]) < reach_px)) {
            error[i] = (double)NAN;
            continue;
        }
        rows[i * l] = 1.0 / slope;
        for (int64_t a = 0; a < MORE; a++) {
            rows[i * l + 1 + a] = -more[a] / slope;
        }
    }
}

// Adds every observation to the block of its camera (c), ring (k) and frame (f): the upper half of rows^T w rows (l,
// l), and rows^T w error (l,).
DOOR void gather_blocks(const int64_t* const frame, const int64_t* const ring, const int64_t* const camera,
                        const double* const weight, const double* const error, const double* const rows,
                        double* const blocks, double* const right, const int64_t n, const int64_t l, const int64_t c,
                        const int64_t k, const int64_t f)
{
    if (c < 1 || k < 1 || f < 1) {
        return;
    }
    for (int64_t i = 0; i < n; i++) {
        if (weight[i] == 0.0) {
            continue;
        }
        const int64_t of_camera = most(0, least(camera[i], c - 1)), of_ring = most(0, least(ring[i], k - 1));
        const int64_t own = (of_camera * k + of_ring) * f + most(0, least(frame[i], f - 1));
        const double* const row = rows + i * l;
        double *const block = blocks + own * l * l, *const vector = right + own * l;
        for (int64_t a = 0; a < l; a++) {
            const double scaled = weight[i] * row[a];
            if (scaled == 0.0) {
                continue;
            }
            vector[a] += scaled * error[i];
            for (int64_t b = a; b < l; b++) {
                block[a * l + b] += scaled * row[b];
            }
        }
    }
}

// Adds to each sector's row of `shared` (s, 7 + 4 F) its angle against its ring, all poses and the radius.
DOOR void gather_sectors(const int64_t* const frame, const int64_t* const sector, const double* const weight,
                         const double* const rows, double* const shared, const int64_t n, const int64_t l,
                         const int64_t s, const int64_t w)
{
    if (l < 11 || s < 1 || w < 11) {
        return;
    }
    for (int64_t i = 0; i < n; i++) {
        const double* const row = rows + i * l;
        const double by = weight[i] * row[0];
        if (by == 0.0) {
            continue;
        }
        double* const out = shared + most(0, least(sector[i], s - 1)) * w;
        for (int64_t a = 0; a < 6; a++) {
            out[a] += by * row[a];
        }
        double* const pose = out + 6 + 4 * most(0, least(frame[i], (w - 7) / 4 - 1));
        for (int64_t a = 0; a < 4; a++) {
            pose[a] += by * row[6 + a];
        }
        out[w - 1] += by * row[10];
    }
}

// What several cameras and their colours add: of the rows (n, l) no camera's for the first, from which all is measured,
// and of the others the turn as their rotation vector's, by turns (c, 3, 3); colours' shifts (t,) px, l = 17 + t.
DOOR void head_rows(const int64_t* const camera, const double* const turns, const double* const tint,
                    const double* const shift, double* const error, double* const rows, const int64_t n,
                    const int64_t c, const int64_t t, const int64_t l)
{
    if (c < 1 || l < ROWS + t) {
        return;
    }
    for (int64_t i = 0; i < n; i++) {
        double* const turned = rows + i * l + 11;
        if (camera[i] == 0) {
            for (int64_t a = 0; a < 6; a++) {
                turned[a] = 0.0;
            }
        } else {
            const double* const by = turns + 9 * most(0, least(camera[i], c - 1));
            const double x = turned[0], y = turned[1], z = turned[2];
            for (int64_t a = 0; a < 3; a++) {
                turned[a] = x * by[a] + y * by[3 + a] + z * by[6 + a];
            }
        }
        for (int64_t a = 0; a < t; a++) {
            turned[6 + a] = tint[i * t + a];
            error[i] -= tint[i * t + a] * shift[a];
        }
    }
}
