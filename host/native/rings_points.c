// From slits to points: each slit's ray meets the cone of a ring that it might be. annulus_pipe.rings.triangulate has
// the theory; equations are Alzuhiri's (2022).

#include <math.h>
#include <string.h>

#include "mathematics.h"
#include "native.h"
#include "rings_frame.h"
#include "selection.h"

#define CONE 7    // numbers of a cone: vertex, axis, half-angle
#define LANES 64  // candidates worked on side by side: what fits into the fastest cache
#define RINGS 64  // whose squared cosines are worked out once a frame; of any more, point by point

typedef struct {
    const float* rays;          // (j, l, 3)
    const float* origins;       // the same, or null: all rays start in the camera's centre
    int64_t nodes;              // l
    double step;                // samples between two nodes
    const double* bend;         // (k, j)
    int64_t lines;              // j
    const double* corrections;  // (k, c, 2), or null
    int64_t azimuths;           // c
    double flat, grazing;       // FLAT and GRAZING of geometry.cone and rings.triangulate
} optics_t;

typedef struct {
    double ox, oy, oz, x, y, z;
} ray_t;

typedef struct {
    double vx, vy, vz, ax, ay, az;
} cone_t;

INLINE cone_t cone_of(const double row[CONE])
{
    const cone_t cone = {row[0], row[1], row[2], row[3], row[4], row[5]};
    return cone;
}

INLINE double is(const bool so)
{
    return so ? 1.0 : 0.0;
}

// How far along its unit way a ray meets a cone, NaN if nowhere: App. A.2; of two forward roots the farther,
// section 5.2.
INLINE double meet(const ray_t ray, const cone_t cone, const double cos2, const double flat, const double grazing)
{
    const double vx = cone.vx - ray.ox, vy = cone.vy - ray.oy, vz = cone.vz - ray.oz;
    const double ax = cone.ax, ay = cone.ay, az = cone.az;
    const double along = (ray.x * ax + ray.y * ay) + ray.z * az;
    const double va = -((vx * ax + vy * ay) + vz * az);
    const double wv = -((ray.x * vx + ray.y * vy) + ray.z * vz);
    const double vv = (vx * vx + vy * vy) + vz * vz;
    const double to_plane = -va / along;
    const double a = along * along - cos2;            // Eq. 5.3
    const double b = 2.0 * (along * va - wv * cos2);  // Eq. 5.4
    const double c = va * va - vv * cos2;             // Eq. 5.5
    // delta^2, Eq. 5.7: b b - 4 a c with what cancels taken out, for a cone that is nearly flat
    const double inside =
        4.0 * cos2 * (((along * along * vv - 2.0 * along * va * wv) + va * va) + cos2 * (wv * wv - vv));
    const double root = sqrt(inside > 0.0 ? inside : 0.0);
    const double q = -0.5 * (b + (b < 0.0 ? -root : root));  // roots of Eq. 5.6 are q / a and c / q: nothing cancels
    // Whether something holds is 1.0 or 0.0, of what divides by nought too: vectors have no choice within a choice.
    const double first = q / a, second = c / q;
    const double at_first = is(a != 0.0) * is(first > 0.0) * is(va + first * along > 0.0);
    const double best = at_first > 0.0 ? first : 0.0;
    const double at_second = is(q != 0.0) * is(second > best) * is(va + second * along > 0.0);
    const double far = at_second > 0.0 ? second : best;
    // delta over the length of the cone's gradient there is the sine of the angle between ray and cone
    const double away2 = (vv + 2.0 * far * wv) + far * far;
    const double least_square = grazing * grazing * 4.0 * cos2 * (1.0 - cos2) * away2;
    const double on_cone = is(inside > 0.0) * is(far > 0.0) * is(inside > least_square);
    const double on_plane = is(fabs(along) > grazing) * is(to_plane > 0.0);
    const double meets = cos2 < flat ? on_plane : on_cone, there = cos2 < flat ? to_plane : far;
    return meets > 0.0 ? there : NOTHING;
}

// The ring's cone as it is at the azimuth of a point, between the samples of its correction (n, 2).
static void corrected(const double px, const double py, const double pz, const double cone[CONE],
                      const double* const correction, const int64_t n, double out[CONE])
{
    const double ax = cone[3], ay = cone[4], az = cone[5];
    const double across = sqrt(1.0 - ax * ax);
    const double x = px - cone[0], y = py - cone[1], z = pz - cone[2];
    const double first = x * across - (y * ay + z * az) * ax / across;  // along the camera's x across the axis
    const double second = (y * az - z * ay) / across;
    const double turn = arc_tangent(second, first) / TURN * (double)n;
    const double known = turn == turn ? turn : 0.0, below = floor(known), part = known - below;
    const int64_t i = around(whole(below, -n, n), n), j = around(i + 1, n);
    const double shift = correction[2 * i + 1] + part * (correction[2 * j + 1] - correction[2 * i + 1]);
    out[0] = cone[0] + shift * ax;  // Eq. 4.12
    out[1] = cone[1] + shift * ay;
    out[2] = cone[2] + shift * az;
    out[3] = ax;
    out[4] = ay;
    out[5] = az;
    out[6] = cone[6] + correction[2 * i] + part * (correction[2 * j] - correction[2 * i]);
}

INLINE const float* node_at(const optics_t* const optics, const int64_t line, const double at)
{
    return optics->rays + 3 * (line * optics->nodes + whole(at / optics->step, 0, optics->nodes - 2));
}

// The ray of a place along a line, between the grid's nodes.
INLINE ray_t ray_at(const optics_t* const optics, const int64_t line, const double at)
{
    const double there = at / optics->step;
    const int64_t i = whole(there, 0, optics->nodes - 2);
    const double part = there - (double)i;
    const float* const near = optics->rays + 3 * (line * optics->nodes + i);
    ray_t ray = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    ray.x = (double)near[0] + part * (double)(near[3] - near[0]);
    ray.y = (double)near[1] + part * (double)(near[4] - near[1]);
    ray.z = (double)near[2] + part * (double)(near[5] - near[2]);
    if (optics->origins != NULL) {
        const float* const start = optics->origins + 3 * (line * optics->nodes + i);
        ray.ox = (double)start[0] + part * (double)(start[3] - start[0]);
        ray.oy = (double)start[1] + part * (double)(start[4] - start[1]);
        ray.oz = (double)start[2] + part * (double)(start[5] - start[2]);
    }
    return ray;
}

INLINE ray_t unit(const ray_t ray)
{
    const double scale = 1.0 / sqrt((ray.x * ray.x + ray.y * ray.y) + ray.z * ray.z);
    const ray_t out = {ray.ox, ray.oy, ray.oz, ray.x * scale, ray.y * scale, ray.z * scale};
    return out;
}

INLINE double squared_cosine(const double angle)
{
    double c, s;
    cosine_sine(angle, &c, &s);
    return c * c;
}

// Once more with the cone that was measured at this azimuth, where there are corrections.
static double met_again(const optics_t* const optics, const ray_t ray, const double far, const double cone[CONE],
                        const int64_t ring)
{
    double own[CONE];
    corrected(ray.ox + far * ray.x, ray.oy + far * ray.y, ray.oz + far * ray.z, cone,
              optics->corrections + 2 * ring * optics->azimuths, optics->azimuths, own);
    return meet(ray, cone_of(own), squared_cosine(own[6]), optics->flat, optics->grazing);
}

// Candidates side by side: rays as they lie in the table, then unit ways, and how far each meets its cone.
typedef struct {
    double ox[LANES], oy[LANES], oz[LANES], x[LANES], y[LANES], z[LANES];
    double vx[LANES], vy[LANES], vz[LANES], ax[LANES], ay[LANES], az[LANES], cos2[LANES];
    double far[LANES];
} lanes_t;

static void meet_all(lanes_t* const restrict one, const int64_t size, const double flat, const double grazing)
{
    for (int64_t i = 0; i < size; i++) {
        const ray_t ray = unit((ray_t){one->ox[i], one->oy[i], one->oz[i], one->x[i], one->y[i], one->z[i]});
        const cone_t cone = {one->vx[i], one->vy[i], one->vz[i], one->ax[i], one->ay[i], one->az[i]};
        one->far[i] = meet(ray, cone, one->cos2[i], flat, grazing);
        one->x[i] = ray.x;
        one->y[i] = ray.y;
        one->z[i] = ray.z;
    }
}

// points (3, n): where each of the first `listed` candidates lies, mm, camera frame; NaN where ray and cone do not
// meet. position, width (s,): of slits; direction (s,). limits (3,): samples a node, FLAT, GRAZING. bend (k, j).
DOOR void rings_points(const int64_t* const direction, const double* const position, const double* const width,
                       const int64_t size, const double widest_part, double* const work, const int32_t* const slit,
                       const int32_t* const name, const int64_t listed, const float* const rays,
                       const float* const origins, const double* const cones, const double* const bend,
                       const double* const corrections, const double* const limits, double* const points,
                       const int64_t s, const int64_t n, const int64_t j, const int64_t l, const int64_t k,
                       const int64_t c)
{
    const optics_t optics = {rays, origins, l, limits[0], bend, j, corrections, c, limits[1], limits[2]};
    const int64_t all = least(listed, n), slits = least(size, s);
    memcpy(work, width, (size_t)slits * sizeof *work);
    const double widest = widest_part * middle(work, slits);
    double squares[RINGS];
    for (int64_t r = 0; r < least(k, RINGS); r++) {
        squares[r] = squared_cosine(cones[CONE * r + 6]);
    }
    lanes_t one = {.ox = {0.0}};
    for (int64_t start = 0; start < all; start += LANES) {
        const int64_t there = least(LANES, all - start);
        double place[LANES];
        for (int64_t i = 0; i < there; i++) {
            const int64_t m = bounded(slit[start + i], 0, s - 1), r = bounded(name[start + i], 0, k - 1);
            const int64_t line = bounded(direction[m], 0, j - 1);
            const double wide = width[m] < widest ? width[m] : widest;
            place[i] = position[m] + bend[r * j + line] * wide * wide / 8.0;
            __builtin_prefetch(node_at(&optics, line, place[i]));
        }
        for (int64_t i = 0; i < there; i++) {
            const int64_t m = bounded(slit[start + i], 0, s - 1), r = bounded(name[start + i], 0, k - 1);
            const ray_t ray = ray_at(&optics, bounded(direction[m], 0, j - 1), place[i]);
            const double* const cone = cones + CONE * r;
            one.ox[i] = ray.ox;
            one.oy[i] = ray.oy;
            one.oz[i] = ray.oz;
            one.x[i] = ray.x;
            one.y[i] = ray.y;
            one.z[i] = ray.z;
            one.vx[i] = cone[0];
            one.vy[i] = cone[1];
            one.vz[i] = cone[2];
            one.ax[i] = cone[3];
            one.ay[i] = cone[4];
            one.az[i] = cone[5];
            one.cos2[i] = r < RINGS ? squares[r] : squared_cosine(cone[6]);
        }
        meet_all(&one, there, optics.flat, optics.grazing);
        for (int64_t i = 0; i < there; i++) {
            if (corrections != NULL) {
                const int64_t r = bounded(name[start + i], 0, k - 1);
                const ray_t ray = {one.ox[i], one.oy[i], one.oz[i], one.x[i], one.y[i], one.z[i]};
                one.far[i] = met_again(&optics, ray, one.far[i], cones + CONE * r, r);
            }
            points[start + i] = one.ox[i] + one.far[i] * one.x[i];
            points[n + start + i] = one.oy[i] + one.far[i] * one.y[i];
            points[2 * n + start + i] = one.oz[i] + one.far[i] * one.z[i];
        }
    }
}

// deviation (n,): distance of the first `listed` points (3, n) from the pipe's axis over its radius, less one.
DOOR void rings_deviations(const double* const points, const int64_t listed, const double* const rotation,
                           const double* const shift, const double radius, double* const deviation, const int64_t n)
{
    const double a0 = rotation[0], a1 = rotation[1], b0 = rotation[3], b1 = rotation[4], c0 = rotation[6];
    const double c1 = rotation[7], sx = shift[0], sy = shift[1];
    for (int64_t i = 0; i < least(listed, n); i++) {
        const double x = points[i] - sx, y = points[n + i] - sy, z = points[2 * n + i];
        const double u = (x * a0 + y * b0) + z * c0;  // Eq. 4.6
        const double v = (x * a1 + y * b1) + z * c1;
        deviation[i] = sqrt(u * u + v * v) / radius - 1.0;
    }
}

// points (n, k, 3): where slit n lies if it is ring k; NaN where that is not wanted, or ray and cone do not meet.
DOOR void rings_all_points(const int64_t* const direction, const double* const position, const double* const width,
                           const bool* const wanted, const float* const rays, const float* const origins,
                           const double* const cones, const double* const bend, const double* const corrections,
                           const double* const limits, double* const points, const int64_t n, const int64_t k,
                           const int64_t j, const int64_t l, const int64_t c)
{
    const optics_t optics = {rays, origins, l, limits[0], bend, j, corrections, c, limits[1], limits[2]};
    for (int64_t m = 0; m < n; m++) {
        const int64_t line = most(0, least(direction[m], j - 1));
        for (int64_t r = 0; r < k; r++) {
            double* const point = points + 3 * (m * k + r);
            if (!wanted[m * k + r]) {
                point[0] = point[1] = point[2] = NOTHING;
                continue;
            }
            const double* const cone = cones + CONE * r;
            const double at = position[m] + bend[r * j + line] * width[m] * width[m] / 8.0;
            const ray_t ray = unit(ray_at(&optics, line, at));
            double far = meet(ray, cone_of(cone), squared_cosine(cone[6]), optics.flat, optics.grazing);
            if (corrections != NULL) {
                far = met_again(&optics, ray, far, cone, r);
            }
            point[0] = ray.ox + far * ray.x;
            point[1] = ray.oy + far * ray.y;
            point[2] = ray.oz + far * ray.z;
        }
    }
}

// far (n, k): how far along each unit way (n, 3) from its start (n, 3) each cone is met, NaN if nowhere.
DOOR void rings_meet(const double* const starts, const double* const ways, const double* const cones, const double flat,
                     const double grazing, double* const far, const int64_t n, const int64_t k)
{
    for (int64_t m = 0; m < n; m++) {
        const ray_t ray = {starts[3 * m], starts[3 * m + 1], starts[3 * m + 2],
                           ways[3 * m],   ways[3 * m + 1],   ways[3 * m + 2]};
        for (int64_t r = 0; r < k; r++) {
            far[m * k + r] = meet(ray, cone_of(cones + CONE * r), squared_cosine(cones[CONE * r + 6]), flat, grazing);
        }
    }
}
