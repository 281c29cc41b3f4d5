// Where a ray meets a wall that is not a plain cylinder, and what stands between it and a light.
//
// In closed form where the wall is a plain cylinder, by secant where it swells gently, by marching and regula falsi
// where it has edges. Tiles of the wall's map say which, and bound what a ray may meet on its way (twin/walls.py).

#include "twin.h"

enum { GENTLE = 1, STEEP = 2, PAINTED = 4 };  // bits of a tile's kind, as twin/walls.py has them; a steep one has both
enum { EVERY = 4 };                           // pixels from one that a gentle wall is looked up at to the next
enum { KNOTS = PIXELS / EVERY + 1, KNOTS_FULL = (KNOTS + LANES - 1) / LANES * LANES };

static const float MARCH_MM = 0.8f;  // along the pipe; no feature is shorter, and regula falsi follows
enum { STEPS_MOST = 200 };           // of a march: 160 mm of pipe, on a ray that grazes
enum { HALVINGS = 8 };               // of regula falsi at most; 1 to 4 reach the next
static const float MET_MM = 1e-3f;   // off the wall, a third of what its map resolves
static const float AWAY_MM = 0.03f;  // that a wall stands off a point before it hides it: its own cell's slope does not
static const float SLACK_MM = 0.01f;  // beyond a tile's bounds, where a march begins and ends

typedef struct {
    float x, y, z;
} Place;

// atan2 within 2e-6 rad.
INLINE float arc_tangent_f(const float y, const float x)
{
    const float ax = fabsf(x), ay = fabsf(y);
    const float big = ax > ay ? ax : ay, small = ax > ay ? ay : ax;
    const float q = small / (big + 1e-20f);
    const float s = q * q;
    float r = 0.0078254829f;
    r = r * s + -0.0368986292f;
    r = r * s + 0.0837415565f;
    r = r * s + -0.1348040561f;
    r = r * s + 0.1987987216f;
    r = r * s + -0.3332637452f;
    r = r * s * q + q;
    r = ay > ax ? 1.5707963f - r : r;
    r = x < 0.0f ? 3.1415927f - r : r;
    return y < 0.0f ? -r : r;
}

// Range along a ray from inside to the cylinder r = radius about the axis; 1e6 if it never gets there.
INLINE float to_cylinder(const Place c, const Place way, const float radius)
{
    const float a = way.x * way.x + way.y * way.y + 1e-12f;
    const float b = c.x * way.x + c.y * way.y;
    const float square = b * b - a * (c.x * c.x + c.y * c.y - radius * radius);
    const float range = (sqrtf(square > 0.0f ? square : 0.0f) - b) / a;
    return range < 1e6f ? range : 1e6f;
}

INLINE Place along(const Place from, const Place way, const float range)
{
    return (Place){from.x + range * way.x, from.y + range * way.y, from.z + range * way.z};
}

INLINE float map_row(const Wall* const wall, const float z)
{
    return (z - wall->numbers.z0) * wall->numbers.rows_a_mm;
}

INLINE int32_t tile_row(const Wall* const wall, const float z, const float low, const float high)
{
    return (int32_t)held_f(floorf(map_row(wall, z) * wall->numbers.tiles_a_row), low, high);
}

INLINE int32_t tile_column(const Wall* const wall, const float column)
{
    return (int32_t)held_f(column * wall->numbers.tiles_a_column, 0.0f, (float)(wall->tile_columns - 1));
}

INLINE float across(const Place p)
{
    return sqrtf(p.x * p.x + p.y * p.y);
}

// Many places of the map at once, whole lanes: the deviation, its change per column, its change per row.
INLINE void look_up(const Map* const map, const float* const column, const float* const row, float* const value,
                    float* const per_column, float* const per_row, const int64_t count)
{
    const float top = (float)map->rows - 1.01f, right = (float)map->pitch - 1.01f;
    for (int64_t first = 0; first < count; first += LANES) {
        int32_t i[LANES], j[LANES];
        float fi[LANES], fj[LANES], a[LANES], b[LANES], c[LANES], d[LANES];
        for (int64_t l = 0; l < LANES; l++) {
            const float at_row = held_f(row[first + l], 0.0f, top);
            const float at_column = held_f(column[first + l] + 1.0f, 0.0f, right);
            i[l] = (int32_t)at_row;
            j[l] = (int32_t)at_column;
            fi[l] = at_row - (float)i[l];
            fj[l] = at_column - (float)j[l];
        }
        for (int64_t l = 0; l < LANES; l++) {
            const float* const cell = map->deviation + i[l] * map->pitch + j[l];
            a[l] = cell[0];
            b[l] = cell[1];
            c[l] = cell[map->pitch];
            d[l] = cell[map->pitch + 1];
        }
        for (int64_t l = 0; l < LANES; l++) {
            const float below = c[l] - a[l], beyond = d[l] - b[l];
            const float left = a[l] + fi[l] * below, more = b[l] + fi[l] * beyond;
            value[first + l] = left + fj[l] * (more - left);
            per_column[first + l] = more - left;
            per_row[first + l] = below + fj[l] * (beyond - below);
        }
    }
}

// Meet a wall without edges instead of the plain cylinder, for a whole stretch: mends range, place and normal.
//
// The fixed point r = R + wall(where r is met), by secant, at every fourth pixel; such a wall is straight enough
// between them (0.01 mm).
static void meet_gentle(Stretch* const s, const Eye* const eye, const Wall* const wall)
{
    const float radius = wall->numbers.radius;
    const Place from = {eye->station[0], eye->station[1], eye->station[2]};
    const int64_t knots = (s->n + EVERY - 1) / EVERY + 1;
    float way_x[KNOTS_FULL] = {0.0f}, way_y[KNOTS_FULL] = {0.0f}, way_z[KNOTS_FULL] = {0.0f};
    float column[KNOTS_FULL] = {0.0f}, row[KNOTS_FULL] = {0.0f}, lift[KNOTS_FULL];
    float d0[KNOTS_FULL], d1[KNOTS_FULL], d2[KNOTS_FULL], d3[KNOTS_FULL], slope_c[KNOTS_FULL], slope_z[KNOTS_FULL];
    for (int64_t k = 0; k < knots; k++) {
        const int64_t u = least(EVERY * k, s->n - 1);
        way_x[k] = s->way_x[u];
        way_y[k] = s->way_y[u];
        way_z[k] = s->way_z[u];
        column[k] = s->column[u];
        row[k] = map_row(wall, s->z[u]);
    }
    look_up(&wall->map, column, row, d0, slope_c, slope_z, KNOTS_FULL);
    for (int64_t k = 0; k < KNOTS_FULL; k++) {
        const float range = to_cylinder(from, (Place){way_x[k], way_y[k], way_z[k]}, radius + d0[k]);
        row[k] = map_row(wall, from.z + range * way_z[k]);
    }
    look_up(&wall->map, column, row, d1, slope_c, slope_z, KNOTS_FULL);
    for (int64_t k = 0; k < KNOTS_FULL; k++) {
        const float gain = (d1[k] - d0[k]) / (fabsf(d0[k]) > 1e-3f ? d0[k] : 1e-3f);
        lift[k] = 1.0f / (1.0f - held_f(gain, -0.5f, 0.5f));
        d2[k] = d0[k] + (d1[k] - d0[k]) * lift[k];
        const float range = to_cylinder(from, (Place){way_x[k], way_y[k], way_z[k]}, radius + d2[k]);
        row[k] = map_row(wall, from.z + range * way_z[k]);
    }
    look_up(&wall->map, column, row, d3, slope_c, slope_z, KNOTS_FULL);
    for (int64_t k = 0; k < KNOTS_FULL; k++) {
        d3[k] = d2[k] + (d3[k] - d2[k]) * lift[k];
    }
    for (int64_t k = 0; k + 1 < knots; k++) {
        for (int64_t i = 0; i < EVERY; i++) {
            const float t = (1.0f / (float)EVERY) * (float)i;
            s->range[EVERY * k + i] = d3[k] + t * (d3[k + 1] - d3[k]);
            s->nx[EVERY * k + i] = slope_c[k] + t * (slope_c[k + 1] - slope_c[k]);
            s->nz[EVERY * k + i] = slope_z[k] + t * (slope_z[k + 1] - slope_z[k]);
        }
    }
    const float c0 = from.x * from.x + from.y * from.y;
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        const float wx = s->way_x[k], wy = s->way_y[k], wz = s->way_z[k];
        const float r = radius + s->range[k];
        const float a = wx * wx + wy * wy + 1e-7f;
        const float b = from.x * wx + from.y * wy;
        const float square = b * b - a * (c0 - r * r);
        const float range = (sqrtf(square > 0.0f ? square : 0.0f) - b) / a;
        const float x = from.x + range * wx, y = from.y + range * wy;
        const float inverse = 1.0f / r;
        const float along_z = s->nz[k] * wall->numbers.rows_a_mm;
        const float round = s->nx[k] * wall->columns_a_rad * inverse;
        const float ex = x * inverse, ey = y * inverse;  // outwards; the clock angle grows along (-ey, ex)
        const float scale = 1.0f / sqrtf(1.0f + round * round + along_z * along_z);
        s->range[k] = range;
        s->x[k] = x;
        s->y[k] = y;
        s->z[k] = from.z + range * wz;
        s->nx[k] = (ex + round * ey) * scale;
        s->ny[k] = (ey - round * ex) * scale;
        s->nz[k] = -along_z * scale;
    }
}

// Rays that are met one by one, as many at once as a vector holds. What is done is a bit of no lane.
typedef struct {
    float from_x[LANES], from_y[LANES], from_z[LANES], way_x[LANES], way_y[LANES], way_z[LANES];
    float column[LANES], in_cell[LANES];  // of the map, and its part beyond `cell`
    const float* cell[LANES];             // of the map's first row
    float low[LANES], high[LANES];        // bounds of the deviation thereabouts, mm
    float range[LANES];
} Rays;

INLINE Place from_of(const Rays* const rays, const int64_t l)
{
    return (Place){rays->from_x[l], rays->from_y[l], rays->from_z[l]};
}

INLINE Place way_of(const Rays* const rays, const int64_t l)
{
    return (Place){rays->way_x[l], rays->way_y[l], rays->way_z[l]};
}

// How far out of the wall rays are at a range; the clock angle hardly changes over a wall's roughness.
static void excess(const Wall* const wall, const Rays* const rays, const float* const range, float* const out)
{
    float fi[LANES], a[LANES], b[LANES], c[LANES], d[LANES];
    int32_t i[LANES];
    const float top = (float)wall->map.rows - 1.01f;
    const int64_t pitch = wall->map.pitch;
    for (int64_t l = 0; l < LANES; l++) {
        const Place p = along(from_of(rays, l), way_of(rays, l), range[l]);
        const float row = held_f(map_row(wall, p.z), 0.0f, top);
        out[l] = across(p) - wall->numbers.radius;
        i[l] = (int32_t)row;
        fi[l] = row - (float)i[l];
    }
    for (int64_t l = 0; l < LANES; l++) {
        const float* const cell = rays->cell[l] + i[l] * pitch;
        a[l] = cell[0];
        b[l] = cell[1];
        c[l] = cell[pitch];
        d[l] = cell[pitch + 1];
    }
    for (int64_t l = 0; l < LANES; l++) {
        const float left = a[l] + fi[l] * (c[l] - a[l]), right = b[l] + fi[l] * (d[l] - b[l]);
        out[l] -= left + rays->in_cell[l] * (right - left);
    }
}

// The tiles that a ray really passes on its way know tighter bounds than those near it: often a flat floor, and no
// march.
static void tighten(const Wall* const wall, Rays* const rays)
{
    const float radius = wall->numbers.radius, tiles = (float)wall->tiles;
    int32_t first[LANES], last[LANES], at[LANES];
    for (int64_t l = 0; l < LANES; l++) {
        const float z = rays->from_z[l], wz = rays->way_z[l];
        const float z0 = z + to_cylinder(from_of(rays, l), way_of(rays, l), radius + rays->low[l] - SLACK_MM) * wz;
        const float z1 = z + to_cylinder(from_of(rays, l), way_of(rays, l), radius + rays->high[l] + SLACK_MM) * wz;
        first[l] = tile_row(wall, z0 < z1 ? z0 : z1, -1.0f, tiles);
        last[l] = tile_row(wall, z0 < z1 ? z1 : z0, -1.0f, tiles);
        at[l] = tile_column(wall, rays->column[l]);
    }
    for (int64_t l = 0; l < LANES; l++) {
        if (first[l] < 0 || last[l] >= wall->tiles) {
            continue;
        }
        int64_t tile = first[l] * wall->tile_columns + at[l];
        float low = wall->low[tile], high = wall->high[tile];
        for (int32_t i = first[l]; i < last[l]; i++) {
            tile += wall->tile_columns;
            low = wall->low[tile] < low ? wall->low[tile] : low;
            high = wall->high[tile] > high ? wall->high[tile] : high;
        }
        rays->low[l] = low;
        rays->high[l] = high;
    }
}

// Range at which each ray first goes through a wall that stays within low..high thereabouts.
//
// The clock angle is that of the plain cylinder; over low..high it drifts by less than a map column.
static void meet_steep(const Wall* const wall, Rays* const rays)
{
    const float radius = wall->numbers.radius;
    float slack[LANES], s0[LANES], step[LANES], a[LANES], b[LANES], m[LANES], fa[LANES], fb[LANES], fm[LANES];
    int32_t steps[LANES], side[LANES] = {0}, on[LANES];  // on : all bits set while a lane is not done
    tighten(wall, rays);
    for (int64_t l = 0; l < LANES; l++) {
        slack[l] = rays->high[l] - rays->low[l] < MET_MM ? 0.0f : SLACK_MM;  // none of a flat floor
    }
    for (int64_t l = 0; l < LANES; l++) {
        s0[l] = to_cylinder(from_of(rays, l), way_of(rays, l), radius + rays->low[l] - slack[l]);
        const float s1 = to_cylinder(from_of(rays, l), way_of(rays, l), radius + rays->high[l] + slack[l]);
        const float pieces = fabsf((s1 - s0[l]) * rays->way_z[l]) * (1.0f / MARCH_MM) + 2.0f;
        steps[l] = (int32_t)(pieces < (float)STEPS_MOST ? pieces : (float)STEPS_MOST);  // NaN: the most
        step[l] = (s1 - s0[l]) / (float)steps[l];
        a[l] = s0[l];
        b[l] = s0[l];
    }
    excess(wall, rays, s0, fa);
    int32_t any = 0;
    for (int64_t l = 0; l < LANES; l++) {
        on[l] = (slack[l] > 0.0f) & (fa[l] < 0.0f) ? -1 : 0;
        fb[l] = -1.0f;
        any |= on[l];
    }
    for (int32_t i = 1; any != 0; i++) {
        any = 0;
        for (int64_t l = 0; l < LANES; l++) {
            b[l] = on[l] != 0 ? s0[l] + (float)i * step[l] : b[l];
        }
        excess(wall, rays, b, fm);
        for (int64_t l = 0; l < LANES; l++) {
            const int32_t inside = fm[l] >= 0.0f ? 0 : on[l];
            fb[l] = on[l] != 0 ? fm[l] : fb[l];
            a[l] = inside != 0 ? b[l] : a[l];
            fa[l] = inside != 0 ? fm[l] : fa[l];
            on[l] = i >= steps[l] ? 0 : inside;
            any |= on[l];
        }
    }
    for (int64_t l = 0; l < LANES; l++) {
        rays->range[l] = b[l];
        on[l] = fb[l] > 0.0f ? -1 : 0;
        any |= on[l];
    }
    for (int32_t i = 0; i <= HALVINGS && any != 0; i++) {  // regula falsi, Illinois
        any = 0;
        for (int64_t l = 0; l < LANES; l++) {
            m[l] = on[l] != 0 ? (a[l] * fb[l] - b[l] * fa[l]) / (fb[l] - fa[l]) : rays->range[l];
            rays->range[l] = m[l];
        }
        if (i == HALVINGS) {
            return;
        }
        excess(wall, rays, m, fm);
        for (int64_t l = 0; l < LANES; l++) {
            const bool out = fm[l] >= 0.0f;
            const float less_b = side[l] == -1 ? 0.5f * fb[l] : fb[l], less_a = side[l] == 1 ? 0.5f * fa[l] : fa[l];
            a[l] = out ? a[l] : m[l];
            fa[l] = out ? less_a : fm[l];
            b[l] = out ? m[l] : b[l];
            fb[l] = out ? fm[l] : less_b;
            side[l] = out ? 1 : -1;
            on[l] = fabsf(fm[l]) < MET_MM ? 0 : on[l];
            any |= on[l];
        }
    }
}

// Whether the wall stands between one of its points and a light inside the pipe.
static bool shadowed(const Wall* const wall, const Place p, const float* const light, const float low,
                     const float column)
{
    const float dx = light[0] - p.x, dy = light[1] - p.y, dz = light[2] - p.z;
    const float r0 = across(p), height = r0 - wall->numbers.radius;
    const float drop = (dx * p.x + dy * p.y) / r0;  // how fast r falls on the way
    const float free = (low - height) / (drop < -1.0f ? drop : -1.0f);
    const float clear = free < 0.5f ? free : 0.5f;  // from here on nothing can hide it
    if (!(clear > 0.0f)) {
        return false;
    }
    const int64_t at = tile_column(wall, column);
    const int32_t last = tile_row(wall, p.z, 0.0f, (float)(wall->tiles - 1));
    const int32_t first = tile_row(wall, p.z + clear * dz, 0.0f, (float)last);
    float lowest = wall->low[last * wall->tile_columns + at];
    for (int32_t i = first; i < last; i++) {
        const float lower = wall->low[i * wall->tile_columns + at];
        lowest = lower < lowest ? lower : lowest;
    }
    if (lowest > height - AWAY_MM) {
        return false;  // nothing on the way stands higher than this point
    }
    const float turn = (p.x * dy - p.y * dx) / (r0 * r0) * wall->columns_a_rad;  // columns per unit of t
    const float step = MARCH_MM / (fabsf(dz) + 1e-3f);
    for (float t = 0.6f * step; t < clear; t += step) {  // off the surface, so that it does not shadow itself
        const Place q = {p.x + t * dx, p.y + t * dy, p.z + t * dz};
        const float stands = wall_at(&wall->map, column + t * turn, map_row(wall, q.z));
        if (across(q) - wall->numbers.radius > stands + AWAY_MM) {
            return true;
        }
    }
    return false;
}

// Meet a wall with edges: mends range, place, normal and shadow of some pixels.
static void meet_rough(Stretch* const s, const int32_t* const which, const int64_t count, const Eye* const eye,
                       const bool apart, const Wall* const wall, const float* const light, const bool ask_shadow)
{
    Rays rays;
    float near_low[LANES], x[LANES], y[LANES], z[LANES], nx[LANES], ny[LANES], nz[LANES];
    float columns[4 * LANES], rows[4 * LANES], at[4 * LANES], unused[4 * LANES], also_unused[4 * LANES];
    const float right = (float)wall->map.pitch - 1.01f, half = 0.4f;  // of a map cell, both ways, over which it slopes
    for (int64_t l = 0; l < LANES; l++) {
        const int32_t k = which[l < count ? l : 0];
        rays.from_x[l] = apart ? s->start_x[k] : eye->station[0];
        rays.from_y[l] = apart ? s->start_y[k] : eye->station[1];
        rays.from_z[l] = apart ? s->start_z[k] : eye->station[2];
        rays.way_x[l] = s->way_x[k];
        rays.way_y[l] = s->way_y[k];
        rays.way_z[l] = s->way_z[k];
        const float near_z = rays.from_z[l] + rays.way_z[l] * s->plain[k];
        const int32_t ti = tile_row(wall, near_z, 0.0f, (float)(wall->tiles - 1));
        const int64_t tile = ti * wall->tile_columns + tile_column(wall, s->column[k]);
        const float column = held_f(s->column[k] + 1.0f, 0.0f, right);
        const int32_t j = (int32_t)column;
        rays.column[l] = s->column[k];
        rays.cell[l] = wall->map.deviation + j;
        rays.in_cell[l] = column - (float)j;
        rays.low[l] = wall->near_low[tile];
        rays.high[l] = wall->near_high[tile];
        near_low[l] = wall->near_low[tile];
    }
    meet_steep(wall, &rays);
    for (int64_t l = 0; l < LANES; l++) {
        const Place p = along(from_of(&rays, l), way_of(&rays, l), rays.range[l]);
        x[l] = p.x;
        y[l] = p.y;
        z[l] = p.z;
        rows[l] = rows[LANES + l] = map_row(wall, p.z);
        rows[2 * LANES + l] = rows[l] - half;
        rows[3 * LANES + l] = rows[l] + half;
        columns[l] = rays.column[l] - half;
        columns[LANES + l] = rays.column[l] + half;
        columns[2 * LANES + l] = columns[3 * LANES + l] = rays.column[l];
    }
    look_up(&wall->map, columns, rows, at, unused, also_unused, 4 * LANES);
    for (int64_t l = 0; l < LANES; l++) {
        const float r = sqrtf(x[l] * x[l] + y[l] * y[l]);
        const float round = (at[LANES + l] - at[l]) * (wall->columns_a_rad / (r * (half + half)));
        const float along_z = (at[3 * LANES + l] - at[2 * LANES + l]) * (wall->numbers.rows_a_mm / (half + half));
        const float ex = x[l] / r, ey = y[l] / r;
        const float scale = 1.0f / sqrtf(1.0f + round * round + along_z * along_z);
        nx[l] = (ex + round * ey) * scale;
        ny[l] = (ey - round * ex) * scale;
        nz[l] = -along_z * scale;
    }
    for (int64_t l = 0; l < count; l++) {
        const int32_t k = which[l];
        s->range[k] = rays.range[l];
        s->x[k] = x[l];
        s->y[k] = y[l];
        s->z[k] = z[l];
        s->nx[k] = nx[l];
        s->ny[k] = ny[l];
        s->nz[k] = nz[l];
        if (ask_shadow && shadowed(wall, (Place){x[l], y[l], z[l]}, light, near_low[l] - 0.02f, s->column[k])) {
            s->open[k] = 0.0f;
        }
    }
}

// Mend what meet_cylinder found where the wall is not plain. apart : whether rays start each at a place of its own;
// ask_shadow : whether `light` gets there.
void meet_wall(Stretch* const s, const Eye* const eye, const bool apart, const Wall* const wall,
               const float* const light, const bool ask_shadow)
{
    const float turn = wall->columns, tiles = (float)wall->tiles, column_most = (float)(wall->tile_columns - 1);
    int32_t on_map[PIXELS], which[ROOM], kinds = 0, gentle = 0;
    for (int64_t k = 0; k < (s->full & -LANES); k++) {  // clock angle = atan2(x, -y)
        const float signed_column = arc_tangent_f(s->x[k], -s->y[k]) * wall->columns_a_rad;
        const float column = signed_column < 0.0f ? signed_column + turn : signed_column;
        const float row = map_row(wall, s->z[k]) * wall->numbers.tiles_a_row;
        const int32_t i = (int32_t)held_f(row, 0.0f, tiles - 1.0f);
        const int32_t j = (int32_t)held_f(column * wall->numbers.tiles_a_column, 0.0f, column_most);
        s->column[k] = column;
        s->mark[k] = i * (int32_t)wall->tile_columns + j;
        on_map[k] = row >= 0.0f && row < tiles ? -1 : 0;
    }
    for (int64_t k = s->n; k < s->full; k++) {
        on_map[k] = 0;
    }
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        s->mark[k] = wall->kind[s->mark[k]];
    }
    for (int64_t k = 0; k < (s->full & -LANES); k++) {
        s->mark[k] &= on_map[k];
        s->paint[k] = (s->mark[k] & PAINTED) != 0 ? 1.0f : 0.0f;
        gentle |= (s->mark[k] & (GENTLE | STEEP)) == GENTLE ? GENTLE : 0;
        kinds |= s->mark[k];
    }
    if (gentle != 0 && !apart) {
        meet_gentle(s, eye, wall);
    }
    const int32_t alone = apart ? STEEP | GENTLE : STEEP;  // kinds of a wall that is met one ray at a time
    if ((kinds & alone) == 0) {
        return;
    }
    int64_t rough = 0;
    for (int64_t k = 0; k < s->n; k++) {
        which[rough] = (int32_t)k;
        rough += (s->mark[k] & alone) != 0 ? 1 : 0;
    }
    for (int64_t k = 0; k < rough; k += LANES) {
        meet_rough(s, which + k, least(LANES, rough - k), eye, apart, wall, light, ask_shadow);
    }
}
