// Every pixel's ray in the pipe frame, and where it meets the plain cylinder r = radius about the axis.

#include "twin.h"

// starts : of this stretch, or NULL; plane : from one of its four to the next.
INLINE void meet(Stretch* const s, const Eye* const eye, const float radius, const float* const restrict starts,
                 const int64_t plane)
{
    const float* const r = eye->rotation;
    const float r00 = r[0], r01 = r[1], r02 = r[2], r10 = r[3], r11 = r[4], r12 = r[5], r20 = r[6], r21 = r[7];
    const float r22 = r[8], sx = eye->station[0], sy = eye->station[1], sz = eye->station[2];
    const float inverse = 1.0f / radius;
    const float* const restrict ray_x = s->ray_x, * const restrict ray_y = s->ray_y;
    for (int64_t k = 0; k < s->n; k++) {
        const float dx = ray_x[k], dy = ray_y[k];
        const float left = 1.0f - dx * dx - dy * dy;
        float dz = sqrtf(left > 0.0f ? left : 0.0f);
        float cx = sx, cy = sy, cz = sz;
        if (starts != NULL) {
            const float ox = starts[k], oy = starts[plane + k], oz = starts[2 * plane + k];
            dz *= starts[3 * plane + k];
            cx += r00 * ox + r10 * oy + r20 * oz;
            cy += r01 * ox + r11 * oy + r21 * oz;
            cz += r02 * ox + r12 * oy + r22 * oz;
            s->start_x[k] = cx;
            s->start_y[k] = cy;
            s->start_z[k] = cz;
        }
        const float wx = r00 * dx + r10 * dy + r20 * dz;
        const float wy = r01 * dx + r11 * dy + r21 * dz;
        const float wz = r02 * dx + r12 * dy + r22 * dz;
        const float a = wx * wx + wy * wy + 1e-7f;
        const float b = cx * wx + cy * wy;
        const float c = cx * cx + cy * cy - radius * radius;
        const float square = b * b - a * c;
        const float range = (sqrtf(square > 0.0f ? square : 0.0f) - b) / a;
        const float x = cx + range * wx, y = cy + range * wy;
        s->way_x[k] = wx;
        s->way_y[k] = wy;
        s->way_z[k] = wz;
        s->plain[k] = range;
        s->range[k] = range;
        s->x[k] = x;
        s->y[k] = y;
        s->z[k] = cz + range * wz;
        s->nx[k] = x * inverse;
        s->ny[k] = y * inverse;
        s->nz[k] = 0.0f;
        s->open[k] = 1.0f;
        s->level[k] = 0.0f;
    }
}

// starts : (4, H, W) or NULL, see ray_table of twin/rays.py; plane : H W.
void meet_cylinder(Stretch* const s, const Eye* const eye, const float* const starts, const int64_t plane,
                   const int64_t width, const float radius)
{
    if (starts == NULL) {
        meet(s, eye, radius, NULL, 0);
    } else {
        meet(s, eye, radius, starts + s->v * width + s->u0, plane);
    }
}
