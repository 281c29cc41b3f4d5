// Ridges of bright lines along every polar line: annulus_pipe.rings.lines has the theory. A ridge lies where the
// smoothed light's slope goes through nought and its curvature is that of a line (Steger 1998).

#include <string.h>

#include "native.h"

#define BLOCK 64  // samples looked at side by side; times, not results

typedef struct {
    float part, bend;  // of a sample from here to the next, where the slope is nought; the curvature there
} Top;

INLINE Top top_at(const float* const slope, const float* const curve)
{
    const float part = slope[0] / (slope[0] - slope[1]);
    return (Top){part, -(curve[0] + part * (curve[1] - curve[0]))};
}

// Which of a block's samples have a ridge between them and the next; whether any has. In most of a line none has.
INLINE bool any_ridge(const float* const slope, const float* const curve, const float least_bend, const int64_t size,
                      int32_t* const is)
{
    int32_t any = 0;
    for (int64_t n = 0; n < size; n++) {
        const bool top = (slope[n] > 0.0f) & (slope[n + 1] <= 0.0f);
        is[n] = top & !(top_at(slope + n, curve + n).bend < least_bend);
        any |= is[n];
    }
    return any != 0;
}

// How wide the light between two dips is, halfway down from its highest to the higher of the dips; of `all` samples the
// first `size` count.
INLINE double width_at(const float* const smooth, const int64_t at, const int64_t size, const int64_t all)
{
    int64_t left = at, right = at;
    while (left > 0 && smooth[left - 1] <= smooth[left]) {
        left--;
    }
    while (right < size - 1 && smooth[right + 1] <= smooth[right]) {
        right++;
    }
    const float dip = smooth[left] > smooth[right] ? smooth[left] : smooth[right];
    const double level = 0.5 * (double)(smooth[at] + dip);
    int64_t a = at, b = at;
    while (a > left && (double)smooth[a - 1] > level) {
        a--;
    }
    while (b < right && (double)smooth[b + 1] > level) {
        b++;
    }
    double low = 0.0, high = 0.0;  // beyond the outermost sample that is higher
    if (a > 0) {
        const double fall = (double)(smooth[a] - smooth[a - 1]);
        low = ((double)smooth[a] - level) / (fall > 1e-6 ? fall : 1e-6);
    }
    if (b < all - 1) {
        const double fall = (double)(smooth[b] - smooth[b + 1]);
        high = ((double)smooth[b] - level) / (fall > 1e-6 ? fall : 1e-6);
    }
    return ((double)b + high) - ((double)a - low);
}

// Adds a ridge (4,) to the rows of its line, `count` of at most `most`, the weakest left out; whether one was.
INLINE bool crowds(float* const rows, int64_t* const count, const int64_t most_of, const float* const ridge)
{
    const bool full = *count == most_of;
    int64_t weakest = 0, where = *count;
    if (full) {
        for (int64_t k = 0; k < most_of; k++) {
            weakest = rows[4 * k + 2] < rows[4 * weakest + 2] ? k : weakest;
        }
        if (most_of == 0 || rows[4 * weakest + 2] >= ridge[2]) {
            return true;
        }
        memmove(rows + 4 * weakest, rows + 4 * (weakest + 1), (size_t)(4 * (most_of - 1 - weakest)) * sizeof rows[0]);
        where = most_of - 1;
    }
    memcpy(rows + 4 * where, ridge, 4 * sizeof rows[0]);
    *count = where + 1;
    return full;
}

// out (m, 4): line, place along it, curvature and width of every ridge, `per_line` of a line at most, the strongest.
// stop: where each line ends. least_bend: the least curvature. crowded: how many were too many. Returns how many there
// are.
DOOR int64_t rings_ridges(const float* const smooth, const float* const slope, const float* const curve,
                          const int64_t* const stop, const float least_bend, const int64_t per_line, float* const out,
                          int64_t* const crowded, const int64_t j, const int64_t i, const int64_t m)
{
    int32_t is[BLOCK];
    int64_t n = 0;
    crowded[0] = 0;
    for (int64_t line = 0; line < j; line++) {
        const float *const light = smooth + line * i, *const s = slope + line * i, *const c = curve + line * i;
        const int64_t end = bounded(stop[line], 0, i), room = bounded(per_line, 0, m - n);
        int64_t count = 0;
        for (int64_t first = 2; first < end - 2; first += BLOCK) {
            const int64_t size = least(BLOCK, end - 2 - first);
            const bool any = any_ridge(s + first, c + first, least_bend, size, is);
            for (int64_t at = first; any && at < first + size; at++) {
                if (is[at - first]) {
                    const Top top = top_at(s + at, c + at);
                    const double place = (double)at + (double)top.part;
                    const double width = width_at(light, top.part < 0.5f ? at : at + 1, end, i);
                    const float ridge[4] = {(float)line, (float)place, top.bend, (float)width};
                    crowded[0] += crowds(out + 4 * n, &count, room, ridge);
                }
            }
        }
        n += count;
    }
    return n;
}
