// Heights of a pipe's wall from frames of a head in it: annulus_pipe.wings.fringe.measure.bore says in what light. As
// fringe_track.c, with a gain and a modulation of its own for each look, a phase that a slope of albedo has shifted,
// and a first start by one eye alone: two on either side of a lamp see its light move in opposite ways.
#include "fringe_head.h"

#define SPAN_RAD 4.146902302738527  // 0.99 of 4 pi / 3, of the frames' phases: what three steps of a third period cover
#define FULL 1.5  // AC over DC: light is not negative; what is above 1 a slide's harmonics and noise may do
#define FEW 3.0   // looks: as many as unknowns

typedef struct {
    const double *base, *path, *texture;
} Wall;

typedef struct {
    double drift_sigma, noise[3], blur_squared, tolerance, tukey, modulated;
    int64_t robust_from;
} Rules;

// Points that are on their way, closed up, and what is known of them.
typedef struct {
    int64_t which[BLOCK];
    Numbers h, level, swing, tilt, scale, texture;
    Row path;
} Live;

// Of one eye's frames: how many see a point, how their phases change, from where to where they go, and the normal
// equations of a first start.
typedef struct {
    Numbers seen, bend, low, high, m00, m10, m11, m20, m21, m22, b0, b1, b2;
} ByEye;

// Of all frames: the normal equations in DC, AC, drift and height.
typedef struct {
    Numbers n, bend, total, cost, m00, m10, m11, t0, t1, tt, h0, h1, ht, hh, b0, b1, bt, bh;
} Sums;

// What a frame shows of a row of points.
typedef struct {
    Numbers phase, slope, gain, crest, steep, sine;
} Looks;

// The symmetric m x = b, by Cholesky: x in b. The last unknown's variance, or -1: m does not determine it.
static double solve(double m[4][4], double b[4], const int64_t size)
{
    for (int64_t j = 0; j < size; j++) {
        double d = m[j][j];
        const double least_pivot = PIVOT * d;
        for (int64_t k = 0; k < j; k++) {
            d -= m[j][k] * m[j][k];
        }
        if (!(d > least_pivot)) {
            return -1.0;
        }
        d = sqrt(d);
        m[j][j] = d;
        for (int64_t i = j + 1; i < size; i++) {
            double s = m[i][j];
            for (int64_t k = 0; k < j; k++) {
                s -= m[i][k] * m[j][k];
            }
            m[i][j] = s / d;
        }
    }
    for (int64_t i = 0; i < size; i++) {
        for (int64_t k = 0; k < i; k++) {
            b[i] -= m[i][k] * b[k];
        }
        b[i] /= m[i][i];
    }
    for (int64_t i = size - 1; i >= 0; i--) {
        for (int64_t k = i + 1; k < size; k++) {
            b[i] -= m[k][i] * b[k];
        }
        b[i] /= m[i][i];
    }
    return 1.0 / (m[size - 1][size - 1] * m[size - 1][size - 1]);
}

// Grey levels of a frame, and with `wide` the blur's square on the wall, mm^2: a height changes it little, so the first
// round's is kept.
static void shown(const Shot* const shot, const Row* const at, const double blur_squared, const int64_t count,
                  double* const grey, double* const wide)
{
    Row seen;
    Numbers u, v, squared;
    place(shot->camera, at, count, &seen);
    see(shot->lens, &seen, count, u, v);
    seen_at(shot, &seen, u, v, count, grey);
    if (wide && blur_squared > 0.0) {
        scale_of(shot, &seen, u, v, count, squared);
    }
    for (int64_t i = 0; wide && i < count; i++) {
        wide[i] = blur_squared > 0.0 && finite(squared[i]) ? blur_squared * squared[i] : 0.0;
    }
}

static void light_up(const Shot* const shot, const double* const eye, const Row* const at, const Live* const live,
                     const double* const wide, const int64_t count, Looks* const restrict looks)
{
    Row there, gradient;
    Numbers along, depth;
    place(shot->head, at, count, &there);
    shade(shot, &there, count, looks->gain, depth);
    place(shot->projector, at, count, &there);
    light(&shot->slide, &there, count, looks->phase, &gradient);
    slopes(shot, eye, at, &there, &gradient, &live->path, count, looks->slope, along);
    for (int64_t i = 0; i < count; i++) {
        looks->phase[i] += live->texture[i] * along[i] * wide[i];
    }
    waves(&shot->slide, looks->phase, count, looks->crest, looks->steep, looks->sine);
    for (int64_t i = 0; i < count; i++) {
        looks->crest[i] *= depth[i];
        looks->steep[i] *= depth[i];
        looks->sine[i] *= depth[i];
    }
}

static void add_eye(const double* const grey, const Looks* const looks, const int64_t count, ByEye* const restrict eye,
                    Sums* const restrict sums)
{
    for (int64_t i = 0; i < count; i++) {
        const bool fine = finite(grey[i]);
        const double slope = fine ? looks->slope[i] : 0.0, phase = looks->phase[i];
        eye->seen[i] += fine ? 1.0 : 0.0;
        eye->bend[i] += slope;
        eye->low[i] = fine && phase < eye->low[i] ? phase : eye->low[i];
        eye->high[i] = fine && phase > eye->high[i] ? phase : eye->high[i];
        sums->bend[i] += fabs(slope);
    }
}

// Eq. 6.11: I = V1 + V2 cos phase - V3 sin phase; harmonics are small beside half a period.
static void add_first(const Rules* const rules, const double* const grey, const Looks* const looks, const int64_t count,
                      ByEye* const restrict eye)
{
    const Rules own = *rules;
    for (int64_t i = 0; i < count; i++) {
        const bool fine = finite(grey[i]);
        const double g = fine ? grey[i] : 0.0, w = fine ? weight_of(own.noise, g) : 0.0;
        const double r0 = fine ? looks->gain[i] : 0.0, r1 = fine ? r0 * looks->crest[i] : 0.0;
        const double r2 = fine ? -r0 * looks->sine[i] : 0.0, w0 = w * r0, w1 = w * r1, w2 = w * r2;
        eye->m00[i] += w0 * r0;
        eye->m10[i] += w1 * r0;
        eye->m11[i] += w1 * r1;
        eye->m20[i] += w2 * r0;
        eye->m21[i] += w2 * r1;
        eye->m22[i] += w2 * r2;
        eye->b0[i] += w0 * g;
        eye->b1[i] += w1 * g;
        eye->b2[i] += w2 * g;
    }
}

// Residuals and tangents; far ones weigh less, by Tukey, where frames are enough to outvote one that is wrong.
INLINE void add(const Rules* const rules, const Live* const live, const double drift, const bool drifting,
                const bool robust_now, const double* const grey, const Looks* const looks, const int64_t count,
                Sums* const restrict sums)
{
    const Rules own = *rules;
    const double enough = (double)own.robust_from, tukey = own.tukey;
    for (int64_t i = 0; i < count; i++) {
        const bool fine = finite(grey[i]);
        const double g = fine ? grey[i] : 0.0, c = fine ? looks->crest[i] : 0.0, gain = fine ? looks->gain[i] : 0.0;
        const double rate = fine ? looks->steep[i] * looks->slope[i] : 0.0;
        const double over = gain * (1.0 + live->tilt[i] * drift), bright = live->level[i] + live->swing[i] * c;
        const double off = g - bright * over, plain = fine ? weight_of(own.noise, g) : 0.0;
        const double misfit = off * off * plain, far = misfit / (live->scale[i] * tukey);
        const double tamed = far < 1.0 ? plain * ((1.0 - far) * (1.0 - far)) : 0.0;
        const double w = robust_now && sums->n[i] >= enough ? tamed : plain;
        const double r1 = c * over, rh = live->swing[i] * rate * over, w0 = w * over, w1 = w * r1, wh = w * rh;
        sums->total[i] += w * off * off;
        sums->cost[i] += misfit < tukey ? misfit : tukey;
        sums->m00[i] += w0 * over;
        sums->m10[i] += w1 * over;
        sums->m11[i] += w1 * r1;
        sums->h0[i] += wh * over;
        sums->h1[i] += wh * r1;
        sums->hh[i] += wh * rh;
        sums->b0[i] += w0 * off;
        sums->b1[i] += w1 * off;
        sums->bh[i] += wh * off;
        if (drifting) {
            const double rt = bright * drift * gain, wt = w * rt;
            sums->t0[i] += wt * over;
            sums->t1[i] += wt * r1;
            sums->tt[i] += wt * rt;
            sums->ht[i] += wh * rt;
            sums->bt[i] += wt * off;
        }
    }
}

// A round over all frames: what they show, then what they say. value, wide: (n, BLOCK).
static void look(const Head* const head, const double* const eyes, const double* const drift, const int64_t n,
                 const Wall* const wall, const Rules* const rules, const Live* const live, const int64_t turn,
                 const int64_t count, double* const value, double* const wide, ByEye* const by_eye, Sums* const sums)
{
    const bool drifting = rules->drift_sigma > 0.0;
    Row at;
    Looks looks;
    memset(sums, 0, sizeof *sums);
    memset(by_eye, 0, (size_t)head->e * sizeof *by_eye);
    for (int64_t i = 0; i < count; i++) {
        const double* const base = wall->base + 3 * live->which[i];
        at.x[i] = base[0] + live->h[i] * live->path.x[i];
        at.y[i] = base[1] + live->h[i] * live->path.y[i];
        at.z[i] = base[2] + live->h[i] * live->path.z[i];
        for (int64_t e = 0; e < head->e; e++) {
            by_eye[e].low[i] = HUGE_VAL;
            by_eye[e].high[i] = -HUGE_VAL;
        }
    }
    for (int64_t k = 0; k < n; k++) {
        const Shot shot = shot_of(head, k);
        double* const grey = value + k * BLOCK;
        shown(&shot, &at, rules->blur_squared, count, grey, turn == 0 ? wide + k * BLOCK : NULL);
        for (int64_t i = 0; i < count; i++) {
            sums->n[i] += finite(grey[i]) ? 1.0 : 0.0;
        }
    }
    for (int64_t k = 0; k < n; k++) {
        const Shot shot = shot_of(head, k);
        const double* const grey = value + k * BLOCK;
        bool any = false;
        for (int64_t i = 0; i < count; i++) {
            any |= finite(grey[i]);
        }
        if (!any) {
            continue;
        }
        light_up(&shot, eyes + 3 * k, &at, live, wide + k * BLOCK, count, &looks);
        add_eye(grey, &looks, count, by_eye + shot.eye, sums);
        if (turn == 0) {
            add_first(rules, grey, &looks, count, by_eye + shot.eye);
        } else if (drifting) {
            add(rules, live, drift[k], true, turn > 1, grey, &looks, count, sums);
        } else {
            add(rules, live, 0.0, false, turn > 1, grey, &looks, count, sums);
        }
    }
}

// The eye that begins: of those that see a point often enough, the one before which its phases go farthest.
static const ByEye* first_eye(const ByEye* const by_eye, const int64_t eyes, const int64_t i)
{
    const ByEye* first = by_eye;
    for (int64_t e = 0; e < eyes; e++) {
        const ByEye* const one = by_eye + e;
        const bool wider = one->high[i] - one->low[i] > first->high[i] - first->low[i];
        if (one->seen[i] >= FEW && (first->seen[i] < FEW || wider)) {
            first = one;
        }
    }
    return first;
}

// The first start of a point: Eq. 6.13, 6.14. What it has become, or UNSETTLED.
static int64_t begin(const ByEye* const eye, const int64_t i, Live* const live)
{
    double m[4][4] = {{eye->m00[i]}, {eye->m10[i], eye->m11[i]}, {eye->m20[i], eye->m21[i], eye->m22[i]}};
    double b[4] = {eye->b0[i], eye->b1[i], eye->b2[i]};
    if (solve(m, b, 3) < 0.0) {
        return UNDETERMINED;
    }
    live->level[i] = b[0];
    live->swing[i] = sqrt(b[1] * b[1] + b[2] * b[2]);
    live->h[i] += arc_tangent(b[2], b[1]) * eye->seen[i] / eye->bend[i];
    return UNSETTLED;
}

// A step of a point: what it has become, or UNSETTLED.
static int64_t step(const Rules* const rules, const Sums* const sums, const int64_t i, const int64_t turn,
                    Live* const live, double* const misfit, double* const variance)
{
    const bool drifting = rules->drift_sigma > 0.0;
    const double stiff = drifting ? 1.0 / (rules->drift_sigma * rules->drift_sigma) : 0.0, n = sums->n[i];
    const double free = drifting && n < 4.0 ? 1.0 : n - 3.0, spread = free > 0.0 ? sums->total[i] / free : 1.0;
    double with[4][4] = {{sums->m00[i]},
                         {sums->m10[i], sums->m11[i]},
                         {sums->t0[i], sums->t1[i], sums->tt[i] + stiff},
                         {sums->h0[i], sums->h1[i], sums->ht[i], sums->hh[i]}};
    double without[4][4] = {{sums->m00[i]}, {sums->m10[i], sums->m11[i]}, {sums->h0[i], sums->h1[i], sums->hh[i]}};
    double b[4] = {sums->b0[i], sums->b1[i], sums->bt[i] - live->tilt[i] * stiff, sums->bh[i]};
    b[2] = drifting ? b[2] : b[3];
    live->scale[i] = spread > 1.0 ? spread : 1.0;
    *variance = drifting ? solve(with, b, 4) : solve(without, b, 3);
    if (*variance < 0.0) {
        return UNDETERMINED;
    }
    const double by = drifting ? b[3] : b[2], most = STEP_RAD * n / sums->bend[i];
    live->level[i] += b[0];
    live->swing[i] += b[1];
    live->tilt[i] += drifting ? b[2] : 0.0;
    live->h[i] += by > most ? most : by < -most ? -most : by;
    *misfit = sums->cost[i];
    if (!(fabs(by) < rules->tolerance && turn > 1)) {
        return UNSETTLED;
    }
    const double swing = live->swing[i];
    const bool modulated = swing > 0.0 && swing * swing * sums->m11[i] > rules->modulated * rules->modulated;
    return modulated && swing < FULL * live->level[i] ? GOOD : UNMODULATED;
}

// A point that goes on to the next round, to the place `to`.
static void move(Live* const live, double* const wide, const int64_t n, const int64_t from, const int64_t to)
{
    live->which[to] = live->which[from];
    live->h[to] = live->h[from];
    live->level[to] = live->level[from];
    live->swing[to] = live->swing[from];
    live->tilt[to] = live->tilt[from];
    live->scale[to] = live->scale[from];
    live->texture[to] = live->texture[from];
    live->path.x[to] = live->path.x[from];
    live->path.y[to] = live->path.y[from];
    live->path.z[to] = live->path.z[from];
    for (int64_t k = 0; k < n && from != to; k++) {
        wide[k * BLOCK + to] = wide[k * BLOCK + from];
    }
}

// Every wall point's height outwards, and how sure: NaN unless its flag is GOOD. who: the eye whose frames told it, the
// number of eyes where several did, -1 where none.
DOOR void fringe_follow_wall(const float* const images, const double* const lens, const double* const cameras,
                             const double* const heads, const double* const eyes, const double* const projectors,
                             const double* const slide, const double* const drift, const int64_t* const eye,
                             const double* const shading, const double blur_squared, const double drift_sigma,
                             const double* const noise, const double* const base, const double* const path,
                             const double* const texture, const double* const start, const double tolerance,
                             const int64_t robust_from, const double tukey, const double modulated,
                             double* const height, double* const sigma, double* const dc, double* const ac,
                             double* const misfit, double* const used, double* const flag, int64_t* const who,
                             double* const rows, double* const by_eyes, const int64_t n, const int64_t h,
                             const int64_t w, const int64_t s, const int64_t e, const int64_t t, const int64_t p)
{
    if (s < SLIDE_LEAST || e < 1) {
        return;
    }
    const Head head = {images, lens, cameras, heads, projectors, slide, shading, eye, h, w, s, e, t};
    const Wall wall = {base, path, texture};
    const Rules rules = {drift_sigma, {noise[0], noise[1], noise[2]}, blur_squared, tolerance, tukey, modulated,
                         robust_from};
    double* const value = rows;
    double* const wide = rows + n * BLOCK;
    ByEye* const by_eye = (ByEye*)by_eyes;
    Live live;
    Sums sums;
    for (int64_t first = 0; first < p; first += BLOCK) {
        int64_t count = least(BLOCK, p - first);
        for (int64_t i = 0; i < count; i++) {
            const int64_t at = first + i;
            live.which[i] = at;
            live.h[i] = start[at];
            live.level[i] = live.swing[i] = live.tilt[i] = 0.0;
            live.scale[i] = 1.0;
            live.texture[i] = texture[at];
            live.path.x[i] = path[3 * at];
            live.path.y[i] = path[3 * at + 1];
            live.path.z[i] = path[3 * at + 2];
        }
        for (int64_t turn = 0; turn < ROUNDS && count > 0; turn++) {
            look(&head, eyes, drift, n, &wall, &rules, &live, turn, count, value, wide, by_eye, &sums);
            int64_t left = 0;
            for (int64_t i = 0; i < count; i++) {
                const ByEye* const begins = first_eye(by_eye, e, i);
                const int64_t to = live.which[i];
                double variance = -1.0;
                int64_t state;
                if (begins->seen[i] < FEW) {
                    state = TOO_FEW;
                } else if (begins->high[i] - begins->low[i] < SPAN_RAD) {
                    state = UNDETERMINED;
                } else {
                    state = turn == 0 ? begin(begins, i, &live)
                                      : step(&rules, &sums, i, turn, &live, misfit + to, &variance);
                }
                if (state == UNSETTLED && turn + 1 < ROUNDS) {
                    move(&live, wide, n, i, left);
                    left++;
                    continue;
                }
                const bool good = state == GOOD;
                height[to] = good ? live.h[i] : (double)NAN;
                sigma[to] = good && variance > 0.0 ? sqrt(variance * live.scale[i]) : (double)NAN;
                dc[to] = live.level[i];
                ac[to] = live.swing[i];
                used[to] = sums.n[i];
                flag[to] = (double)state;
                who[to] = -1;
                for (int64_t one = 0; one < e; one++) {
                    if (by_eye[one].seen[i] > 0.0) {
                        who[to] = who[to] < 0 ? one : e;
                    }
                }
            }
            count = left;
        }
    }
}

// Points of a wall that stands across `normal` in every frame: grey level, phase, its slope along the frame's ray per
// mm, what a slope of albedo does to it (`pull`), and where they stand in the head's frame. NaN where not seen.
DOOR void fringe_look_around(const float* const images, const double* const lens, const double* const cameras,
                             const double* const heads, const double* const eyes, const double* const projectors,
                             const double* const slide, const double* const points, const double* const normal,
                             double* const grey, double* const phase, double* const slope, double* const pull,
                             double* const seen, const int64_t n, const int64_t h, const int64_t w, const int64_t s,
                             const int64_t p)
{
    if (s < SLIDE_LEAST) {
        return;
    }
    Row at = {{0.0}, {0.0}, {0.0}}, across = at, there, gradient;
    Numbers u, v, along, squared;
    for (int64_t first = 0; first < p; first += BLOCK) {
        const int64_t count = least(BLOCK, p - first);
        for (int64_t i = 0; i < count; i++) {
            const double* const point = points + 3 * (first + i);
            const double* const way = normal + 3 * (first + i);
            at.x[i] = point[0];
            at.y[i] = point[1];
            at.z[i] = point[2];
            across.x[i] = way[0];
            across.y[i] = way[1];
            across.z[i] = way[2];
        }
        for (int64_t k = 0; k < n; k++) {
            const Shot shot = {.lens = lens + 10 * k,
                               .camera = cameras + 12 * k,
                               .projector = projectors + 12 * k,
                               .image = {images + k * h * w, h, w},
                               .slide = slide_of(slide + s * k, s)};
            const int64_t to = k * p + first;
            place(shot.camera, &at, count, &there);
            see(shot.lens, &there, count, u, v);
            scale_of(&shot, &there, u, v, count, squared);
            sample(&shot.image, u, v, count, grey + to);
            place(heads + 12 * k, &at, count, &there);
            for (int64_t i = 0; i < count; i++) {
                seen[3 * (to + i)] = there.x[i];
                seen[3 * (to + i) + 1] = there.y[i];
                seen[3 * (to + i) + 2] = there.z[i];
            }
            place(shot.projector, &at, count, &there);
            light(&shot.slide, &there, count, phase + to, &gradient);
            slopes(&shot, eyes + 3 * k, &at, &there, &gradient, &across, count, slope + to, along);
            for (int64_t i = 0; i < count; i++) {
                pull[to + i] = along[i] * squared[i];
            }
        }
    }
}
