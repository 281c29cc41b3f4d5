// What a frame shows beside each slit: the light of its two stripes, the slit's own darkness taken off. The pixels lie
// all over the frame, so the places of slits ahead are worked out and fetched while those at hand are read.

#include <string.h>

#include "native.h"
#include "rings_frame.h"

#define AHEAD 16  // slits; a power of two
#define RUN 4     // pixels of a stripe that are read side by side: all, of rings up to 58 px apart
#define PLACES (3 * RUN)

#pragma GCC diagnostic ignored                                                                                         \
    "-Wpsabi"  // how such values are handed over changes with the level: none is, all is inline

// Four numbers side by side; a mask of whole numbers has all bits or none.
typedef double four_t __attribute__((vector_size(8 * RUN)));
typedef int64_t mask_t __attribute__((vector_size(8 * RUN)));
typedef int32_t whole_t __attribute__((vector_size(4 * RUN)));

static const uint8_t BLACK[IN_COLOURS];  // where no pixel counts

typedef struct {
    picture_t picture;
    int64_t lines, first;
    const double* ways;  // (lines, 4)
    bool mosaic;
} frame_t;

// Pixels of one slit, of a mosaic none at its margin. Only of a mosaic: all bits of `there` are set where a pixel
// counts, of column and row where those have red cells.
typedef struct {
    const uint8_t* pixel[PLACES];
    uint32_t there[PLACES], column[PLACES], row[PLACES];
} places_t;

#define CHOSEN(mask, yes, no) ((four_t)(((mask) & (mask_t)(yes)) | (~(mask) & (mask_t)(no))))

// Whole numbers of four values that may be anything. (By address: how such values are handed over changes with levels.)
INLINE whole_t whole_of(const four_t* const values, const int64_t low, const int64_t high)
{
    const four_t least_of = (four_t){0.0} + (double)low, most_of = (four_t){0.0} + (double)high;
    const four_t above = CHOSEN(*values > least_of, *values, least_of);
    return __builtin_convertvector(CHOSEN(above < most_of, above, most_of), whole_t);
}

// Samples a, a + 2, .. of a line: half of them its own, the rest of its two neighbours. The nearest pixels to four.
INLINE void places_of(const frame_t* const frame, const int64_t line, const int64_t a, const int64_t offset,
                      whole_t* const x, whole_t* const y)
{
    const double* const own = frame->ways + 4 * line;
    const double* const before = frame->ways + 4 * around(line - 1, frame->lines);
    const double* const after = frame->ways + 4 * around(line + 1, frame->lines);
    const int64_t margin = frame->mosaic ? 1 : 0, first = frame->first + a + offset;
    const four_t steps = (four_t){0.0, 2.0, 4.0, 6.0} + (double)first;
    const four_t x0 = {own[0], before[0], own[0], after[0]}, dx = {own[2], before[2], own[2], after[2]};
    const four_t y0 = {own[1], before[1], own[1], after[1]}, dy = {own[3], before[3], own[3], after[3]};
    const four_t across = x0 + steps * dx, down = y0 + steps * dy;
    *x = whole_of(&across, margin, frame->picture.width - 1 - margin);
    *y = whole_of(&down, margin, frame->picture.height - 1 - margin);
}

// The three runs of samples of a slit: of its bottom, inside, outside.
INLINE void run_of(const int32_t sample[5], const int part, int64_t* const a, int64_t* const b)
{
    *a = part == 0 ? sample[0] - 1 : part == 1 ? sample[1] : sample[3];
    *b = part == 0 ? *a + 2 : most(*a, part == 1 ? sample[2] : sample[4]);
}

// The first pixels of each run, and the memory asked for.
INLINE void fetch(const frame_t* const frame, const int64_t direction, const int32_t sample[5], places_t* const places)
{
    const int64_t line = bounded(direction, 0, frame->lines - 1), phase = frame->picture.phase;
    const int32_t w = (int32_t)frame->picture.width, bytes = frame->mosaic ? 1 : IN_COLOURS;
    for (int part = 0; part < 3; part++) {
        int64_t a, b;
        whole_t x, y;
        run_of(sample, part, &a, &b);
        places_of(frame, line, a, 0, &x, &y);
        const whole_t at = (y * w + x) * bytes;
        for (int n = 0; n < RUN; n++) {
            const uint8_t* const pixel = frame->picture.data + at[n];
            const bool counts = a + 2 * n <= b;
            __builtin_prefetch(pixel);
            places->pixel[RUN * part + n] = frame->mosaic || counts ? pixel : BLACK;
            if (frame->mosaic) {
                places->there[RUN * part + n] = counts ? ~0u : 0u;
            }
        }
        if (frame->mosaic) {
            const whole_t column = ((x ^ (int32_t)phase) & 1) - 1, row = ((y ^ (int32_t)(phase >> 1)) & 1) - 1;
            memcpy(places->column + RUN * part, &column, sizeof column);
            memcpy(places->row + RUN * part, &row, sizeof row);
        }
    }
}

INLINE uint32_t four_at(const uint8_t* const at)
{
    uint32_t four;
    memcpy(&four, at, sizeof four);
    return four;
}

// The colours of all places of a mosaic as `pixel_of` has them, side by side, 0 of those that do not count: blue and
// 2^16 red, and green. Four bytes are read of each row: of the one below from one
// further left on, so that none is beyond the mosaic.
INLINE void read_cells(const picture_t* const picture, const places_t* const places, uint32_t blue_red[PLACES],
                       uint32_t greens[PLACES])
{
    const int64_t w = picture->width;
    uint32_t up[PLACES], own[PLACES], down[PLACES];
    for (int64_t k = 0; k < PLACES; k++) {
        const uint8_t* const at = places->pixel[k];
        up[k] = four_at(at - w - 1);
        own[k] = four_at(at - 1);
        down[k] = four_at(at + w - 2);
    }
    for (int64_t k = 0; k < PLACES; k++) {
        const uint32_t left = own[k] & 255, here = own[k] >> 8 & 255, right = own[k] >> 16 & 255;
        const uint32_t above = up[k] >> 8 & 255, below = down[k] >> 16 & 255;
        const uint32_t corners = (up[k] & 255) + (up[k] >> 16 & 255) + (down[k] >> 8 & 255) + (down[k] >> 24);
        const uint32_t across = (left + right + 1) >> 1, along = (above + below + 1) >> 1;
        const uint32_t cross = (left + right + above + below + 2) >> 2, askew = (corners + 2) >> 2;
        const uint32_t c = places->column[k], r = places->row[k];
        const uint32_t own_colour = (c & here) | (~c & across), other = (c & along) | (~c & askew);
        const uint32_t of_blue_row = (c & across) | (~c & here), of_red_row = (c & askew) | (~c & along);
        const uint32_t blue = (r & of_red_row) | (~r & of_blue_row), red = (r & own_colour) | (~r & other);
        blue_red[k] = (blue | red << 16) & places->there[k];
        greens[k] = ((~(r ^ c) & cross) | ((r ^ c) & here)) & places->there[k];
    }
}

// Of stripes wider than there are places for, pixel by pixel.
static void sum_of_run(const frame_t* const frame, const int64_t line, const int64_t a, const int64_t b,
                       uint32_t sum[3])
{
    sum[0] = sum[1] = sum[2] = 0;
    for (int64_t i = 0; i <= b - a; i += 2 * RUN) {
        whole_t x, y;
        places_of(frame, line, a, i, &x, &y);
        for (int n = 0; n < RUN && i + 2 * n <= b - a; n++) {
            const pixel_t own = pixel_of(&frame->picture, x[n], y[n], frame->mosaic);
            sum[0] += own.blue;
            sum[1] += own.green;
            sum[2] += own.red;
        }
    }
}

INLINE void light_of(const frame_t* const frame, const int64_t* const direction, const int32_t* const samples,
                     const int64_t slits, double* const light, double* const bright, const int64_t n)
{
    places_t places[AHEAD];
    uint32_t blue_red[PLACES], greens[PLACES];
    double scales[RUN + 1];
    for (int64_t k = 1; k <= RUN; k++) {
        scales[k] = (double)(float)(1.0 / (double)k);
    }
    for (int64_t s = 0; s < least(AHEAD, slits); s++) {
        fetch(frame, direction[s], samples + 5 * s, places + s);
    }
    for (int64_t s = 0; s < slits; s++) {
        const places_t* const known = places + (s & (AHEAD - 1));
        if (frame->mosaic) {
            read_cells(&frame->picture, known, blue_red, greens);
        }
        double dark[3] = {0.0, 0.0, 0.0};
        double strongest[2] = {0.0, 0.0};
        for (int part = 0; part < 3; part++) {
            int64_t a, b;
            run_of(samples + 5 * s, part, &a, &b);
            const int64_t size = (b - a) / 2 + 1;
            uint32_t sum[3];
            double scale;
            if (size <= RUN) {
                uint32_t both = 0, green = 0;
                for (int k = RUN * part; k < RUN * (part + 1); k++) {
                    if (frame->mosaic) {
                        both += blue_red[k];
                        green += greens[k];
                    } else {
                        const uint8_t* const at = known->pixel[k];
                        both += at[0] + ((uint32_t)at[2] << 16);
                        green += at[1];
                    }
                }
                sum[0] = both & 65535;
                sum[1] = green;
                sum[2] = both >> 16;
                scale = scales[size];
            } else {
                sum_of_run(frame, bounded(direction[s], 0, frame->lines - 1), a, b, sum);
                scale = (double)(float)(1.0 / (double)size);
            }
            for (int channel = 0; channel < 3; channel++) {
                const double mean = (double)(int32_t)sum[channel] * scale;
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
            fetch(frame, direction[s + AHEAD], samples + 5 * (s + AHEAD), places + (s & (AHEAD - 1)));
        }
    }
}

// light (6, n): blue, green, red of the stripe inside, then of that outside, of the first `size` slits; bright (n,):
// the strongest of either, together. ways (j, 4): x and y of a line's sample 0, with a half, and its step, px;
// first: of the samples that slits are counted from.
void rings_light(const picture_t* const picture, const bool mosaic, const double* const ways, const int64_t lines,
                 const int64_t first, const int64_t* const direction, const int32_t* const samples, const int64_t size,
                 double* const light, double* const bright, const int64_t n)
{
    if (mosaic) {
        const frame_t frame = {*picture, lines, first, ways, true};
        light_of(&frame, direction, samples, least(size, n), light, bright, n);
    } else {
        const frame_t frame = {*picture, lines, first, ways, false};
        light_of(&frame, direction, samples, least(size, n), light, bright, n);
    }
}
