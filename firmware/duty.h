// The duty limit of one output, kept over time: whoever lets it shine for a while owes the dark that goes with it
// before it may shine again, whatever was configured and whoever asked. So, from the beginning of any on-time on and
// over any span, the output is on for its duty's share and one on-time more, never longer. Both boards count with this.

#ifndef ANNULUS_DUTY_H
#define ANNULUS_DUTY_H

#include <stdbool.h>
#include <stdint.h>

#include "ticks.h"

typedef struct {
    bool owing;
    uint32_t paid_at;  // tick from which on nothing is owed; meaningful while owing
} duty_t;

// On for `on_ticks` from `start` on, `permille` being the limit. Never more than 20 s' worth at once.
static inline void duty_charge(duty_t* const self, const uint32_t start, const uint32_t on_ticks,
                               const uint32_t permille)
{
    if (on_ticks > 0U) {
        const uint32_t from = (self->owing && !tick_is_past(start, self->paid_at)) ? self->paid_at : start;
        self->owing = true;
        self->paid_at = from + (uint32_t)(((uint64_t)on_ticks * 1000U + permille - 1U) / permille);
    }
}

// Is so much of a period over the limit already by itself?
static inline bool duty_exceeds(const uint32_t on_ticks, const uint32_t period_ticks, const uint32_t permille)
{
    return (uint64_t)on_ticks * 1000U > (uint64_t)permille * period_ticks;
}

// May it go on again at this tick?
static inline bool duty_allows(const duty_t* const self, const uint32_t at)
{
    return !self->owing || tick_is_past(at, self->paid_at);
}

// Once a round: what is paid is forgotten, long before the tick counter comes round to it again.
static inline void duty_run(duty_t* const self, const uint32_t now)
{
    self->owing = self->owing && !tick_is_past(now, self->paid_at);
}

#endif
