// What an LED frame shows of places of the wall, and the sum over frames of what they show.
//
// Between pixels a place is on the plane patch of its four, linear along either way: as OpenCV's remap has it, to a
// last bit.

#include "native.h"

enum { CHANNELS = 3, BLOCK = 64 };  // places looked up at a time: the image is far larger than what is near at hand
typedef struct {
    int64_t first[BLOCK];  // of the image's bytes, the upper left pixel of four
    float right[BLOCK], down[BLOCK];
} Places;

// Where a block of pixels (n, 2) lies, of those that do not lie in the image some place in it; what they need of the
// image is asked for meanwhile.
INLINE void places_of(const uint8_t* const image, const double* const pixels, const int64_t size, Places* const to,
                      bool* const inside, const int64_t h, const int64_t w)
{
    const double right_most = (double)(w - 2), down_most = (double)(h - 2);
    for (int64_t i = 0; i < size; i++) {
        const double x = pixels[2 * i], y = pixels[2 * i + 1];
        inside[i] = (x >= 1.0) & (x <= right_most) & (y >= 1.0) & (y <= down_most);
        const float at = (float)held(x, 0.0, right_most), below = (float)held(y, 0.0, down_most);
        const int64_t column = least((int64_t)at, w - 2), row = least((int64_t)below, h - 2);
        to->first[i] = CHANNELS * (row * w + column);
        to->right[i] = at - (float)column;
        to->down[i] = below - (float)row;
    }
    for (int64_t i = 0; i < size; i++) {
        __builtin_prefetch(image + to->first[i]);
        __builtin_prefetch(image + to->first[i] + CHANNELS * w);
    }
}

// What the four pixels about each place of a block show: upper left, upper right, lower left, lower right.
typedef struct {
    uint8_t of[4][CHANNELS][BLOCK];
} Corners;

INLINE void corners_of(const uint8_t* const image, const Places* const at, const int64_t size, Corners* const to,
                       const int64_t w)
{
    for (int64_t i = 0; i < size; i++) {
        const uint8_t *const upper = image + at->first[i], *const lower = upper + CHANNELS * w;
        for (int64_t k = 0; k < CHANNELS; k++) {
            to->of[0][k][i] = upper[k];
            to->of[1][k][i] = upper[CHANNELS + k];
            to->of[2][k][i] = lower[k];
            to->of[3][k][i] = lower[CHANNELS + k];
        }
    }
}

INLINE float between(const Places* const at, const int64_t i, const float a, const float b, const float c,
                     const float d)
{
    const float upper = a + at->right[i] * (b - a), lower = c + at->right[i] * (d - c);
    return upper + at->down[i] * (lower - upper);
}

// The colours (n, 3) of an image at pixels (n, 2), and which of those lie in it with all about them.
DOOR void colours_at(const uint8_t* const image, const double* const pixels, uint8_t* const colour, bool* const inside,
                     const int64_t h, const int64_t w, const int64_t n)
{
    Places at;
    Corners corners;
    uint8_t out[CHANNELS][BLOCK];
    for (int64_t begin = 0; begin < (h > 2 && w > 2 ? n : 0); begin += BLOCK) {
        const int64_t size = least(BLOCK, n - begin);
        places_of(image, pixels + 2 * begin, size, &at, inside + begin, h, w);
        corners_of(image, &at, size, &corners, w);
        for (int64_t k = 0; k < CHANNELS; k++) {
            for (int64_t i = 0; i < size; i++) {
                const float value =
                    between(&at, i, corners.of[0][k][i], corners.of[1][k][i], corners.of[2][k][i], corners.of[3][k][i]);
                out[k][i] = (uint8_t)rintf(value);
            }
        }
        for (int64_t i = 0; i < size; i++) {
            for (int64_t k = 0; k < CHANNELS; k++) {
                colour[CHANNELS * (begin + i) + k] = out[k][i];
            }
        }
    }
}

INLINE uint8_t brightest(const uint8_t one, const uint8_t two, const uint8_t three)
{
    const uint8_t more = one > two ? one : two;
    return more > three ? more : three;
}

// The same of the brightest channel of each pixel.
DOOR void light_at(const uint8_t* const image, const double* const pixels, float* const light, bool* const inside,
                   const int64_t h, const int64_t w, const int64_t n)
{
    Places at;
    Corners corners;
    for (int64_t begin = 0; begin < (h > 2 && w > 2 ? n : 0); begin += BLOCK) {
        const int64_t size = least(BLOCK, n - begin);
        places_of(image, pixels + 2 * begin, size, &at, inside + begin, h, w);
        corners_of(image, &at, size, &corners, w);
        for (int64_t corner = 0; corner < 4; corner++) {
            uint8_t(*const of)[BLOCK] = corners.of[corner];
            for (int64_t i = 0; i < size; i++) {
                of[0][i] = brightest(of[0][i], of[1][i], of[2][i]);
            }
        }
        for (int64_t i = 0; i < size; i++) {
            light[begin + i] =
                between(&at, i, corners.of[0][0][i], corners.of[1][0][i], corners.of[2][0][i], corners.of[3][0][i]);
        }
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
            if (!inside[i] || !((double)brightest(own[0], own[1], own[2]) > black)) {
                continue;
            }
            for (int64_t k = 0; k < CHANNELS; k++) {
                total[CHANNELS * i + k] += (float)own[k] / gain[row] * near[row];
            }
            weight[i] += near[row];
        }
    }
}
