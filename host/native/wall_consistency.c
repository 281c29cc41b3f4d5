// Which points the frames around them contradict: a vote over the cells about each.
//
// A cell is a patch of the wall, rows along the pipe and columns round it. A point is judged by the points of other
// frames in its own cell and the eight about it; each weighs what its sigma allows. Points are laid side by side cell
// by cell, so that a neighbourhood is three runs of memory, or six where it goes over 12 o'clock; sums go in eight
// lanes.

#include "native.h"

enum { LANES = 8 };
static const double ROUNDING = 1.000001;  // of sums of the same weights in another order, by far

// Adds what a run of points says of one: who is another frame's, what all of those weigh, and what those weigh that
// see the same radius.
INLINE void heard(const double* const frame, const double* const radius, const double* const weight,
                  const int64_t begin, const int64_t end, const double own, const double at, const double slack,
                  double others[LANES], double all[LANES], double agree[LANES])
{
    int64_t q = begin;
    for (; q + LANES <= end; q += LANES) {
        for (int64_t i = 0; i < LANES; i++) {
            const double apart = radius[q + i] - at;
            const double counted = frame[q + i] != own ? 1.0 : 0.0;
            const double w = frame[q + i] != own ? weight[q + i] : 0.0;
            others[i] += counted;
            all[i] += w;
            agree[i] += (apart <= slack) & (apart >= -slack) ? w : 0.0;
        }
    }
    for (int64_t i = 0; q < end; q++, i++) {
        const double apart = radius[q] - at;
        const double w = frame[q] != own ? weight[q] : 0.0;
        others[i] += frame[q] != own ? 1.0 : 0.0;
        all[i] += w;
        agree[i] += (apart <= slack) & (apart >= -slack) ? w : 0.0;
    }
}

INLINE double total(const double lanes[LANES])
{
    return ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7]));
}

// Whether what a run of points says of one is enough, wherever all others about it stand: whose weights that see its
// radius come to `enough`.
INLINE bool agreed(const double* const frame, const double* const radius, const double* const weight,
                   const int64_t begin, const int64_t end, const double own, const double at, const double slack,
                   const double enough)
{
    double sum = 0.0;
    for (int64_t q = begin; q < end; q += LANES) {
        double agree[LANES] = {0};
        const int64_t size = least(LANES, end - q);
        for (int64_t i = 0; i < size; i++) {
            const double apart = radius[q + i] - at;
            agree[i] = (frame[q + i] != own) & (apart <= slack) & (apart >= -slack) ? weight[q + i] : 0.0;
        }
        sum += total(agree);
        if (sum >= enough) {
            return true;
        }
    }
    return false;
}

// good (n,): not contradicted. cell (n,) of a grid r x k; frame, radius, weight (n,) of each point. Contradicted is who
// has `needed` points of others about it, and of their weight less than `part` within `slack`. first (c,), c = r k + 1;
// order, sorted: room.
DOOR void wall_votes(const int64_t* const cell, const double* const frame, const double* const radius,
                     const double* const weight, const double slack, const double needed, const double part,
                     const int64_t rows, int64_t* const first, int64_t* const order, double* const sorted,
                     bool* const good, const int64_t n, const int64_t c)
{
    const int64_t columns = rows > 0 ? (c - 1) / rows : 0;
    if (columns < 1) {
        return;
    }
    const int64_t cells = rows * columns;
    for (int64_t i = 0; i < c; i++) {
        first[i] = 0;
    }
    for (int64_t p = 0; p < n; p++) {
        first[1 + most(0, least(cell[p], cells - 1))]++;
    }
    for (int64_t i = 0; i < cells; i++) {
        first[i + 1] += first[i];
    }
    for (int64_t p = 0; p < n; p++) {  // first[i] becomes the end of cell i, which is where i + 1 begins
        order[first[most(0, least(cell[p], cells - 1))]++] = p;
    }
    for (int64_t i = cells; i > 0; i--) {
        first[i] = first[i - 1];
    }
    first[0] = 0;
    double *const frames = sorted, *const radii = sorted + n, *const weights = sorted + 2 * n;
    for (int64_t q = 0; q < n; q++) {
        frames[q] = frame[order[q]];
        radii[q] = radius[order[q]];
        weights[q] = weight[order[q]];
    }
    for (int64_t row = 0; row < rows; row++) {
        const int64_t low = most(row - 1, 0), high = least(row + 2, rows);
        for (int64_t column = 0; column < columns; column++) {
            const int64_t own = row * columns + column;
            double most_of_all = 0.0;  // that the weight of all others can be
            for (int64_t r = low; r < high && first[own] < first[own + 1]; r++) {
                for (int64_t step = -1; step <= 1; step++) {
                    const int64_t beside = r * columns + around(column + step, columns);
                    for (int64_t q = first[beside]; q < first[beside + 1]; q++) {
                        most_of_all += weights[q];
                    }
                }
            }
            const int64_t* const same = first + row * columns;
            for (int64_t p = first[own]; p < first[own + 1]; p++) {
                if (agreed(frames, radii, weights, same[most(column - 1, 0)], same[least(column + 2, columns)],
                           frames[p], radii[p], slack, ROUNDING * part * most_of_all)) {
                    good[order[p]] = true;
                    continue;
                }
                double others[LANES] = {0}, all[LANES] = {0}, agree[LANES] = {0};
                for (int64_t r = low; r < high; r++) {
                    const int64_t* const line = first + r * columns;
                    const int64_t before = column - 1, after = column + 2;
                    heard(frames, radii, weights, line[most(before, 0)], line[least(after, columns)], frames[p],
                          radii[p], slack, others, all, agree);
                    if (before < 0) {
                        heard(frames, radii, weights, line[columns - 1], line[columns], frames[p], radii[p], slack,
                              others, all, agree);
                    }
                    if (after > columns) {
                        heard(frames, radii, weights, line[0], line[1], frames[p], radii[p], slack, others, all, agree);
                    }
                }
                good[order[p]] = total(others) < needed || total(agree) >= part * total(all);
            }
        }
    }
}
