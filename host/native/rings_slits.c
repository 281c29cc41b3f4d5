// Dark slits along every polar line, to a fraction of a pixel: annulus_pipe.rings.slits has the theory. Single
// precision, each sum in one order: a slit's place has the same bits on every processor.

#include <math.h>
#include <string.h>

#include "native.h"
#include "rings_frame.h"
#include "selection.h"

#define SLITS_MOST 48  // of one line: room for the turning points of a line on the stack; rings.slits passes PER_LINE
#define MASKED 128     // samples of which every other one is a bit
#define MARGIN 5       // samples at both ends of a line that nothing is looked for in

// What rings.slits passes as `limits`, in this order; units and reasons stand there.
enum { FALL, HALFWAY, LEVEL, STEEPEST, BLUR_MOST, FLOOR, SPACING, FAR, STEP };

typedef struct {
    const float* smooth;
    const float* slope;
    const float* limits;
    int64_t length;
} line_t;

// Offset of the top of the parabola through three samples, within half a sample.
INLINE float extremum(const float before, const float at, const float after)
{
    const float bend = before - 2.0f * at + after;
    return bend == 0.0f ? 0.0f : held_f(0.5f * (before - after) / bend, -0.5f, 0.5f);
}

// How far an edge is drawn towards the light, in samples: a stripe that brightens by a part g of itself a sample moves
// the steepest place of its edge, blurred by sigma, by g sigma^2; sigma^2 is the slope there over its bend. clear:
// samples from an edge, where its blur has ended; beside: over how many more the light's slope is read.
static float drawn(const line_t* const line, const int64_t edge, const int64_t last, const float bend,
                   const float greatest, const int64_t clear, const int64_t beside)
{
    const int64_t way = last > edge ? 1 : -1, far_off = way * (last - edge);
    if (far_off < clear + 2) {
        return 0.0f;
    }
    const int64_t near = edge + way * clear, far = edge + way * least(far_off, clear + beside);
    const float at_near = line->smooth[near], at_far = line->smooth[far];
    if (at_near <= 0.0f || bend == 0.0f) {
        return 0.0f;
    }
    const float reach = (float)(way * (far - near));
    const float growth =
        held_f((float)way * (at_far - at_near) / (reach * 0.5f * (at_near + at_far)), -greatest, greatest);
    return growth * held_f(-line->slope[edge] / bend, 0.0f, line->limits[BLUR_MOST]);
}

static float mean_of(const line_t* const line, const int64_t from, const int64_t to)
{
    const int64_t a = most(from, 0), b = least(most(to, a), line->length - 1);
    float total = 0.0f;
    for (int64_t i = a; i <= b; i++) {
        total += line->smooth[i];
    }
    return total / (float)(b + 1 - a);
}

// Nine taps along a line of bytes, and the step from each sample to the next but one. `light` is room to work in.
static void smoothed(const uint8_t* const bright, const int64_t length, const float taps[5],
                     float* const restrict light, float* const restrict smooth, float* const restrict slope)
{
    for (int64_t i = 0; i < length; i++) {
        light[i] = (float)bright[i];
    }
    const float t0 = taps[0], t1 = taps[1], t2 = taps[2], t3 = taps[3], t4 = taps[4];
    for (int64_t i = 4; i < length - 4; i++) {
        smooth[i] = (t0 * light[i] + t1 * (light[i - 1] + light[i + 1])) +
                    (t2 * (light[i - 2] + light[i + 2]) +
                     (t3 * (light[i - 3] + light[i + 3]) + t4 * (light[i - 4] + light[i + 4])));
    }
    for (int64_t i = 0; i < 4; i++) {
        smooth[i] = smooth[length - 1 - i] = 0.0f;
    }
    slope[0] = slope[length - 1] = 0.0f;
    for (int64_t i = 1; i < length - 1; i++) {
        slope[i] = smooth[i + 1] - smooth[i - 1];
    }
    for (int64_t i = 1; i < MARGIN; i++) {
        slope[i] = slope[length - 1 - i] = 0.0f;
    }
}

// Every other of `size` bytes that are 0 or 1, as bits: whoever walks along them guesses where they end four times a
// line, not at every few samples.
INLINE uint64_t mask_of(const uint8_t* const turning, const int64_t size)
{
    uint64_t mask = 0;
    for (int64_t at = 0; at < size; at += 8) {
        uint64_t eight = 0;
        memcpy(&eight, turning + at, 8);
        if (size - at < 8) {
            eight &= (1ull << (8 * (size - at))) - 1;
        }
        mask |= ((eight & 0x0001000100010001u) * 0x0001000200040008u >> 48 & 15) << (at / 2);
    }
    return mask;
}

// Samples that are looked at, one after another: of every other one those whose byte is 1.
typedef struct {
    const uint8_t* turning;
    int64_t start, end;
    uint64_t mask;
} walk_t;

// The next one; 0: there is none.
INLINE int64_t next_of(walk_t* const walk)
{
    while (walk->mask == 0) {
        walk->start += MASKED;
        if (walk->start >= walk->end) {
            return 0;
        }
        walk->mask = mask_of(walk->turning + walk->start, least(MASKED, walk->end - walk->start));
    }
    const int64_t i = walk->start + 2 * __builtin_ctzll(walk->mask);
    walk->mask &= walk->mask - 1;
    return i;
}

// Alternating tops and bottoms of a line: high[k] low[k] high[k + 1]; one is confirmed when the next has clearly begun.
// Every other sample will do: the line is smooth, and edges are looked for between tops and bottoms sample by sample.
// turning: room to work in. Returns how many bottoms; *crowded counts lines with more than there is room for.
static int64_t turning_points(const line_t* const line, const int64_t per_line, uint8_t* const turning,
                              int64_t* const low, int64_t* const high, int64_t* const crowded)
{
    const float* const smooth = line->smooth;
    const float* const slope = line->slope;
    const float fall = line->limits[FALL], floor_level = line->limits[FLOOR];
    // A sample between a lower and a higher neighbour changes nothing that the end of its run does not change as well:
    // where it rises, or falls, both before and after.
    for (int64_t i = 7; i < line->length - 7; i++) {
        turning[i] = (uint8_t)(slope[i - 1] * slope[i + 1] > 0.0f ? 0 : 1);
    }
    for (int64_t i = most(line->length - 7, 7); i < line->length; i++) {
        turning[i] = 1;  // the last ones are all looked at
    }
    walk_t walk = {turning, 7 - MASKED, line->length - MARGIN, 0};
    int64_t k = 0, best = MARGIN;
    float value = smooth[best];
    for (;;) {
        int64_t i = next_of(&walk);
        for (; i > 0; i = next_of(&walk)) {  // until clearly below the top
            const float s = smooth[i];
            if ((s < fall * value) & (value > floor_level) & (value - s > 0.5f * floor_level)) {
                break;
            }
            best = s > value ? i : best;
            value = s > value ? s : value;
        }
        high[k] = best;
        if (i == 0) {
            return k;
        }
        best = i;
        value = smooth[i];
        for (i = next_of(&walk); i > 0; i = next_of(&walk)) {  // until clearly above the bottom
            const float s = smooth[i];
            if ((fall * s > value) & (s - value > floor_level)) {
                break;
            }
            best = s < value ? i : best;
            value = s < value ? s : value;
        }
        if (i == 0) {
            return k;
        }
        if (k == per_line) {
            (*crowded)++;
            return k;  // the last top is the one before this bottom
        }
        low[k++] = best;
        best = i;
        value = smooth[i];
    }
}

// The nearest edge from a bottom on, in steps of `way`: the steepest place up to where the light is back and level
// again. The steepest of the whole stripe could be the rim of a pocket farther on.
static int64_t edge_from(const line_t* const line, const int64_t bottom, const int64_t end, const int64_t way,
                         const float back)
{
    const float level = line->limits[LEVEL], sign = (float)way;
    int64_t edge = bottom;
    float steepest = sign * line->slope[bottom];
    for (int64_t i = bottom; way * (end - i) >= 0; i += way) {
        const float steep = sign * line->slope[i];
        if (steep > steepest) {
            edge = i;
            steepest = steep;
        } else if (line->smooth[i] > back && steep < level * steepest) {
            break;
        }
    }
    return edge;
}

// Slits, as many as there is room for: `rings_find` says what of.
typedef struct {
    int64_t* direction;
    double *place, *width, *blur;
    float* depth;
    int32_t* samples;  // (room, 5)
    int64_t size, room, crowded;
} slits_t;

// From line to line, outwards. work (3 room + 8), marks (room + 8): as many samples as a line may have.
static void scan(const uint8_t* const top, const int64_t* const stop, const int64_t first_sample, const int64_t m,
                 const float* const taps, const float* const limits, const int64_t per_line, const int64_t clear,
                 const int64_t beside, float* const work, uint8_t* const marks, const int64_t room, const int64_t t,
                 const int64_t j, slits_t* const slits)
{
    int64_t low[SLITS_MOST + 1], high[SLITS_MOST + 2];
    const int64_t kept = least(per_line, SLITS_MOST), n = slits->room;
    float* const light = work;
    float* const smooth = work + room;
    float* const slope = work + 2 * room;
    const float spacing = limits[SPACING], reach = held_f(0.12f * spacing, 2.0f, 1e6f);
    int64_t size = 0, crowded = 0;
    for (int64_t line_no = 0; line_no < j && (line_no + 1) * m <= t; line_no++) {
        const int64_t length = least(least(stop[line_no] - first_sample, m), room);
        if (length < 16) {
            continue;
        }
        smoothed(top + line_no * m, length, taps, light, smooth, slope);
        const line_t line = {smooth, slope, limits, length};
        const int64_t k = turning_points(&line, kept, marks, low, high, &crowded);
        for (int64_t s = 0; s < k && size < n; s++) {
            const int64_t bottom = low[s], first = high[s], last = high[s + 1];
            const float dark = smooth[bottom];
            const float dimmer = smooth[first] < smooth[last] ? smooth[first] : smooth[last];
            const float back = dark + limits[HALFWAY] * (dimmer - dark);
            const int64_t a = edge_from(&line, bottom, first, -1, back), e = edge_from(&line, bottom, last, 1, back);
            if (a < 6 || e > length - 7 || e <= a) {
                continue;
            }
            const float fall_bend = slope[a - 1] - 2.0f * slope[a] + slope[a + 1];
            const float rise_bend = slope[e - 1] - 2.0f * slope[e] + slope[e + 1];
            const float away = fabsf(limits[FAR] + limits[STEP] * (float)bottom);
            const float greatest = limits[STEEPEST] / (away > 1e-3f ? away : 1e-3f);
            const int64_t before = s > 0 ? low[s - 1] : 0, after = s + 1 < k ? low[s + 1] : length;
            const int64_t inner = most((bottom + before) / 2, 4), outer = least((bottom + after) / 2, length - 5);
            const float left = extremum(slope[a - 1], slope[a], slope[a + 1]) + (float)a -
                               drawn(&line, a, inner, fall_bend, greatest, clear, beside);
            const float right = extremum(slope[e - 1], slope[e], slope[e + 1]) + (float)e -
                                drawn(&line, e, outer, rise_bend, greatest, clear, beside);
            // the stripes' light just beyond the edges, but not beyond half way to the next slit
            const int64_t following = s + 1 < k ? low[s + 1] : length - 1;
            const int64_t p1 = (int64_t)(left - 1.5f);
            const int64_t p0 = most((int64_t)(left - 1.5f - reach), (p1 + before) / 2);
            const int64_t p2 = (int64_t)(right + 1.5f) + 1;
            const int64_t p3 = least((int64_t)(right + 1.5f + reach) + 1, (p2 + following) / 2);
            const float inside = mean_of(&line, p0, p1), outside = mean_of(&line, p2, p3);
            const float stripe = held_f(inside < outside ? inside : outside, 1.0f, 1e6f);
            const float part = dark / stripe;
            slits->direction[size] = line_no;
            slits->place[size] = (double)(0.5f * (left + right));
            slits->width[size] = (double)(right - left);
            slits->depth[size] = 1.0f - (part < 1.0f ? part : 1.0f);
            const float fall_square = fall_bend * fall_bend, rise_square = rise_bend * rise_bend;
            slits->blur[size] = (double)sqrtf(1.0f / (fall_square > 1e-6f ? fall_square : 1e-6f) +
                                              1.0f / (rise_square > 1e-6f ? rise_square : 1e-6f));
            int32_t* const sample = slits->samples + 5 * size;
            sample[0] = (int32_t)bottom;
            sample[1] = (int32_t)p0;
            sample[2] = (int32_t)p1;
            sample[3] = (int32_t)p2;
            sample[4] = (int32_t)p3;
            size++;
        }
    }
    slits->size = size;
    slits->crowded = crowded;
}

// Leaves out slits that are not at least a part as deep as the usual one, and counts places from sample `first` on.
// work (size,).
static void dark_ones(const float shallow, const int64_t first, float* const work, slits_t* const slits)
{
    memcpy(work, slits->depth, (size_t)slits->size * sizeof *work);
    const float limit = shallow * middle_f(work, slits->size);
    int64_t kept = 0;
    while (kept < slits->size && slits->depth[kept] >= limit) {
        kept++;  // most frames have none that is not
    }
    for (int64_t s = kept; s < slits->size; s++) {
        if (!(slits->depth[s] >= limit)) {
            continue;
        }
        slits->direction[kept] = slits->direction[s];
        slits->place[kept] = slits->place[s];
        slits->width[kept] = slits->width[s];
        slits->blur[kept] = slits->blur[s];
        slits->depth[kept] = slits->depth[s];
        memmove(slits->samples + 5 * kept, slits->samples + 5 * s, 5 * sizeof *slits->samples);
        kept++;
    }
    for (int64_t s = 0; s < kept; s++) {
        slits->place[s] += (double)first;
    }
    slits->size = kept;
}

// Every slit's line; its place and width, samples; its edges' blur; how dark it is, a part; samples (n, 5): its bottom,
// the first and last of the stripe inside and of that outside, from `first` on, the sample that the rows of top (t,)
// begin with, m in each; light (6, n) and bright (n,): see `rings_light`. Sorted by line, then outwards. work (3 m +
// 8), marks (m + 8), depths (n,): room to work in. counts (3,): slits; how many more were not dark enough; lines that
// had more than per_line.
DOOR void rings_find(const uint8_t* const image, const int64_t phase, const uint8_t* const top,
                     const int64_t* const stop, const int64_t first, const int64_t m, const float* const taps,
                     const float* const limits, const int64_t per_line, const int64_t clear, const int64_t beside,
                     const float shallow, const double* const ways, float* const work, uint8_t* const marks,
                     float* const depths, int64_t* const direction, double* const place, double* const width,
                     double* const blur, float* const depth, int32_t* const samples, double* const light,
                     double* const bright, int64_t* const counts, const int64_t h, const int64_t w, const int64_t b,
                     const int64_t t, const int64_t j, const int64_t r, const int64_t q, const int64_t n)
{
    slits_t slits = {direction, place, width, blur, depth, samples, 0, n, 0};
    scan(top, stop, first, m, taps, limits, per_line, clear, beside, work, marks, least((r - 8) / 3, q - 8), t, j,
         &slits);
    const int64_t every = slits.size;
    dark_ones(shallow, first, depths, &slits);
    const picture_t picture = {image, w, h, phase};
    rings_light(&picture, b != IN_COLOURS, ways, j, first, direction, samples, slits.size, light, bright, n);
    counts[0] = slits.size;
    counts[1] = every - slits.size;
    counts[2] = slits.crowded;
}
