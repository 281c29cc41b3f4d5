// A CT volume along rays, and where the grey of a wall begins and ends on them:
// annulus_pipe.wings.joints.measure.unwrap and .surface. Trilinear between voxels; a surface is where the grey crosses
// a level, linear between two samples.
#include <math.h>

#include "native.h"

#define HAIR 1e-6     // voxels: a place so far beyond the first or the last slice by rounding is in it
#define INSIDE 1.001  // voxels off the last one: where the edge's grey is taken for what lies beyond

// Within the slab: a place on its far faces counts to the voxels before them.
INLINE double trilinear(const float* const slab, const double x, const double y, const double s, const int64_t d,
                        const int64_t r, const int64_t c)
{
    const int64_t i = least((int64_t)x, c - 2), j = least((int64_t)y, r - 2);
    const int64_t k = least(most((int64_t)s, 0), d - 2);
    const double fx = x - (double)i, fy = y - (double)j, fz = s - (double)k;
    const float* const low = slab + (k * r + j) * c + i;
    const float* const high = low + r * c;
    const double near = ((double)low[0] * (1.0 - fx) + (double)low[1] * fx) * (1.0 - fy) +
                        ((double)low[c] * (1.0 - fx) + (double)low[c + 1] * fx) * fy;
    const double far = ((double)high[0] * (1.0 - fx) + (double)high[1] * fx) * (1.0 - fy) +
                       ((double)high[c] * (1.0 - fx) + (double)high[c + 1] * fx) * fy;
    return near * (1.0 - fz) + far * fz;
}

// out[plane, ray, place]: grey at origin + z along + beside + rho way, all in x, y, z, mm, of a slab whose first slice
// is the volume's slice `first`. Outside: NaN, or the edge's grey.
DOOR void joints_sampled(const float* const slab, const int64_t first, const double* const voxel,
                         const double* const origin, const double* const along, const double* const z,
                         const double* const beside, const double* const way, const double* const rho,
                         const bool to_edge, float* const out, const int64_t d, const int64_t r, const int64_t c,
                         const int64_t p, const int64_t j, const int64_t k)
{
    const double last_x = (double)(c - 1), last_y = (double)(r - 1), last_s = (double)(d - 1);
    const bool hollow = d < 2 || r < 2 || c < 2;
    for (int64_t a = 0; a < p * j; a++) {
        const double* const off = beside + a % j * 3;
        const double* const to = way + a % j * 3;
        const double height = z[a / j];
        const double x0 = (origin[0] + height * along[0] + off[0]) / voxel[0], dx = to[0] / voxel[0];
        const double y0 = (origin[1] + height * along[1] + off[1]) / voxel[1], dy = to[1] / voxel[1];
        const double s0 = (origin[2] + height * along[2] + off[2]) / voxel[2] - (double)first, ds = to[2] / voxel[2];
        float* const grey = out + a * k;
        for (int64_t b = 0; b < k; b++) {
            double x = x0 + rho[b] * dx, y = y0 + rho[b] * dy, s = s0 + rho[b] * ds;
            if (to_edge) {
                x = held(x, 0.0, (double)c - INSIDE);
                y = held(y, 0.0, (double)r - INSIDE);
                s = held(s, 0.0, (double)d - INSIDE);
            }
            const bool inside = x >= 0.0 && x <= last_x && y >= 0.0 && y <= last_y && s >= -HAIR && s <= last_s + HAIR;
            grey[b] = inside && !hollow ? (float)trilinear(slab, x, y, s, d, r, c) : NAN;
        }
    }
}

// Rho of the outermost and the innermost crossing of the level on each ray, mm; NaN where there is none.
DOOR void joints_edges(const float* const block, const double* const rho, const double level, double* const outer,
                       double* const inner, const int64_t p, const int64_t j, const int64_t n)
{
    for (int64_t a = 0; a < p * j; a++) {
        const float* const grey = block + a * n;
        outer[a] = NAN;
        inner[a] = NAN;
        for (int64_t k = n - 2; k >= 0; k--) {
            if ((double)grey[k] > level) {
                if ((double)grey[k + 1] <= level) {
                    const double part = ((double)grey[k] - level) / (double)(grey[k] - grey[k + 1]);
                    outer[a] = rho[k] + part * (rho[k + 1] - rho[k]);
                }
                break;
            }
        }
        for (int64_t k = 1; k < n; k++) {
            if ((double)grey[k] > level) {
                if ((double)grey[k - 1] <= level) {
                    const double part = ((double)grey[k] - level) / (double)(grey[k] - grey[k - 1]);
                    inner[a] = rho[k] - part * (rho[k] - rho[k - 1]);
                }
                break;
            }
        }
    }
}
