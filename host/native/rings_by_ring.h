// Slits listed ring by ring: whoever asks something of each ring goes through them once, and not once for every ring.
#ifndef ANNULUS_RINGS_BY_RING_H
#define ANNULUS_RINGS_BY_RING_H

#include <string.h>

#include "native.h"

#define RINGS_MOST 64  // of a pattern: more than any slide has; a slit of any more is of none

typedef struct {
    uint64_t rings;                 // how many there are
    int64_t first[RINGS_MOST + 1];  // where each ring's begin; those of the last end where the next would begin
    int64_t next[RINGS_MOST + 1];   // where its next one goes
} by_ring_t;

// Where in the list a slit of that ring goes; of no ring, or one that there is not, behind the list's end, where there
// must be room for one more.
INLINE int64_t place_in(by_ring_t* const list, const int64_t ring)
{
    return (uint64_t)ring < list->rings ? list->next[ring]++ : list->first[RINGS_MOST];
}

// rings (n,): of all slits, less than 0 where it is none; k: how many there are. Listed are the first `size`, or those
// that `which` (size,) says.
INLINE by_ring_t by_ring(const int64_t* const rings, const int64_t n, const int64_t* const which, const int64_t size,
                         const int64_t k)
{
    by_ring_t out = {.rings = (uint64_t)least(k, RINGS_MOST)};
    int64_t counted[RINGS_MOST + 1] = {0};
    for (int64_t s = 0; s < size; s++) {
        const int64_t ring = rings[which == NULL ? s : bounded(which[s], 0, n - 1)];
        counted[(uint64_t)ring < out.rings ? ring : RINGS_MOST]++;
    }
    for (int r = 0; r < RINGS_MOST; r++) {
        out.first[r + 1] = out.first[r] + counted[r];
    }
    memcpy(out.next, out.first, sizeof out.next);
    return out;
}

#endif
