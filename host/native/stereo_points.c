// From distances along the projector's generators to points of the wall, and back from a clean pipe: places, sigma of
// the radius, colour. A generator is a straight line of light from a ring's vertex, `ways` its unit vector; `rotation`
// (columns: the pipe's x, y and axis) and `shift` are a pose.

#include <math.h>
#include <string.h>

#include "native.h"

#define BLOCK 64  // points at a time; times, not results

typedef struct {
    double x, y, along;  // in the pipe's frame
} InPipe;

INLINE InPipe in_pipe(const double* const rotation, const double x, const double y, const double z)
{
    return (InPipe){x * rotation[0] + y * rotation[3] + z * rotation[6],
                    x * rotation[1] + y * rotation[4] + z * rotation[7],
                    x * rotation[2] + y * rotation[5] + z * rotation[8]};
}

// Of one vertex' generators: how far along them a clean pipe is, |v + s w| = radius across the axis.
static void to_pipe(const double* const rotation, const InPipe from, const double radius, const double* const ways,
                    double* const restrict out, const int64_t size)
{
    const double r0 = rotation[0], r1 = rotation[1], r3 = rotation[3], r4 = rotation[4], r6 = rotation[6];
    const double r7 = rotation[7], c = from.x * from.x + from.y * from.y - radius * radius;
    for (int64_t p = 0; p < size; p++) {
        const double x = ways[3 * p], y = ways[3 * p + 1], z = ways[3 * p + 2];
        const double u = x * r0 + y * r3 + z * r6, v = x * r1 + y * r4 + z * r7;
        const double a = u * u + v * v, b = from.x * u + from.y * v, square = b * b - a * c;
        out[p] = (sqrt(square) - b) / a;  // NaN where it leads to none
    }
}

// mm along each generator to a clean pipe; NaN where it leads to none.
DOOR void stereo_to_pipe(const double* const vertices, const double* const ways, const double* const rotation,
                         const double* const shift, const double radius, double* const out, const int64_t k,
                         const int64_t p)
{
    for (int64_t ring = 0; ring < k; ring++) {
        const double* const v = vertices + 3 * ring;
        const InPipe from = in_pipe(rotation, v[0] - shift[0], v[1] - shift[1], v[2] - shift[2]);
        to_pipe(rotation, from, radius, ways + 3 * ring * p, out + ring * p, p);
    }
}

// Where the wall is known: at (2, ..) ring and generator, points (.., 3). Returns how many.
DOOR int64_t stereo_known(const double* const distance, const double* const vertices, const double* const ways,
                          int64_t* const at, double* const points, const int64_t k, const int64_t p, const int64_t n)
{
    int64_t size = 0;
    for (int64_t ring = 0; ring < k; ring++) {
        for (int64_t step = 0; step < p; step++) {
            const double s = distance[ring * p + step];
            if (s == s && size < n) {
                at[size] = ring;
                at[n + size] = step;
                for (int i = 0; i < 3; i++) {
                    points[3 * size + i] = vertices[3 * ring + i] + s * ways[3 * (ring * p + step) + i];
                }
                size++;
            }
        }
    }
    return size;
}

// A block of points that lie (.., 3) and their generators: the part of each generator that leads outwards, and what the
// pose by its covariance leaves open of the radius there, a square.
static void radial(const double* const rotation, const double* const shift, const double* const covariance,
                   const double* const points, const double (*const ways)[BLOCK], double* const restrict outwards,
                   double* const restrict by_pose, const int size)
{
    double r[9], c[16], t[3];
    memcpy(r, rotation, sizeof r);
    memcpy(c, covariance, sizeof c);
    memcpy(t, shift, sizeof t);
    for (int i = 0; i < size; i++) {
        const InPipe q = in_pipe(r, points[3 * i] - t[0], points[3 * i + 1] - t[1], points[3 * i + 2] - t[2]);
        const InPipe way = in_pipe(r, ways[0][i], ways[1][i], ways[2][i]);
        const double inverse = 1.0 / sqrt(q.x * q.x + q.y * q.y), u = q.x * inverse, v = q.y * inverse;
        const double rx = q.along * v, ry = -q.along * u;  // by rx, ry, and -u, -v by tx, ty
        const double of_rx = rx * ((c[0] * rx + c[1] * ry) - (c[2] * u + c[3] * v));
        const double of_ry = ry * ((c[4] * rx + c[5] * ry) - (c[6] * u + c[7] * v));
        const double of_tx = u * ((c[8] * rx + c[9] * ry) - (c[10] * u + c[11] * v));
        const double of_ty = v * ((c[12] * rx + c[13] * ry) - (c[14] * u + c[15] * v));
        outwards[i] = u * way.x + v * way.y;
        by_pose[i] = (of_rx + of_ry) - (of_tx + of_ty);
    }
}

// The part of each point's generator that leads away from the pipe's axis; where `along` has the points' sigma along
// their generators, what that and the pose, by its covariance, leave open of the radius.
DOOR void stereo_radial(const double* const points, const int64_t* const at, const double* const ways,
                        const double* const rotation, const double* const shift, const double* const covariance,
                        const double* const along, double* const out, const int64_t n, const int64_t k, const int64_t p)
{
    double way[3][BLOCK], by_pose[BLOCK];
    for (int64_t first = 0; first < n; first += BLOCK) {
        const int size = (int)least(BLOCK, n - first);
        double* const own = out + first;
        for (int i = 0; i < size; i++) {
            const int64_t ring = bounded(at[first + i], 0, k - 1), step = bounded(at[n + first + i], 0, p - 1);
            const double* const w = ways + 3 * (ring * p + step);
            way[0][i] = w[0];
            way[1][i] = w[1];
            way[2][i] = w[2];
        }
        radial(rotation, shift, covariance, points + 3 * first, way, own, by_pose, size);
        for (int i = 0; i < size && along; i++) {
            const double by_way = along[first + i] * own[i];
            own[i] = sqrt(by_way * by_way + by_pose[i]);
        }
    }
}

// Light (n, 3) RGB of points that this camera knows best, as the stripes inside and outside of its slit (s, 3) BGR show
// it. which (k, j): its slit on each of its lines, -1 for none; a neighbouring line's will do.
DOOR void stereo_beside(const int64_t* const at, const int64_t* const heaviest, const int64_t* const line,
                        const int64_t camera, const int64_t* const which, const double* const inside,
                        const double* const outside, uint8_t* const light, const int64_t n, const int64_t k,
                        const int64_t p, const int64_t j, const int64_t s)
{
    for (int64_t i = 0; i < n; i++) {
        const int64_t ring = bounded(at[i], 0, k - 1), step = bounded(at[n + i], 0, p - 1);
        if (heaviest[ring * p + step] != camera) {
            continue;
        }
        const int64_t* const on = which + ring * j;
        const int64_t own = around(bounded(line[ring * p + step], 0, j), j);
        int64_t slit = on[own];
        if (slit < 0) {
            const int64_t next = on[around(own + 1, j)];
            slit = next < 0 ? on[around(own - 1, j)] : next;
        }
        if (slit >= 0 && slit < s) {
            for (int c = 0; c < 3; c++) {
                const double both = 0.5 * (inside[3 * slit + 2 - c] + outside[3 * slit + 2 - c]);
                light[3 * i + c] = (uint8_t)held(both, 0.0, 255.0);
            }
        }
    }
}
