// The best alignment of one line's candidates with the rings, in order.
#ifndef ANNULUS_RINGS_CHOOSE_H
#define ANNULUS_RINGS_CHOOSE_H

#include "native.h"

// A ring is given only where every other reading is worse by `margin`. slit, name, own (worth, above 0): of `size`
// candidates, sorted by slit, then name; ahead, behind: room to work in. Written: ring, by slit.
static inline void choose(const int64_t* const slit, const int64_t* const name, const double* const own,
                          double* const ahead, double* const behind, const int64_t size, const double margin,
                          int64_t* const ring)
{
    // Nearly every line: each slit may be one ring, in order, and nothing speaks against any.
    bool plain = true;
    for (int64_t c = 1; c < size; c++) {
        plain &= (slit[c] > slit[c - 1]) & (name[c] > name[c - 1]);
    }
    if (plain) {
        for (int64_t c = 0; c < size; c++) {
            ring[slit[c]] = name[c];
        }
        return;
    }
    for (int64_t c = 0; c < size; c++) {  // the best alignment up to and with this candidate
        double best = 0.0;
        for (int64_t p = 0; p < c; p++) {
            const bool before = (slit[p] < slit[c]) & (name[p] < name[c]);
            best = before && ahead[p] > best ? ahead[p] : best;
        }
        ahead[c] = best + own[c];
    }
    for (int64_t c = size - 1; c >= 0; c--) {  // the best after it
        double best = 0.0;
        for (int64_t p = c + 1; p < size; p++) {
            const bool after = (slit[p] > slit[c]) & (name[p] > name[c]);
            const double worth = behind[p] + own[p];
            best = after && worth > best ? worth : best;
        }
        behind[c] = best;
    }
    double best = 0.0;
    for (int64_t c = 0; c < size; c++) {
        const double total = ahead[c] + behind[c];
        best = total > best ? total : best;
    }
    for (int64_t c = 0; c < size; c++) {
        const double total = ahead[c] + behind[c];
        if (total < best - 1e-9 || total <= 0.0) {
            continue;
        }
        bool alone = true;
        for (int64_t p = 0; p < size; p++) {
            const bool other = (p != c) & ((slit[p] == slit[c]) | (name[p] == name[c]));
            alone &= !(other & (ahead[p] + behind[p] > total - margin));
        }
        if (alone) {
            ring[slit[c]] = name[c];
        }
    }
}

#endif
