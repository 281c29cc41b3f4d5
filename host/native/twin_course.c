// What the camera sees of a pipe of several pieces, with water in it: each pixel's ray met one at a time, lit by the
// same lamps as any wall.
//
// Of a place under water the stretch says where the projector's light would have come to had it gone on straight, its
// normal is shortened to the cosine that the light arrives with, `open` is what the surface lets in, `view` what it
// lets out (Snell, Fresnel). A row with water in it is drawn twice, for what the surface mirrors.

#include "twin_tube.h"

static const double WATER = 1.333;   // refractive index
static const double FAR_MM = 500.0;  // what is further is not lit
static const double LAMP_MM = 0.1;   // short of the wall, where the way to a lamp ends: the wall does not hide itself
static const double SLANT = 0.02;    // least cosine to the wall's normal that a blur is drawn out by
enum { HALVINGS = 40 };              // of a way on the water: to 1e-9 mm of a metre

// Part of unpolarised light that goes through a water surface at an angle whose cosine is given (Fresnel).
DOOR double twin_passed(const double cosine)
{
    const double inner = sqrt(1.0 - (1.0 - cosine * cosine) / (WATER * WATER));
    const double across = (cosine - WATER * inner) / (cosine + WATER * inner);
    const double along = (WATER * cosine - inner) / (WATER * cosine + inner);
    return 1.0 - (across * across + along * along) / 2.0;
}

// How far (mm) from above one point light enters the water on its way to another, by Snell's law.
DOOR double twin_entry(const double above, const double below, const double apart)
{
    double low = 0.0, high = apart;
    for (int64_t i = 0; i < HALVINGS; i++) {
        const double x = (low + high) / 2.0, left = apart - x;
        if (x * sqrt(left * left + below * below) < WATER * left * sqrt(x * x + above * above)) {
            low = x;
        } else {
            high = x;
        }
    }
    return (low + high) / 2.0;
}

// Where a ray ends, and on what.
typedef struct {
    Point place, way;    // space; at the end, bent by water
    double range, view;  // mm; part of its light that comes back
    int64_t piece;
    bool wet, met;  // whether it came to water, and to a wall
} Met;

// mirrored : what the surface shows instead of what lies under it.
INLINE Met meet(const Tube* const tube, const Point from, const Point ray, const bool mirrored, const int64_t hint)
{
    const double level = tube->numbers.level;
    Met met = {from, ray, 0.0, 1.0, hint, false, false};
    double range = leaves(tube, from, ray, FAR_MM, &met.piece);
    if (ray.y > 1e-6 && from.y + range * ray.y > level) {
        met.wet = true;
        met.range = (level - from.y) / ray.y;
        met.place = (Point){from.x + met.range * ray.x, level, from.z + met.range * ray.z};
        met.view = twin_passed(ray.y);
        if (mirrored) {
            met.way.y = -ray.y;
            met.view = 1.0 - met.view;
        } else {
            met.way = (Point){ray.x / WATER, sqrt(1.0 - (1.0 - ray.y * ray.y) / (WATER * WATER)), ray.z / WATER};
        }
        range = leaves(tube, met.place, met.way, FAR_MM, &met.piece);
    }
    met.met = range < FAR_MM && (met.range != 0.0 || !mirrored);
    met.place = beyond(met.place, met.way, range);
    met.range += range;
    return met;
}

// Light of a lamp at a place: from where it seems to come, how far, and how much of it.
typedef struct {
    Point from_lamp, normal;  // mm; shortened where it comes through water
    double away, light;
} Arrived;

INLINE Arrived through_water(const Point lamp, const double level, const Point place, const Point normal)
{
    const Point p = from_to(lamp, place);
    const double above = level - lamp.y, below = place.y - level, apart = sqrt(p.x * p.x + p.z * p.z);
    const double x = twin_entry(above, below, apart);
    const double dry = sqrt(x * x + above * above), left = apart - x;
    const double away = dry + sqrt(left * left + below * below), cosine = above / dry;
    const double inner = sqrt(1.0 - (1.0 - cosine * cosine) / (WATER * WATER));
    const double in_water = sqrt(1.0 - inner * inner) / apart, in_air = sqrt(1.0 - cosine * cosine) / apart;
    const double facing = p.x * in_water * normal.x + inner * normal.y + p.z * in_water * normal.z;
    const Point seems = {p.x * in_air * away, cosine * away, p.z * in_air * away};
    const double scale = facing / away;
    return (Arrived){seems, {seems.x * scale, seems.y * scale, seems.z * scale}, away, twin_passed(cosine)};
}

// How fast the cotangent of the angle to the projector's axis turns as the ray does, on the plane that the wall is
// here.
INLINE double turning(const Arrived* const light, const Point axis, const Met* const met, const Point normal)
{
    const Point p = light->from_lamp;
    const double cosine = times(p, axis) / light->away, square = 1.0 - cosine * cosine;
    const double sine2 = square > 1e-6 ? square : 1e-6, by = 1.0 / (light->away * sqrt(sine2));
    const double scale = cosine / light->away;
    const Point t = {by * (p.x * scale - axis.x), by * (p.y * scale - axis.y), by * (p.z * scale - axis.z)};
    const double slant = times(met->way, normal);
    const Point off = beyond(t, normal, -times(t, met->way) / (slant > SLANT ? slant : SLANT));
    return met->range * sqrt(times(off, off)) / sine2;
}

// What each pixel sees; `spread` becomes that of ray_table in twin/rays.py for the wall it really meets, 0 where
// nothing is to be drawn. rims : cosines to the projector's axis between which there is light. dark : only the
// projector is lit. Whether water is in view.
static bool meet_tube(Stretch* const s, const Eye* const eye, const float* const pixel_rad, const Tube* const tube,
                      const float* const lamp, const double* const rims, const bool mirrored, const bool dark,
                      const int64_t hint)
{
    const float* const r = eye->rotation;
    const Point from = {(double)eye->station[0], (double)eye->station[1], (double)eye->station[2]};
    const Point centre = {(double)lamp[0], (double)lamp[1], (double)lamp[2]};
    const Point axis = {(double)lamp[3], (double)lamp[4], (double)lamp[5]};
    bool wet = false;
    for (int64_t k = 0; k < s->n; k++) {
        const bool seen = s->spread[k] > 0.0f;
        s->spread[k] = 0.0f;
        if (!seen) {
            continue;
        }
        const double dx = (double)s->ray_x[k], dy = (double)s->ray_y[k];
        const double dz = root(1.0 - dx * dx - dy * dy);
        const Point ray = {(double)r[0] * dx + (double)r[3] * dy + (double)r[6] * dz,
                           (double)r[1] * dx + (double)r[4] * dy + (double)r[7] * dz,
                           (double)r[2] * dx + (double)r[5] * dy + (double)r[8] * dz};
        Met met = meet(tube, from, ray, mirrored, hint);
        wet = wet || met.wet;
        if (!met.met) {
            continue;
        }
        Arrived light = {from_to(centre, met.place), {0.0, 0.0, 0.0}, 0.0, 1.0};
        const bool under = met.place.y > tube->numbers.level;
        bool lit = true;
        if (!under) {
            light.away = sqrt(times(light.from_lamp, light.from_lamp));
            const double cosine = times(light.from_lamp, axis) / light.away;
            lit = rims[0] > cosine && cosine > rims[1];
            if (!lit && dark) {
                continue;
            }
        }
        const Point normal = normal_at(tube, met.place, met.piece);
        const Spot spot = spot_at(tube, met.place, met.piece);
        if (under) {
            light = through_water(centre, tube->numbers.level, met.place, normal);
        } else {
            const double scale = 1.0 / light.away;
            const Point way = {light.from_lamp.x * scale, light.from_lamp.y * scale, light.from_lamp.z * scale};
            int64_t piece = spot.piece;
            lit = lit && times(light.from_lamp, normal) > 0.0;
            lit = lit && leaves(tube, centre, way, light.away - LAMP_MM, &piece) >= light.away - LAMP_MM;
            light.light = lit ? 1.0 : 0.0;
            light.normal = normal;
        }
        s->spread[k] = (float)(turning(&light, axis, &met, normal) * (double)pixel_rad[k] + 1e-9);
        s->range[k] = (float)met.range;
        s->x[k] = (float)(centre.x + light.from_lamp.x);
        s->y[k] = (float)(centre.y + light.from_lamp.y);
        s->z[k] = (float)(centre.z + light.from_lamp.z);
        s->nx[k] = (float)light.normal.x;
        s->ny[k] = (float)light.normal.y;
        s->nz[k] = (float)light.normal.z;
        s->open[k] = (float)light.light;
        s->view[k] = (float)met.view;
        s->paint[k] = (float)tube->pieces[spot.piece].bright;
        s->column[k] = (float)map_column(tube, spot.u, spot.v);
        s->plain[k] = (float)spot.s;
    }
    return wet;
}

// Rows of one frame. lit : see `meet_tube`. hint : the piece that the head is in.
DOOR void twin_draw_course(uint8_t* const out, const int64_t seed, const float* const rays, const float* const eye,
                           const float* const pixel_rad, const double* const rims, const int64_t hint,
                           const double* const course, const double* const pieces, const double* const beads,
                           const double* const bores, const float* const deviation, const uint8_t* const rough,
                           const double* const near, const double* const leap, const uint8_t* const albedo,
                           const float* const base, const float* const beam_gain, const float* const beam,
                           const float* const rods, const int64_t slide, const float* const slide_numbers,
                           const float* const led_gain, const float* const led, const float* const pixel,
                           const float* const noise, const int64_t h, const int64_t w, const int64_t q, const int64_t b,
                           const int64_t o, const int64_t r, const int64_t p, const int64_t y, const int64_t a,
                           const int64_t n, const int64_t s, const int64_t z)
{
    if (q < 1 || y < 1 || r < 2 || p < 2 || a < 2 || z <= w) {
        return;
    }
    Eye at;
    Pixel sensor;
    const Paint paint = {albedo, base, r, a};
    const Tube tube = tube_of(course, pieces, beads, bores, deviation, rough, near, leap, q, b, o, r, p, y);
    const Lights lights = lights_of(beam_gain, beam, rods, slide, slide_numbers, led_gain, led, n, s);
    memcpy(&at, eye, sizeof at);
    memcpy(&sensor, pixel, sizeof sensor);
    const int64_t start = least(most(hint, 0), q - 1);
    Dice dice = dice_of(seed, noise, z - w);
    Stretch stretch = {0};
    for (int64_t v = 0; v < h; v++) {
        const float* const thrown = row_of(&dice, v);
        const bool led_lit = led_gain[v] > 0.0f;
        if (!led_lit && !(beam_gain[v] > 0.0f)) {
            expose(out + v * w, thrown, NULL, &sensor, v, 0, w);
            continue;
        }
        for (int64_t u = 0; u < w; u += PIXELS) {
            float sum[PIXELS] = {0.0f}, row[PIXELS] = {0.0f}, white[PIXELS];
            bool wet = true;
            for (int64_t mirrored = 0; mirrored < 2 && wet; mirrored++) {
                begin(&stretch, rays, h * w, v, w, u, least(PIXELS, w - u));
                memset(stretch.level, 0, sizeof stretch.level);
                wet = meet_tube(&stretch, &at, pixel_rad + v * w + u, &tube, lights.beam.centre, rims, mirrored == 1,
                                !led_lit, start);
                shine(&stretch, &lights);
                for (int64_t k = 0; k < stretch.n; k++) {
                    row[k] = stretch.plain[k] * (float)tube.numbers.map_rows_a_mm;
                }
                reflected(&stretch, &paint, row, white);
                for (int64_t k = 0; k < stretch.n; k++) {
                    const float back = stretch.level[k] * white[k] * stretch.paint[k] * stretch.view[k];
                    sum[k] += stretch.spread[k] > 0.0f ? back : 0.0f;
                }
            }
            expose(out + v * w, thrown, sum, &sensor, v, u, stretch.n);
        }
    }
}
