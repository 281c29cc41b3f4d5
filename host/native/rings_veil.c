// The light that comes from everywhere, made from the least of each channel around each place, and taken off a frame:
// annulus_pipe.rings.pedestal has the theory. All in whole numbers but for one division, which rounds to even.

#include <math.h>
#include <string.h>

#include "native.h"

#define CHANNELS 3
#define ONE 256  // weights of two rows, or columns, that are looked between: a level of 255 times it fits 16 bits

// A place beyond an end, as if the picture were mirrored in its last row (or column).
INLINE int64_t mirrored(const int64_t at, const int64_t size)
{
    const int64_t inside = at < 0 ? -at : at >= size ? 2 * size - 2 - at : at;
    return bounded(inside, 0, size - 1);
}

// The least within `half` places to either side, in rows of `size` places (CHANNELS bytes each), then in columns.
static void least_around(const uint8_t* const values, uint8_t* const restrict rows, uint8_t* const restrict out,
                         const int64_t half, const int64_t a, const int64_t b)
{
    const int64_t bytes = CHANNELS * b;
    memset(rows, 255, (size_t)(a * bytes));
    memset(out, 255, (size_t)(a * bytes));
    for (int64_t y = 0; y < a; y++) {
        for (int64_t k = -least(half, b - 1); k <= least(half, b - 1); k++) {
            const uint8_t* const shifted = values + y * bytes + CHANNELS * k;
            for (int64_t x = CHANNELS * most(-k, 0); x < CHANNELS * least(b - k, b); x++) {
                const uint8_t value = shifted[x], darkest = rows[y * bytes + x];
                rows[y * bytes + x] = value < darkest ? value : darkest;
            }
        }
    }
    for (int64_t y = 0; y < a; y++) {
        for (int64_t k = most(y - half, 0); k <= least(y + half, a - 1); k++) {
            for (int64_t x = 0; x < bytes; x++) {
                const uint8_t value = rows[k * bytes + x], darkest = out[y * bytes + x];
                out[y * bytes + x] = value < darkest ? value : darkest;
            }
        }
    }
}

// The mean over a square of 2 half + 1 places. sums (b * CHANNELS,): room to work in, of columns.
static void mean_around(const uint8_t* const values, uint32_t* const restrict sums, uint8_t* const restrict out,
                        const int64_t half, const int64_t a, const int64_t b)
{
    const int64_t bytes = CHANNELS * b, side = 2 * half + 1;
    const double part = 1.0 / (double)(side * side);
    for (int64_t y = 0; y < a; y++) {
        memset(sums, 0, (size_t)bytes * sizeof *sums);
        for (int64_t k = -half; k <= half; k++) {
            const uint8_t* const row = values + mirrored(y + k, a) * bytes;
            for (int64_t x = 0; x < bytes; x++) {
                sums[x] += row[x];
            }
        }
        for (int64_t c = 0; c < CHANNELS; c++) {
            uint32_t total = 0;
            for (int64_t k = -half; k <= half; k++) {
                total += sums[CHANNELS * mirrored(k, b) + c];
            }
            for (int64_t x = 0; x < b; x++) {
                out[y * bytes + CHANNELS * x + c] = (uint8_t)rint((double)total * part);
                total += sums[CHANNELS * mirrored(x + half + 1, b) + c];
                total -= sums[CHANNELS * mirrored(x - half, b) + c];
            }
        }
    }
}

// Where a row (or column) of `size` lies between those of `few`, weights of ONE.
typedef struct {
    int64_t near, far;
    int32_t part;
} between_t;

INLINE between_t between(const int64_t at, const int64_t size, const int64_t few)
{
    // (at + 1/2) few / size - 1/2, in units of 1 / (2 size)
    const int64_t twice = bounded((2 * at + 1) * few - size, 0, 2 * size * (few - 1));
    const int64_t near = twice / (2 * size);
    const between_t out = {near, least(near + 1, few - 1), (int32_t)((twice % (2 * size)) * ONE / (2 * size))};
    return out;
}

// out (h, w, 3): image less the light that is no stripe's. Every step-th pixel is looked at, from the one step / 2 on;
// half: of the window that has a slit in it, and of the one that smooths; small (4, a, b, 3), sums (m,), columns (2,
// w), wide (2, v): room to work in, m and v at least 3 b and 3 w.
DOOR void rings_without_veil(const uint8_t* const image, const int64_t step, const int64_t half, const int64_t smooth,
                             uint8_t* const small, uint32_t* const sums, int32_t* const columns, uint64_t* const spread,
                             uint16_t* const wide, uint8_t* const out, const int64_t h, const int64_t w,
                             const int64_t a, const int64_t b, const int64_t m, const int64_t v)
{
    const int64_t size = a * b * CHANNELS, bytes = CHANNELS * w;
    if (m < CHANNELS * b || v < bytes) {
        return;
    }
    uint8_t* const first = small;
    uint8_t* const second = small + size;
    uint8_t* const darkest = small + 2 * size;
    uint8_t* const veil = small + 3 * size;
    for (int64_t y = 0; y < a; y++) {
        for (int64_t x = 0; x < b; x++) {
            const int64_t row = least(y * step + step / 2, h - 1), column = least(x * step + step / 2, w - 1);
            memcpy(first + CHANNELS * (y * b + x), image + row * bytes + CHANNELS * column, CHANNELS);
        }
    }
    least_around(first, second, darkest, half, a, b);
    mean_around(darkest, sums, first, half, a, b);
    // no more than the least: a stripe that goes on beyond the last slit must not smooth its own light onto that
    for (int64_t i = 0; i < size; i++) {
        first[i] = first[i] < darkest[i] ? first[i] : darkest[i];
    }
    mean_around(first, sums, veil, smooth, a, b);
    for (int64_t x = 0; x < w; x++) {
        const between_t place = between(x, w, b);
        columns[x] = (int32_t)place.near;
        columns[w + x] = place.part;
    }
    int64_t laid[2] = {-1, -1};  // which of the few rows lie in `wide`, as wide as the image, in 1/16
    for (int64_t y = 0; y < h; y++) {
        const between_t rows = between(y, h, a);
        for (int64_t k = 0; k < 2; k++) {
            const int64_t wanted = k == 0 ? rows.near : rows.far;
            if (laid[wanted & 1] == wanted) {
                continue;
            }
            laid[wanted & 1] = wanted;
            const uint8_t* const few = veil + wanted * b * CHANNELS;
            uint16_t* const row = wide + (wanted & 1) * v;
            // a pixel's channels 16 bits apart in one word: weighed all at once, none runs over into the next
            for (int64_t x = 0; x < b; x++) {
                spread[x] =
                    few[CHANNELS * x] | (uint64_t)few[CHANNELS * x + 1] << 16 | (uint64_t)few[CHANNELS * x + 2] << 32;
            }
            for (int64_t x = 0; x < w; x++) {
                const uint64_t part = (uint64_t)columns[w + x], at = (uint64_t)columns[x];
                const uint64_t far = spread[at + 1 < (uint64_t)b ? at + 1 : at];
                const uint64_t both = ((spread[at] * (ONE - part) + far * part) >> 4) & 0x0FFF0FFF0FFFu;
                memcpy(row + CHANNELS * x, &both, CHANNELS * sizeof *row);
            }
        }
        const uint16_t* const near = wide + (rows.near & 1) * v;
        const uint16_t* const far = wide + (rows.far & 1) * v;
        const uint8_t* const source = image + y * bytes;
        uint8_t* const left = out + y * bytes;
        const int16_t part = (int16_t)least(rows.part * 128, INT16_MAX);
        for (int64_t x = 0; x < bytes; x++) {
            const int16_t step_there = (int16_t)(far[x] - near[x]);
            const int16_t more = (int16_t)((step_there * part + (1 << 14)) >> 15);
            const uint16_t there = (uint16_t)((near[x] + more + 8) >> 4), own = source[x];
            left[x] = (uint8_t)(own > there ? own - there : 0);
        }
    }
}
