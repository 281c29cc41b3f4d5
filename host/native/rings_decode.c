// Which ring each slit is: annulus_pipe.rings.decode has the theory. Of a slit only those rings are looked at whose two
// stripes have its colours, one in five: they are listed once, and everything after goes through the list.

#include <math.h>

#include "native.h"
#include "rings_choose.h"
#include "rings_frame.h"

#define UNKNOWN 255
#define COLOURS 4      // red, green, blue, and unknown
#define RINGS_MOST 64  // of a pattern: a bit of a word each; more than any slide has

// What two stripes prove of a ring's: 2 for both, 1 for one with the other unknown, 0 for none.
INLINE int fit_of(const uint8_t inside, const uint8_t outside, const uint8_t left, const uint8_t right)
{
    const bool l = inside == left, r = outside == right;
    return (l & r) ? 2 : ((l & (outside == UNKNOWN)) | (r & (inside == UNKNOWN))) ? 1 : 0;
}

INLINE int place_of(const uint8_t colour)
{
    return colour < COLOURS - 1 ? colour : COLOURS - 1;
}

INLINE uint8_t letter(const int place)
{
    return place < COLOURS - 1 ? (uint8_t)place : UNKNOWN;
}

// out (n, k): slit n has the two colours of ring k, as far as they are known, and at least one is. pattern (k + 1,).
DOOR void rings_read(const uint8_t* const inside, const uint8_t* const outside, const uint8_t* const pattern,
                     bool* const out, const int64_t n, const int64_t p, const int64_t k)
{
    for (int64_t s = 0; s < n; s++) {
        for (int64_t r = 0; r < k && r + 1 < p; r++) {
            out[s * k + r] = fit_of(inside[s], outside[s], pattern[r], pattern[r + 1]) > 0;
        }
    }
}

// The list of what each of the first `size` slits may be: its place, the ring, how well the colours fit. colour (2, c):
// inside, outside. counts (2,): how many; slits with a stripe of no clear colour.
DOOR void rings_list(const uint8_t* const colour, const int64_t size, const uint8_t* const pattern, int32_t* const slit,
                     int32_t* const name, uint8_t* const fit, int64_t* const counts, const int64_t c, const int64_t p,
                     const int64_t n)
{
    const uint8_t* const inside = colour;
    const uint8_t* const outside = colour + c;
    uint64_t both[COLOURS][COLOURS] = {{0}}, one[COLOURS][COLOURS] = {{0}};  // a bit for each ring that two colours fit
    const int64_t rings = least(p - 1, RINGS_MOST);
    for (int a = 0; a < COLOURS; a++) {
        for (int b = 0; b < COLOURS; b++) {
            for (int64_t r = 0; r < rings; r++) {
                const int fits = fit_of(letter(a), letter(b), pattern[r], pattern[r + 1]);
                both[a][b] |= (uint64_t)(fits == 2) << r;
                one[a][b] |= (uint64_t)(fits == 1) << r;
            }
        }
    }
    int64_t there = 0, unclear = 0;
    for (int64_t s = 0; s < least(size, c); s++) {
        const int a = place_of(inside[s]), b = place_of(outside[s]);
        unclear += (a == COLOURS - 1) | (b == COLOURS - 1);
        for (uint64_t left = both[a][b] | one[a][b]; left != 0 && there < n; left &= left - 1) {
            const int r = __builtin_ctzll(left);
            slit[there] = (int32_t)s;
            name[there] = r;
            fit[there++] = (both[a][b] >> r) & 1 ? 2 : 1;
        }
    }
    counts[0] = there;
    counts[1] = unclear;
}

// What each candidate is worth: 1 for each colour that fits, `skip` for one slit not left out, and the price of a wall
// that is off by a part of the tolerance; less than 0 where it is off by more.
static void weigh(const uint8_t* const fit, const double* const deviation, const int64_t size, const double tolerance,
                  const double skip, const double place, double* const restrict worth)
{
    for (int64_t i = 0; i < size; i++) {
        const double part = deviation[i] / tolerance, price = place * (part * part);
        worth[i] = fabs(deviation[i]) <= tolerance ? ((double)fit[i] + skip) - price : -1.0;
    }
}

// Ring of each of the first `size` slits, by the list's (first `listed`) deviations, and which of the list was chosen.
// deviation (n,): as it is, or of points, see `rings_deviations`. Returns how many have one. work (3, w), places (2,
// w): as many as one line may list. prices (3,): skip, place, margin. ring (c,) is NONE (-1) where it is none or could
// be more than one.
DOOR int64_t rings_align(const int64_t* const direction, const int64_t size, const int32_t* const slit,
                         const int32_t* const name, const uint8_t* const fit, double* const deviation,
                         const int64_t listed, const double* const points, const double* const rotation,
                         const double* const shift, const double radius, const double tolerance,
                         const double* const prices, double* const worth, int64_t* const places, double* const work,
                         int64_t* const ring, int32_t* const chosen, const int64_t c, const int64_t n, const int64_t w)
{
    if (points != NULL && rotation != NULL && shift != NULL) {
        rings_deviations(points, listed, rotation, shift, radius, deviation, n);
    }
    const int64_t slits = least(size, c), all = least(listed, n);
    weigh(fit, deviation, all, tolerance, prices[0], prices[1], worth);
    int64_t* const own_slit = places;
    int64_t* const own_name = places + w;
    double* const own = work;
    int64_t named = 0;
    for (int64_t s = 0; s < slits; s++) {
        ring[s] = -1;
    }
    for (int64_t start = 0, next = 0; start < all; start = next) {
        const int64_t line = direction[bounded(slit[start], 0, slits - 1)];
        int64_t there = 0;
        for (next = start; next < all; next++) {
            const int64_t s = bounded(slit[next], 0, slits - 1);
            if (direction[s] != line) {
                break;
            }
            if (there < w) {
                own_slit[there] = s;
                own_name[there] = name[next];
                own[there] = worth[next];
                there += worth[next] > 0.0;
            }
        }
        choose(own_slit, own_name, own, work + w, work + 2 * w, there, prices[2], ring);
        for (int64_t i = start; i < next; i++) {
            const int64_t s = bounded(slit[i], 0, slits - 1);
            if (ring[s] == name[i]) {
                chosen[s] = (int32_t)i;
                named++;
            }
        }
    }
    return named;
}

// The same for lines of light without a colour: ring (n,) of each by its strength, 1 is the usual one, and its
// deviation (n, k) if it were that ring. prices (4,): skip, strong, place, margin.
DOOR void rings_align_lines(const int64_t* const direction, const double* const strength, const double* const deviation,
                            const double tolerance, const double* const prices, int64_t* const places,
                            double* const work, int64_t* const ring, const int64_t n, const int64_t k, const int64_t w)
{
    int64_t* const slit = places;
    int64_t* const name = places + w;
    double* const own = work;
    for (int64_t start = 0, next = 0; start < n; start = next) {
        int64_t there = 0;
        for (next = start; next < n && direction[next] == direction[start]; next++) {
            ring[next] = -1;
            for (int64_t r = 0; r < k && there < w; r++) {
                const double part = deviation[next * k + r] / tolerance;
                const double strong = strength[next] < 1.0 ? strength[next] : 1.0;
                slit[there] = next;
                name[there] = r;
                own[there] = (prices[0] + prices[1] * strong) - prices[2] * (part * part);
                there += (fabs(part) <= 1.0) & (own[there] > 0.0);
            }
        }
        choose(slit, name, own, work + w, work + 2 * w, there, prices[3], ring);
    }
}
