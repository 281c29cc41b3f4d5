// The controller's clock, and when its main loop comes round.

#include "hardware.h"

static uint64_t next_round;
static uint64_t stalled_until;

uint32_t board_tick(void)
{
    return (uint32_t)(world.now - world.boot_tick);
}

void time_start(void)
{
    world.boot_tick = world.now;
    next_round = world.now;
    stalled_until = 0;
}

// The main loop sees what just happened a moment later.
void time_wake(void)
{
    const uint64_t soon = world.now + NATIVE_LATENCY_TICKS;
    if (soon < next_round) {
        next_round = (soon > stalled_until) ? soon : stalled_until;
    }
}

void time_begin_round(void)
{
    next_round = world.now + NATIVE_ROUND_TICKS;
}

uint64_t time_of_round(void)
{
    return world.powered ? next_round : NEVER;
}

void native_stall_cpu(const uint64_t ticks)
{
    stalled_until = world.now + ticks;
    if (next_round < stalled_until) {
        next_round = stalled_until;
    }
}
