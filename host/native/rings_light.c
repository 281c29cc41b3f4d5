// What a frame shows beside each slit: the light of its two stripes, the slit's own darkness taken off. The pixels lie
// all over the frame, so the places of slits ahead are worked out and fetched while those at hand are read.

#include <math.h>

#include "native.h"
#include "rings_picture.h"

#define AHEAD 16   // slits; a power of two
#define PACKED 20  // bits of a pixel's column; its row stands above them
#define PLACES 24  // of a slit whose pixels are fetched ahead: stripes of rings up to 60 px apart

typedef struct {
    picture_t picture;
    int64_t lines, bytes;
    double cx, cy, first, step;
    const double* cosine;
    const double* sine;
} frame_t;

// The nearest pixel to sample i of a line, as its place among the frame's.
INLINE int64_t place_of(const frame_t* const frame, const int64_t line, const int64_t i)
{
    const double far = frame->first + frame->step * (double)i;
    const int64_t x = whole(frame->cx + far * frame->cosine[line] + 0.5, 0, frame->picture.width - 1);
    const int64_t y = whole(frame->cy + far * frame->sine[line] + 0.5, 0, frame->picture.height - 1);
    return (y << PACKED) + x;
}

// Samples a, a + 2, .. to b of a line: half of them its own, the rest of its two neighbours.
INLINE int64_t line_of(const int64_t line, const int64_t offset, const int64_t lines)
{
    return !(offset & 2) ? line : around(line + ((offset & 4) ? 1 : -1), lines);
}

// The three runs of samples of a slit: of its bottom, inside, outside.
INLINE void run_of(const int32_t sample[5], const int part, int64_t* const a, int64_t* const b)
{
    *a = part == 0 ? sample[0] - 1 : part == 1 ? sample[1] : sample[3];
    *b = part == 0 ? *a + 2 : most(*a, part == 1 ? sample[2] : sample[4]);
}

// Addresses of a slit's pixels, as many as there is room for, and the memory asked for.
static void fetch(const frame_t* const frame, const int64_t line, const int32_t sample[5], int64_t places[PLACES])
{
    int64_t n = 0;
    for (int part = 0; part < 3; part++) {
        int64_t a, b;
        run_of(sample, part, &a, &b);
        for (int64_t i = a; i <= b && n < PLACES; i += 2) {
            const int64_t at = place_of(frame, line_of(line, i - a, frame->lines), i);
            const int64_t y = at >> PACKED, x = at & ((1 << PACKED) - 1);
            __builtin_prefetch(frame->picture.data + frame->bytes * (y * frame->picture.width + x));
            places[n++] = at;
        }
    }
}

INLINE void light_of(const frame_t* const frame, const int64_t* const direction, const int32_t* const samples,
                     const int64_t slits, double* const light, double* const bright, const int64_t n, const bool mosaic)
{
    int64_t places[AHEAD][PLACES];
    for (int64_t s = 0; s < least(AHEAD, slits); s++) {
        fetch(frame, bounded(direction[s], 0, frame->lines - 1), samples + 5 * s, places[s]);
    }
    for (int64_t s = 0; s < slits; s++) {
        const int64_t line = bounded(direction[s], 0, frame->lines - 1);
        const int64_t* const known = places[s & (AHEAD - 1)];
        double dark[3] = {0.0, 0.0, 0.0};
        double strongest[2] = {0.0, 0.0};
        int64_t k = 0;
        for (int part = 0; part < 3; part++) {
            int64_t a, b;
            int32_t sum[3] = {0, 0, 0};
            run_of(samples + 5 * s, part, &a, &b);
            for (int64_t i = a; i <= b; i += 2, k++) {
                const int64_t at = k < PLACES ? known[k] : place_of(frame, line_of(line, i - a, frame->lines), i);
                const pixel_t own = pixel_of(&frame->picture, at & ((1 << PACKED) - 1), at >> PACKED, mosaic);
                sum[0] += own.blue;
                sum[1] += own.green;
                sum[2] += own.red;
            }
            const double scale = (double)(float)(1.0 / (double)((b - a) / 2 + 1));
            for (int channel = 0; channel < 3; channel++) {
                const double mean = (double)sum[channel] * scale;
                if (part == 0) {
                    dark[channel] = mean;
                } else {
                    const double lit = mean > dark[channel] ? mean - dark[channel] : 0.0;
                    light[(3 * (part - 1) + channel) * n + s] = lit;
                    strongest[part - 1] = lit > strongest[part - 1] ? lit : strongest[part - 1];
                }
            }
        }
        bright[s] = strongest[0] + strongest[1];
        if (s + AHEAD < slits) {
            fetch(frame, bounded(direction[s + AHEAD], 0, frame->lines - 1), samples + 5 * (s + AHEAD),
                  places[s & (AHEAD - 1)]);
        }
    }
}

// light (6, n): blue, green, red of the stripe inside, then of that outside, of the first `size` slits; bright (n,):
// the strongest of either, together.
DOOR void rings_light(const uint8_t* const image, const int64_t phase, const double cx, const double cy,
                      const double first, const double step, const double* const cosine, const double* const sine,
                      const int64_t* const direction, const int32_t* const samples, const int64_t size,
                      double* const light, double* const bright, const int64_t h, const int64_t w, const int64_t b,
                      const int64_t j, const int64_t n)
{
    const frame_t frame = {{image, w, h, phase}, j, b, cx, cy, first, step, cosine, sine};
    if (b == IN_COLOURS) {
        light_of(&frame, direction, samples, least(size, n), light, bright, n, false);
    } else {
        light_of(&frame, direction, samples, least(size, n), light, bright, n, true);
    }
}
