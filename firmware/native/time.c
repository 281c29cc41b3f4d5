// The controller's clock and its main loop: when that comes round, and the time it takes. The loop is a coroutine.
// Whatever the core asks of the board takes some time, and where the world does something meanwhile, or
// native_run_until ends, the loop is left right there, between two statements of the core; it goes on when its time has
// come. So an edge may fall anywhere in a round, as it does on a Pico.

#include <ucontext.h>

#include "hardware.h"

#define CALL_LEAST_TICKS 20U  // what one call of the board stands for: 0.2 to 0.8 us of the core's work,
#define CALL_SPREAD_TICKS 64U
#define MISS_TICKS 500U  // and now and then 5 us, for code that was not in the flash's cache
#define MISS_ONE_IN 16U
#define STACK_BYTES 262144U

static uint64_t next_round;
static uint64_t stalled_from;
static uint64_t stalled_until;

static struct {
    void (*round)(void);
    uint64_t (*next_time)(void);
    ucontext_t world;
    ucontext_t context;
    uint8_t stack[STACK_BYTES];
    bool inside;      // a round has begun and not ended
    bool running;     // and is being run this moment
    uint64_t resume;  // when it goes on
    uint64_t due;     // the world does nothing before this
    bool acted;       // unless the core had it do something in this round
    uint32_t random;
} loop;

uint32_t time_now(void)
{
    return (uint32_t)(world.now - world.boot_tick);
}

uint32_t board_tick(void)
{
    time_look();
    return time_now();
}

void native_seed(const uint32_t seed)
{
    loop.random = seed;
}

// The loop goes on at this tick: at once, or when the world has done what comes first.
static void go_on_at(const uint64_t tick)
{
    loop.resume = tick;
    if (loop.acted || (tick >= loop.due)) {
        loop.due = loop.next_time();
    }
    if ((tick < loop.due) && (tick <= world.until) && world.powered) {
        world.now = (tick > world.now) ? tick : world.now;
    } else {
        swapcontext(&loop.context, &loop.world);
    }
}

static void rounds(void)
{
    for (;;) {
        loop.inside = true;
        next_round = world.now + NATIVE_ROUND_TICKS;
        const uint64_t began = (stalled_from != NEVER) ? stalled_from : world.now;
        loop.round();
        crash_measure(began);
        stalled_from = NEVER;
        loop.inside = false;
        go_on_at(next_round);
        loop.acted = false;
    }
}

// A round under way is never ended: its stack is begun anew.
void time_start(void (*const round)(void), uint64_t (*const next_time)(void))
{
    loop.round = round;
    loop.next_time = next_time;
    world.boot_tick = world.now;
    next_round = world.now;
    stalled_from = NEVER;
    stalled_until = 0;
    loop.inside = false;
    getcontext(&loop.context);
    loop.context.uc_stack.ss_sp = loop.stack;
    loop.context.uc_stack.ss_size = sizeof loop.stack;
    loop.context.uc_link = NULL;
    makecontext(&loop.context, rounds, 0);
}

static uint32_t call_ticks(void)
{
    loop.random = loop.random * 1664525U + 1013904223U;
    const uint32_t ticks = CALL_LEAST_TICKS + (loop.random >> 16) % CALL_SPREAD_TICKS;
    return (((loop.random >> 24) % MISS_ONE_IN) == 0U) ? ticks + MISS_TICKS : ticks;
}

void time_look(void)
{
    if (loop.running) {  // else it is the world's own doing
        go_on_at(world.now + call_ticks());
    }
}

void time_pass(void)
{
    time_look();
    loop.acted = true;
}

// The main loop sees what just happened a moment later.
void time_wake(void)
{
    const uint64_t soon = world.now + NATIVE_LATENCY_TICKS;
    if (soon < next_round) {
        next_round = (soon > stalled_until) ? soon : stalled_until;
    }
}

void time_step(void)
{
    loop.running = true;
    loop.due = 0;
    swapcontext(&loop.world, &loop.context);
    loop.running = false;
}

uint64_t time_of_round(void)
{
    return !world.powered ? NEVER : loop.inside ? loop.resume : next_round;
}

void native_stall_cpu(const uint64_t ticks)
{
    stalled_from = world.now;
    stalled_until = world.now + ticks;
    if (next_round < stalled_until) {
        next_round = stalled_until;
    }
    if (loop.resume < stalled_until) {
        loop.resume = stalled_until;
    }
}
