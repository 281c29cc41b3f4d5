// The wall's distance along every generator, from what several cameras saw of its ring: annulus_pipe.stereo.merge has
// the method. Weighted squares of what is left, in pixels, are least where
//
//     s = s + sum_c w_c (seen_c - expected_c) / g_c / sum_c w_c,    w_c = (g_c / sigma_c)^2,
//
// g_c = d(sample)/ds - d(sample)/d(line) d(line)/ds: how many pixels a mm of the wall moves the ring's image across its
// own course. It is nought where a ray is tangent to the cone, and so is that camera's weight. Cameras are numbered c,
// rings k, steps round a cone p, a camera's lines j.

#include "stereo_lens.h"

// By topic stereo of the metrology table: errors against truth, share inside k = 2, at the tangents as elsewhere.
#define JUMP_PX 3.0        // between two neighbouring lines: more is an edge of the wall, nothing is read between them
#define SLOPE_LINES 3      // to each side, over which the course of what was seen is read
#define CLOSE_MM 0.2       // of the wall: a step so small is the last, what it bends by is its square over the distance
#define ROUNDS 6           // steps at most
#define NEARER 0.5         // of the distance to a clean pipe: no wall is looked for nearer ..
#define FARTHER 2.0        // .. or farther
#define CONTRADICTS 6.0    // sigma apart: two cameras do not see the same wall ..
#define LEAST_PX 0.04      // .. a sigma being at least so much
#define ACROSS 0.25        // of what is not known: where an edge leaves so much open of a slit's middle, none is known
#define SHARE 0.03         // of the weight: a camera with less is none that a point was made from
#define BOTH 0.1           // of the weight: two cameras that both have so much say by lying apart what sigmas are worth
#define NOISY 0.12         // of what is not known: a direction that says less is known together with its neighbours, ..
#define BESIDE_DEG 2.5     // .. so far to each side, ..
#define SLOPE_MM_DEG 0.2   // .. as a wall that goes out or in by so much a degree, ..
#define ALIKE 3.0          // .. so many saying as much as one (pixels lie in rows), or less, by what they leave of it
#define GATED_WEIGHT 1e-6  // of all that the source's gate lets through, so that they count alike

enum { KNOWN, UNSEEN, CONTRADICTED, BLUNT, EDGE };  // stereo.merge has the same; test_merge_in_c.py compares them

typedef struct {
    double left, gain, off, at;  // px from where it should be, px a mm, sigma px, line
} One;

typedef struct {
    double weight, towards, square, by_px;  // of how far a clean wall is off: weight, and its pulls
} Clean;

typedef struct {
    const double *vertex, *ways, *lenses, *expected, *course, *stray, *sigma_px, *edge_px, *bias_px;
    const bool* usable;
    int64_t cameras, rings, steps, lines;
} Sights;

typedef struct {
    double value, slope, spread;  // sample, samples a line, px; NaN where nothing was seen
} Look;

// Where a ring was seen on a line between lines, how that changes from line to line, and its sigma.
static Look look(const double* const stray, const double* const sigma_px, const double* const course, const double line,
                 const int64_t lines)
{
    const Look nothing = {NOTHING, NOTHING, NOTHING};
    if (line != line) {
        return nothing;
    }
    const int64_t at = whole(line, 0, lines), a = around(at, lines), b = around(at + 1, lines);
    const double part = line - (double)at, here = stray[a], there = stray[b];
    const bool is_here = here == here, is_there = there == there;
    Look out;
    if (is_here && is_there) {
        if (fabs(there - here) > JUMP_PX) {
            return nothing;
        }
        out.value = here + part * (there - here);
        out.spread = sigma_px[a] + part * (sigma_px[b] - sigma_px[a]);
    } else if (part <= 0.5 ? is_here : is_there) {
        out.value = part <= 0.5 ? here : there;
        out.spread = part <= 0.5 ? sigma_px[a] : sigma_px[b];
    } else {
        return nothing;
    }
    out.slope = course[b] - course[a];
    out.value += course[a] + part * out.slope;
    const double beyond = stray[around(b + SLOPE_LINES, lines)] - stray[around(a - SLOPE_LINES, lines)];
    const double change = beyond / (2 * SLOPE_LINES + 1);
    if (fabs(change) < JUMP_PX / 2) {
        out.slope += change;
    }
    return out;
}

// A direction that says too little by itself: as far from a clean wall as its neighbours are together, by a straight
// line through them. False where those say too little, too. shift (c, 2): pulls if all of a camera's places are off by
// a pixel.
static bool among_neighbours(const Sights* const sights, const Clean* const clean, double* const shift, const int64_t p,
                             const double most, double* const beyond, double* const sigma, int64_t* const camera)
{
    const int64_t cameras = sights->cameras, steps = sights->steps;
    const double degrees = (double)steps / 360.0, slope_known = degrees / SLOPE_MM_DEG;
    const int64_t beside = bounded((int64_t)(BESIDE_DEG * degrees + 0.5), 1, steps);
    double total = 0.0, by_turn = 0.0, by_square = slope_known * slope_known, pull = 0.0, pull_turn = 0.0;
    double square = 0.0, best = 0.0;
    int64_t count = 0, first = 0;
    for (int64_t c = 0; c < cameras; c++) {
        double own = 0.0;
        shift[2 * c] = shift[2 * c + 1] = 0.0;
        for (int64_t d = -beside; d <= beside; d++) {
            const Clean one = clean[around(p + d, steps) * cameras + c];
            if (one.square > 0.0) {
                const double turn = (double)d;
                own += one.weight;
                by_turn += one.weight * turn;
                by_square += one.weight * turn * turn;
                pull += one.towards;
                pull_turn += one.towards * turn;
                square += one.square;
                shift[2 * c] += one.by_px;
                shift[2 * c + 1] += one.by_px * turn;
                count++;
            }
        }
        total += own;
        if (own > best) {
            best = own;
            first = c;
        }
    }
    if (count <= beside || !(total > 0.0)) {
        return false;
    }
    const double lean = by_turn / by_square, known = total - by_turn * lean;
    const double off = (pull - pull_turn * lean) / known, slope = (pull_turn - by_turn * off) / by_square;
    const double unlike = (square - pull * off - pull_turn * slope) / (double)count;
    double variance = ALIKE * (unlike > 1.0 ? unlike : 1.0) / known;
    for (int64_t c = 0; c < cameras; c++) {
        const double alike = sights->bias_px[c] * (shift[2 * c] - shift[2 * c + 1] * lean) / known;
        variance += alike * alike;
    }
    if (!(variance <= most * most)) {
        return false;
    }
    *beyond = off;
    *sigma = sqrt(variance);
    *camera = total - best < SHARE * total ? first : cameras;
    return true;
}

// What every camera saw of the wall `s` mm along generator p of ring k; `first`: a clean pipe's. Sums of weights and of
// pulls.
INLINE double ask(const Sights* const sights, const int64_t k, const int64_t p, const double s, const bool first,
                  One* const ones, Clean* const clean, double* const pulls)
{
    const int64_t plane = sights->rings * sights->steps, at = k * sights->steps + p;
    double pull = 0.0, total = 0.0;
    for (int64_t c = 0; c < sights->cameras; c++) {
        One* const one = ones + c;
        one->left = one->gain = one->off = NOTHING;
        if (sights->usable && !sights->usable[c * plane + at]) {
            continue;
        }
        const double *const expected = sights->expected + 4 * c * plane + at, *const way = sights->ways + 3 * at;
        const double* const vertex = sights->vertex;
        const Seen seen = first ? (Seen){expected[0], expected[plane]}
                                : on_line(sights->lenses + c * LENS_NUMBERS, vertex[0] + s * way[0],
                                          vertex[1] + s * way[1], vertex[2] + s * way[2]);
        one->at = seen.line;
        const int64_t row = (c * sights->rings + k) * sights->lines;
        const Look found =
            look(sights->stray + row, sights->sigma_px + row, sights->course + row, seen.line, sights->lines);
        if (found.value != found.value) {
            continue;
        }
        const double gain = expected[3 * plane] - found.slope * expected[2 * plane], left = found.value - seen.place;
        const double square = found.spread * found.spread;
        one->left = left;
        one->gain = gain;
        one->off = found.spread;
        double weight = gain * gain / square;
        if (sights->usable) {  // the source's: each camera's own answer, and their mean
            weight = gain * gain * GATED_WEIGHT;
            pull += left / gain;
            total += 1.0;
        } else {
            pull += gain != 0.0 ? weight * left / gain : 0.0;
            total += weight;
        }
        if (first) {
            clean[c] = (Clean){weight, gain * left / square, left * left / square, gain / square};
        }
    }
    *pulls = pull;
    return total;
}

typedef struct {
    double distance, sigma, apart;
    int64_t camera, heaviest, line, state;
} Solved;

// What the cameras together say of the wall at `s`, from what each has left.
static Solved decide(const Sights* const sights, const int64_t k, const double s, const double most,
                     const One* const ones)
{
    const bool gated = sights->usable != NULL;
    double square = 0.0, wrong = 0.0, weights = 0.0, best = -1.0, own = 0.0, shared = 0.0;
    int64_t seen = 0, used = 0;
    Solved out = {.distance = NOTHING, .sigma = NOTHING, .apart = NOTHING, .state = UNSEEN};
    for (int64_t c = 0; c < sights->cameras; c++) {
        const One one = ones[c];
        if (one.left == one.left) {
            const double weight = (one.gain / one.off) * (one.gain / one.off);
            const int64_t line = around(whole(one.at + 0.5, 0, sights->lines), sights->lines);
            const double on_edge = sights->edge_px[(c * sights->rings + k) * sights->lines + line];
            const double edge = on_edge < one.off ? on_edge : one.off, part = edge / one.off;
            const double sigmas = one.left / one.off, least = one.left / (one.off > LEAST_PX ? one.off : LEAST_PX);
            own += weight * (1.0 - part * part);
            shared += fabs(one.gain) * edge / (one.off * one.off);
            square += sigmas * sigmas;
            wrong += least * least;
            weights += weight;
            seen++;
            if (weight > best) {
                best = weight;
                out.heaviest = c;
            }
        }
    }
    if (seen == 0 || !(weights > 0.0)) {
        return out;
    }
    out.line = whole(ones[out.heaviest].at + 0.5, 0, sights->lines);
    if (!gated) {
        const double enough = NOISY * most;
        out.state = shared > ACROSS * most * weights                                     ? EDGE
                    : !(weights * (enough * enough) >= 1.0)                              ? BLUNT
                    : seen > 1 && wrong > CONTRADICTS * CONTRADICTS * (double)(seen - 1) ? CONTRADICTED
                                                                                         : KNOWN;
        if (out.state != KNOWN) {
            return out;
        }
    }
    for (int64_t c = 0; c < sights->cameras; c++) {
        const double sharp = ones[c].gain / ones[c].off;
        used += ones[c].left == ones[c].left && sharp * sharp > SHARE * weights;
    }
    out.state = KNOWN;
    out.distance = s;
    out.sigma = sqrt(own + shared * shared) / weights;
    out.camera = used == 1 ? out.heaviest : sights->cameras;
    out.apart = seen == 2 && best < (1.0 - BOTH) * weights ? square : NOTHING;
    return out;
}

// One generator: steps of Gauss and Newton from a clean pipe's distance, then what the cameras together say.
static Solved solve(const Sights* const sights, const int64_t k, const int64_t p, const double start, const double most,
                    One* const ones, Clean* const clean)
{
    const bool gated = sights->usable != NULL;
    const double enough = NOISY * most;
    double s = start, total = 0.0;
    for (int64_t c = 0; c < sights->cameras; c++) {
        clean[c] = (Clean){0};
    }
    if (s == s) {
        for (int turn = 0; turn < ROUNDS; turn++) {
            double pull;
            total = ask(sights, k, p, s, turn == 0, ones, clean, &pull);
            if (!(total > 0.0) || pull != pull) {
                total = 0.0;
                break;
            }
            if (!(total * (enough * enough) >= 1.0 || gated)) {
                break;
            }
            const double step = held(pull / total, (NEARER - 1.0) * start, (FARTHER - 1.0) * start);
            s = held(s + step, NEARER * start, FARTHER * start);
            if (fabs(step) < CLOSE_MM) {
                for (int64_t c = 0; c < sights->cameras; c++) {
                    ones[c].left -= ones[c].gain * step;
                }
                break;
            }
        }
    }
    if (!(total > 0.0)) {
        return (Solved){.distance = NOTHING, .sigma = NOTHING, .apart = NOTHING, .state = UNSEEN};
    }
    const Solved out = decide(sights, k, s, most, ones);
    for (int64_t c = 0; c < sights->cameras && out.state == EDGE; c++) {
        clean[c] = (Clean){0};  // it would put its neighbours off, too
    }
    return out;
}

// Distance, sigma, camera, heaviest, line, state and apart of every generator: the fields of `Merged`. usable: where
// each camera is asked, and all count alike; none, everywhere, by what each says. expected (c, 4, k, p): line and
// sample of a clean pipe, and what both change by in a mm. work: 4 (p + 1) + 2 numbers for each camera.
DOOR void stereo_merge(const double* const vertices, const double* const ways, const double* const start,
                       const double* const limit, const double* const lenses, const double* const expected,
                       const double* const course, const double* const stray, const double* const sigma_px,
                       const double* const edge_px, const double* const bias_px, const bool* const usable,
                       double* const work, double* const distance, double* const sigma, int64_t* const camera,
                       int64_t* const heaviest, int64_t* const line, int64_t* const state, double* const apart,
                       const int64_t k, const int64_t p, const int64_t c, const int64_t j, const int64_t w)
{
    if (w < c * (4 * (p + 1) + 2)) {
        return;
    }
    Clean* const clean = (Clean*)work;
    One* const ones = (One*)(clean + p * c);
    double* const shift = (double*)(ones + c);
    Sights sights = {.ways = ways, .lenses = lenses, .expected = expected, .course = course, .stray = stray};
    sights.sigma_px = sigma_px;
    sights.edge_px = edge_px;
    sights.bias_px = bias_px;
    sights.usable = usable;
    sights.cameras = c;
    sights.rings = k;
    sights.steps = p;
    sights.lines = j;
    for (int64_t ring = 0; ring < k; ring++) {
        sights.vertex = vertices + 3 * ring;
        for (int64_t step = 0; step < p; step++) {
            const int64_t at = ring * p + step;
            const double from = j > 2 * SLOPE_LINES ? start[at] : NOTHING;  // else no course of anything
            const Solved out = solve(&sights, ring, step, from, limit[ring], ones, clean + step * c);
            distance[at] = out.distance;
            sigma[at] = out.sigma;
            camera[at] = out.camera;
            heaviest[at] = out.heaviest;
            line[at] = out.line;
            state[at] = out.state;
            apart[at] = out.apart;
        }
        for (int64_t step = 0; step < p && !usable; step++) {
            const int64_t at = ring * p + step;
            double beyond;
            if ((state[at] == EDGE || state[at] == BLUNT) &&
                among_neighbours(&sights, clean, shift, step, limit[ring], &beyond, sigma + at, camera + at)) {
                state[at] = KNOWN;
                distance[at] = start[at] + beyond;
            }
        }
    }
}
