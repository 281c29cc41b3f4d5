// What frames show of a cross-section of a pipe's wall with a groove in it, by the albedo of its rows:
// annulus_pipe.wings.fringe.measure.groove says of what it is made. Every line of sight ends on wall, floor or far
// wall, each lit by the slide or shaded by a rim; the lens's blur runs over all of it.
#include "fringe_head.h"

#define FINE 3         // steps of the light's own grid from row to row
#define REACH 4.0      // sigma of the blur
#define PAD_MOST 9999  // fine steps beside the rows: a blur of 800 rows shows no groove

// A groove from a to b of a depth, mm along the pipe, in a wall that lies `off` the radius, as one frame sees it: z and
// distance from the axis of the camera and of the light, mm.
typedef struct {
    double a, b, deep, radius, off;
    double per_fine;  // fine steps a mm
    double sight_z, sight_r, lamp_z, lamp_r;
    const double *projector, *normal;
    Slide slide;
} Cut;

// Lines of sight side by side: where each meets the wall, or would, how much it is aslant, how much of it a groove has,
// the slide's swing there, and the first and last row of its blur; of the blur's share of a row the first one's, what
// it is times to the next, and that likewise.
typedef struct {
    Numbers t, slope, groove, swing, first, last, weight, ratio, narrower;
} Fan;

// What the lines of a fan end on: wall, floor or far wall, at z, h mm down, and how bright that is.
typedef struct {
    Numbers z, h, bright;
    bool any;  // of it lit
} Ends;

INLINE double part(const double value)
{
    return held(value, 0.0, 1.0);
}

// How much of a fine step at z lies between both rims.
INLINE double between(const Cut* const cut, const double z)
{
    return part((z - cut->a) * cut->per_fine + 0.5) * part((cut->b - z) * cut->per_fine + 0.5);
}

// Lines of sight a fine step apart, the first `from` steps after z0.
static void spread(const Cut* const cut, const double* const blur, const double* const depth, const double modulation,
                   const double z0, const double step, const int64_t from, const int64_t rows, const int64_t count,
                   Fan* const restrict fan)
{
    Numbers wide;
    const Cut own = *cut;
    const double fine = step / FINE, last = (double)(rows - 1), per = 1.0 / step;
    for (int64_t i = 0; i < count; i++) {
        const int64_t f = from + i, nearest = (f + FINE / 2 + FINE * PAD_MOST) / FINE - PAD_MOST;
        const int64_t near = least(most(nearest, 0), rows - 1);
        wide[i] = blur[near];
        fan->swing[i] = modulation * depth[near];
        fan->t[i] = z0 + (double)f * fine;
    }
    for (int64_t i = 0; i < count; i++) {
        const double t = fan->t[i], over = 1.0 / wide[i], in_rows = step * over;
        const double first = held(ceil((t - REACH * wide[i] - z0) * per), 0.0, last + 1.0);
        const double far = (first * step + z0 - t) * over;
        fan->first[i] = first;
        fan->last[i] = held(floor((t + REACH * wide[i] - z0) * per), -1.0, last);
        fan->weight[i] = fine * over * (1.0 / sqrt(TURN)) * exponential(-0.5 * far * far);
        fan->ratio[i] = exponential(-in_rows * (far + 0.5 * in_rows));
        fan->narrower[i] = exponential(-in_rows * in_rows);
        fan->slope[i] = (t - own.sight_z) / (own.radius - own.sight_r);
        fan->groove[i] = between(&own, t);
    }
}

static void on_wall(const Fan* const fan, const int64_t count, Ends* const restrict ends)
{
    for (int64_t i = 0; i < count; i++) {
        ends->z[i] = fan->t[i];
        ends->h[i] = 0.0;
        ends->bright[i] = 1.0 - fan->groove[i];
    }
}

// .. on the floor of the groove and on its far wall, in the light that comes past the rims. The far wall stands across:
// cosines over the wall's.
static void in_groove(const Cut* const cut, const Fan* const fan, const int64_t count, Ends* const restrict floor_ends,
                      Ends* const restrict far_ends)
{
    const Cut own = *cut;
    for (int64_t i = 0; i < count; i++) {
        const double t = fan->t[i], slope = fan->slope[i], z = t + slope * own.deep;
        const double beam = (z - own.lamp_z) / (own.radius + own.deep - own.lamp_r), there = between(&own, z);
        floor_ends->z[i] = z;
        floor_ends->h[i] = own.deep;
        floor_ends->bright[i] = fan->groove[i] * there * between(&own, z - beam * own.deep);
        const double rim = slope > 0.0 ? own.b : own.a, down = (rim - t) / (slope != 0.0 ? slope : 1.0);
        const double h = slope != 0.0 ? held(down, 0.0, own.deep) : own.deep;
        const double past = (rim - own.lamp_z) / (own.radius + h - own.lamp_r), facing = slope > 0.0 ? past : -past;
        far_ends->z[i] = rim;
        far_ends->h[i] = h;
        far_ends->bright[i] =
            fan->groove[i] * (1.0 - there) * between(&own, rim - past * h) * (facing > 0.0 ? facing : 0.0);
    }
}

// .. in the slide's light.
static void light_up(const Cut* const cut, const Fan* const fan, const int64_t count, Ends* const restrict ends)
{
    Row at, there, gradient;
    Numbers phase, crest, steep, sine;
    ends->any = false;
    for (int64_t i = 0; i < count; i++) {
        const double r = cut->radius + cut->off + ends->h[i];
        at.x[i] = r * cut->normal[0];
        at.y[i] = r * cut->normal[1];
        at.z[i] = ends->z[i];
        ends->any |= ends->bright[i] > 0.0;
    }
    if (!ends->any) {
        return;
    }
    place(cut->projector, &at, count, &there);
    light(&cut->slide, &there, count, phase, &gradient);
    waves(&cut->slide, phase, count, crest, steep, sine);
    for (int64_t i = 0; i < count; i++) {
        ends->bright[i] *= fan->weight[i] * (1.0 + fan->swing[i] * crest[i]);
    }
}

// A fan's light into the rows that show it, by the albedo's rows: albedo is linear between them. The blur's shares come
// one from the other: an exponential each would be half of the work.
static void lay(const Fan* const fan, const Ends ends[3], const double z0, const double step, const int64_t rows,
                const int64_t count, double* const restrict by_albedo, double* const restrict taps)
{
    for (int64_t i = 0; i < count; i++) {
        const int64_t first = (int64_t)fan->first[i], size = (int64_t)fan->last[i] - first + 1;
        double weight = 1.0, ratio = fan->ratio[i];
        for (int64_t r = 0; r < size; r++) {
            taps[r] = weight;
            weight *= ratio;
            ratio *= fan->narrower[i];
        }
        for (int64_t kind = 0; kind < 3; kind++) {
            const double bright = ends[kind].bright[i];
            if (!ends[kind].any || bright == 0.0) {
                continue;
            }
            const double at = held((ends[kind].z[i] - z0) / step, 0.0, (double)(rows - 1));
            const int64_t left = least((int64_t)at, rows - 2);
            const double right_part = at - (double)left, one = bright * (1.0 - right_part), other = bright * right_part;
            double* const to = by_albedo + left * rows + first;
            for (int64_t r = 0; r < size; r++) {
                to[r] += one * taps[r];
                to[rows + r] += other * taps[r];
            }
        }
    }
}

// out (k, j, j): grey = out . albedo, of k frames and j rows. depth, gain, blur (k, j): of the modulation, of the
// light, and the blur's sigma on the wall, mm.
DOOR void fringe_light_of_cut(const double* const slide, const double* const projectors, const double* const sight,
                              const double* const lamp, const double* const normal, const double radius,
                              const double z0, const double step, const double a, const double b, const double deep,
                              const double off, const double modulation, const double* const depth,
                              const double* const gain, const double* const blur, double* const out, double* const room,
                              double* const taps, const int64_t k, const int64_t s, const int64_t j)
{
    if (j < 2 || s < SLIDE_LEAST) {
        return;
    }
    Fan fan;
    Ends ends[3];
    for (int64_t n = 0; n < k; n++) {
        const Cut cut = {.a = a,
                         .b = b,
                         .deep = deep,
                         .radius = radius,
                         .off = off,
                         .per_fine = FINE / step,
                         .sight_z = sight[2 * n],
                         .sight_r = sight[2 * n + 1],
                         .lamp_z = lamp[2 * n],
                         .lamp_r = lamp[2 * n + 1],
                         .projector = projectors + 12 * n,
                         .normal = normal,
                         .slide = slide_of(slide + s * n, s)};
        const int64_t pad = whole(ceil(REACH * blur[n * j] * cut.per_fine), 0, PAD_MOST) + 1;
        const int64_t end = (j - 1) * FINE + pad + 1;
        memset(room, 0, (size_t)(j * j) * sizeof *room);
        for (int64_t from = -pad; from < end; from += BLOCK) {
            const int64_t count = least(BLOCK, end - from);
            spread(&cut, blur + n * j, depth + n * j, modulation, z0, step, from, j, count, &fan);
            on_wall(&fan, count, ends);
            in_groove(&cut, &fan, count, ends + 1, ends + 2);
            for (int64_t kind = 0; kind < 3; kind++) {
                light_up(&cut, &fan, count, ends + kind);
            }
            lay(&fan, ends, z0, step, j, count, room, taps);
        }
        for (int64_t r = 0; r < j; r++) {
            for (int64_t i = 0; i < j; i++) {
                out[(n * j + r) * j + i] = room[i * j + r] * gain[n * j + r];
            }
        }
    }
}

// Rows of a wall in every frame: grey level, gain and depth of the head's light, sigma of the blur on the wall, mm,
// each (n, j); grey is NaN where not seen. The head's depth is that of the blurred light; this one is of the light
// before.
DOOR void fringe_look_at_cut(const float* const images, const double* const lens, const double* const cameras,
                             const double* const heads, const double* const projectors, const double* const slide,
                             const int64_t* const eye, const double* const shading, const double blur_px,
                             const double* const normal, const double radius, const double* const z, double* const grey,
                             double* const gain, double* const depth, double* const blur, const int64_t n,
                             const int64_t h, const int64_t w, const int64_t s, const int64_t e, const int64_t t,
                             const int64_t j)
{
    if (s < SLIDE_LEAST || e < 1) {
        return;
    }
    const Head head = {images, lens, cameras, heads, projectors, slide, shading, eye, h, w, s, e, t};
    Row at, there, gradient;
    Numbers u, v, phase, squared;
    for (int64_t first = 0; first < j; first += BLOCK) {
        const int64_t count = least(BLOCK, j - first);
        for (int64_t i = 0; i < count; i++) {
            at.x[i] = radius * normal[0];
            at.y[i] = radius * normal[1];
            at.z[i] = z[first + i];
        }
        for (int64_t k = 0; k < n; k++) {
            const Shot shot = shot_of(&head, k);
            const int64_t to = k * j + first;
            place(shot.camera, &at, count, &there);
            see(shot.lens, &there, count, u, v);
            seen_at(&shot, &there, u, v, count, grey + to);
            scale_of(&shot, &there, u, v, count, squared);
            place(shot.head, &at, count, &there);
            shade(&shot, &there, count, gain + to, depth + to);
            place(shot.projector, &at, count, &there);
            light(&shot.slide, &there, count, phase, &gradient);
            const double ax = shot.projector[2], ay = shot.projector[6], az = shot.projector[10];
            for (int64_t i = 0; i < count; i++) {
                const double rate = gradient.x[i] * ax + gradient.y[i] * ay + gradient.z[i] * az;
                blur[to + i] = blur_px * sqrt(squared[i]);
                depth[to + i] *= exponential(0.5 * (rate * blur[to + i]) * (rate * blur[to + i]));
            }
        }
    }
}
