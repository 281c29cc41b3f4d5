// Two strips of the unrolled wall, held against each other: what is marked on each, and how alike they look under every
// shift along the pipe.
//
// A mark is what is darker or brighter than about it: light averaged by a narrow bell less light averaged by a wide
// one, both over what was seen. Likeness is a correlation, of which the six sums are taken here, sector by sector;
// those of products are sums of products in single precision.

#include "native.h"
#include "selection.h"

enum { SUMS = 6, BLOCK = 8 };

// Place of a row or column that is reflected at the ends, both of which are counted twice.
INLINE int64_t mirrored(const int64_t at, const int64_t size)
{
    const int64_t turn = 2 * size, there = at < 0 ? turn - 1 - (-at - 1) % turn : at % turn;
    return there < size ? there : turn - 1 - there;
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
    for (int64_t row = 0; row < r; row++) {
        float* const sum = middle_field + row * a;
        for (int64_t i = 0; i < a; i++) {
            sum[i] = half[0] * field[row * a + i];
        }
        for (int64_t step = 1; step < k; step++) {
            const float* const before = field + mirrored(row - step, r) * a;
            const float* const after = field + mirrored(row + step, r) * a;
            for (int64_t i = 0; i < a; i++) {
                sum[i] += half[step] * (before[i] + after[i]);
            }
        }
    }
    for (int64_t row = 0; row < r; row++) {
        const float* const from = middle_field + row * a;
        float* const sum = out + row * a;
        for (int64_t i = -m; i < a + m; i++) {
            line[i + m] = from[mirrored(i, a)];
        }
        for (int64_t i = 0; i < a; i++) {
            sum[i] = beside[0] * line[i + m];
        }
        for (int64_t step = 1; step < m; step++) {
            for (int64_t i = 0; i < a; i++) {
                sum[i] += beside[step] * (line[i + m - step] + line[i + m + step]);
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
    for (int64_t begin = 0; begin < a; begin += BLOCK) {
        for (int64_t shift = 0; shift < d; shift++) {
            const int64_t there = shift * a + begin;
            double* const own = sums + shift * SUMS * a + begin;
            if (a - begin >= BLOCK) {
                add_block(one + begin, other + there, seen_one + begin, seen_other + there, r, a, BLOCK, own);
            } else {
                add_block(one + begin, other + there, seen_one + begin, seen_other + there, r, a, a - begin, own);
            }
        }
    }
}
