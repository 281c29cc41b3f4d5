// From transitions of the odometer's two lines to a place, for both boards. Hardware writes every transition into a
// ring; the main loop decodes what has come once a round. What came faster than that was overwritten: it is counted,
// never guessed.

#ifndef ANNULUS_QUADRATURE_H
#define ANNULUS_QUADRATURE_H

#include <stdint.h>

#define QUADRATURE_KEPT 512U        // in the ring
#define QUADRATURE_HELD 448U        // of these, decoded; the rest is room for what comes meanwhile
#define QUADRATURE_AT_ONCE 16U      // decoded before another look: at the fastest, fewer than that room comes meanwhile
#define QUADRATURE_WRAP (1U << 27)  // transitions are counted modulo this, a multiple of the ring: DMA counts no more

typedef struct {
    uint32_t decoded;  // transitions so far, lost ones included
    int32_t position;
    uint32_t lost;        // overwritten before they were decoded
    uint32_t impossible;  // both lines at once, or neither: two went unseen, up or down
    uint8_t state;        // B A after the last one
} quadrature_t;

// From one count of transitions to another that is not older; a negative number of them is a large one.
static inline uint32_t quadrature_between(const uint32_t earlier, const uint32_t later)
{
    return (later - earlier) & (QUADRATURE_WRAP - 1U);
}

// Decode up to a count of transitions; `now` says how many there are by now, and hardware writes on meanwhile. What
// may have been overwritten while it was read is not believed, but lost. The place there.
static inline int32_t quadrature_decode(quadrature_t* const self, const volatile uint8_t* const ring,
                                        const uint32_t until, uint32_t (*const now)(void))
{
    static const int8_t steps[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};  // B A before, B A after
    for (uint32_t written = now();;) {
        const uint32_t behind = quadrature_between(self->decoded, written);
        if (behind > QUADRATURE_HELD) {
            self->lost += behind - QUADRATURE_HELD;
            self->decoded += behind - QUADRATURE_HELD;
            self->state = ring[(self->decoded - 1U) % QUADRATURE_KEPT] & 3U;
        }
        const uint32_t ready = quadrature_between(self->decoded, written);
        uint32_t left = quadrature_between(self->decoded, until);
        left = (left < QUADRATURE_WRAP / 2U) ? left : 0U;  // what was lost went past it
        left = (left < ready) ? left : ready;              // an edge from before the ring was begun anew
        const uint32_t end = self->decoded + ((left < QUADRATURE_AT_ONCE) ? left : QUADRATURE_AT_ONCE);
        int32_t position = self->position;
        uint32_t impossible = self->impossible;
        uint8_t state = self->state;
        for (uint32_t at = self->decoded; at != end; at++) {
            const uint8_t after = ring[at % QUADRATURE_KEPT] & 3U;
            const int32_t step = steps[state * 4U + after];
            position += step;
            impossible += (step == 0) ? 1U : 0U;
            state = after;
        }
        written = now();
        if (quadrature_between(self->decoded, written) >= QUADRATURE_KEPT) {
            continue;  // with what the ring still holds
        }
        *self = (quadrature_t){end, position, self->lost, impossible, state};
        if (left <= QUADRATURE_AT_ONCE) {
            return position;
        }
    }
}

#endif
