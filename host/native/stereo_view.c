// One camera of a head with several: where it would see each ring on a clean pipe, its slits against that, and how far
// each one's place may be off. Rings are numbered k, a camera's lines j, steps round a cone p, slits n.

#include "selection.h"
#include "stereo_lens.h"

#define FARTHER 0.02  // of the distance: step of the finite differences along a generator
#define EVERY 12      // of so many generators places are worked out on one ..
#define NODES 40      // .. but on so many of a cone at least
#define NODE 6        // numbers: line and sample; both by a mm; both by a radian of the half-angle

// A stripe at twice full scale moves a slit by up to 0.2 px, evenly. One camera's rings tell by how much, lying apart
// (rings.uncertainty); where cones graze, nothing does.
#define OVER_EXPOSED 235.0  // grey levels: a stripe so bright may have been brighter
#define CLIPPED_PX 0.12     // and its slit's place is off by so much
#define LAG 4               // lines; these three as rings.uncertainty
#define LEARNT_FROM 40      // values a ring's scatter is learnt from
#define UNKNOWN_PX 0.1      // its scatter with fewer
#define BLUR_LEAST 0.5      // of the ring's usual edge, what a sharper edge counts for at least ..
#define BLUR_MOST 4.0       // .. and a softer one at most

typedef struct {
    const double *lens, *cone, *rotation, *shift;  // cone: vertex, axis, half-angle
    double cosine, sine;                           // of the half-angle
    double lines;
} Cast;

typedef struct {
    double u, v;  // along the pipe's x and y
} Across;

INLINE Across across(const double* const rotation, const double x, const double y, const double z)
{
    return (Across){x * rotation[0] + y * rotation[3] + z * rotation[6],
                    x * rotation[1] + y * rotation[4] + z * rotation[7]};
}

// A difference of lines, the short way round.
INLINE double short_way(const double lines, const double all)
{
    return lines - all * floor(lines / all + 0.5);
}

// How line and sample change from out[0..1] to those of a point, which is `by` away.
INLINE void moved(const Cast* const cast, const double x, const double y, const double z, const double by,
                  const double* const from, double* const out)
{
    const Seen seen = on_line(cast->lens, x, y, z);
    out[0] = short_way(seen.line - from[0], cast->lines) / by;
    out[1] = (seen.place - from[1]) / by;
}

// Of a generator that meets the wall `near` mm from the vertex: line and sample, how both change with a mm, and how
// with a radian of the half-angle where the wall stays.
static void node_of(const Cast* const cast, const double* const way, const double near, double* const out)
{
    const double *const cone = cast->cone, *const shift = cast->shift;
    const double x = cone[0] + near * way[0], y = cone[1] + near * way[1], z = cone[2] + near * way[2];
    const double step = FARTHER * near;
    const Seen seen = on_line(cast->lens, x, y, z);
    out[0] = seen.line;
    out[1] = seen.place;
    moved(cast, x + step * way[0], y + step * way[1], z + step * way[2], step, out, out + 2);
    // how the way turns
    const double a = cast->cosine * way[0] - cone[3], b = cast->cosine * way[1] - cone[4];
    const double c = cast->cosine * way[2] - cone[5];
    const Across at = across(cast->rotation, x - shift[0], y - shift[1], z - shift[2]);
    const Across along = across(cast->rotation, way[0], way[1], way[2]), turn = across(cast->rotation, a, b, c);
    const double back = (at.u * turn.u + at.v * turn.v) / (at.u * along.u + at.v * along.v);
    const double by = step / cast->sine;
    moved(cast, x + by * (a - back * way[0]), y + by * (b - back * way[1]), z + by * (c - back * way[2]), FARTHER, out,
          out + 4);
}

// From what neighbouring generators show, what the lines between them do: course, and its changes with a radius and a
// radian.
INLINE void fill_lines(const double* const by_generator, const double* const by_radius, const double* const turn,
                       double* const by_line, const int64_t plane, const int64_t p, const int64_t rings,
                       const int64_t j)
{
    const double lines = (double)j;
    for (int64_t s = 0; s < p; s++) {
        const int64_t q = s + 1 < p ? s + 1 : 0;
        const double a = by_generator[s], b = by_generator[q];
        const double span = short_way(b - a, lines);
        if (!(fabs(span) > 0.0)) {
            continue;
        }
        const double *const place = by_generator + plane, *const line_by = by_generator + 2 * plane;
        const double* const place_by = by_generator + 3 * plane;
        const double slope = (place[q] - place[s]) / span;
        const double own_s = (place_by[s] - slope * line_by[s]) / by_radius[s];
        const double own_q = (place_by[q] - slope * line_by[q]) / by_radius[q];
        const double turn_s = turn[2 * s + 1] - slope * turn[2 * s], turn_q = turn[2 * q + 1] - slope * turn[2 * q];
        const int64_t low = whole(ceil(span > 0.0 ? a : a + span), -j, 2 * j - 1);
        const int64_t high = whole(floor(span > 0.0 ? a + span : a), -j, 2 * j - 1);
        for (int64_t line = low; line <= high; line++) {
            const double part = ((double)line - a) / span;
            double* const out = by_line + around(line, j);
            out[0] = place[s] + part * (place[q] - place[s]);
            out[rings * j] = own_s + part * (own_q - own_s);
            out[2 * rings * j] = turn_s + part * (turn_q - turn_s);
        }
    }
}

// Line, sample and their changes with a mm, by_generator (4, k, p); course, change with a radius and with a radian of
// the half-angle, by_line (3, k, j), NaN beforehand.
//
// They change slowly round a cone and are worked out on some generators; cubics lead to those between (6 degrees apart,
// within 2e-3 px), but for where the cone meets no wall. work: 6 numbers of every node, three for each step.
DOOR void stereo_expect(const double* const lens, const double* const cones, const double* const ways,
                        const double* const start, const double* const rotation, const double* const shift,
                        double* const by_generator, double* const by_line, double* const work, const int64_t k,
                        const int64_t p, const int64_t j, const int64_t w)
{
    int64_t every = EVERY;
    while (every > 1 && (p % every != 0 || p < every * NODES)) {
        every /= 2;
    }
    const int64_t nodes = p / every, plane = k * p;
    if (p < 1 || j < 1 || w < NODE * (nodes + 3) + 3 * p) {
        return;
    }
    double *const node = work, *const by_radius = work + NODE * (nodes + 3), *const turn = by_radius + p;
    double cubic[EVERY][4];
    for (int64_t q = 0; q < every; q++) {
        const double t = (double)q / (double)every;
        cubic[q][0] = -t * (t - 1.0) * (t - 2.0) / 6.0;
        cubic[q][1] = (t * t - 1.0) * (t - 2.0) / 2.0;
        cubic[q][2] = -t * (t + 1.0) * (t - 2.0) / 2.0;
        cubic[q][3] = t * (t * t - 1.0) / 6.0;
    }
    for (int64_t ring = 0; ring < k; ring++) {
        const double* const cone = cones + 7 * ring;
        Cast cast = {.lens = lens, .cone = cone, .rotation = rotation, .shift = shift, .lines = (double)j};
        cosine_sine(cone[6], &cast.cosine, &cast.sine);
        for (int64_t m = 0; m < nodes; m++) {
            const int64_t at = ring * p + m * every;
            node_of(&cast, ways + 3 * at, start[at], node + NODE * (m + 1));
        }
        // the last, all, and the first two once more
        memcpy(node, node + NODE * nodes, NODE * sizeof node[0]);
        memcpy(node + NODE * (nodes + 1), node + NODE, NODE * sizeof node[0]);
        memcpy(node + NODE * (nodes + 2), node + 2 * NODE, NODE * sizeof node[0]);
        for (int64_t m = 1; m < nodes + 3; m++) {  // lines begin anew after the last: between nodes they must not
            const double before = node[NODE * (m - 1)],
                         nearest = before + short_way(node[NODE * m] - before, cast.lines);
            node[NODE * m] = before == before ? nearest : node[NODE * m];
        }
        for (int64_t s = 0; s < p; s++) {
            const int64_t at = ring * p + s;
            const double *const n = node + NODE * (s / every), *const c = cubic[s % every];
            const double near = start[at];
            double own[NODE];
            for (int i = 0; i < NODE; i++) {
                own[i] = c[0] * n[i] + c[1] * n[NODE + i] + c[2] * n[2 * NODE + i] + c[3] * n[3 * NODE + i];
            }
            if (own[3] != own[3] || near != near) {
                node_of(&cast, ways + 3 * at, near, own);
            }
            own[0] -= cast.lines * floor(own[0] / cast.lines);
            for (int i = 0; i < 4; i++) {
                by_generator[i * plane + at] = own[i];
            }
            turn[2 * s] = own[4];
            turn[2 * s + 1] = own[5];
            // how fast the step leads away from the axis, radii a mm
            const double* const way = ways + 3 * at;
            const Across place = across(rotation, cone[0] + near * way[0] - shift[0],
                                        cone[1] + near * way[1] - shift[1], cone[2] + near * way[2] - shift[2]);
            const Across along = across(rotation, way[0], way[1], way[2]);
            by_radius[s] = (place.u * along.u + place.v * along.v) / (place.u * place.u + place.v * place.v);
        }
        fill_lines(by_generator + ring * p, by_radius, turn, by_line + ring * j, plane, p, k, j);
    }
}

// px of each slit beyond where each ring should be, off (n, k); and against how far a wall of a radius more or less, or
// the nearer neighbour's place, is from there, NaN where it cannot be that ring.
DOOR void stereo_off(const int64_t* const direction, const double* const position, const bool* const could_be,
                     const double* const course, const double* const by_radius, const double spacing, double* const off,
                     double* const deviation, const int64_t n, const int64_t k, const int64_t j)
{
    for (int64_t s = 0; s < n; s++) {
        const double* const here = course + bounded(direction[s], 0, j - 1);
        for (int64_t r = 0; r < k; r++) {
            const double place = here[r * j];
            const int64_t at = s * k + r;
            off[at] = position[s] - place;
            deviation[at] = NOTHING;
            if (could_be[at]) {
                const double before = r > 0 ? fabs(place - here[(r - 1) * j]) : NOTHING;
                const double after = r + 1 < k ? fabs(here[(r + 1) * j] - place) : NOTHING;
                double gap = before == before ? before : after;
                gap = after < gap ? after : gap;
                gap = gap == gap ? gap : spacing;
                const double by = (by_radius + (here - course))[r * j];
                deviation[at] = off[at] / sqrt(by * by + gap * gap);
            }
        }
    }
}

// Turns widths (n,) into what they would be where a ring's slit were equally wide all round.
DOOR void stereo_as_usual(const int64_t* const ring, const int64_t* const direction, const double* const by_angle,
                          double* const mean, double* const width, const int64_t n, const int64_t k, const int64_t j)
{
    for (int64_t r = 0; r < k; r++) {
        double sum = 0.0;
        int64_t count = 0;
        for (int64_t line = 0; line < j; line++) {
            const double by = by_angle[r * j + line];
            sum += by == by ? by : 0.0;
            count += by == by;
        }
        mean[r] = sum / (double)most(count, 1);
    }
    for (int64_t s = 0; s < n; s++) {
        const int64_t r = ring[s];
        if (r >= 0 && r < k) {
            const double by = by_angle[r * j + bounded(direction[s], 0, j - 1)];
            if (by > 0.0) {
                width[s] *= mean[r] / by;
            }
        }
    }
}

// Slits (k, j), -1 beforehand, and their places, NaN beforehand, moved to the middle of the angles, less what colours
// draw them.
DOOR void stereo_table(const int64_t* const ring, const int64_t* const direction, const double* const position,
                       const double* const width, const double widest, const double* const bend,
                       const double* const offset, double* const place, int64_t* const which, const int64_t n,
                       const int64_t k, const int64_t j)
{
    for (int64_t s = 0; s < n; s++) {
        if (ring[s] >= 0 && ring[s] < k) {
            const int64_t at = ring[s] * j + bounded(direction[s], 0, j - 1);
            const double wide = width[s] < widest ? width[s] : widest;
            which[at] = s;
            place[at] = position[s] + bend[at] * wide * wide / 8.0 - offset[at];
        }
    }
}

// How far each slit's place may be off, px, sigma (k, j), and of that what the edge of a wall may; both are left as
// they are where there is no slit. rings.uncertainty has the terms. least_px: what
// neighbours may be off alike. work: three of every line.
DOOR void stereo_spread(const int64_t* const which, const double* const stray, const double* const edge_blur,
                        const double* const inside, const double* const outside, const double* const wider,
                        const double least_px, const double sigma_of_mad, double* const work, double* const sigma,
                        double* const edge, const int64_t k, const int64_t j, const int64_t n, const int64_t w)
{
    if (w < 3 * j) {
        return;
    }
    const int64_t lag = least(LAG, j / 3);
    double* const round = work + j;  // a row, and its beginning once more
    const double clipped = CLIPPED_PX > least_px ? CLIPPED_PX : least_px;
    for (int64_t r = 0; r < k; r++) {
        const double* const own = stray + r * j;
        const int64_t* const slits = which + r * j;
        int64_t size = 0;
        const double *const one = round, *const two = round + lag, *const three = two + lag, *const four = three + lag;
        memcpy(round, own, (size_t)j * sizeof own[0]);
        memcpy(round + j, own, (size_t)(3 * lag) * sizeof own[0]);
        for (int64_t line = 0; line < j; line++) {
            const double third = (four[line] - one[line]) - 3.0 * (three[line] - two[line]);
            work[size] = fabs(third);
            size += third == third;
        }
        // sizes of a third difference's terms: 1, 3, 3, 1, root of the sum of squares 20
        const double scatter = size >= LEARNT_FROM ? sigma_of_mad / sqrt(20.0) * middle(work, size) : UNKNOWN_PX;
        size = 0;
        for (int64_t line = 0; line < j; line++) {
            const int64_t s = slits[line];
            if (s >= 0 && s < n) {
                work[size++] = edge_blur[s];
            }
        }
        const double middle_blur = middle(work, size), usual = middle_blur > 1e-9 ? middle_blur : 1e-9;
        for (int64_t line = 0; line < j; line++) {
            const int64_t s = slits[line];
            if (s < 0 || s >= n) {
                continue;
            }
            const double soft = scatter * held(edge_blur[s] / usual, BLUR_LEAST, BLUR_MOST);
            double bright = 0.0;
            for (int64_t c = 3 * s; c < 3 * s + 3; c++) {
                bright = inside[c] > bright ? inside[c] : bright;
                bright = outside[c] > bright ? outside[c] : bright;
            }
            const double bias = bright > OVER_EXPOSED ? clipped : least_px;
            const double beyond = 0.25 * wider[s] * wider[s] - 4.0 * soft * soft;
            const double foreign = beyond > 0.0 ? beyond / 3.0 : 0.0;
            edge[r * j + line] = sqrt(foreign);
            sigma[r * j + line] = sqrt(soft * soft + bias * bias + foreign);
        }
    }
}
