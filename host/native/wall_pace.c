// Two strips of the unrolled wall, held against each other: what is marked on each, and how alike they look under every
// shift along the pipe.
//
// A mark is what is darker or brighter than about it: light averaged by a narrow bell less light averaged by a wide
// one, both over what was seen. Likeness is a correlation, of which the six sums are taken here, sector by sector;
// those of products are sums of products in single precision.

#include "lanes.h"
#include "selection.h"

enum { SUMS = 6, BLOCK = 8, RUN = 2 * AT_ONCE };
typedef float Run __attribute__((vector_size(4 * RUN)));

// Place of a row or column that is reflected at the ends, both of which are counted twice.
INLINE int64_t mirrored(const int64_t at, const int64_t size)
{
    if (at >= 0 && at < size) {
        return at;
    }
    const int64_t turn = 2 * size, there = at < 0 ? turn - 1 - (-at - 1) % turn : at % turn;
    return there < size ? there : turn - 1 - there;
}

// What a bell makes of a field that is `value` as far as it reaches.
static float level(const float* const bell, const int64_t size, const float value)
{
    float sum = 0.0F;
    for (int64_t step = 0; step < size; step++) {
        sum += bell[step] * (step ? value + value : value);
    }
    return sum;
}

INLINE bool is_all(const float* const values, const float value, const int64_t size)
{
    int64_t same = 0;
    for (int64_t i = 0; i < size; i++) {
        same += values[i] == value ? 1 : 0;
    }
    return same == size;
}

// The average along the rows of RUN columns, or of one. Where the field is 1 as far as the bell reaches (of what was
// seen it mostly is) it is known.
INLINE void add_rows(const float* const field, const float* const half, float* const out, const int64_t r,
                     const int64_t a, const int64_t k, const bool many)
{
    const float of_ones = level(half, k, 1.0F);
    int64_t looked_at = -1, other = -1;  // rows up to which it was looked, and the last one that is not 1
    for (int64_t row = 0; row < r; row++) {
        Run sum = {0.0F}, before, after;
        while (looked_at < least(row + k, r) - 1) {
            looked_at++;
            other = is_all(field + looked_at * a, 1.0F, many ? RUN : 1) ? other : looked_at;
        }
        const bool is_known = other <= row - k, is_inner = row >= k - 1 && row + k <= r;
        for (int64_t step = 0; step < (is_known ? 0 : k); step++) {
            const float* const low = field + (is_inner ? row - step : mirrored(row - step, r)) * a;
            const float* const high = field + (is_inner ? row + step : mirrored(row + step, r)) * a;
            if (!many) {
                sum[0] += half[step] * (step ? *low + *high : *low);
            } else {
                memcpy(&before, low, sizeof before);
                memcpy(&after, high, sizeof after);
                sum += half[step] * (step ? before + after : before);
            }
        }
        sum = is_known ? sum + of_ones : sum;
        memcpy(out + row * a, &sum, many ? sizeof sum : sizeof sum[0]);
    }
}

// The same along a row, of a line that begins m values before the first. is_known: it is `value` as far as that
// reaches.
INLINE void add_beside(const float* const line, const float* const beside, float* const out, const int64_t m,
                       const bool many, const bool is_known, const float value)
{
    Run sum = {0.0F}, before, after;
    for (int64_t step = 0; step < (is_known ? 0 : m); step++) {
        const float *const low = line + m - step, *const high = line + m + step;
        if (!many) {
            sum[0] += beside[step] * (step ? *low + *high : *low);
        } else {
            memcpy(&before, low, sizeof before);
            memcpy(&after, high, sizeof after);
            sum += beside[step] * (step ? before + after : before);
        }
    }
    sum = is_known ? sum + value : sum;
    memcpy(out, &sum, many ? sizeof sum : sizeof sum[0]);
}

// field (r, a) averaged by a bell of `half` (k,) weights from its middle out along the columns, then one of `beside`
// (m,) along the rows, both symmetric; line (b,) of at least a + 2 m values, middle (r, a): room.
DOOR void bell_averaged(const float* const field, const float* const half, const float* const beside, float* const line,
                        float* const middle_field, float* const out, const int64_t r, const int64_t a, const int64_t k,
                        const int64_t m, const int64_t b)
{
    if (r < 1 || a < 1 || k < 1 || m < 1 || b < a + 2 * m) {
        return;
    }
    const int64_t whole_runs = a / RUN * RUN;
    const float of_ones = level(half, k, 1.0F), of_those = level(beside, m, of_ones);
    for (int64_t at = 0; at < whole_runs; at += RUN) {
        add_rows(field + at, half, middle_field + at, r, a, k, true);
    }
    for (int64_t at = whole_runs; at < a; at++) {
        add_rows(field + at, half, middle_field + at, r, a, k, false);
    }
    for (int64_t row = 0; row < r; row++) {
        const float* const from = middle_field + row * a;
        for (int64_t i = -m; i < a + m; i++) {
            line[i + m] = from[mirrored(i, a)];
        }
        int64_t looked_at = 0, other = -1;
        for (int64_t at = 0; at < a; at += at < whole_runs ? RUN : 1) {
            const bool many = at < whole_runs;
            for (const int64_t end = at + 2 * m + (many ? RUN : 1); looked_at < end; looked_at++) {
                other = line[looked_at] == of_ones ? other : looked_at;
            }
            if (many) {
                add_beside(line + at, beside, out + row * a + at, m, true, other < at, of_those);
            } else {
                add_beside(line + at, beside, out + row * a + at, m, false, other < at, of_those);
            }
        }
    }
}

// Medians of the rows of a field (r, a), NaN passed over; NaN of a row of nothing. line (a,): room.
DOOR void row_medians(const float* const field, float* const line, float* const out, const int64_t r, const int64_t a)
{
    for (int64_t row = 0; row < r; row++) {
        int64_t size = 0;
        for (int64_t i = 0; i < a; i++) {
            const float value = field[row * a + i];
            line[size] = value;
            size += isfinite(value) ? 1 : 0;
        }
        out[row] = size ? halfway_f(line, size) : (float)NAN;
    }
}

// The median size of what is seen of a field (n,); NaN of nothing. line (n,): room.
DOOR double size_median(const float* const field, float* const line, const int64_t n)
{
    int64_t size = 0;
    for (int64_t i = 0; i < n; i++) {
        line[size] = fabsf(field[i]);
        size += isfinite(field[i]) ? 1 : 0;
    }
    return size ? (double)halfway_f(line, size) : NOTHING;
}

// Adds what both of two strips show in BLOCK columns of some rows, to the columns' sums (6, a).
INLINE void add_block(const float* const one, const float* const other, const float* const seen_one,
                      const float* const seen_other, const int64_t rows, const int64_t a, const int64_t columns,
                      double* const sums)
{
    double lanes[SUMS][BLOCK] = {{0.0}};
    for (int64_t row = 0; row < rows; row++) {
        for (int64_t i = 0; i < columns; i++) {
            const int64_t at = row * a + i;
            const float x = one[at], y = other[at], m = seen_one[at], n = seen_other[at];
            lanes[0][i] += (double)(m * n);
            lanes[1][i] += (double)(x * n);
            lanes[2][i] += (double)(y * m);
            lanes[3][i] += (double)(x * x * n);
            lanes[4][i] += (double)(y * y * m);
            lanes[5][i] += (double)(x * y);
        }
    }
    for (int64_t k = 0; k < SUMS; k++) {
        for (int64_t i = 0; i < columns; i++) {
            sums[k * a + i] = lanes[k][i];
        }
    }
}

// Whether all of BLOCK columns was seen.
INLINE bool all_seen(const float* const seen, const int64_t rows, const int64_t a)
{
    float least_seen[BLOCK];
    for (int64_t i = 0; i < BLOCK; i++) {
        least_seen[i] = 1.0F;
    }
    for (int64_t row = 0; row < rows; row++) {
        for (int64_t i = 0; i < BLOCK; i++) {
            least_seen[i] = least_seen[i] < seen[row * a + i] ? least_seen[i] : seen[row * a + i];
        }
    }
    bool all = true;
    for (int64_t i = 0; i < BLOCK; i++) {
        all &= least_seen[i] > 0.0F;
    }
    return all;
}

// The same of BLOCK columns of which all was seen: nothing but the products is another sum under another shift; what
// the shifted strip shows is summed once, and from then on less what goes and with what comes.
INLINE void add_seen(const float* const one, const float* const other, const int64_t rows, const int64_t a,
                     const int64_t shifts, double* const sums)
{
    double of_one[2][BLOCK] = {{0.0}}, of_other[2][BLOCK] = {{0.0}};
    for (int64_t row = 0; row < rows; row++) {
        for (int64_t i = 0; i < BLOCK; i++) {
            const float x = one[row * a + i], y = other[row * a + i];
            of_one[0][i] += (double)x;
            of_one[1][i] += (double)(x * x);
            of_other[0][i] += (double)y;
            of_other[1][i] += (double)(y * y);
        }
    }
    for (int64_t shift = 0; shift < shifts; shift++) {
        const float* const moved = other + shift * a;
        double products[BLOCK] = {0.0};
        for (int64_t row = 0; row < rows; row++) {
            for (int64_t i = 0; i < BLOCK; i++) {
                products[i] += (double)(one[row * a + i] * moved[row * a + i]);
            }
        }
        double* const own = sums + shift * SUMS * a;
        for (int64_t i = 0; i < BLOCK; i++) {
            own[i] = (double)rows;
            own[a + i] = of_one[0][i];
            own[2 * a + i] = of_other[0][i];
            own[3 * a + i] = of_one[1][i];
            own[4 * a + i] = of_other[1][i];
            own[5 * a + i] = products[i];
        }
        for (int64_t i = 0; i < (shift + 1 < shifts ? BLOCK : 0); i++) {
            const float gone = moved[i], come = moved[rows * a + i];
            of_other[0][i] += (double)come - (double)gone;
            of_other[1][i] += (double)(come * come) - (double)(gone * gone);
        }
    }
}

// Sums (d, 6, a) of what both of two strips show under each of d shifts, column by column: how much that is, x, y, x x,
// y y and x y. one (r, a) is held against `other` (q, a) from its row 0, 1, .. d - 1 on; NaN: not seen. Both are
// changed: NaN becomes 0. seen_one, seen_other: room.
DOOR void strip_sums(float* const one, float* const other, float* const seen_one, float* const seen_other,
                     double* const sums, const int64_t r, const int64_t a, const int64_t q, const int64_t d)
{
    if (q < r + d - 1) {
        return;
    }
    for (int64_t i = 0; i < r * a; i++) {
        seen_one[i] = isfinite(one[i]) ? 1.0F : 0.0F;
        one[i] = isfinite(one[i]) ? one[i] : 0.0F;
    }
    for (int64_t i = 0; i < q * a; i++) {
        seen_other[i] = isfinite(other[i]) ? 1.0F : 0.0F;
        other[i] = isfinite(other[i]) ? other[i] : 0.0F;
    }
    for (int64_t at = 0; at < a; at += BLOCK) {
        if (a - at >= BLOCK && all_seen(seen_one + at, r, a) && all_seen(seen_other + at, r + d - 1, a)) {
            add_seen(one + at, other + at, r, a, d, sums + at);
            continue;
        }
        for (int64_t shift = 0; shift < d; shift++) {
            const int64_t there = shift * a + at;
            double* const own = sums + shift * SUMS * a + at;
            if (a - at >= BLOCK) {
                add_block(one + at, other + there, seen_one + at, seen_other + there, r, a, BLOCK, own);
            } else {
                add_block(one + at, other + there, seen_one + at, seen_other + there, r, a, a - at, own);
            }
        }
    }
}
