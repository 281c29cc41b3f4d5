// Stations of a wall: medians over their rows, and the closed line of each.

#include <string.h>

#include "native.h"
#include "selection.h"

// Medians (s, a) over so many `rows` of a field (z, a) and `beside` columns on either side, round the clock, of what
// was seen; NaN of a column in whose own rows nothing was. values (m,): room for as many as that is.
DOOR void station_medians(const float* const field, const int64_t rows, const int64_t beside, double* const values,
                          double* const out, const int64_t z, const int64_t a, const int64_t m, const int64_t s)
{
    const int64_t high = most(rows, 1), side = bounded(beside, 0, (a - 1) / 2);
    if (m < high * (2 * side + 1)) {
        return;
    }
    for (int64_t station = 0; station < s; station++) {
        const int64_t first = least(station * high, z), last = least(first + high, z);
        for (int64_t column = 0; column < a; column++) {
            int64_t size = 0;
            bool own = false;
            for (int64_t step = -side; step <= side; step++) {
                const float* const from = field + around(column + step, a);
                for (int64_t row = first; row < last; row++) {
                    const float value = from[row * a];
                    values[size] = (double)value;
                    size += isfinite(value) ? 1 : 0;
                    own |= step == 0 && isfinite(value);
                }
            }
            out[station * a + column] = own ? halfway(values, size) : NOTHING;
        }
    }
}

// Length (mm) and area (mm^2) of the closed line through each row of radii (s, a), NaN where not seen: an arc that was
// not is crossed in the course of `usual` (s, a). NaN where more than `unseen_most` columns were not seen, or
// `gap_most` beside one another. Radii are evened out over `even` columns; chord: of an arc over its chord, and the
// cosine of a column's angle, and that angle. line, even_line (a,): room.
DOOR void closed_lines(const double* const radii, const double* const usual, const double unseen_most,
                       const double gap_most, const int64_t even, const double chord, const double cosine,
                       const double angle, double* const line, double* const even_line, double* const out,
                       const int64_t s, const int64_t a)
{
    const int64_t width = bounded(even, 1, a), back = width / 2;
    for (int64_t station = 0; station < s; station++) {
        const double *const radius = radii + station * a, *const shape = usual + station * a;
        int64_t first = -1, seen = 0;
        for (int64_t j = 0; j < a; j++) {
            if (isfinite(radius[j])) {
                first = first < 0 ? j : first;
                seen++;
            }
        }
        bool known = seen > 0 && (double)(a - seen) <= unseen_most;
        for (int64_t begin = first; known && begin < first + a;) {  // from a seen column to the next
            int64_t end = begin + 1;
            while (!isfinite(radius[end % a])) {
                end++;
            }
            known = (double)(end - begin - 1) <= gap_most;
            const double low = radius[begin % a] - shape[begin % a], high = radius[end % a] - shape[end % a];
            for (int64_t k = begin; k < end; k++) {
                const double part = (double)(k - begin) / (double)(end - begin);
                line[k % a] = shape[k % a] + (low + part * (high - low));
            }
            begin = end;
        }
        double length = 0.0, area = 0.0;
        if (known) {
            for (int64_t j = 0; j < a; j++) {
                double sum = 0.0;
                for (int64_t k = 0; k < width; k++) {
                    sum += line[(j + k - back + a) % a];
                }
                even_line[j] = sum / (double)width;
            }
            for (int64_t j = 0; j < a; j++) {
                const double r = even_line[j], next = even_line[around(j + 1, a)];
                length += sqrt(r * r + next * next - 2.0 * r * next * cosine);
                area += r * r;
            }
        }
        out[2 * station] = known ? chord * length : NOTHING;
        out[2 * station + 1] = known ? 0.5 * angle * area : NOTHING;
    }
}
