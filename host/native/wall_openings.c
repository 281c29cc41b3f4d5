// Where rings end at an opening: the last point of a ring before the columns in which its light found no wall.

#include "native.h"
#include "selection.h"

enum { INSIDE_LEAST = 3 };  // columns of a look inside the opening: fewer are a point that was missed

// Sorts a look's angles, by Shell's way.
static void sort_angles(double* const values, const int64_t size)
{
    int64_t gap = 1;
    while (gap < size / 3) {
        gap = 3 * gap + 1;
    }
    for (; gap > 0; gap /= 3) {
        for (int64_t i = gap; i < size; i++) {
            const double value = values[i];
            int64_t place = i;
            while (place >= gap && values[place - gap] > value) {
                values[place] = values[place - gap];
                place -= gap;
            }
            values[place] = value;
        }
    }
}

// The usual angle from one of a look's points to the next, NaN of a single one.
static double usual_step(const double* const angle, double* const room, const int64_t size)
{
    for (int64_t i = 0; i < size; i++) {
        room[i] = angle[i];
    }
    sort_angles(room, size);
    for (int64_t i = 0; i + 1 < size; i++) {
        room[i] = room[i + 1] - room[i];
    }
    return size > 1 ? halfway(room, size - 1) : NOTHING;
}

// Of every look (l,) with columns inside the opening its first and last of them, where a point stands in the column
// beyond: `at` (e, 2) look and column, `end` (e,) the angle of the nearest such point and half a step towards the
// opening; how many. Points (n,) look by look, `first` (m,), m = l + 1, of each, their angle and column round the
// clock; inside, open_ended (l, a): columns inside, and those beyond which nothing ends; order (a,): columns round the
// clock of these. room (n,).
DOOR int64_t ring_ends(const int64_t* const first, const double* const angle, const int64_t* const column,
                       double* const room, const bool* const inside, const bool* const open_ended,
                       const int64_t* const order, int64_t* const at, double* const end, const int64_t m,
                       const int64_t n, const int64_t l, const int64_t a, const int64_t e)
{
    int64_t size = 0;
    for (int64_t look = 0; look < l && look + 1 < m; look++) {
        const bool* const in = inside + look * a;
        int64_t count = 0, run[2] = {a, -1};
        for (int64_t i = 0; i < a; i++) {
            if (in[i]) {
                count++;
                run[0] = least(run[0], i);
                run[1] = i;
            }
        }
        const int64_t begin = bounded(first[look], 0, n), points = bounded(first[look + 1], begin, n) - begin;
        double step = NOTHING;
        bool is_known = false;
        for (int side = 0; side < 2 && count >= INSIDE_LEAST; side++) {
            const int64_t way = side ? 1 : -1, beyond = run[side] + way;
            if (beyond < 0 || beyond >= a || open_ended[look * a + beyond] || size >= e) {
                continue;
            }
            double nearest = NOTHING;
            for (int64_t i = begin; i < begin + points; i++) {
                const double there = (double)way * angle[i];
                if (column[i] == order[beyond] && !(there >= nearest)) {
                    nearest = there;
                }
            }
            if (!isfinite(nearest)) {
                continue;
            }
            step = is_known ? step : usual_step(angle + begin, room, points);
            is_known = true;
            at[2 * size] = look;
            at[2 * size + 1] = run[side];
            end[size++] = (double)way * nearest - (double)way * step / 2.0;
        }
    }
    return size;
}
