// What a slide with circular slits lets through: coloured stripes with black rings between them, or lit rings in the
// dark.
//
// Lens blur is not a filter over the image: a slit's edge is a step in projected angle, smoothed by what the blur
// subtends in that angle at that pixel. A wall that light enters shows each edge as a sum of parts, every one farther
// along the pipe and softer than it came in.

#include "twin.h"

// Before the tables: (slits, 9) vertex, axis (pipe frame), cosine and sine of the half-angle, half-width (rad), the
// first and the last being the pattern's rims; (slits + 1, 3) stripes as red, green and blue pixels see them, [i]
// inside and [i + 1] outside of slit i; (slits, 2, parts, 3) of the edge inside and outside of each: mm along the pipe,
// share, sigma in mm; and the nearest slit by cosine of the angle to the beam's axis.
typedef struct {
    float slits, parts;
    float cos0, cos_step;  // of the first bin; bins a unit
    float leak;            // of the stripes' light through a slit
    float line[3];         // what red, green and blue pixels see of light through a slit
} SlitNumbers;

enum { SLITS_MOST = 127, PARTS_MOST = 64 };

typedef struct {
    const float *slit, *inside, *outside, *leaving;
    int64_t parts;
    float leak, line_even, line_odd;
} Slit;

typedef struct {
    float off[LANES], cosine[LANES], sine[LANES], sine2[LANES], away[LANES], z[LANES];
} Angles;

INLINE void angles(const Stretch* const s, const float* const slit, const int64_t first, Angles* const out)
{
    const float vx = slit[0], vy = slit[1], vz = slit[2], ax = slit[3], ay = slit[4], az = slit[5];
    for (int64_t l = 0; l < LANES; l++) {
        const float px = s->x[first + l] - vx, py = s->y[first + l] - vy, pz = s->z[first + l] - vz;
        const float away = sqrtf(px * px + py * py + pz * pz);
        const float cosine = (px * ax + py * ay + pz * az) / away;
        const float square = 1.0f - cosine * cosine, sine2 = square > 1e-9f ? square : 1e-9f;
        const float sine = sqrtf(sine2);
        out->off[l] = sine * slit[6] - cosine * slit[7];  // sin(theta_P - theta), small
        out->cosine[l] = cosine;
        out->sine[l] = sine;
        out->sine2[l] = sine2;
        out->away[l] = away;
        out->z[l] = pz;
    }
}

INLINE void add(Stretch* const s, const int64_t first, const Slit* const slit, const float* const inside,
                const float* const outside)
{
    const float in_even = even_of(s, slit->inside), in_odd = odd_of(s, slit->inside);
    const float out_even = even_of(s, slit->outside), out_odd = odd_of(s, slit->outside);
    for (int64_t l = 0; l < LANES; l++) {
        const bool odd = ((first + l) & 1) != 0;
        const float colour_in = odd ? in_odd : in_even, colour_out = odd ? out_odd : out_even;
        const float between_them = 1.0f - inside[l] - outside[l];
        const float through = slit->leak * (colour_in + colour_out) + (odd ? slit->line_odd : slit->line_even);
        const float share = inside[l] * colour_in + outside[l] * colour_out + between_them * through;
        s->level[first + l] = s->lit[first + l] * share;
    }
}

// Pixels from `first` on that one slit is nearest to; what lies beyond the last is written again by the next.
INLINE void sharp(Stretch* const s, const Beam* const beam, const Slit* const slit, const int64_t first)
{
    Angles angle;
    float inside[LANES], outside[LANES];
    const float wide = slit->slit[8], blur = beam->blur;
    angles(s, slit->slit, first, &angle);
    for (int64_t l = 0; l < LANES; l++) {
        const float rate = 1.0f / (blur * angle.sine2[l] * s->spread[first + l] + 1e-9f);
        inside[l] = 1.0f - step_up((angle.off[l] + wide) * rate);
        outside[l] = step_up((angle.off[l] - wide) * rate);
    }
    add(s, first, slit, inside, outside);
}

// The same on a wall that light enters.
static void soft(Stretch* const s, const Beam* const beam, const Slit* const slit, const int64_t first)
{
    Angles angle;
    float inside[LANES] = {0.0f}, outside[LANES] = {0.0f}, turn[LANES], lens2[LANES];
    const float az = slit->slit[5], wide = slit->slit[8];
    angles(s, slit->slit, first, &angle);
    for (int64_t l = 0; l < LANES; l++) {  // of the light's angle, one mm up the pipe
        const float lens = beam->blur * angle.sine2[l] * s->spread[first + l];
        turn[l] = (az - angle.cosine[l] * angle.z[l] / angle.away[l]) / (angle.away[l] * angle.sine[l]);
        lens2[l] = lens * lens;
    }
    const float* near = slit->leaving;
    for (int64_t j = 0; j < slit->parts; j++, near += 3) {
        const float* const far = near + 3 * slit->parts;
        for (int64_t l = 0; l < LANES; l++) {
            const float turn2 = turn[l] * turn[l];
            const float near_blur = sqrtf(lens2[l] + near[2] * near[2] * turn2) + 1e-9f;
            const float far_blur = sqrtf(lens2[l] + far[2] * far[2] * turn2) + 1e-9f;
            inside[l] += near[1] * (1.0f - step_up((angle.off[l] + near[0] * turn[l] + wide) / near_blur));
            outside[l] += far[1] * step_up((angle.off[l] + far[0] * turn[l] - wide) / far_blur);
        }
    }
    add(s, first, slit, inside, outside);
}

void through_slits(Stretch* const s, const Beam* const beam, const float* const numbers, const int64_t size)
{
    SlitNumbers head;
    const int64_t before = (int64_t)(sizeof head / sizeof(float));
    if (size < before) {
        return;
    }
    memcpy(&head, numbers, sizeof head);
    const int64_t slits = whole((double)head.slits, 0, SLITS_MOST), parts = whole((double)head.parts, 0, PARTS_MOST);
    const int64_t bins = size - before - 9 * slits - 3 * (slits + 1) - 6 * slits * parts;
    if (slits < 1 || bins < 1) {
        return;
    }
    const float* const table = numbers + before;
    const float* const colours = table + 9 * slits;
    const float* const leaving = colours + 3 * (slits + 1);
    const float* const nearest = leaving + 6 * slits * parts;
    const float last_bin = (float)(bins - 1);
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        s->mark[k] = (int32_t)held_f((s->at[k] - head.cos0) * head.cos_step, 0.0f, last_bin);
    }
    for (int64_t first = 0; first < s->n;) {
        const float nearest_here = nearest[s->mark[first]];
        int64_t end = first + 1;
        while (end < s->n && nearest[s->mark[end]] == nearest_here) {
            end++;
        }
        const int64_t i = (int64_t)held_f(nearest_here, 0.0f, (float)(slits - 1));
        const Slit slit = {table + 9 * i, colours + 3 * i, colours + 3 * (i + 1), leaving + 6 * parts * i,
                           parts,         head.leak,       even_of(s, head.line), odd_of(s, head.line)};
        for (int64_t k = first; k < end; k += LANES) {
            if (parts > 0) {
                soft(s, beam, &slit, k);
            } else {
                sharp(s, beam, &slit, k);
            }
        }
        first = end;
    }
}
