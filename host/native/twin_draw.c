// What the camera sees of a pipe of one piece: rows of a Bayer frame, lit by as much of each lamp as the gates gave
// them.

#include "mathematics.h"
#include "twin.h"

typedef struct {
    int64_t first, end;
} Span;

// Which pixels of a row can hold light: all, or left and right of the pattern's hole.
static void lit_part(const int64_t v, const int64_t width, const Lights* const lights, Span out[2])
{
    out[0] = out[1] = (Span){0, 0};
    const float* const lit = lights->beam.lit;
    if (lights->led_gain[v] > 0.0f) {
        out[0].end = width;
    } else if (lights->beam_gain[v] > 0.0f) {
        const float dv = (float)v - lit[1];
        const float chord = lit[3] * lit[3] - dv * dv, hole = lit[2] * lit[2] - dv * dv;
        if (!(chord > 0.0f)) {
            return;
        }
        const float half = sqrtf(chord);
        const int64_t left = whole((double)(lit[0] - half), 0, width);
        const int64_t right = most(least(whole((double)(lit[0] + half), 0, width) + 2, width), left);
        out[0] = (Span){left, right};
        out[1] = (Span){right, right};
        if (hole > 0.0f) {
            const float half_hole = sqrtf(hole);
            out[1].first = most(whole((double)(lit[0] + half_hole), 0, right), left);
            out[0].end = most(least(whole((double)(lit[0] - half_hole), 0, width) + 1, out[1].first), left);
        }
    }
}

// Albedo 0..1 at the pixels' columns and rows of the map, of the channel that each sees.
void reflected(const Stretch* const s, const Paint* const paint, const float* const row, float* const white)
{
    int32_t i[PIXELS], j[PIXELS];
    uint32_t cells[PIXELS];
    float fi[PIXELS], fj[PIXELS];
    const float bottom = (float)paint->rows - 1.0f, right = (float)paint->pitch - 1.01f;
    const float even = even_of(s, paint->base), odd = odd_of(s, paint->base);
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float r = held_f(row[k], 0.0f, bottom - 0.01f), c = held_f(s->column[k], 0.0f, right);
        i[k] = (int32_t)r;
        j[k] = (int32_t)c;
        fi[k] = r - (float)i[k];
        fj[k] = c - (float)j[k];
    }
    const int64_t plane = paint->rows * paint->pitch;
    const uint8_t* const of[2] = {paint->albedo + channel_of(s, 0) * plane, paint->albedo + channel_of(s, 1) * plane};
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const uint8_t* const cell = of[k & 1] + i[k] * paint->pitch + j[k];
        const uint8_t* const next = cell + paint->pitch;
        cells[k] = cell[0] | (uint32_t)cell[1] << 8 | (uint32_t)next[0] << 16 | (uint32_t)next[1] << 24;
    }
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float p = (float)(int32_t)(cells[k] & 255), q = (float)(int32_t)(cells[k] >> 8 & 255);
        const float r = (float)(int32_t)(cells[k] >> 16 & 255), t = (float)(int32_t)(cells[k] >> 24);
        const float a = p + fj[k] * (q - p), b = r + fj[k] * (t - r);
        const float painted = (a + fi[k] * (b - a)) * (1.0f / 255.0f), bare = (k & 1) != 0 ? odd : even;
        white[k] = row[k] >= 0.0f && row[k] < bottom ? painted : bare;
    }
}

// Light that arrives to light that comes back.
static void reflect(Stretch* const s, const Paint* const paint, const Wall* const wall)
{
    float row[PIXELS], white[PIXELS] = {0.0f};
    const float even = even_of(s, paint->base), odd = odd_of(s, paint->base);
    int32_t painted = 0;
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        row[k] = (s->z[k] - wall->numbers.z0) * wall->numbers.rows_a_mm;
        painted |= s->paint[k] > 0.0f;
    }
    if (painted != 0) {
        reflected(s, paint, row, white);
    }
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float bare = (k & 1) != 0 ? odd : even, share = s->paint[k] > 0.0f ? white[k] : bare;
        s->level[k] *= s->spread[k] > 0.0f ? share : 0.0f;  // the lens sees nothing there
    }
}

// Light to grey levels. level : NULL where it is dark.
INLINE void expose_any(uint8_t* const out, const float* const noise, const float* const level, const Pixel* const pixel,
                       const float even, const float odd, const int64_t count)
{
    const float read2 = pixel->read * pixel->read, shot = pixel->shot, above = pixel->black + 0.5f;
    for (int64_t k = 0; k < count; k++) {
        const float light = level == NULL ? 0.0f : level[k];
        const float value = ((k & 1) != 0 ? odd : even) * (light + sqrtf(read2 + shot * light) * noise[k]) + above;
        out[k] = (uint8_t)(int32_t)held_f(value, 0.0f, 255.0f);
    }
}

// The same, of pixels of row v of a frame from u on; noise : the row's.
void expose(uint8_t* const row, const float* const noise, const float* const level, const Pixel* const pixel,
            const int64_t v, const int64_t u, const int64_t count)
{
    const float even = pixel->balance[(v & 1) + (u & 1)], odd = pixel->balance[(v & 1) + ((u + 1) & 1)];
    if (level == NULL) {
        expose_any(row + u, noise + u, NULL, pixel, even, odd, count);
    } else {
        expose_any(row + u, noise + u, level, pixel, even, odd, count);
    }
}

// One frame, a row at a time.
DOOR void twin_draw(uint8_t* const out, const int64_t seed, const float* const rays, const float* const eye,
                    const float* const starts, const float* const wall, const float* const deviation,
                    const float* const tile_low, const float* const tile_high, const float* const near_low,
                    const float* const near_high, const uint8_t* const kind, const uint8_t* const albedo,
                    const float* const base, const float* const beam_gain, const float* const beam,
                    const float* const rods, const int64_t slide, const float* const slide_numbers,
                    const float* const led_gain, const float* const led, const float* const pixel,
                    const float* const noise, const int64_t h, const int64_t w, const int64_t r, const int64_t p,
                    const int64_t t, const int64_t c, const int64_t a, const int64_t n, const int64_t s,
                    const int64_t z)
{
    if (r < 2 || p < 2 || a < 2 || t < 1 || c < 1 || z <= w) {
        return;
    }
    Eye at;
    Pixel sensor;
    Wall met = {.columns = (float)(a - 1), .columns_a_rad = (float)((double)(a - 1) / TURN), .map = {deviation, r, p}};
    const Paint paint = {albedo, base, r, a};
    const Lights lights = lights_of(beam_gain, beam, rods, slide, slide_numbers, led_gain, led, n, s);
    memcpy(&at, eye, sizeof at);
    memcpy(&sensor, pixel, sizeof sensor);
    memcpy(&met.numbers, wall, sizeof met.numbers);
    met.tiles = t;
    met.tile_columns = c;
    met.low = tile_low;
    met.high = tile_high;
    met.near_low = near_low;
    met.near_high = near_high;
    met.kind = kind;
    Dice dice = dice_of(seed, noise, z - w);
    Stretch stretch = {0};
    for (int64_t v = 0; v < h; v++) {
        Span spans[2];
        const float* const thrown = row_of(&dice, v);
        uint8_t* const row = out + v * w;
        int64_t drawn = 0;
        lit_part(v, w, &lights, spans);
        for (int64_t i = 0; i < 2; i++) {
            for (int64_t u = spans[i].first; u < spans[i].end; u += PIXELS) {
                expose(row, thrown, NULL, &sensor, v, drawn, u - drawn);
                begin(&stretch, rays, h * w, v, w, u, least(PIXELS, spans[i].end - u));
                meet_cylinder(&stretch, &at, starts, h * w, w, met.numbers.radius);
                meet_wall(&stretch, &at, starts != NULL, &met, lights.beam.centre, beam_gain[v] > 0.0f);
                shine(&stretch, &lights);
                reflect(&stretch, &paint, &met);
                expose(row, thrown, stretch.level, &sensor, v, u, stretch.n);
                drawn = u + stretch.n;
            }
        }
        expose(row, thrown, NULL, &sensor, v, drawn, w - drawn);
    }
}
