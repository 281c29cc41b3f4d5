// Whether stripes stand on light that is none of theirs: annulus_pipe.rings.pedestal has the theory. A coarse look,
// which most frames are done with.

#include <string.h>

#include "native.h"
#include "rings_picture.h"

#define LEVELS 256

// The quantile of what was counted by level, linear between two ranks; 0 of nothing.
static double quantile(const int64_t counted[LEVELS], const double part)
{
    int64_t size = 0;
    for (int64_t level = 0; level < LEVELS; level++) {
        size += counted[level];
    }
    if (size == 0) {
        return 0.0;
    }
    const double rank = part * (double)(size - 1);
    const int64_t lower = (int64_t)rank;
    int64_t level = 0, below = counted[0];  // how many lie at or below the level
    while (below <= lower && level < LEVELS - 1) {
        below += counted[++level];
    }
    int64_t after = level;
    while (after < LEVELS - 1 && below <= lower + 1 && lower + 1 < size) {
        below += counted[++after];
    }
    return (double)level + (rank - (double)lower) * (double)(after - level);
}

// The least of `window` places in a row of n, and of rows: at both ends of those that there are.
static void least_around(const uint8_t* const values, uint8_t* const restrict rows, uint8_t* const restrict out,
                         const int64_t half, const int64_t a, const int64_t b)
{
    memset(rows, 255, (size_t)(a * b));
    for (int64_t y = 0; y < a; y++) {
        for (int64_t k = -least(half, b - 1); k <= least(half, b - 1); k++) {
            const uint8_t* const shifted = values + y * b + k;
            for (int64_t x = most(-k, 0); x < least(b - k, b); x++) {
                const uint8_t value = shifted[x], darkest = rows[y * b + x];
                rows[y * b + x] = value < darkest ? value : darkest;
            }
        }
    }
    for (int64_t y = 0; y < a; y++) {
        memset(out + y * b, 255, (size_t)b);
        for (int64_t k = most(y - half, 0); k <= least(y + half, a - 1); k++) {
            for (int64_t x = 0; x < b; x++) {
                const uint8_t value = rows[k * b + x], darkest = out[y * b + x];
                out[y * b + x] = value < darkest ? value : darkest;
            }
        }
    }
}

// 1 where, as a median over the places that are brighter than the part `lit` of the bright level, the darkest place
// around each is brighter than the part `worth` of it. Every step-th pixel is looked at, from the one step / 4 on;
// half: of the window around a place, places. strongest, rows, darkest (a, b): room to work in, a and b as many as
// there are.
DOOR int64_t rings_pedestal(const uint8_t* const image, const int64_t phase, const int64_t step, const int64_t half,
                            const double lit, const double worth, uint8_t* const strongest, uint8_t* const rows,
                            uint8_t* const darkest, const int64_t h, const int64_t w, const int64_t c, const int64_t a,
                            const int64_t b)
{
    const picture_t picture = {image, w, h, phase};
    int64_t counted[LEVELS];
    memset(counted, 0, sizeof counted);
    for (int64_t y = 0; y < a; y++) {
        const int64_t row = least(y * step + step / 4, h - 1), next = least(row + step, h - 1);
        const int64_t inside = c == IN_COLOURS && step / 4 < w ? least(b, (w - 1 - step / 4) / step + 1) : 0;
        const uint8_t* at = image + c * (row * w + step / 4);
        for (int64_t x = 0; x < inside; x++, at += c * step) {
            __builtin_prefetch(at + c * (next - row) * w);  // places are far apart
            const uint8_t top = at[0] > at[1] ? at[0] : at[1];
            strongest[y * b + x] = top > at[2] ? top : at[2];
        }
        for (int64_t x = inside; x < b; x++) {
            const int64_t column = least(x * step + step / 4, w - 1);
            if (c != IN_COLOURS) {
                __builtin_prefetch(image + next * w + column);
                __builtin_prefetch(image + most(next - 1, 0) * w + column);
                __builtin_prefetch(image + least(next + 1, h - 1) * w + column);
            }
            const pixel_t own = pixel_of(&picture, column, row, c != IN_COLOURS);
            const uint8_t top = own.blue > own.green ? own.blue : own.green;
            strongest[y * b + x] = top > own.red ? top : own.red;
        }
    }
    for (int64_t y = 0; y < a; y += 2) {
        for (int64_t x = 0; x < b; x += 2) {
            counted[strongest[y * b + x]]++;
        }
    }
    const double bright = quantile(counted, 0.97);
    least_around(strongest, rows, darkest, half, a, b);
    memset(counted, 0, sizeof counted);
    for (int64_t i = 0; i < a * b; i++) {
        counted[darkest[i]] += (double)strongest[i] > lit * bright;
    }
    return quantile(counted, 0.5) > worth * bright;
}
