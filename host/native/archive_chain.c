// What each place or roll of a row of the second map would cost, and the likeliest chain of them: annulus_pipe.archive
// .chain says what for. Viterbi's shortest path, and forward-backward over all paths, with steps whose cost or
// likelihood depends on their length alone: a row takes time in proportion to its states, not to their square.
#include <math.h>

#include "native.h"

#define LANES 8  // partial sums of a row's columns: as many as the widest vector has, added up in one order everywhere

// Half the squares of what a row differs by, less what they are of a wall that shows nothing.
typedef struct {
    double part, aside;   // of a row and of a column, that the place lies beyond the lower one
    double squared, per;  // mm^2, its inverse: of the differences' sigma
    double cut, stands_mm, grows;
} Costs;

// One column's; 0 where one of the two maps did not see.
INLINE double cost_of(const Costs* const of, const float seen, const float a, const float b, const float c,
                      const float d)
{
    const double low = (1.0 - of->aside) * (double)a + of->aside * (double)b;
    const double high = (1.0 - of->aside) * (double)c + of->aside * (double)d;
    const double there = (1.0 - of->part) * low + of->part * high, own = (double)seen;
    const double off = own - there, over = fabs(there) - of->stands_mm;
    const double stands = of->grows * (over > 0.0 ? over : 0.0);
    const double differs = off * off / (of->squared + stands * stands), bare = (double)(seen * seen) * of->per;
    const double cost = (differs < of->cut ? differs : of->cut) - (bare < of->cut ? bare : of->cut);
    return off == off ? cost : 0.0;
}

// Columns that lie side by side in both maps.
static void add_costs(const Costs* const of, const float* const seen, const float* const low, const float* const high,
                      const int64_t columns, double* const sums)
{
    const Costs held = *of;
    const int64_t whole_lanes = columns - columns % LANES;
    for (int64_t c = 0; c < whole_lanes; c += LANES) {
        for (int64_t l = 0; l < LANES; l++) {
            sums[l] += cost_of(&held, seen[c + l], low[c + l], low[c + l + 1], high[c + l], high[c + l + 1]);
        }
    }
    for (int64_t c = whole_lanes; c < columns; c++) {
        sums[c - whole_lanes] += cost_of(&held, seen[c], low[c], low[c + 1], high[c], high[c + 1]);
    }
}

// Of each of z rows of the second at k places of the first; 0 beside the first's rows.
DOOR void chain_costs(const float* const second, const float* const first, const double* const row_at,
                      const double* const turned, const double sigma_mm, const double cut, const double stands_mm,
                      const double grows, double* const cost, const int64_t z, const int64_t c, const int64_t r,
                      const int64_t k)
{
    Costs of = {.squared = sigma_mm * sigma_mm, .per = 1.0 / (sigma_mm * sigma_mm)};
    of.cut = cut;
    of.stands_mm = stands_mm;
    of.grows = grows;
    for (int64_t i = 0; i < z * k; i++) {
        const double below = floor(row_at[i]), left = floor(turned[i]);
        cost[i] = 0.0;
        if (!(below >= 0.0 && below + 1.0 < (double)r && left == left) || c == 0) {
            continue;
        }
        of.part = row_at[i] - below;
        of.aside = turned[i] - left;
        const int64_t turns = whole(left, -0x1p52, 0x1p52) % c, begin = turns < 0 ? turns + c : turns;
        const float* const seen = second + i / k * c;
        const float* const low = first + (int64_t)below * c;
        const float* const high = low + c;
        const int64_t before = c - 1 - begin;  // columns until the first's last one, whose neighbour is its first
        double sums[LANES] = {0.0};
        add_costs(&of, seen, low + begin, high + begin, before, sums);
        sums[0] += cost_of(&of, seen[before], low[c - 1], low[0], high[c - 1], high[0]);
        add_costs(&of, seen + before + 1, low, high, begin, sums);
        cost[i] = 0.5 * (((sums[0] + sums[4]) + (sums[2] + sums[6])) + ((sums[1] + sums[5]) + (sums[3] + sums[7])));
    }
}

// The states of the cheapest chain: from a row to the next a neighbour costs `step`, any other `slip`.
DOOR void chain_likeliest(const double* const cost, const double step, const double slip, double* const room,
                          int32_t* const came, int64_t* const chain, const int64_t z, const int64_t k)
{
    double* const total = room;
    double* const reach = room + k;
    if (z == 0 || k == 0) {
        return;
    }
    for (int64_t s = 0; s < k; s++) {
        total[s] = cost[s];
    }
    for (int64_t i = 1; i < z; i++) {
        int32_t* const from = came + i * k;
        int64_t cheapest = 0;
        for (int64_t s = 0; s < k; s++) {
            from[s] = (int32_t)s;
            reach[s] = total[s];
            cheapest = total[s] < total[cheapest] ? s : cheapest;
        }
        for (int64_t s = 1; s < k; s++) {
            if (reach[s - 1] + step < reach[s]) {
                reach[s] = reach[s - 1] + step;
                from[s] = from[s - 1];
            }
        }
        for (int64_t s = k - 2; s >= 0; s--) {
            if (reach[s + 1] + step < reach[s]) {
                reach[s] = reach[s + 1] + step;
                from[s] = from[s + 1];
            }
        }
        const double far = total[cheapest] + slip;
        for (int64_t s = 0; s < k; s++) {
            from[s] = far < reach[s] ? (int32_t)cheapest : from[s];
            total[s] = (far < reach[s] ? far : reach[s]) + cost[i * k + s];
        }
    }
    int64_t at = 0;
    for (int64_t s = 0; s < k; s++) {
        at = total[s] < total[at] ? s : at;
    }
    for (int64_t i = z - 1; i >= 0; i--) {
        chain[i] = at;
        at = came[i * k + at];
    }
}

// From a row to the next: a neighbour either way with the likelihood `near`, a slip with `far`, by n states with
// fade^n.
typedef struct {
    double near, far, fade;
} Passing;

static void spread(double* const belief, const Passing* const by, double* const down, double* const up, const int64_t k)
{
    double forth = 0.0, back = 0.0;
    for (int64_t s = 0; s < k; s++) {
        forth = belief[s] + by->fade * forth;
        back = belief[k - 1 - s] + by->fade * back;
        down[s] = forth;
        up[k - 1 - s] = back;
    }
    const double share = by->far * (1.0 - by->fade) / (1.0 + by->fade);
    double before = belief[0];
    for (int64_t s = 0; s < k; s++) {
        const double now = belief[s], after = s + 1 < k ? belief[s + 1] : now;
        belief[s] = now + by->near * (before - 2.0 * now + after) - by->far * now + share * (down[s] + up[s] - now);
        before = now;
    }
}

// Each times the other, made to add up to 1.
static void multiplied(double* const belief, const double* const other, const int64_t k)
{
    double sum = 0.0;
    for (int64_t s = 0; s < k; s++) {
        belief[s] *= other[s];
        sum += belief[s];
    }
    for (int64_t s = 0; s < k; s++) {
        belief[s] /= sum;
    }
}

// How likely each state is by all rows, from how likely it is by each alone: before row i state s is what s + leaps[i]
// was.
DOOR void chain_believed(const double* const likely, const int64_t* const leaps, const double near, const double far,
                         const double fade, double* const room, double* const ahead, const int64_t z, const int64_t k)
{
    const Passing by = {near, far, fade};
    double* const down = room;
    double* const up = room + k;
    double* const back = room + 2 * k;
    double* const part = room + 3 * k;
    if (k == 0) {
        return;
    }
    for (int64_t i = 0; i < z; i++) {
        double* const own = ahead + i * k;
        const int64_t leap = least(most(leaps[i], -k), k);
        for (int64_t s = 0; s < k; s++) {  // no slip where one was believed: the same place is another state
            const bool inside = i > 0 && s + leap >= 0 && s + leap < k;
            own[s] = inside ? own[s + leap - k] : i > 0 ? 0.0 : 1.0;
        }
        if (i > 0) {
            spread(own, &by, down, up, k);
        }
        multiplied(own, likely + i * k, k);
    }
    for (int64_t s = 0; s < k; s++) {
        back[s] = 1.0 / (double)k;
    }
    for (int64_t i = z - 1; i >= 0; i--) {
        const int64_t leap = least(most(leaps[i], -k), k);
        multiplied(ahead + i * k, back, k);
        for (int64_t s = 0; s < k; s++) {
            part[s] = back[s] * likely[i * k + s];
        }
        spread(part, &by, down, up, k);
        double sum = 0.0;
        for (int64_t s = 0; s < k; s++) {
            back[s] = s - leap >= 0 && s - leap < k ? part[s - leap] : 0.0;
            sum += back[s];
        }
        for (int64_t s = 0; s < k; s++) {
            back[s] /= sum;
        }
    }
}

// The x of least sum weight x^2 / 2 - pull x + tie (x[i + 1] - x[i])^2 / 2, and its variances: elimination from both
// ends of a matrix of three diagonals.
DOOR void chain_joined(const double* const weight, const double* const pull, const double* const tie,
                       double* const room, double* const value, double* const variance, const int64_t z,
                       const int64_t t)
{
    const int64_t rows = least(z, t + 1);
    double* const down = room;
    double* const up = room + z;
    double* const right = room + 2 * z;
    if (rows <= 0) {
        return;
    }
    for (int64_t i = 0; i < rows; i++) {
        variance[i] = weight[i] + (i > 0 ? tie[i - 1] : 0.0) + (i < rows - 1 ? tie[i] : 0.0);
    }
    // from both ends at once: each division waits for the one before it, and not for the other end's
    double below = variance[0], pulled = pull[0], above = variance[rows - 1];
    down[0] = below;
    right[0] = pulled;
    up[rows - 1] = above;
    for (int64_t i = 1; i < rows; i++) {
        const int64_t back = rows - 1 - i;
        pulled = pull[i] + tie[i - 1] / below * pulled;
        below = variance[i] - tie[i - 1] * tie[i - 1] / below;
        above = variance[back] - tie[back] * tie[back] / above;
        down[i] = below;
        right[i] = pulled;
        up[back] = above;
    }
    double found = pulled / below;
    value[rows - 1] = found;
    for (int64_t i = rows - 2; i >= 0; i--) {
        found = right[i] / down[i] + tie[i] / down[i] * found;
        value[i] = found;
    }
    for (int64_t i = 0; i < rows; i++) {
        variance[i] = 1.0 / (down[i] + up[i] - variance[i]);
    }
}
