// Half of a pipe seen from inside: the report's picture of the wall in 3-D.
//
// The map of the wall is laid out finer than the picture, each of its places shaded by its slope and put where it
// falls, orthographically. Where several fall on one pixel the nearest stays (a depth buffer: Catmull 1974), of two as
// near the later. It is laid out row by row; of the rows before and behind, which slopes need, three are kept.
#include <math.h>

#include "native.h"

#define SLOPE_MOST 3.0F   // of the wall against the pipe: what is steeper, an edge, is shaded as if it were that
#define SHADE_LEAST 0.50  // of a place's colour, where it looks away from the lamp ..
#define SHADE_MORE 0.49   // .. and what is added where it looks at the lamp
#define SEEN_LEAST 0.5    // of the four cells about a place: with less it is drawn as a hole

// What all rows have in common.
typedef struct {
    const float* map;       // (rows, columns) mm, NaN: not seen
    const int32_t* left;    // (across) the map's column before each place, and ..
    const int32_t* beside;  // .. the one behind it, beyond the clock's end its first
    const double* part;     // (across) how far between them it lies
    int64_t rows, columns, across;
    float radius, exaggeration;
} Layout;

// A row between those of the map: the radius drawn, and whether there is one; between the four cells about each place,
// of those that were seen.
static void lay(const Layout* const layout, const double row, float* const radius, bool* const seen)
{
    const int64_t last = layout->columns - 1;
    const int64_t y = whole(floor(row), 0, layout->rows - 1), below = least(y + 1, layout->rows - 1);
    const double down = row - (double)y;
    const float* const upper = layout->map + y * layout->columns;
    const float* const lower = layout->map + below * layout->columns;
    for (int64_t k = 0; k < layout->across; k++) {
        const int64_t x = most(least(layout->left[k], last), 0), next = most(least(layout->beside[k], last), 0);
        const double part = layout->part[k];
        const double value[4] = {(double)upper[x], (double)upper[next], (double)lower[x], (double)lower[next]};
        const double share[4] = {(1.0 - down) * (1.0 - part), (1.0 - down) * part, down * (1.0 - part), down * part};
        double total = 0.0, weight = 0.0;
        for (int i = 0; i < 4; i++) {
            const bool known = value[i] == value[i];
            total += known ? value[i] * share[i] : 0.0;
            weight += known ? share[i] : 0.0;
        }
        const double deviation = total / (weight > 1e-9 ? weight : 1e-9);
        radius[k] = layout->radius + layout->exaggeration * (float)deviation;
        seen[k] = weight >= SEEN_LEAST;
    }
}

// Where a place on the wall falls: right and down in the picture, and how far off it is.
INLINE void fall(const double* const axes, const double* const point, double* const fallen)
{
    for (int axis = 0; axis < 3; axis++) {
        const double* const way = axes + 3 * axis;
        fallen[axis] = point[0] * way[0] + point[1] * way[1] + point[2] * way[2];
    }
}

DOOR void half_view(const float* const map, const uint8_t* const colour, const double* const row,
                    const int32_t* const left, const int32_t* const beside, const int32_t* const nearest,
                    const double* const part, const float* const sine, const float* const cosine,
                    const bool* const facing, const float* const along, const double radius, const double exaggeration,
                    const double turn, const double advance, const double* const axes, const float* const origin,
                    const double* const lamp, const double scale, float* const room, bool* const seen,
                    double* const depth, uint8_t* const canvas, const int64_t n, const int64_t m, const int64_t r,
                    const int64_t c, const int64_t h, const int64_t w)
{
    const Layout layout = {map, left, beside, part, n, m, c, (float)radius, (float)exaggeration};
    for (int64_t k = 0; k < h * w; k++) {
        depth[k] = INFINITY;
    }
    for (int64_t laid = 0, i = 0; i < r; i++) {
        for (; laid < least(i + 2, r); laid++) {
            lay(&layout, row[laid], room + laid % 3 * c, seen + laid % 3 * c);
        }
        const int64_t before = most(i - 1, 0), behind = least(i + 1, r - 1);
        const float* const here = room + i % 3 * c;
        const float* const up = room + before % 3 * c;
        const float* const down = room + behind % 3 * c;
        const float rows_mm = (float)((double)(behind - before) * advance);
        const uint8_t* const painted = colour + whole(rint(row[i]), 0, n - 1) * m * 3;
        for (int64_t k = 0; k < c; k++) {
            if (!seen[i % 3 * c + k] || !facing[k]) {
                continue;
            }
            const double point[3] = {(double)(here[k] * sine[k] - origin[0]),
                                     (double)(-here[k] * cosine[k] - origin[1]), (double)(along[i] - origin[2])};
            double fallen[3];
            fall(axes, point, fallen);
            const double u = rint(fallen[0] * scale + 0.5 * (double)(w - 1));
            const double v = rint(fallen[1] * scale + 0.5 * (double)(h - 1));
            if (!(u >= 0.0 && u < (double)w && v >= 0.0 && v < (double)h)) {
                continue;
            }
            const int64_t at = (int64_t)v * w + (int64_t)u;
            if (fallen[2] > depth[at]) {
                continue;
            }
            depth[at] = fallen[2];
            const int64_t one = most(k - 1, 0), other = least(k + 1, c - 1);
            const float turned = (here[other] - here[one]) / (float)((double)(other - one) * turn);
            const float slope_t = held_f(turned / here[k], -SLOPE_MOST, SLOPE_MOST);
            const float slope_z = held_f((down[k] - up[k]) / rows_mm, -SLOPE_MOST, SLOPE_MOST);
            const float x = slope_t * cosine[k] - sine[k], y = cosine[k] + slope_t * sine[k];
            const double length = sqrt((double)(x * x + y * y + slope_z * slope_z));
            const double towards = ((double)x * lamp[0] + (double)y * lamp[1] + (double)slope_z * lamp[2]) / length;
            const double shade = SHADE_LEAST + SHADE_MORE * held(towards, 0.0, 1.0);
            const uint8_t* const own = painted + most(least(nearest[k], m - 1), 0) * 3;
            for (int channel = 0; channel < 3; channel++) {
                canvas[3 * at + channel] = (uint8_t)((double)own[channel] * shade);
            }
        }
    }
}
