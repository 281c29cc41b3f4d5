// The wall's grid: what points say of their cells, what neighbours say of a cell, and gaps no wider than the sampling.
//
// Points are put side by side cell by cell (counted, summed, laid), and the few of each cell are sorted where they lie.

#include <math.h>
#include <string.h>

#include "by_cell.h"
#include "native.h"
#include "selection.h"

enum { FEW = 24, LANES = 16 };

// Sorts a few values, and what comes with them where it is not null.
static void sort_few(double* const values, double* const with, const int64_t size)
{
    for (int64_t i = 1; i < size; i++) {
        const double value = values[i], own = with ? with[i] : 0.0;
        int64_t place = i;
        while (place > 0 && values[place - 1] > value) {
            values[place] = values[place - 1];
            if (with) {
                with[place] = with[place - 1];
            }
            place--;
        }
        values[place] = value;
        if (with) {
            with[place] = own;
        }
    }
}

// Sorts many: a heap is built and taken off from its top.
static void sort_many(double* const values, double* const with, const int64_t size)
{
    for (int64_t built = size / 2, end = size; end > 1;) {
        int64_t at;
        if (built > 0) {
            at = --built;
        } else {
            end--;
            const double value = values[0], own = with[0];
            values[0] = values[end];
            with[0] = with[end];
            values[end] = value;
            with[end] = own;
            at = 0;
        }
        for (int64_t child = 2 * at + 1; child < end; child = 2 * at + 1) {
            child += child + 1 < end && values[child + 1] > values[child];
            if (!(values[child] > values[at])) {
                break;
            }
            const double value = values[at], own = with[at];
            values[at] = values[child];
            with[at] = with[child];
            values[child] = value;
            with[child] = own;
            at = child;
        }
    }
}

// Median of values that weigh differently: the mean of the two in which just less and just more than half of the weight
// is reached, give or take `slack` of all of it, for sums round.
static double weighed_median(double* const values, double* const weights, const int64_t size, const double slack)
{
    if (size <= FEW) {
        sort_few(values, weights, size);
    } else {
        sort_many(values, weights, size);
    }
    double all = 0.0;
    for (int64_t i = 0; i < size; i++) {
        all += weights[i];
    }
    const double less = (0.5 - slack) * all, more = (0.5 + slack) * all;
    double sum = 0.0, low = values[size - 1], high = values[size - 1];
    bool found = false;
    for (int64_t i = 0; i < size; i++) {
        sum += weights[i];
        if (!found && sum >= less) {
            low = values[i];
            found = true;
        }
        if (sum >= more) {
            high = values[i];
            break;
        }
    }
    return 0.5 * (low + high);
}

// Median of each cell's values, NaN of none, and how many they are. cell (n,) in 0 .. c - 1, values (n,), weights (n,)
// or none; ends (c,), laid (2, n): room.
DOOR void cell_medians(const int64_t* const cell, const double* const values, const double* const weights,
                       const double slack, int64_t* const ends, double* const laid, double* const medians,
                       int32_t* const count, const int64_t n, const int64_t c)
{
    if (c < 1) {
        return;
    }
    begin_cells(cell, ends, n, c);
    double *const side = laid, *const with = laid + n;
    for (int64_t i = 0; i < n; i++) {
        const int64_t at = ends[bounded(cell[i], 0, c - 1)]++;
        side[at] = values[i];
        if (weights) {
            with[at] = weights[i];
        }
    }
    int64_t begin = 0;
    for (int64_t i = 0; i < c; i++) {
        double* const own = side + begin;
        const int64_t size = ends[i] - begin;
        count[i] = (int32_t)least(size, INT32_MAX);
        if (size < 1) {
            medians[i] = (double)NAN;
        } else if (weights) {
            medians[i] = weighed_median(own, with + begin, size, slack);
        } else if (size <= FEW) {
            sort_few(own, 0, size);
            medians[i] = 0.5 * (own[(size - 1) / 2] + own[size / 2]);
        } else {
            medians[i] = halfway(own, size);
        }
        begin = ends[i];
    }
}

#define SWAP(a, b)                                                                                                     \
    for (int64_t i = 0; i < LANES; i++) {                                                                              \
        const float low = side[a][i] < side[b][i] ? side[a][i] : side[b][i];                                           \
        const float high = side[a][i] < side[b][i] ? side[b][i] : side[a][i];                                          \
        side[a][i] = low;                                                                                              \
        side[b][i] = high;                                                                                             \
    }

// Nine by nine lanes put in order: a network of 25 exchanges (Floyd).
static void sort_nine(float side[9][LANES]){
    SWAP(0, 1) SWAP(3, 4) SWAP(6, 7) SWAP(1, 2) SWAP(4, 5) SWAP(7, 8) SWAP(0, 1) SWAP(3, 4) SWAP(6, 7) SWAP(0, 3)
        SWAP(3, 6) SWAP(0, 3) SWAP(1, 4) SWAP(4, 7) SWAP(1, 4) SWAP(2, 5) SWAP(5, 8) SWAP(2, 5) SWAP(1, 3) SWAP(5, 7)
            SWAP(2, 6) SWAP(4, 6) SWAP(2, 4) SWAP(2, 3) SWAP(5, 6)}

// Median over the seen neighbours of each cell that was seen, of `rows` (1 or 3) by 3, itself included; NaN of the
// others. Columns close round the pipe. field (z, a); line (9, b), b = a + 2 and more: room.
DOOR void smoothed(const float* const field, const int64_t rows, float* const line, float* const out, const int64_t z,
                   const int64_t a, const int64_t b)
{
    if (a < 1 || b < a + LANES) {
        return;
    }
    const int64_t reach = rows > 1 ? 1 : 0;
    for (int64_t row = 0; row < z; row++) {
        for (int64_t step = -1; step <= 1;
             step++) {  // each neighbour's row, seen or infinite, with its closing columns
            for (int64_t way = -1; way <= 1; way++) {
                float* const of = line + ((step + 1) * 3 + way + 1) * b;
                const bool there = step >= -reach && step <= reach && row + step >= 0 && row + step < z;
                const float* const from = field + (row + (there ? step : 0)) * a;
                for (int64_t j = 0; j < a; j++) {
                    const float value = from[around(j + way, a)];
                    of[j] = there && isfinite(value) ? value : INFINITY;
                }
            }
        }
        for (int64_t begin = 0; begin < a; begin += LANES) {
            float side[9][LANES];
            int32_t seen[LANES] = {0};
            for (int64_t k = 0; k < 9; k++) {
                for (int64_t i = 0; i < LANES; i++) {
                    side[k][i] = line[k * b + begin + i];
                    seen[i] += side[k][i] < INFINITY ? 1 : 0;
                }
            }
            sort_nine(side);
            for (int64_t i = 0; i < LANES && begin + i < a; i++) {
                const int32_t n = seen[i];
                const bool own = isfinite(field[row * a + begin + i]);
                out[row * a + begin + i] = own ? 0.5F * (side[(n - 1) / 2][i] + side[n / 2][i]) : (float)NAN;
            }
        }
    }
}

// Least and greatest of the seen cells about each, two columns each way and a row; infinite where there is none.
// line (2, b) of b = a + 4 values, columns going round: room.
DOOR void neighbour_extremes(const double* const grid, double* const line, double* const low, double* const high,
                             const int64_t z, const int64_t a, const int64_t b)
{
    double *const least_of = line, *const most_of = line + b;
    for (int64_t row = 0; row < (b == a + 4 && a >= 2 ? z : 0); row++) {
        double *const lowest = low + row * a, *const highest = high + row * a;
        for (int64_t j = 0; j < a; j++) {
            lowest[j] = (double)INFINITY;
            highest[j] = -(double)INFINITY;
        }
        for (int64_t r = most(row - 1, 0); r < least(row + 2, z); r++) {
            for (int64_t j = 0; j < b; j++) {
                const double value = grid[r * a + (j < 2 ? j + a - 2 : j < a + 2 ? j - 2 : j - a - 2)];
                least_of[j] = isfinite(value) ? value : (double)INFINITY;
                most_of[j] = isfinite(value) ? value : -(double)INFINITY;
            }
            for (int64_t step = 0; step <= 4; step++) {
                if (r == row && step == 2) {
                    continue;  // the cell itself
                }
                for (int64_t j = 0; j < a; j++) {
                    const double lower = least_of[j + step], higher = most_of[j + step];
                    lowest[j] = lower < lowest[j] ? lower : lowest[j];
                    highest[j] = higher > highest[j] ? higher : highest[j];
                }
            }
        }
    }
}

// A gap of at most `cells` steps between two seen values a step from `fall` to `rise` apart, filled on the line through
// both. Of a line of `size` values `stride` apart; one that closes is gone round until its first value comes again.
INLINE void bridge(const double* const from, double* const to, const int64_t size, const int64_t stride,
                   const double cells, const double fall, const double rise, const bool closes)
{
    int64_t last = -1;  // the latest that was seen, -1 of none
    for (int64_t i = 0; i < (closes ? 2 * size : size); i++) {
        const int64_t own = i < size ? i : i - size;
        if (!isfinite(from[own * stride])) {
            continue;
        }
        const int64_t gap = i - last;
        if (last >= 0 && gap > 1 && (double)gap <= cells) {
            const double before = from[(last < size ? last : last - size) * stride], step = from[own * stride] - before;
            if (step >= fall && step <= rise) {
                for (int64_t k = 1; k < gap; k++) {
                    const int64_t at = last + k < size ? last + k : last + k - size;
                    to[at * stride] = before + (double)k / (double)gap * step;
                }
            }
        }
        last = i;
        if (i >= size) {
            break;  // where the line closes
        }
    }
}

// Gaps of a grid (z, a) filled down its columns, or along its rows, which close; out begins as a copy of it.
DOOR void bridged(const double* const grid, const double cells, const double fall, const double rise,
                  const bool along_rows, double* const out, const int64_t z, const int64_t a)
{
    for (int64_t i = 0; i < (along_rows ? z : a); i++) {
        const int64_t first = along_rows ? i * a : i;
        bridge(grid + first, out + first, along_rows ? a : z, along_rows ? 1 : a, cells, fall, rise, along_rows);
    }
}

// Of each cell how many observations it has, of numbers (n,), and the sum of their squares: of the ring that a number
// says, number % k, squares (k,). ends (c,), laid (n,): room.
DOOR void cell_observations(const int64_t* const cell, const int32_t* const number, const double* const square,
                            int64_t* const ends, int32_t* const laid, double* const times, double* const squares,
                            const int64_t n, const int64_t k, const int64_t c)
{
    if (c < 1 || k < 1) {
        return;
    }
    begin_cells(cell, ends, n, c);
    for (int64_t i = 0; i < n; i++) {
        laid[ends[bounded(cell[i], 0, c - 1)]++] = number[i];
    }
    int64_t begin = 0;
    for (int64_t i = 0; i < c; i++) {
        const int64_t end = ends[i];
        double sum = 0.0;
        int64_t many = 0;
        int64_t gap = 1;  // in order, so that equals stand side by side: Shell's way, for they may come in any
        while (gap < (end - begin) / 3) {
            gap = 3 * gap + 1;
        }
        for (; gap > 0; gap /= 3) {
            for (int64_t j = begin + gap; j < end; j++) {
                const int32_t own = laid[j];
                int64_t place = j;
                while (place >= begin + gap && laid[place - gap] > own) {
                    laid[place] = laid[place - gap];
                    place -= gap;
                }
                laid[place] = own;
            }
        }
        for (int64_t j = begin; j < end; j++) {
            if (j == begin || laid[j] != laid[j - 1]) {
                many++;
                sum += square[bounded(laid[j] % k, 0, k - 1)];
            }
        }
        times[i] = (double)many;
        squares[i] = sum;
        begin = end;
    }
}
