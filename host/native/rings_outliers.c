// Slits that got a ring's name and are still not believed: annulus_pipe.rings.outliers has the theory. A ring is laid
// out by direction, so that what its neighbours say is asked of all directions side by side.

#include <math.h>
#include <string.h>

#include "native.h"
#include "rings_by_ring.h"
#include "selection.h"

#define NONE (-1)
#define EDGE 8  // directions laid out twice at both ends, at least the farthest neighbour that is asked

// What rings.outliers passes as `limits`, in this order; units and reasons stand there.
enum { NARROW, WIDE, WIDTH_NOISE, UNLIKE, SHADE, SIGMA_OF_MAD };

typedef struct {
    double mean, even, odd, spread;
} usual_t;

// A ring's width over its median as mean, cosine and sine of the direction, and the robust spread about that. Of every
// so manieth of its slits: three numbers do not need every direction. ratio, c, s, work (size,).
static usual_t usual_width(const double* const ratio, const double* const c, const double* const s, const int64_t size,
                           double* const work, const double sigma_of_mad)
{
    usual_t usual = {1.0, 0.0, 0.0, 0.2};
    for (int round = 0; round < 3; round++) {
        const double limit = 2.5 * usual.spread > 0.05 ? 2.5 * usual.spread : 0.05;
        double used = 0.0, sc = 0.0, ss = 0.0, scc = 0.0, sss = 0.0, scs = 0.0, sv = 0.0, svc = 0.0, svs = 0.0;
        for (int64_t m = 0; m < size; m++) {
            const double v = ratio[m];
            const double w = fabs(v - usual.mean - usual.even * c[m] - usual.odd * s[m]) < limit ? 1.0 : 0.0;
            const double wc = w * c[m], ws = w * s[m];
            used += w;
            sc += wc;
            ss += ws;
            scc += wc * c[m];
            sss += ws * s[m];
            scs += wc * s[m];
            sv += w * v;
            svc += wc * v;
            svs += ws * v;
        }
        if (used < 0.5 * (double)size) {
            break;
        }
        // Cramer's rule on the normal equations; a trace of ridge, for an arc alone does not tell the three apart
        const double a = used + 1e-6, b = scc + 1e-6, d = sss + 1e-6;
        const double det = a * (b * d - scs * scs) - sc * (sc * d - scs * ss) + ss * (sc * scs - b * ss);
        usual.mean = (sv * (b * d - scs * scs) - sc * (svc * d - scs * svs) + ss * (svc * scs - b * svs)) / det;
        usual.even = (a * (svc * d - svs * scs) - sv * (sc * d - scs * ss) + ss * (sc * svs - svc * ss)) / det;
        usual.odd = (a * (b * svs - scs * svc) - sc * (sc * svs - ss * svc) + sv * (sc * scs - b * ss)) / det;
        for (int64_t m = 0; m < size; m++) {
            work[m] = fabs(ratio[m] - usual.mean - usual.even * c[m] - usual.odd * s[m]);
        }
        usual.spread = sigma_of_mad * middle(work, size);
    }
    return usual;
}

// The ends of a row (j,) that begins EDGE after `row`, laid out again beyond each other.
static void closed(double* const row, const int64_t j)
{
    for (int64_t i = 0; i < EDGE; i++) {
        row[i] = row[j + i];
        row[EDGE + j + i] = row[EDGE + i];
    }
}

// Sets ring (n,) to NONE where a slit is not to be believed; counts (3,): for its width, as shaded, as alone. wider
// (n,), px: than its ring around there. width (n,); deviation (c,), of which
// `chosen` is each slit's: of the wall's radius from the pipe's. bright (n,): its
// stripes' light. step (k,), mm: how much two neighbours may differ. cosine, sine (j,). every: slits between two that a
// ring's width is learnt from; reach, neighbours: directions; company: slits. work (w,), at least n and 6 (j +
// 16), order (o,), at least n + 1: room to work in.
DOOR void rings_reject(int64_t* const ring, const int64_t* const direction, const double* const width,
                       const double* const bright, const int32_t* const chosen, const double* const deviation,
                       const double pipe, const double* const step, const double* const cosine,
                       const double* const sine, const double* const limits, const int64_t every, const int64_t reach,
                       const int64_t neighbours, const int64_t company, const int64_t size, double* const work,
                       int32_t* const order, int64_t* const slit, int64_t* const counts, double* const wider,
                       const int64_t n, const int64_t c, const int64_t k, const int64_t j, const int64_t l,
                       const int64_t w, const int64_t o)
{
    const int64_t slits = least(least(size, n), o - 1), room = j + 2 * EDGE, asked = bounded(neighbours, 0, EDGE);
    double* const light = work;             // by direction, EDGE of the other end before and after
    double* const place = work + room;      // NaN: none
    double* const ratio = work + 2 * room;  // of some of the ring's slits
    double* const even = work + 3 * room;
    double* const odd = work + 4 * room;
    double* const values = work + 5 * room;
    memset(counts, 0, 3 * sizeof *counts);
    memset(wider, 0, (size_t)slits * sizeof *wider);
    if (j < 2 * EDGE || w < 6 * room || w < slits) {
        return;
    }
    by_ring_t list = by_ring(ring, n, NULL, slits, k);
    for (int64_t s = 0; s < slits; s++) {
        order[place_in(&list, ring[s])] = (int32_t)s;
    }
    const int64_t named = list.first[RINGS_MOST];
    for (int64_t i = 0; i < named; i++) {
        work[i] = width[order[i]];
    }
    const double frame = middle(work, named);
    for (int64_t r = 0; r < least(k, RINGS_MOST); r++) {
        const int32_t* const own = order + list.first[r];
        const int64_t members = least(list.first[r + 1] - list.first[r], j);
        int64_t some = 0;
        for (int64_t i = 0; i < j; i++) {
            slit[i] = NONE;
            light[EDGE + i] = 0.0;
            place[EDGE + i] = NOTHING;
        }
        for (int64_t i = 0; i < members; i++) {
            values[i] = width[own[i]];
        }
        for (int64_t i = 0; i < members; i += every) {
            const int64_t at = bounded(direction[own[i]], 0, j - 1);
            ratio[some] = width[own[i]];
            even[some] = cosine[at];
            odd[some] = sine[at];
            some++;
        }
        if (members == 0) {
            continue;
        }
        // Two slits with a dark stripe between them look like one wide one, all the way round.
        const double usual = held(middle(values, members), frame / limits[UNLIKE], frame * limits[UNLIKE]);
        for (int64_t i = 0; i < some; i++) {
            ratio[i] /= usual;
        }
        const usual_t about = usual_width(ratio, even, odd, some, values, limits[SIGMA_OF_MAD]);
        const double noise = limits[WIDTH_NOISE] * about.spread / (limits[WIDE] - 1.0);
        const double slack = held(noise, 1.0, 2.0);
        const double narrowest = 1.0 - (1.0 - limits[NARROW]) * slack, widest = 1.0 + (limits[WIDE] - 1.0) * slack;
        for (int64_t i = list.first[r]; i < list.first[r + 1]; i++) {
            const int64_t s = order[i], at = bounded(direction[s], 0, j - 1);
            const double around_there = about.mean + about.even * cosine[at] + about.odd * sine[at];
            const double expected = held(around_there, limits[NARROW], limits[WIDE]);
            const double part = width[s] / usual / expected;
            wider[s] = width[s] - usual * expected;
            if (part < narrowest || part > widest) {
                ring[s] = NONE;
                counts[0]++;
            } else {
                slit[at] = s;
                light[EDGE + at] = bright[s];
                place[EDGE + at] = pipe * (1.0 + deviation[bounded(chosen[s], 0, c - 1)]);
            }
        }
        closed(light, j);
        double* const brightest = even;
        memset(brightest, 0, (size_t)j * sizeof *brightest);
        for (int64_t d = -bounded(reach, 0, EDGE); d <= bounded(reach, 0, EDGE); d++) {
            for (int64_t i = 0; i < j; i++) {
                const double other = light[EDGE + i + d];
                brightest[i] = other > brightest[i] ? other : brightest[i];
            }
        }
        for (int64_t i = 0; i < j; i++) {
            if (slit[i] != NONE && light[EDGE + i] < limits[SHADE] * brightest[i]) {
                ring[slit[i]] = NONE;
                place[EDGE + i] = NOTHING;
                slit[i] = NONE;
                counts[1]++;
            }
        }
        closed(place, j);
        double* const near = odd;  // how many neighbours lie near
        memset(near, 0, (size_t)j * sizeof *near);
        for (int64_t d = 1; d <= asked; d++) {
            for (int64_t i = 0; i < j; i++) {
                const double here = place[EDGE + i];
                near[i] += fabs(place[EDGE + i - d] - here) <= step[r] ? 1.0 : 0.0;
                near[i] += fabs(place[EDGE + i + d] - here) <= step[r] ? 1.0 : 0.0;
            }
        }
        for (int64_t i = 0; i < j; i++) {
            if (slit[i] != NONE && near[i] < (double)company) {
                ring[slit[i]] = NONE;
                counts[2]++;
            }
        }
    }
    (void)l;
}
