// Patches of a grid whose columns close round the pipe: grown, thinned out, numbered, measured round.
//
// A box is passed over by counters: how many more cells what was met last still reaches, or how many in a row were set.
// Rows that have nothing, most of a sound pipe's, are passed over.

#include <string.h>

#include "native.h"

// Whether a row has anything.
INLINE bool any(const bool* const row, const int64_t a)
{
    return memchr(row, true, (size_t)a) != NULL;
}

// Cells with a marked one within `rows` and `columns` on either side; columns close round where `closes`. line (a,),
// left (a,): room.
DOOR void box_grown(const bool* const mask, const int64_t rows, const int64_t columns, const bool closes,
                    bool* const line, int32_t* const left, bool* const out, const int64_t z, const int64_t a)
{
    const int64_t up = bounded(rows, 0, z), side = bounded(columns, 0, a);
    memset(left, 0, (size_t)a * sizeof *left);
    bool still = false;  // whether anything of rows before still reaches on
    for (int64_t row = 0; row < z + up; row++) {
        const bool fresh = row < z && any(mask + row * a, a);
        if (fresh) {  // the row, grown along itself
            const bool* const own = mask + row * a;
            memset(line, 0, (size_t)a * sizeof *line);
            for (int64_t j = 0; j < a; j++) {
                if (!own[j]) {
                    continue;
                }
                const int64_t begin = j - side, end = j + side;
                for (int64_t i = closes ? begin : most(begin, 0); i <= (closes ? end : least(end, a - 1)); i++) {
                    line[(i % a + a) % a] = true;
                }
                while (j + 1 < a && own[j + 1]) {  // a run goes on by one cell at a time
                    j++;
                    if (closes || j + side < a) {
                        line[(j + side) % a] = true;
                    }
                }
            }
        }
        if (fresh || still) {
            still = false;
            for (int64_t j = 0; j < a; j++) {
                left[j] = fresh && line[j] ? (int32_t)(2 * up + 1) : left[j] > 0 ? left[j] - 1 : 0;
                still |= left[j] > 0;
            }
        }
        if (row >= up) {
            bool* const to = out + (row - up) * a;
            for (int64_t j = 0; j < a; j++) {
                to[j] = left[j] > 0;
            }
        }
    }
}

// Cells that lie in a box of `rows` by `columns` marked ones; columns close round. held (z, a), run (a,): room.
DOOR void box_opened(const bool* const mask, const int64_t rows, const int64_t columns, bool* const held,
                     int32_t* const run, bool* const out, const int64_t z, const int64_t a)
{
    if (rows < 1 || columns < 1 || columns > a) {
        memset(out, 0, (size_t)(z * a) * sizeof *out);
        return;
    }
    memset(run, 0, (size_t)a * sizeof *run);
    for (int64_t row = 0; row < z; row++) {  // held: a whole box ends in this row and column
        const bool* const own = mask + row * a;
        bool* const ends = held + row * a;
        if (!any(own, a)) {
            memset(ends, 0, (size_t)a * sizeof *ends);
            memset(run, 0, (size_t)a * sizeof *run);
            continue;
        }
        int64_t length = 0;
        for (int64_t j = a - columns + 1; j < a; j++) {
            length = own[j] ? length + 1 : 0;
        }
        for (int64_t j = 0; j < a; j++) {
            length = own[j] ? length + 1 : 0;
            run[j] = length >= columns ? run[j] + 1 : 0;
            ends[j] = run[j] >= rows;
        }
    }
    memset(run, 0, (size_t)a * sizeof *run);
    for (int64_t row = z - 1; row >= 0; row--) {  // from where boxes end back over their rows and columns
        const bool* const ends = held + row * a;
        bool* const to = out + row * a;
        int64_t left = 0;
        for (int64_t j = 0; j < a; j++) {
            run[j] = ends[j] ? (int32_t)least(rows, INT32_MAX) : run[j] > 0 ? run[j] - 1 : 0;
        }
        for (int64_t j = columns - 2; j >= 0; j--) {
            left = run[j] > 0 ? columns : left > 0 ? left - 1 : 0;
        }
        for (int64_t j = a - 1; j >= 0; j--) {
            left = run[j] > 0 ? columns : left > 0 ? left - 1 : 0;
            to[j] = left > 0;
        }
    }
}

// Connected patches (corners count) numbered from 1 as they are met row by row, 0 elsewhere; how many. waiting (z a,):
// room.
DOOR int64_t label_patches(const bool* const mask, int32_t* const waiting, int32_t* const label, const int64_t z,
                           const int64_t a, const int64_t w)
{
    memset(label, 0, (size_t)(z * a) * sizeof *label);
    int32_t count = 0;
    for (int64_t row = 0; row < z; row++) {
        if (!any(mask + row * a, a)) {
            continue;
        }
        for (int64_t begin = row * a; begin < (row + 1) * a; begin++) {
            if (!mask[begin] || label[begin]) {
                continue;
            }
            int64_t size = 0;
            label[begin] = ++count;
            waiting[size++] = (int32_t)begin;
            while (size > 0) {
                const int64_t at = waiting[--size], i = at / a, j = at % a;
                for (int64_t r = most(i - 1, 0); r < least(i + 2, z); r++) {
                    for (int64_t step = -1; step <= 1; step++) {
                        const int64_t beside = r * a + around(j + step, a);
                        if (mask[beside] && !label[beside] && size < w) {
                            label[beside] = count;
                            waiting[size++] = (int32_t)beside;
                        }
                    }
                }
            }
        }
    }
    return count;
}

// Of each marked cell how many lie in its run round the pipe, all of a whole circle; 0 of the others.
DOOR void run_lengths(const bool* const mask, double* const out, const int64_t z, const int64_t a)
{
    memset(out, 0, (size_t)(z * a) * sizeof *out);
    for (int64_t row = 0; row < z; row++) {
        const bool* const own = mask + row * a;
        if (!any(own, a)) {
            continue;
        }
        const bool* const gap = memchr(own, false, (size_t)a);
        const int64_t start = gap ? gap - own : 0;
        for (int64_t begin = 0; begin < a;) {
            int64_t end = begin;
            while (end < a && own[(start + end) % a]) {
                end++;
            }
            for (int64_t i = begin; i < end; i++) {
                out[row * a + (start + i) % a] = (double)(end - begin);
            }
            begin = end + 1;
        }
    }
}
