// Heights of points that are carried past a head: annulus_pipe.wings.fringe.measure.track says what is sought, and its
// equations are Alzuhiri's (2022). First linear least squares on a point's own phases, then Gauss and Newton in DC, AC,
// height and the light's drift; a block of points at a time, and in it a frame at a time, in two passes: what all
// frames show, then what they say.
#include "fringe_camera.h"

typedef struct {
    const float* images;    // (n, h, w) splines, or none:
    const double* samples;  // (n, p) grey levels where the pixels are the points' own
    const double *lens, *cameras, *eyes, *projectors, *drift;
    Slide slide;
    int64_t n, h, w, p;
} Frames;

// P points, each on its own line: base + h path. q, r: paths and normals, as many as points or one for all.
typedef struct {
    const double *base, *path, *normal;
    int64_t q, r;
} Lines;

typedef struct {
    const double* noise;
    double drift_sigma, tolerance, tukey, excess, modulated;
    int64_t robust_from;
} Rules;

// Points that are on their way, closed up, and what is known of them.
typedef struct {
    int64_t which[BLOCK];
    Numbers h, level, swing, tilt, scale;
} Live;

// Of the normal equations in DC, AC and height, in that order, and t, the drift's: the height stands last, its variance
// is then what the elimination leaves.
typedef struct {
    Numbers n, bend, m00, m10, m11, m20, m21, m22, b0, b1, b2, t0, t1, t2, t3, bt, total, cost;
} Sums;

typedef struct {
    double x, y, z, variance;
} Solved;

// The symmetric [[a b d] [b c e] [d e f]] by (x, y, z); the last one's variance, -1 where the matrix does not determine
// them: a pivot is below its least.
INLINE Solved solve(const double a, const double b, const double c, const double d, const double e, const double f,
                    const double x, const double y, const double z, const double diagonal[3])
{
    const Solved none = {0.0, 0.0, 0.0, -1.0};
    if (!(a > PIVOT * diagonal[0])) {
        return none;
    }
    const double over_a = 1.0 / a, l10 = b * over_a, l20 = d * over_a, c1 = c - l10 * b;
    if (!(c1 > PIVOT * diagonal[1])) {
        return none;
    }
    const double over_c = 1.0 / c1, e1 = e - l20 * b, l21 = e1 * over_c, f1 = f - (l20 * d + l21 * e1);
    if (!(f1 > PIVOT * diagonal[2])) {
        return none;
    }
    const double variance = 1.0 / f1, y1 = y - l10 * x, last = (z - l20 * x - l21 * y1) * variance;
    const double middle = y1 * over_c - l21 * last;
    return (Solved){x * over_a - l10 * middle - l20 * last, middle, last, variance};
}

// Where the points are, what stands across them, and how far out that is of the world's origin.
static void stand(const Lines* const lines, const Live* const live, const int64_t count, Row* const restrict at,
                  Row* const restrict normal, double* const restrict out)
{
    for (int64_t i = 0; i < count; i++) {
        const int64_t p = live->which[i];
        const double* const base = lines->base + 3 * p;
        const double* const path = lines->path + 3 * least(p, lines->q - 1);
        const double* const across = lines->normal + 3 * least(p, lines->r - 1);
        at->x[i] = base[0] + live->h[i] * path[0];
        at->y[i] = base[1] + live->h[i] * path[1];
        at->z[i] = base[2] + live->h[i] * path[2];
        normal->x[i] = across[0];
        normal->y[i] = across[1];
        normal->z[i] = across[2];
        out[i] = at->x[i] * across[0] + at->y[i] * across[1] + at->z[i] * across[2];
    }
}

// Grey levels of a frame at points.
static void shown(const Frames* const frames, const Live* const live, const Row* const at, const int64_t k,
                  const int64_t count, double* const grey)
{
    if (!frames->images) {
        for (int64_t i = 0; i < count; i++) {
            grey[i] = frames->samples[k * frames->p + live->which[i]];
        }
        return;
    }
    const Spline image = {frames->images + k * frames->h * frames->w, frames->h, frames->w};
    Row seen;
    Numbers u, v;
    place(frames->cameras + 12 * k, at, count, &seen);
    see(frames->lens, &seen, count, u, v);
    sample(&image, u, v, count, grey);
}

// Phases of a frame at points, and how they change with height: along the frame's ray where it has images, for a wrong
// height samples the wall beside the point; else along the points' paths.
static void lit_along(const Frames* const frames, const Lines* const lines, const Live* const live, const Row* const at,
                      const Row* const normal, const double* const out, const int64_t k, const int64_t count,
                      double* const restrict phase, double* const restrict slope)
{
    const double* const pose = frames->projectors + 12 * k;
    const double* const eye = frames->eyes + 3 * k;
    Row there, gradient;
    place(pose, at, count, &there);
    light(&frames->slide, &there, count, phase, &gradient);
    if (!frames->images) {
        for (int64_t i = 0; i < count; i++) {
            const double* const way = lines->path + 3 * least(live->which[i], lines->q - 1);
            slope[i] = gradient.x[i] * (pose[0] * way[0] + pose[1] * way[1] + pose[2] * way[2]) +
                       gradient.y[i] * (pose[4] * way[0] + pose[5] * way[1] + pose[6] * way[2]) +
                       gradient.z[i] * (pose[8] * way[0] + pose[9] * way[1] + pose[10] * way[2]);
        }
        return;
    }
    const double ex = eye[0], ey = eye[1], ez = eye[2];  // in the projector's frame the ray is the point less the eye
    const double x = pose[0] * ex + pose[1] * ey + pose[2] * ez + pose[3];
    const double y = pose[4] * ex + pose[5] * ey + pose[6] * ez + pose[7];
    const double z = pose[8] * ex + pose[9] * ey + pose[10] * ez + pose[11];
    for (int64_t i = 0; i < count; i++) {
        const double away = out[i] - ex * normal->x[i] - ey * normal->y[i] - ez * normal->z[i];
        const double rate =
            gradient.x[i] * (there.x[i] - x) + gradient.y[i] * (there.y[i] - y) + gradient.z[i] * (there.z[i] - z);
        slope[i] = rate / away;
    }
}

// Eq. 6.11: I = V1 + V2 cos phase - V3 sin phase; harmonics are small beside half a period.
static void add_first(const double* const noise, const double* const grey, const double* const crest,
                      const double* const sine, const double* const slope, const int64_t count,
                      Sums* const restrict sums)
{
    const double held_noise[3] = {noise[0], noise[1], noise[2]};
    for (int64_t i = 0; i < count; i++) {
        const bool fine = finite(grey[i]);
        const double g = fine ? grey[i] : 0.0, c = fine ? crest[i] : 0.0, s = fine ? sine[i] : 0.0;
        const double w = fine ? weight_of(held_noise, g) : 0.0, wc = w * c, ws = w * s;
        sums->m00[i] += w;
        sums->m10[i] += wc;
        sums->m11[i] += wc * c;
        sums->m20[i] -= ws;
        sums->m21[i] -= ws * c;
        sums->m22[i] += ws * s;
        sums->b0[i] += w * g;
        sums->b1[i] += wc * g;
        sums->b2[i] -= ws * g;
        sums->bend[i] += fine ? slope[i] : 0.0;
    }
}

// Residuals and tangents in DC, AC and height, and in the light's drift; far ones weigh less, by Tukey, where frames
// are enough to outvote one that is wrong.
INLINE void add(const Rules* const rules, const Live* const live, const double drift, const bool drifting,
                const bool robust_now, const double* const grey, const double* const crest, const double* const steep,
                const double* const slope, const int64_t count, Sums* const restrict sums)
{
    const double noise[3] = {rules->noise[0], rules->noise[1], rules->noise[2]}, tukey = rules->tukey;
    const double enough = (double)rules->robust_from;
    for (int64_t i = 0; i < count; i++) {
        const bool fine = finite(grey[i]);
        const double g = fine ? grey[i] : 0.0, c = fine ? crest[i] : 0.0;
        const double rate = fine ? steep[i] * slope[i] : 0.0;
        const double gain = 1.0 + live->tilt[i] * drift, bright = live->level[i] + live->swing[i] * c;
        const double off = fine ? g - bright * gain : 0.0, plain = fine ? weight_of(noise, g) : 0.0;
        const double misfit = off * off * plain, far = misfit / (live->scale[i] * tukey);
        const double tamed = far < 1.0 ? plain * ((1.0 - far) * (1.0 - far)) : 0.0;
        const double w = robust_now && sums->n[i] >= enough ? tamed : plain;
        const double r1 = c * gain, r2 = live->swing[i] * rate * gain, w0 = w * gain, w1 = w * r1, w2 = w * r2;
        sums->cost[i] += misfit < tukey ? misfit : tukey;
        sums->total[i] += w * off * off;
        sums->m00[i] += w0 * gain;
        sums->m10[i] += w1 * gain;
        sums->m11[i] += w1 * r1;
        sums->m20[i] += w2 * gain;
        sums->m21[i] += w2 * r1;
        sums->m22[i] += w2 * r2;
        sums->b0[i] += w0 * off;
        sums->b1[i] += w1 * off;
        sums->b2[i] += w2 * off;
        sums->bend[i] += fine ? slope[i] : 0.0;
        if (drifting) {
            const double r3 = bright * drift;
            sums->t0[i] += w0 * r3;
            sums->t1[i] += w1 * r3;
            sums->t2[i] += w2 * r3;
            sums->t3[i] += w * r3 * r3;
            sums->bt[i] += w * r3 * off;
        }
    }
}

// The first start of a point: Eq. 6.13, 6.14. What it has become, or UNSETTLED.
static int64_t begin(const Sums* const sums, const int64_t i, Live* const live, double* const variance)
{
    const double diagonal[3] = {sums->m00[i], sums->m11[i], sums->m22[i]}, n = sums->n[i];
    const Solved one = solve(sums->m00[i], sums->m10[i], sums->m11[i], sums->m20[i], sums->m21[i], sums->m22[i],
                             sums->b0[i], sums->b1[i], sums->b2[i], diagonal);
    *variance = one.variance;
    if (n < 3.0 || one.variance < 0.0) {
        return n < 3.0 ? TOO_FEW : UNDETERMINED;
    }
    live->level[i] = one.x;
    live->swing[i] = sqrt(one.y * one.y + one.z * one.z);
    live->h[i] += arc_tangent(one.z, one.y) * n / sums->bend[i];  // the phase that is left, as a height
    return UNSETTLED;
}

// A step of a point: what it has become, or UNSETTLED.
static int64_t step(const Rules* const rules, const Sums* const sums, const int64_t i, Live* const live,
                    double* const variance)
{
    const bool drifting = rules->drift_sigma > 0.0;
    const double n = sums->n[i], free = drifting && n < 4.0 ? 1.0 : n - 3.0, total = sums->total[i];
    const bool excess = free > 0.0 && total > free + rules->excess * sqrt(2.0 * free);
    live->scale[i] = excess ? total / free : 1.0;
    // the light's drift is eliminated first: what is believed of it keeps its pivot
    const double t0 = sums->t0[i], t1 = sums->t1[i], t2 = sums->t2[i], t3 = sums->t3[i], bt = sums->bt[i];
    const double q = drifting ? 1.0 / t3 : 0.0, diagonal[3] = {sums->m00[i], sums->m11[i], sums->m22[i]};
    const Solved one = solve(sums->m00[i] - t0 * t0 * q, sums->m10[i] - t1 * t0 * q, sums->m11[i] - t1 * t1 * q,
                             sums->m20[i] - t2 * t0 * q, sums->m21[i] - t2 * t1 * q, sums->m22[i] - t2 * t2 * q,
                             sums->b0[i] - t0 * bt * q, sums->b1[i] - t1 * bt * q, sums->b2[i] - t2 * bt * q, diagonal);
    *variance = one.variance;
    if (n < 3.0 || one.variance < 0.0) {
        return n < 3.0 ? TOO_FEW : UNDETERMINED;
    }
    live->level[i] += one.x;
    live->swing[i] += one.y;
    live->tilt[i] += drifting ? (bt - t0 * one.x - t1 * one.y - t2 * one.z) * q : 0.0;
    const double most = STEP_RAD * n / fabs(sums->bend[i]);
    live->h[i] += one.z > most ? most : one.z < -most ? -most : one.z;
    if (!(fabs(one.z) < rules->tolerance)) {
        return UNSETTLED;
    }
    const double swing = live->swing[i];
    return swing > 0.0 && swing * swing * diagonal[1] > rules->modulated * rules->modulated ? GOOD : UNMODULATED;
}

// A round over all frames: what they show, then what they say. value, crest: (n, BLOCK).
static void look(const Frames* const frames, const Lines* const lines, const Rules* const rules, const Live* const live,
                 const int64_t turn, const int64_t count, double* const value, double* const crest, Sums* const sums)
{
    Row at = {{0.0}, {0.0}, {0.0}}, normal = at;
    Numbers out = {0.0}, phase = {0.0}, slope = {0.0}, steep, sine;
    const bool drifting = rules->drift_sigma > 0.0;
    const double stiff = drifting ? 1.0 / (rules->drift_sigma * rules->drift_sigma) : 0.0;
    memset(sums, 0, sizeof *sums);
    for (int64_t i = 0; i < count; i++) {
        sums->t3[i] = stiff;
        sums->bt[i] = -live->tilt[i] * stiff;
    }
    stand(lines, live, count, &at, &normal, out);
    for (int64_t k = 0; k < frames->n; k++) {
        double* const grey = value + k * BLOCK;
        shown(frames, live, &at, k, count, grey);
        for (int64_t i = 0; i < count; i++) {
            sums->n[i] += finite(grey[i]) ? 1.0 : 0.0;
        }
    }
    for (int64_t k = 0; k < frames->n; k++) {
        const double* const grey = value + k * BLOCK;
        double* const own = crest + k * BLOCK;
        lit_along(frames, lines, live, &at, &normal, out, k, count, phase, slope);
        waves(&frames->slide, phase, count, own, steep, sine);
        if (turn == 0) {
            add_first(rules->noise, grey, own, sine, slope, count, sums);
        } else if (drifting) {
            add(rules, live, frames->drift[k], true, turn > 2, grey, own, steep, slope, count, sums);
        } else {
            add(rules, live, 0.0, false, turn > 2, grey, own, steep, slope, count, sums);
        }
    }
}

// A point that goes on to the next round, to the place `to`.
static void move(Live* const live, const int64_t from, const int64_t to)
{
    live->which[to] = live->which[from];
    live->h[to] = live->h[from];
    live->level[to] = live->level[from];
    live->swing[to] = live->swing[from];
    live->tilt[to] = live->tilt[from];
    live->scale[to] = live->scale[from];
}

// Every point's height, and how sure: NaN unless its flag is GOOD. residual: (n, p) grey levels, or none.
DOOR void fringe_follow(const float* const images, const double* const samples, const double* const lens,
                        const double* const cameras, const double* const eyes, const double* const projectors,
                        const double* const slide, const double* const drift, const double* const base,
                        const double* const path, const double* const normal, const double* const start,
                        const double drift_sigma, const double* const noise, const double tolerance,
                        const int64_t robust_from, const double tukey, const double excess, const double modulated,
                        double* const height, double* const sigma, double* const dc, double* const ac,
                        double* const misfit, double* const used, double* const flag, float* const residual,
                        double* const room, const int64_t n, const int64_t h, const int64_t w, const int64_t p,
                        const int64_t s, const int64_t q, const int64_t r)
{
    if (s < SLIDE_LEAST || q < 1 || r < 1 || (!images && !samples)) {
        return;
    }
    const Frames frames = {images, samples, lens, cameras, eyes, projectors, drift, slide_of(slide, s), n, h, w, p};
    const Lines lines = {base, path, normal, q, r};
    const Rules rules = {noise, drift_sigma, tolerance, tukey, excess, modulated, robust_from};
    double* const value = room;
    double* const crest = room + n * BLOCK;
    Live live;
    Sums sums;
    for (int64_t first = 0; first < p; first += BLOCK) {
        int64_t count = least(BLOCK, p - first);
        for (int64_t i = 0; i < count; i++) {
            live.which[i] = first + i;
            live.h[i] = start[first + i];
            live.level[i] = live.swing[i] = live.tilt[i] = 0.0;
            live.scale[i] = 1.0;
        }
        for (int64_t turn = 0; turn < ROUNDS && count > 0; turn++) {
            look(&frames, &lines, &rules, &live, turn, count, value, crest, &sums);
            int64_t left = 0;
            for (int64_t i = 0; i < count; i++) {
                double variance;
                const int64_t state =
                    turn == 0 ? begin(&sums, i, &live, &variance) : step(&rules, &sums, i, &live, &variance);
                const int64_t to = live.which[i];
                if (turn > 0 && !(sums.n[i] < 3.0 || variance < 0.0)) {
                    misfit[to] = sums.cost[i];
                }
                if (state == UNSETTLED && turn + 1 < ROUNDS) {
                    move(&live, i, left);
                    left++;
                    continue;
                }
                height[to] = state == GOOD ? live.h[i] : (double)NAN;
                sigma[to] = state == GOOD ? sqrt(variance * live.scale[i]) : (double)NAN;
                dc[to] = live.level[i];
                ac[to] = live.swing[i];
                used[to] = sums.n[i];
                flag[to] = (double)state;
                for (int64_t k = 0; residual && k < n; k++) {
                    const double grey = value[k * BLOCK + i];
                    const double bright = live.level[i] + live.swing[i] * crest[k * BLOCK + i];
                    const double predicted = bright * (1.0 + live.tilt[i] * drift[k]);
                    residual[k * p + to] = state == GOOD && finite(grey) ? (float)(grey - predicted) : NAN;
                }
            }
            count = left;
        }
    }
}

// Pixels at which a camera (3, 4) sees world points; NaN behind a pinhole.
DOOR void fringe_look(const double* const lens, const double* const camera, const double* const points, double* const u,
                      double* const v, const int64_t p)
{
    for (int64_t first = 0; first < p; first += BLOCK) {
        const int64_t count = least(BLOCK, p - first);
        Row at, seen;
        for (int64_t i = 0; i < count; i++) {
            at.x[i] = points[3 * (first + i)];
            at.y[i] = points[3 * (first + i) + 1];
            at.z[i] = points[3 * (first + i) + 2];
        }
        place(camera, &at, count, &seen);
        see(lens, &seen, count, u + first, v + first);
    }
}
