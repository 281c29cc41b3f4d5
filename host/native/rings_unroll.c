// A plane along the polar lines of a grid: what cv2.remap and cv2.GaussianBlur do, to the bit, in one pass that keeps
// three lines at hand. All in whole numbers.

#include <math.h>
#include <string.h>

#include "native.h"

#define BLOCK 64  // samples fetched one by one, then weighed together

// Bilinear samples of one line: address of the upper left pixel, and in part 32 fy + fx, 1/32 px.
static void sample(const uint8_t* const plane, const int64_t w, const uint32_t* const address,
                   const uint16_t* const part, const int64_t size, uint8_t* const out)
{
    uint16_t above[BLOCK], below[BLOCK];
    for (int64_t start = 0; start < size; start += BLOCK) {
        const int64_t n = least(size - start, BLOCK);
        for (int64_t k = 0; k < n; k++) {
            const uint8_t* const at = plane + address[start + k];
            memcpy(&above[k], at, 2);
            memcpy(&below[k], at + w, 2);
        }
        for (int64_t k = 0; k < n; k++) {
            const uint16_t fx = part[start + k] & 31, fy = (part[start + k] >> 5) & 31;
            const uint16_t top = (uint16_t)((above[k] & 255) * (32 - fx) + (above[k] >> 8) * fx);
            const uint16_t low = (uint16_t)((below[k] & 255) * (32 - fx) + (below[k] >> 8) * fx);
            out[start + k] = (uint8_t)(((uint32_t)top * (uint32_t)(32 - fy) + (uint32_t)low * fy + 512) >> 10);
        }
    }
}

// top (t,), rows of m: samples a .. a + m of every line, averaged with its two neighbours, weights 1, 2, 1. address,
// part (i, n): two more lines, since they begin with the last one and end with the first. rows (3, n): room to work in.
DOOR void rings_unroll(const uint8_t* const plane, const int64_t w, const uint32_t* const address,
                       const uint16_t* const part, const int64_t a, const int64_t m, uint8_t* const rows,
                       uint8_t* const top, const int64_t p, const int64_t i, const int64_t n, const int64_t t)
{
    const int64_t size = least(m, n - a);
    for (int64_t line = 0; line < i && (line - 1) * m <= t; line++) {
        sample(plane, w, address + line * n + a, part + line * n + a, size, rows + (line % 3) * n);
        if (line < 2) {
            continue;
        }
        const uint8_t* const before = rows + ((line - 2) % 3) * n;
        const uint8_t* const own = rows + ((line - 1) % 3) * n;
        const uint8_t* const after = rows + (line % 3) * n;
        uint8_t* const out = top + (line - 2) * m;
        for (int64_t k = 0; k < size; k++) {
            out[k] = (uint8_t)((before[k] + 2 * own[k] + after[k] + 2) >> 2);
        }
        memset(out + size, 0, (size_t)(m - size));
    }
    (void)p;
}

static int64_t rank_of(const int64_t counted[256], const double part)
{
    int64_t all = 0;
    for (int64_t level = 0; level < 256; level++) {
        all += counted[level];
    }
    const double wanted = part * (double)all;
    int64_t total = counted[0], level = 0;
    while ((double)total < wanted && level < 255) {
        level++;
        total += counted[level];
    }
    return level;
}

// The frame's bright level and noise in grey levels, out (2,), from every 24th line and every third sample along it.
// top as above; stop (j,): the grid's, from its own first sample on. sigma_of_mad: standard deviation of normal errors
// over the median of their sizes.
DOOR void rings_level(const uint8_t* const top, const int64_t* const stop, const int64_t a, const int64_t m,
                      const double sigma_of_mad, double* const out, const int64_t t, const int64_t j)
{
    int64_t levels[256], steps[256];
    memset(levels, 0, sizeof levels);
    memset(steps, 0, sizeof steps);
    int64_t size = 0;
    const int64_t lines = m > 0 ? least(j, t / m) : 0;
    for (int64_t line = 0; line < lines; line += 24) {
        for (int64_t k = 1; k < least(stop[line] - a, m); k += 3) {
            levels[top[line * m + k]]++;
            size++;
        }
    }
    out[0] = out[1] = 0.0;
    if (size == 0) {
        return;
    }
    // the darker half of the samples holds few edges; a step of n is anything up to n
    const int64_t half = rank_of(levels, 0.5);
    int64_t all = 0;
    for (int64_t line = 0; line < lines; line += 24) {
        for (int64_t k = 1; k < least(stop[line] - a, m); k += 3) {
            const int64_t value = top[line * m + k], step = value - top[line * m + k - 1];
            if (value <= half) {
                steps[step < 0 ? -step : step]++;
                all++;
            }
        }
    }
    const int64_t at = rank_of(steps, 0.5);
    int64_t below = 0;
    for (int64_t level = 0; level < at; level++) {
        below += steps[level];
    }
    const double median = (double)at - 0.5 + (0.5 * (double)all - (double)below) / (double)steps[at];
    out[0] = (double)rank_of(levels, 0.95);
    out[1] = sigma_of_mad / sqrt(2.0) * (median > 0.0 ? median : 0.0);
}

// The lines alone, not averaged: out (i, n).
DOOR void rings_sample(const uint8_t* const plane, const int64_t w, const uint32_t* const address,
                       const uint16_t* const part, uint8_t* const out, const int64_t p, const int64_t i,
                       const int64_t n)
{
    for (int64_t line = 0; line < i; line++) {
        sample(plane, w, address + line * n, part + line * n, n, out + line * n);
    }
    (void)p;
}
