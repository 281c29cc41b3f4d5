// What an LED frame shows of places of the wall, and the sum over frames of what they show.
//
// Between pixels a place is on the plane patch of its four, linear along either way: as OpenCV's remap has it, to a
// last bit.

#include "native.h"

enum { CHANNELS = 3 };

typedef struct {
    int64_t first;  // of the image's bytes, the upper left pixel of four
    float right, down;
    bool inside;
} Place;

INLINE Place place_of(const double* const pixel, const int64_t h, const int64_t w)
{
    Place out = {0, 0.0F, 0.0F, false};
    const double x = pixel[0], y = pixel[1];
    if (x >= 1.0 && x <= (double)(w - 2) && y >= 1.0 && y <= (double)(h - 2)) {
        const float at = (float)x, below = (float)y;
        const int64_t column = least((int64_t)at, w - 2), row = least((int64_t)below, h - 2);
        out.first = CHANNELS * (row * w + column);
        out.right = at - (float)column;
        out.down = below - (float)row;
        out.inside = true;
    }
    return out;
}

INLINE float between(const Place* const at, const float a, const float b, const float c, const float d)
{
    const float upper = a + at->right * (b - a), lower = c + at->right * (d - c);
    return upper + at->down * (lower - upper);
}

INLINE uint8_t brightest(const uint8_t* const pixel)
{
    const uint8_t more = pixel[0] > pixel[1] ? pixel[0] : pixel[1];
    return more > pixel[2] ? more : pixel[2];
}

// The colours (n, 3) of an image at pixels (n, 2), and which of those lie in it with all about them.
DOOR void colours_at(const uint8_t* const image, const double* const pixels, uint8_t* const colour, bool* const inside,
                     const int64_t h, const int64_t w, const int64_t n)
{
    for (int64_t i = 0; i < (h > 0 && w > 0 ? n : 0); i++) {
        const Place at = place_of(pixels + 2 * i, h, w);
        inside[i] = at.inside;
        const uint8_t *const p = image + at.first, *const q = p + (at.inside ? CHANNELS * w : 0);
        const int64_t next = at.inside ? CHANNELS : 0;
        for (int64_t k = 0; k < CHANNELS; k++) {
            const float value = between(&at, p[k], p[k + next], q[k], q[k + next]);
            colour[CHANNELS * i + k] = (uint8_t)rintf(value);
        }
    }
}

// The same of the brightest channel of each pixel.
DOOR void light_at(const uint8_t* const image, const double* const pixels, float* const light, bool* const inside,
                   const int64_t h, const int64_t w, const int64_t n)
{
    for (int64_t i = 0; i < (h > 0 && w > 0 ? n : 0); i++) {
        const Place at = place_of(pixels + 2 * i, h, w);
        inside[i] = at.inside;
        const uint8_t *const p = image + at.first, *const q = p + (at.inside ? CHANNELS * w : 0);
        const int64_t next = at.inside ? CHANNELS : 0;
        light[i] = between(&at, brightest(p), brightest(p + next), brightest(q), brightest(q + next));
    }
}

// Adds a frame's colours (r, a, 3) to `total` and what they weigh to `weight` (r, a): rows weigh `near` (r,), and their
// colours are over `gain` (r,), NaN of a row whose light is not known. No brighter than `black` is no colour.
DOOR void add_colours(const uint8_t* const colour, const bool* const inside, const float* const gain,
                      const float* const near, const double black, float* const total, float* const weight,
                      const int64_t r, const int64_t a)
{
    for (int64_t row = 0; row < r; row++) {
        if (!isfinite(gain[row])) {
            continue;
        }
        for (int64_t i = row * a; i < (row + 1) * a; i++) {
            const uint8_t* const own = colour + CHANNELS * i;
            if (!inside[i] || !((double)brightest(own) > black)) {
                continue;
            }
            for (int64_t k = 0; k < CHANNELS; k++) {
                total[CHANNELS * i + k] += (float)own[k] / gain[row] * near[row];
            }
            weight[i] += near[row];
        }
    }
}
