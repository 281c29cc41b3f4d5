// A plane along the polar lines of a grid: what cv2.remap and cv2.GaussianBlur do, to the bit, in one pass that keeps
// three lines at hand. All in whole numbers.

#include <math.h>
#include <string.h>

#include "native.h"
#include "rings_frame.h"

#define BLOCK 64     // samples fetched one by one, then weighed together
#define RAISED 8192  // more than 32 times any difference of two bytes
#define BESIDE 3.0   // px around the samples that are looked at: what is between pixels is made of those beside it

// 32 times what lies between two neighbours, a low and a high byte, fx / 32 of the way.
INLINE uint16_t weighed(const uint16_t two, const uint16_t fx)
{
    return (uint16_t)((uint16_t)((two & 255) << 5) + (uint16_t)((uint16_t)((two >> 8) - (two & 255)) * fx));
}

INLINE void fetch(const uint8_t* const plane, const int64_t w, const uint32_t* const address, const int64_t size,
                  uint16_t above[BLOCK], uint16_t below[BLOCK])
{
    for (int64_t k = 0; k < size; k++) {
        const uint8_t* const at = plane + address[k];
        memcpy(&above[k], at, 2);
        memcpy(&below[k], at + w, 2);
    }
}

INLINE void weigh(const uint16_t above[BLOCK], const uint16_t below[BLOCK], const uint16_t* const part,
                  const int64_t size, uint8_t* const restrict out)
{
    for (int64_t k = 0; k < size; k++) {
        const uint16_t fx = part[k] & 31, fy = (uint16_t)(part[k] << 5) & 0x7C00;  // 2^10 fy
        const uint16_t top = weighed(above[k], fx), low = weighed(below[k], fx);
        // (32 - fy) top + fy low, half of 1024 and over that; of the product of 16 bits the upper 16 are fy / 32
        const uint16_t more = (uint16_t)(2 * (uint16_t)(low - top + RAISED));  // never negative
        const uint16_t part_of = (uint16_t)((uint32_t)more * fy >> 16);
        out[k] = (uint8_t)((uint16_t)(top + part_of - (fy >> 10) * (RAISED / 32) + 16) >> 5);
    }
}

// Bilinear samples of one line: address of the upper left pixel, and in part 32 fy + fx, 1/32 px.
static void sample(const uint8_t* const plane, const int64_t w, const uint32_t* const address,
                   const uint16_t* const part, const int64_t size, uint8_t* const out)
{
    // A block is weighed when the next one has been fetched: what was just stored in pieces cannot be loaded as a
    // whole.
    uint16_t above[2][BLOCK], below[2][BLOCK];
    fetch(plane, w, address, least(size, BLOCK), above[0], below[0]);
    for (int64_t start = 0, now = 0; start < size; start += BLOCK, now = 1 - now) {
        const int64_t next = start + BLOCK;
        if (next < size) {
            fetch(plane, w, address + next, least(size - next, BLOCK), above[1 - now], below[1 - now]);
        }
        weigh(above[now], below[now], part + start, least(size - start, BLOCK), out + start);
    }
}

// top (t,), rows of m: samples a .. a + m of every line, averaged with its two neighbours, weights 1, 2, 1. rows (3,
// length): room to work in.
static void unrolled(const uint8_t* const plane, const int64_t w, const lines_t* const lines, const int64_t a,
                     const int64_t m, uint8_t* const rows, uint8_t* const top, const int64_t t)
{
    const int64_t n = lines->length, size = least(m, n - a);
    for (int64_t line = 0; line < lines->lines + 2 && (line - 1) * m <= t; line++) {
        sample(plane, w, lines->address + line * n + a, lines->part + line * n + a, size, rows + (line % 3) * n);
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

// How many samples of a line lie between a and a + m.
INLINE int64_t samples_of(const int64_t stop, const int64_t a, const int64_t m)
{
    return bounded(stop, a, a + m) - a;
}

// The frame's bright level and noise in grey levels, out (2,), from every 24th line and every third sample along it.
// top as above; stop (j,): the grid's, from its own first sample on. sigma_of_mad: standard deviation of normal errors
// over the median of their sizes.
static void level(const uint8_t* const top, const int64_t* const stop, const int64_t a, const int64_t m,
                  const double sigma_of_mad, double* const out, const int64_t t, const int64_t j)
{
    int64_t levels[256], steps[256];
    memset(levels, 0, sizeof levels);
    memset(steps, 0, sizeof steps);
    int64_t size = 0;
    const int64_t lines = m > 0 ? least(j, t / m) : 0;
    for (int64_t line = 0; line < lines; line += 24) {
        for (int64_t k = 1; k < samples_of(stop[line], a, m); k += 3) {
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
        for (int64_t k = 1; k < samples_of(stop[line], a, m); k += 3) {
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

// A frame along a grid's lines: top (t,), rows of as many samples as there are in `range` (2,), from one to the other;
// levels (2,): how bright the frame is, and its noise. address, part (i, n): two more lines than stop (j,), since they
// begin with the last one and end with the first. first, step, px: of a line's samples about the centre (cx, cy). every
// .. seen, black, gain, range: see `rings_look`; plane: see `rings_strongest`; rows: room to work in.
DOOR void rings_lay_out(const uint8_t* const image, const int64_t phase, const uint32_t* const address,
                        const uint16_t* const part, const int64_t* const stop, const double cx, const double cy,
                        const double first, const double step, const int64_t every, const int64_t px,
                        const double* const limits, const double sigma_of_mad, uint8_t* const seen,
                        int32_t* const black, int32_t* const gain, int64_t* const range, uint8_t* const plane,
                        uint8_t* const rows, uint8_t* const top, double* const levels, const int64_t h, const int64_t w,
                        const int64_t b, const int64_t i, const int64_t n, const int64_t j, const int64_t s,
                        const int64_t p, const int64_t t)
{
    const picture_t picture = {image, w, h, phase};
    const bool mosaic = b != IN_COLOURS;
    const lines_t lines = {address, part, stop, least(j, i - 2), n};
    const look_t look = {black, gain, range};
    rings_look(&picture, mosaic, &lines, every, px, limits, seen, s, &look);
    const double one = first + step * (double)range[0], other = first + step * (double)range[1];
    const double inner = (one < other ? one : other) - BESIDE, outer = (one < other ? other : one) + BESIDE;
    rings_strongest(&picture, mosaic, cx, cy, inner, outer, &look, plane, p);
    unrolled(plane, w, &lines, range[0], range[1] - range[0], rows, top, t);
    level(top, stop, range[0], range[1] - range[0], sigma_of_mad, levels, t, j);
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
