// A frame's strongest channel, as one plane that lines are read from: where slits are is read there, their colours in
// the frame itself. That pass also fetches the frame in the order of memory, once.

#include <math.h>
#include <string.h>

#include "native.h"
#include "rings_frame.h"

typedef uint8_t bytes_t __attribute__((vector_size(16), aligned(1), may_alias));

#define PROBE_LEVELS 256
#define AHEAD 64           // bytes of a cache line
#define CELLS 64           // of a mosaic that are worked on side by side; even
#define ROWS_AHEAD 4       // that are fetched while one is worked on ..
#define CELL_ROWS_AHEAD 2  // .. and of a mosaic, whose rows are a third as long

// The level below or at which that part of what was counted lies.
static int64_t rank_of(const int64_t counted[PROBE_LEVELS], const double part)
{
    int64_t all = 0;
    for (int64_t level = 0; level < PROBE_LEVELS; level++) {
        all += counted[level];
    }
    const double wanted = part * (double)all;
    int64_t total = counted[0], level = 0;
    while ((double)total < wanted && level < PROBE_LEVELS - 1) {
        level++;
        total += counted[level];
    }
    return level;
}

// A slit has light on both sides, so there is none outside of look.range. every: lines, px: samples, between the places
// looked at. limits: (5,) the part of the bright level that is light, samples kept around it, how many times weaker a
// channel is raised and by how much at most, and the least samples of a line. seen (room,): to work in.
void rings_look(const picture_t* const picture, const bool mosaic, const lines_t* const all, const int64_t every,
                const int64_t px, const double* const limits, uint8_t* const seen, const int64_t room,
                const look_t* const look)
{
    const uint8_t* const image = picture->data;
    const int64_t h = picture->height, w = picture->width, n = all->length, b = mosaic ? 1 : IN_COLOURS;
    const int64_t* const stop = all->stop;
    int32_t* const black = look->black;
    int32_t* const gain = look->gain;
    const int64_t lines = (all->lines + every - 1) / every;
    int64_t counted[3][PROBE_LEVELS];
    memset(counted, 0, sizeof counted);
    uint8_t* place = seen;
    for (int64_t line = 0; line < lines; line++) {
        const uint32_t* const along = all->address + (line * every + 1) * n;
        const int64_t looks = (least(stop[line * every], n) + px - 1) / px;
        // those of the next line are asked for before: each place is far from all others
        const uint32_t* const next = along + (line + 1 < lines ? every * n : 0);
        for (int64_t k = 0; k < looks; k++) {
            __builtin_prefetch(image + b * (int64_t)next[k * px]);
            if (mosaic) {
                __builtin_prefetch(image + (int64_t)next[k * px] - w);
                __builtin_prefetch(image + (int64_t)next[k * px] + w);
            }
            const int64_t at = along[k * px];
            const pixel_t own = at < h * w ? pixel_of(picture, (int64_t)((uint32_t)at % (uint32_t)w),
                                                      (int64_t)((uint32_t)at / (uint32_t)w), mosaic)
                                           : (pixel_t){0, 0, 0};
            counted[0][own.blue]++;
            counted[1][own.green]++;
            counted[2][own.red]++;
            if (place + 3 <= seen + room) {
                *place++ = own.blue;
                *place++ = own.green;
                *place++ = own.red;
            }
        }
    }
    double light[3], greatest = 0.0;
    for (int64_t c = 0; c < 3; c++) {
        black[c] = (int32_t)rank_of(counted[c], 0.02);
        light[c] = (double)most(rank_of(counted[c], 0.97) - black[c], 1);
        greatest = light[c] > greatest ? light[c] : greatest;
    }
    for (int64_t c = 0; c < 3; c++) {
        const double weaker = greatest / light[c];
        gain[c] = 64;
        if (weaker > limits[2]) {
            gain[c] = (int32_t)rint(64.0 * (weaker < limits[3] ? weaker : limits[3]));
        } else {
            black[c] = 0;
        }
    }
    // one sample brighter than the limit is noise, one together with the next is light
    const double bright = limits[0] * greatest;
    const int64_t limit = (int64_t)(64.0 * (bright > 2.0 ? bright : 2.0));
    int64_t first = n, last = 0;
    const uint8_t* again = seen;
    for (int64_t line = 0; line < lines; line++) {
        const int64_t looks = (least(stop[line * every], n) + px - 1) / px;
        bool before = false;
        for (int64_t k = 0; k < looks && again < place; k++, again += 3) {
            bool lit = false;
            for (int64_t c = 0; c < 3; c++) {
                lit |= ((int32_t)again[c] - black[c]) * gain[c] > limit;
            }
            if (lit && before) {
                first = least(first, (k - 1) * px);
                last = most(last, k * px);
            }
            before = lit;
        }
    }
    const int64_t margin = (int64_t)limits[1], shortest = (int64_t)limits[4];
    look->range[0] = most(least(first - margin, n - shortest), 0);
    look->range[1] = least(most(least(last + margin, n), look->range[0] + shortest), n);
}

// max(B, G, R) of size pixels. Each load is of 16 neighbouring bytes, the greatest of three such loads a byte apart has
// every third byte right; three of those are 16 pixels. The last few are taken one by one. ahead: to the bytes that are
// fetched, for later, into the second cache: the first has too few places to wait in.
static void greatest_of(const uint8_t* source, uint8_t* out, const int64_t size, const int64_t ahead)
{
    static const bytes_t FIRST = {0, 3, 6, 9, 12, 15, 16, 16, 16, 16, 16, 16, 16, 16, 16, 16};
    static const bytes_t SECOND = {16, 16, 16, 16, 16, 16, 2, 5, 8, 11, 14, 16, 16, 16, 16, 16};
    static const bytes_t THIRD = {16, 16, 16, 16, 16, 16, 16, 16, 16, 16, 16, 1, 4, 7, 10, 13};
    const bytes_t none = {0};
    int64_t x = 0;
    for (; x + 17 <= size; x += 16, source += 48, out += 16) {  // one more: the last load is two bytes beyond
        uint8_t top[48];
        __builtin_prefetch(source + ahead, 0, 2);
        for (int k = 0; k < 48; k++) {
            const uint8_t a = source[k], b = source[k + 1], c = source[k + 2];
            const uint8_t ab = a > b ? a : b;
            top[k] = ab > c ? ab : c;
        }
        bytes_t part[3];
        memcpy(part, top, sizeof part);
        *(bytes_t*)out = __builtin_shuffle(part[0], none, FIRST) | __builtin_shuffle(part[1], none, SECOND) |
                         __builtin_shuffle(part[2], none, THIRD);
    }
    for (; x < size; x++, source += 3, out++) {
        const uint8_t a = source[0], b = source[1], c = source[2];
        const uint8_t ab = a > b ? a : b;
        *out = ab > c ? ab : c;
    }
}

// The same of `size` cells of a row of a mosaic, none of them at its margin. Of a green cell the others are the means
// of two neighbours, of a red or blue one those of four. chosen: 255 where a cell is green, else 0.
INLINE void greatest_of_run(const uint8_t* const at, const int64_t w, const uint8_t* const chosen, uint8_t* const out,
                            const int64_t size)
{
    for (int64_t k = 0; k < size; k++) {
        const uint8_t a = at[k - 1], b = at[k + 1], c = at[k - w], d = at[k + w], own = at[k];
        const uint8_t across = mean_of_two(a, b), along = mean_of_two(c, d);
        const uint8_t cross = mean_of_four(c, d, a, b);
        const uint8_t askew = mean_of_four(at[k - w - 1], at[k - w + 1], at[k + w - 1], at[k + w + 1]);
        const uint8_t of_two = across > along ? across : along, of_four = cross > askew ? cross : askew;
        const uint8_t others = (uint8_t)((of_two & chosen[k]) | (of_four & ~chosen[k]));
        out[k] = own > others ? own : others;
    }
}

static void greatest_of_cells(const uint8_t* const at, const int64_t w, const bool green, uint8_t* const restrict out,
                              const int64_t size)
{
    uint8_t every_other[CELLS + 1];
    for (int k = 0; k < CELLS + 1; k++) {
        every_other[k] = k % 2 == 0 ? 255 : 0;
    }
    const uint8_t* const chosen = every_other + (green ? 0 : 1);
    int64_t start = 0;
    for (; start + CELLS <= size; start += CELLS) {
        greatest_of_run(at + start, w, chosen, out + start, CELLS);
    }
    greatest_of_run(at + start, w, chosen, out + start, size - start);
}

// Cells from .. to, at least one, of row y; the margin repeats what is beside it.
static void strongest_cells(const picture_t* const picture, const int64_t from, const int64_t to, const int64_t y,
                            uint8_t* const out)
{
    const int64_t w = picture->width, row = bounded(y, 1, picture->height - 2);
    const int64_t first = bounded(from, 1, w - 2), last = bounded(to, first + 1, w - 1);
    const bool green = ((row ^ first ^ picture->phase ^ (picture->phase >> 1)) & 1) != 0;
    greatest_of_cells(picture->data + row * w + first, w, green, out + first, last - first);
    if (from == 0) {
        out[0] = out[1];
    }
    if (to == w) {
        out[w - 1] = out[w - 2];
    }
}

// The same with black taken off and weak channels raised, at most 255.
static void raised_of(const picture_t* const picture, const int64_t x, const int64_t y, const bool mosaic,
                      uint8_t* const out, const int64_t size, const int32_t black[3], const int32_t gain[3])
{
    for (int64_t k = 0; k < size; k++) {
        const pixel_t own = pixel_of(picture, x + k, y, mosaic);
        const int32_t blue = (own.blue - black[0]) * gain[0], green = (own.green - black[1]) * gain[1];
        const int32_t red = (own.red - black[2]) * gain[2];
        int32_t top = blue > green ? blue : green;
        top = (top > red ? top : red) >> 6;
        out[k] = (uint8_t)(top < 0 ? 0 : top < 255 ? top : 255);
    }
}

// The strongest channel of the pixels between two circles, px, about (cx, cy). plane (room,): h * w and a tail, which
// stays 0 for places outside of the image.
void rings_strongest(const picture_t* const picture, const bool mosaic, const double cx, const double cy,
                     const double inner, const double outer, const look_t* const look, uint8_t* const plane,
                     const int64_t room)
{
    const int64_t h = picture->height, w = picture->width, b = mosaic ? 1 : IN_COLOURS;
    const int32_t* const gain = look->gain;
    const bool raised = gain[0] != 64 || gain[1] != 64 || gain[2] != 64;
    for (int64_t y = 0; y < h && (y + 1) * w <= room; y++) {
        const double up = (double)y - cy, far = outer * outer - up * up;
        if (far <= 0.0) {
            continue;
        }
        const double half = sqrt(far), within = inner * inner - up * up;
        const double hole = inner > 0.0 && within > 0.0 ? sqrt(within) : 0.0;
        for (int64_t side = 0; side < 2; side++) {
            const int64_t from = whole(side == 0 ? cx - half : cx + hole, 0, w);
            const int64_t to = least(whole(side == 0 ? cx - hole : cx + half, 0, w) + 2, w);
            if (to <= from) {
                continue;
            }
            const uint8_t* const source = picture->data + b * (y * w + from);
            if (mosaic && y + CELL_ROWS_AHEAD < h) {
                for (int64_t k = 0; k < to - from; k += AHEAD) {
                    __builtin_prefetch(source + CELL_ROWS_AHEAD * w + k);
                }
            }
            uint8_t* const out = plane + y * w + from;
            if (raised) {
                raised_of(picture, from, y, mosaic, out, to - from, look->black, gain);
            } else if (!mosaic) {
                greatest_of(source, out, to - from, y + ROWS_AHEAD < h ? ROWS_AHEAD * b * w : 0);
            } else {
                strongest_cells(picture, from, to, y, plane + y * w);
            }
        }
    }
}
