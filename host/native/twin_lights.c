// What lights the wall: the projector, a point whose light falls off, is turned from, is stopped by rods and let
// through by a slide; and white LEDs round the lens, as one point behind it that shines all round.

#include "twin.h"

// A slide adds to `level` what it lets through of `lit`. Kinds by their places here, as the `kind` of slides in
// twin/lights and in wings has them.
static void (*const SLIDES[])(Stretch*, const Beam*, const float*, int64_t) = {through_slits, through_fringes};
enum { SLIDE_KINDS = sizeof SLIDES / sizeof SLIDES[0] };

// What the beam would give each pixel's place without a slide, and at which angle to its axis that place lies.
static void fall(Stretch* const s, const Beam* const beam, const float gain)
{
    const float* const c = beam->centre;
    const float vx = c[0], vy = c[1], vz = c[2], ax = c[3], ay = c[4], az = c[5], power = gain * beam->power;
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float px = s->x[k] - vx, py = s->y[k] - vy, pz = s->z[k] - vz;
        const float inverse = 1.0f / sqrtf(px * px + py * py + pz * pz);
        const float facing = px * s->nx[k] + py * s->ny[k] + pz * s->nz[k];
        const float towards = facing > 0.0f ? facing : 0.0f;
        s->lit[k] = power * towards * inverse * inverse * inverse * s->open[k];
        s->at[k] = (px * ax + py * ay + pz * az) * inverse;
    }
}

// A rod on the way of the light.
static void shade(Stretch* const s, const Beam* const beam, const float* const rod)
{
    const float* const r = beam->rotation;
    const float r00 = r[0], r01 = r[1], r02 = r[2], r10 = r[3], r11 = r[4], r12 = r[5], r20 = r[6], r21 = r[7];
    const float r22 = r[8], vx = beam->centre[0], vy = beam->centre[1], vz = beam->centre[2];
    const float rx = rod[0], ry = rod[1], thick = rod[2], back = rod[3], front = rod[4];
    float px[PIXELS], py[PIXELS];
    int32_t near = 0;
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float x = s->x[k] - vx, y = s->y[k] - vy, z = s->z[k] - vz;
        px[k] = r00 * x + r01 * y + r02 * z;
        py[k] = r10 * x + r11 * y + r12 * z;
        const float beside = rx * py[k] - ry * px[k];
        const bool close = beside * beside < 4.0f * thick * thick * (px[k] * px[k] + py[k] * py[k]);
        near |= close & (rx * px[k] + ry * py[k] > 0.0f);
    }
    if (near == 0) {
        return;
    }
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float x = s->x[k] - vx, y = s->y[k] - vy, z = s->z[k] - vz;
        const float pz = r20 * x + r21 * y + r22 * z;
        const float flat2 = px[k] * px[k] + py[k] * py[k];
        const float t = (rx * px[k] + ry * py[k]) / flat2;  // where on its way the light passes nearest to the rod
        const float at = t * pz;
        const float beyond = at - front > back - at ? at - front : back - at, past = beyond > 0.0f ? beyond : 0.0f;
        const float past2 = past * past * flat2 / (flat2 + pz * pz);
        const float square = rx * rx + ry * ry - t * t * flat2 + past2;
        const float distance = sqrtf(square > 0.0f ? square : 0.0f);
        const float far = s->range[k] * (t > 0.05f ? t : 0.05f);
        const float through = step_up((distance - thick) * beam->focal / (beam->blur * far));
        s->lit[k] *= t > 0.0f ? through : 1.0f;
    }
}

static void glow(Stretch* const s, const Led* const led, const float gain)
{
    const float lx = led->place[0], ly = led->place[1], lz = led->place[2];
    const float even = gain * even_of(s, led->power), odd = gain * odd_of(s, led->power);
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float x = s->x[k] - lx, y = s->y[k] - ly, z = s->z[k] - lz;
        const float d2 = x * x + y * y + z * z;
        const float facing = x * s->nx[k] + y * s->ny[k] + z * s->nz[k];
        const float towards = facing > 0.0f ? facing : 0.0f;
        s->level[k] += ((k & 1) != 0 ? odd : even) * towards / (d2 * sqrtf(d2));
    }
}

// Adds all light that arrives to `level`.
void shine(Stretch* const s, const Lights* const lights)
{
    const float beam_gain = lights->beam_gain[s->v], led_gain = lights->led_gain[s->v];
    if (beam_gain > 0.0f && lights->slide >= 0 && lights->slide < SLIDE_KINDS) {
        fall(s, &lights->beam, beam_gain);
        for (int64_t i = 0; i < lights->rod_count; i++) {
            shade(s, &lights->beam, lights->rods + 5 * i);
        }
        SLIDES[lights->slide](s, &lights->beam, lights->slide_numbers, lights->slide_size);
    }
    if (led_gain > 0.0f) {
        glow(s, &lights->led, led_gain);
    }
}
