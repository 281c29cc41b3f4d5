// What lies in each cell, laid out cell by cell in the order in which it came: a counting sort.
#ifndef ANNULUS_BY_CELL_H
#define ANNULUS_BY_CELL_H

#include <string.h>

#include "native.h"

// Where those of each of c cells, at least one, begin: next (c,), of cell (n,). Who lays them out counts on from there,
// and then it is where each cell's end.
INLINE void begin_cells(const int64_t* const cell, int64_t* const next, const int64_t n, const int64_t c)
{
    memset(next, 0, (size_t)c * sizeof *next);
    for (int64_t i = 0; i < n; i++) {
        next[bounded(cell[i], 0, c - 1)]++;
    }
    int64_t begin = 0;
    for (int64_t i = 0; i < c; i++) {
        const int64_t size = next[i];
        next[i] = begin;
        begin += size;
    }
}

#endif
