// How far each point may be off in radius: annulus_pipe.rings.uncertainty has the theory.

#include <math.h>
#include <string.h>

#include "native.h"
#include "rings_by_ring.h"
#include "selection.h"

// What rings.uncertainty passes as `limits`, in this order; units and reasons stand there.
enum { LEAST, UNKNOWN_PX, CLIPPED_PX, DRAWN_PX, BLUR_LEAST, BLUR_MOST, SIGMA_OF_MAD, LAG };

// The points of a profile, of the first `size` slits those that have a ring: kept (n,) which slits; wall (n, 3), pipe
// frame, mm, z with the frame's station; colour (n, 3), RGB, the mean of what the two stripes show; clipped (n,): one
// is brighter than `full`; of_ring, of_line (n,). light (6, n). points (3, c): of candidates, of which `chosen` (n,) is
// each slit's. seen (3, n): the kept points in the camera's frame. Returns how many.
DOOR int64_t rings_keep(const int64_t* const ring, const int64_t* const direction, const int32_t* const chosen,
                        const double* const light, const double* const points, const double* const rotation,
                        const double* const shift, const double z, const double full, const int64_t size,
                        int64_t* const kept, double* const seen, float* const wall, uint8_t* const colour,
                        bool* const clipped, uint8_t* const of_ring, uint16_t* const of_line, const int64_t n,
                        const int64_t c)
{
    int64_t there = 0;
    for (int64_t s = 0; s < least(size, n); s++) {
        if (ring[s] < 0) {
            continue;
        }
        const int64_t at = bounded(chosen[s], 0, c - 1);
        kept[there] = s;
        of_ring[there] = (uint8_t)ring[s];
        of_line[there] = (uint16_t)direction[s];
        for (int axis = 0; axis < 3; axis++) {
            seen[axis * n + there] = points[axis * c + at];
        }
        bool over = false;
        for (int channel = 0; channel < 3; channel++) {
            const double a = light[(2 - channel) * n + s], b = light[(5 - channel) * n + s];
            const double mean = 0.5 * (a + b);
            colour[3 * there + channel] = (uint8_t)held(mean, 0.0, 255.0);
            over |= (a > full) | (b > full);
        }
        clipped[there] = over;
        there++;
    }
    for (int64_t i = 0; i < there; i++) {
        const double x = seen[i] - shift[0], y = seen[n + i] - shift[1], ahead = seen[2 * n + i] - shift[2];
        for (int axis = 0; axis < 3; axis++) {  // Eq. 4.6
            const double value = (x * rotation[axis] + y * rotation[3 + axis]) + ahead * rotation[6 + axis];
            wall[3 * i + axis] = (float)(value + (axis == 2 ? z : 0.0));
        }
    }
    return there;
}

typedef struct {
    double scatter;  // mm, of a place of usual blur
    double usual;    // blur
    double median;   // radius, mm; 0 where too few points
    double apart;    // px, from the median of all rings
    double share;    // px, what its edges are drawn
} ring_t;

// What one ring's own radii, laid out by direction (0: no point), say: third differences leave out the wall's slope and
// bend.
static ring_t ring_of(const double* const line, const int64_t directions, const double* const limits,
                      const double mm_per_px, double* const work)
{
    const int64_t lag = bounded((int64_t)limits[LAG], 1, directions / 4);
    ring_t out = {limits[UNKNOWN_PX] * mm_per_px, 1.0, 0.0, 0.0, 0.0};
    int64_t size = 0;
    for (int64_t j = 0; j < directions; j++) {
        const double r0 = line[j], r1 = line[around(j + lag, directions)], r2 = line[around(j + 2 * lag, directions)];
        const double r3 = line[around(j + 3 * lag, directions)];
        work[size] = fabs(r3 - r0 - 3.0 * (r2 - r1));
        size += (r0 > 0.0) & (r1 > 0.0) & (r2 > 0.0) & (r3 > 0.0);
    }
    if ((double)size >= limits[LEAST]) {
        out.scatter = limits[SIGMA_OF_MAD] / sqrt(20.0) * middle(work, size);
    }
    size = 0;
    for (int64_t j = 0; j < directions; j++) {
        work[size] = line[j];
        size += line[j] > 0.0;
    }
    if ((double)size >= limits[LEAST]) {
        out.median = middle(work, size);
    }
    return out;
}

// Distance of each point from the pipe's axis, and what the pose's covariance leaves open of it, squared.
static void of_pose(const double* const points, const int64_t n, const int64_t size, const double rotation[9],
                    const double shift[3], const double covariance[16], double* const restrict radius,
                    double* const restrict square)
{
    const double a0 = rotation[0], a1 = rotation[1], a2 = rotation[2], b0 = rotation[3], b1 = rotation[4];
    const double b2 = rotation[5], c0 = rotation[6], c1 = rotation[7], c2 = rotation[8], sx = shift[0], sy = shift[1];
    const double* const v = covariance;
    const double v00 = v[0], v11 = v[5], v22 = v[10], v33 = v[15], v01 = v[1] + v[4], v02 = v[2] + v[8];
    const double v03 = v[3] + v[12], v12 = v[6] + v[9], v13 = v[7] + v[13], v23 = v[11] + v[14];
    for (int64_t i = 0; i < size; i++) {
        const double x = points[i] - sx, y = points[n + i] - sy, z = points[2 * n + i];
        const double p = (x * a0 + y * b0) + z * c0, q = (x * a1 + y * b1) + z * c1;  // Eq. 4.6
        const double ahead = (x * a2 + y * b2) + z * c2, r = sqrt(p * p + q * q);
        // A lean turns the point about the camera; leans are small, so x and y of the two frames are alike here.
        const double across = 1.0 / r, dx = -p * across, dy = -q * across;
        const double drx = -ahead * dy, dry = ahead * dx;
        radius[i] = r;
        square[i] = (drx * (v00 * drx + v01 * dry + v02 * dx + v03 * dy) + dry * (v11 * dry + v12 * dx + v13 * dy)) +
                    (dx * (v22 * dx + v23 * dy) + dy * v33 * dy);
    }
}

// Values (s,) of slits that were kept, ring by ring.
static void lay_out(by_ring_t list, const int64_t* const ring, const int64_t s, const int64_t* const kept,
                    const int64_t size, const double* const values, double* const out)
{
    for (int64_t i = 0; i < size; i++) {
        const int64_t m = bounded(kept[i], 0, s - 1);
        out[place_in(&list, ring[m])] = values[m];
    }
}

// out (o,) and drawn (k,): the sigmas of `point_sigma`, mm, of the first `size` points, which are slits kept (n,);
// points (3, n), camera frame. covariance (4, 4): of rx, ry, tx, ty. bias: px, of every place. usual_width (k,),
// samples: the median of each ring's, 0 of fewer than `fewest`. table (k, j), rings (k, 5), work (w,): room to work in.
DOOR void rings_sigma(const int64_t* const kept, const int64_t* const ring, const int64_t* const direction,
                      const double* const points, const double* const blur, const double* const width,
                      const double* const wider, const bool* const clipped, const double* const rotation,
                      const double* const shift, const double* const covariance, const double* const mm_per_px,
                      const double* const calibrated, const double bias, const double* const limits,
                      const int64_t fewest, const int64_t size, double* const table, double* const rings,
                      double* const work, double* const pose, float* const out, double* const drawn,
                      double* const usual_width, const int64_t n, const int64_t s, const int64_t k, const int64_t j,
                      const int64_t l, const int64_t w, const int64_t o)
{
    const int64_t all = least(size, least(n, o));
    if (w < most(all + 1, j + 1)) {
        return;
    }
    ring_t* const of = (ring_t*)rings;
    memset(table, 0, (size_t)(k * j) * sizeof *table);
    of_pose(points, n, all, rotation, shift, covariance, work, pose);
    for (int64_t i = 0; i < all; i++) {
        const int64_t m = bounded(kept[i], 0, s - 1);
        table[bounded(ring[m], 0, k - 1) * j + bounded(direction[m], 0, j - 1)] = work[i];
    }
    const by_ring_t list = by_ring(ring, s, kept, all, k);
    lay_out(list, ring, s, kept, all, width, work);
    for (int64_t q = 0; q < k; q++) {
        const int64_t first = list.first[least(q, RINGS_MOST)], members = list.first[least(q + 1, RINGS_MOST)] - first;
        usual_width[q] = members >= most(fewest, 1) ? halfway(work + first, members) : 0.0;
    }
    lay_out(list, ring, s, kept, all, blur, work);
    for (int64_t q = 0; q < k; q++) {
        const int64_t first = list.first[least(q, RINGS_MOST)], members = list.first[least(q + 1, RINGS_MOST)] - first;
        const double usual = middle(work + first, members);
        of[q].usual = usual > 1e-9 ? usual : 1e-9;
    }
    for (int64_t q = 0; q < k; q++) {
        const double usual = of[q].usual;
        of[q] = ring_of(table + q * j, j, limits, mm_per_px[q], work);
        of[q].usual = usual;
    }
    int64_t known = 0;
    for (int64_t q = 0; q < k && known < w; q++) {
        work[known] = of[q].median;
        known += of[q].median > 0.0;
    }
    const double wall = middle(work, known);
    double common = bias;
    if (known > 1) {
        known = 0;
        for (int64_t q = 0; q < k; q++) {
            if (of[q].median > 0.0) {
                of[q].apart = fabs(of[q].median - wall) / mm_per_px[q];
                work[known++] = of[q].apart;
            }
        }
        const double scatter = limits[SIGMA_OF_MAD] * middle(work, known), least_px = scatter > bias ? scatter : bias;
        common = least_px < limits[DRAWN_PX] ? least_px : limits[DRAWN_PX];
    }
    for (int64_t q = 0; q < k; q++) {
        of[q].share = common < of[q].apart && of[q].apart < limits[DRAWN_PX] ? of[q].apart : common;
        const double more = of[q].share * of[q].share - bias * bias;
        drawn[q] = sqrt(more > 0.0 ? more : 0.0) * mm_per_px[q];
    }
    for (int64_t i = 0; i < all; i++) {
        const int64_t q = bounded(ring[bounded(kept[i], 0, s - 1)], 0, k - 1);
        const double soft = held(blur[bounded(kept[i], 0, s - 1)] / of[q].usual, limits[BLUR_LEAST], limits[BLUR_MOST]);
        const double place = (of[q].scatter * soft) * (of[q].scatter * soft);
        const double most_px = of[q].share > limits[CLIPPED_PX] ? of[q].share : limits[CLIPPED_PX];
        const double shared = (clipped[i] ? most_px : of[q].share) * mm_per_px[q];
        // the width scatters by twice what the middle does; only what is more is not noise
        const double half = 0.5 * wider[bounded(kept[i], 0, s - 1)] * mm_per_px[q], more = half * half - 4.0 * place;
        const double known_mm = calibrated[q * j + bounded(direction[bounded(kept[i], 0, s - 1)], 0, j - 1)];
        out[i] =
            (float)sqrt((place + shared * shared) + (more > 0.0 ? more : 0.0) / 3.0 + pose[i] + known_mm * known_mm);
    }
    (void)l;
}

// What a pose is fitted to: of the first `size` slits those with a ring, every so manieth where there are more than
// `most_points` twice over (0: all). out (3, p); weight (p,): worth (k,) of its ring. counts (2,): how many; how many
// rings have more than ring_points of them. in_ring (k,): room to work in.
DOOR void rings_for_fit(const int64_t* const ring, const int32_t* const chosen, const double* const points,
                        const double* const worth, const int64_t most_points, const int64_t ring_points,
                        const int64_t size, double* const out, double* const weight, int64_t* const in_ring,
                        int64_t* const counts, const int64_t n, const int64_t c, const int64_t k, const int64_t p)
{
    const int64_t slits = least(size, n);
    int64_t named = 0;
    for (int64_t s = 0; s < slits; s++) {
        named += ring[s] >= 0;
    }
    const int64_t every = most_points > 0 ? most(named / most_points, 1) : 1;
    memset(in_ring, 0, (size_t)k * sizeof *in_ring);
    int64_t there = 0, wait = 0;
    for (int64_t s = 0; s < slits && there < p; s++) {
        if (ring[s] < 0) {
            continue;
        }
        if (wait == 0) {
            const int64_t at = bounded(chosen[s], 0, c - 1), own = bounded(ring[s], 0, k - 1);
            out[there] = points[at];
            out[p + there] = points[c + at];
            out[2 * p + there] = points[2 * c + at];
            weight[there] = worth[own];
            in_ring[own]++;
            there++;
            wait = every;
        }
        wait--;
    }
    counts[0] = there;
    counts[1] = 0;
    for (int64_t r = 0; r < k; r++) {
        counts[1] += in_ring[r] > ring_points;
    }
}
