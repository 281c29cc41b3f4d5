// Arithmetic of a tick counter that wraps after 43 s. Two ticks are compared by the sign of their difference, so
// neither may be older than 21 s: whoever keeps a tick for longer forgets it in time, or moves it along.

#ifndef ANNULUS_TICKS_H
#define ANNULUS_TICKS_H

#include <stdbool.h>
#include <stdint.h>

// From `then` to `now`; negative when `then` is still to come, as an edge stamped while a round was under way is.
static inline int32_t ticks_since(const uint32_t now, const uint32_t then)
{
    return (int32_t)(now - then);
}

static inline bool tick_is_past(const uint32_t now, const uint32_t tick)
{
    return ticks_since(now, tick) >= 0;
}

#endif
