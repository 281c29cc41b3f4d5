// What every point of a scan is to the pipe and to the other frames: how far it lies off the shape, and which points of
// neighbouring frames look at the same spot.

#include <string.h>

#include "by_cell.h"
#include "mathematics.h"

enum { SHAPE = 5, BLOCK = 128 };
static const double DEGREES = 57.295779513082321;  // a radian

INLINE void about_axis(const double* const x, const double* const y, const bool clock, double* const radius,
                       double* const angle)
{
    for (int64_t i = 0; i < BLOCK; i++) {
        const double turn = clock ? arc_tangent(x[i], -y[i]) : arc_tangent(y[i], x[i]), degrees = DEGREES * turn;
        radius[i] = sqrt(x[i] * x[i] + y[i] * y[i]);
        angle[i] = !clock ? turn : degrees < 0.0 ? degrees + 360.0 : degrees;
    }
}

// Radius, angle and z (3, n) of points (n, 3) about the axis. The angle is that of (x, y), radians from -pi to pi, or
// that of the clock: degrees from 0 to 360, of (-y, x).
DOOR void round_axis(const float* const points, const bool clock, double* const out, const int64_t n)
{
    double x[BLOCK] = {0.0}, y[BLOCK] = {0.0}, radius[BLOCK], angle[BLOCK];
    for (int64_t begin = 0; begin < n; begin += BLOCK) {
        const int64_t size = least(BLOCK, n - begin);
        for (int64_t i = 0; i < size; i++) {
            const float* const point = points + 3 * (begin + i);
            x[i] = (double)point[0];
            y[i] = (double)point[1];
            out[2 * n + begin + i] = (double)point[2];
        }
        if (clock) {
            about_axis(x, y, true, radius, angle);
        } else {
            about_axis(x, y, false, radius, angle);
        }
        memcpy(out + begin, radius, (size_t)size * sizeof *out);
        memcpy(out + n + begin, angle, (size_t)size * sizeof *out);
    }
}

// radius and departure (n,) of points (n, 3) from the shape (z, 5) at stations (z,), rising; before the first and
// beyond the last it is theirs. With c = cos t = -y/r and s = sin t = x/r the shape is s0 + s1 c + s2 s + s3 (c^2 -
// s^2) + s4 2 c s.
DOOR void shape_departures(const float* const points, const double* const stations, const double* const shape,
                           double* const radius, double* const departure, const int64_t n, const int64_t z)
{
    if (z < 1) {
        return;
    }
    const double step = (stations[z - 1] - stations[0]) / (double)most(z - 1, 1);
    for (int64_t i = 0; i < n; i++) {
        const double x = (double)points[3 * i], y = (double)points[3 * i + 1];
        const double at = held((double)points[3 * i + 2], stations[0], stations[z - 1]);
        int64_t own = z > 1 ? whole((at - stations[0]) / step, 0, z - 2) : 0;
        while (own > 0 && at < stations[own]) {
            own--;
        }
        while (own + 2 < z && at >= stations[own + 1]) {
            own++;
        }
        const double *const low = shape + SHAPE * own, *const high = shape + SHAPE * least(own + 1, z - 1);
        const double between = z > 1 ? stations[own + 1] - stations[own] : 1.0, along = at - stations[own];
        double s[SHAPE];
        for (int64_t k = 0; k < SHAPE; k++) {
            s[k] = (high[k] - low[k]) / between * along + low[k];
        }
        const double r = sqrt(x * x + y * y), cosine = -y / r, sine = x / r;
        radius[i] = r;
        departure[i] = r - (s[0] + s[1] * cosine + s[2] * sine + s[3] * (cosine * cosine - sine * sine) +
                            s[4] * (2.0 * cosine * sine));
    }
}

// Points of one spot in two frames. Of each ring of each frame that looks at a spot its middle point stands for it; it
// is held against that of the next ring or frame there, and of the one after, where that is another frame's. cell,
// frame, ring (n,), frames rising; calm (c,): spots that are asked. pairs (2, 2, n): a and b of the next ones, then of
// those after; returns how many the first are, size[0] how many the second. ends (c,), order (n,), one (n,): room.
DOOR int64_t spot_pairs(const int64_t* const cell, const int64_t* const frame, const int64_t* const ring,
                        const bool* const calm, int64_t* const ends, int32_t* const order, int32_t* const one,
                        int32_t* const pairs, int64_t* const size, const int64_t n, const int64_t c)
{
    size[0] = 0;
    if (c < 1 || n > INT32_MAX) {
        return 0;
    }
    begin_cells(cell, ends, n, c);
    for (int64_t i = 0; i < n; i++) {
        order[ends[bounded(cell[i], 0, c - 1)]++] = (int32_t)i;
    }
    int64_t next = 0, after = 0;
    int32_t *const a_next = pairs, *const b_next = pairs + n, *const a_after = pairs + 2 * n,
                   *const b_after = pairs + 3 * n;
    int64_t begin = 0;
    for (int64_t spot = 0; spot < c; spot++) {
        const int64_t end = ends[spot];
        if (!calm[spot]) {
            begin = end;
            continue;
        }
        for (int64_t i = begin + 1; i < end; i++) {  // by ring within a frame, as they come: they nearly are
            const int32_t own = order[i];
            int64_t place = i;
            while (place > begin && frame[order[place - 1]] == frame[own] && ring[order[place - 1]] > ring[own]) {
                order[place] = order[place - 1];
                place--;
            }
            order[place] = own;
        }
        int64_t count = 0;
        for (int64_t first = begin; first < end;) {
            int64_t last = first + 1;
            while (last < end && frame[order[last]] == frame[order[first]] && ring[order[last]] == ring[order[first]]) {
                last++;
            }
            one[count++] = order[(first + last) / 2];
            first = last;
        }
        for (int64_t i = 0; i + 1 < count; i++) {
            if (frame[one[i]] != frame[one[i + 1]]) {
                a_next[next] = one[i];
                b_next[next++] = one[i + 1];
            }
            if (i + 2 < count && frame[one[i]] != frame[one[i + 2]]) {
                a_after[after] = one[i];
                b_after[after++] = one[i + 2];
            }
        }
        begin = end;
    }
    size[0] = after;
    return next;
}
