// The core on this board, from power-on through its main loop: time jumps from one thing that happens to the next, so
// an hour of scanning costs what its edges and bytes cost.
//
// Stands for the RP2040's PIO, DMA, UART and watchdog as board.h promises them, without input synchronisers: an output
// follows its edge by exactly the loaded delay.

#include "../core/controller.h"
#include "hardware.h"

static controller_t controller;

static void run_round(void);
static uint64_t next_time(void);

void native_begin(void)
{
    world_begin();
    identity_begin();
    native_seed(0);
    pinuse_begin();
    lines_begin();
}

void native_power_on(const uint8_t boot, const uint8_t cause)
{
    world.in_bootloader = false;
    world.refuse_next = false;
    world.powered = true;
    identity_start(boot, cause);
    crash_start();
    reset_start();
    lines_start();
    time_start(run_round, next_time);
    controller_start(&controller);
}

static void apply_input(void)
{
    const input_t input = world_input();
    if (!pinuse_input(input.pin, input.level) || !world.powered) {
        return;
    }
    if ((input.pin == PIN_ODOMETER_A) || (input.pin == PIN_ODOMETER_B)) {
        odometer_input();
    }
    if ((input.pin == PIN_SYNC) && (pinuse_seen(PIN_SYNC) == 0U) && !camera_trigger_leads()) {
        lamps_edge();
        time_wake();
    }
    if (pinuse_opens_interlock(input.pin, input.level)) {
        microwave_cut();
        time_wake();
    }
    if ((input.pin == PIN_END_LOW) || (input.pin == PIN_END_HIGH)) {
        time_wake();
    }
}

static void run_round(void)
{
    controller_run(&controller);
    if (lines_waiting()) {
        time_wake();
    }
}

static void restart(void)
{
    native_power_on((uint8_t)(board_boot() + 1U), reset_wanted() ? BOOT_CAUSE_HOST_RESET : BOOT_CAUSE_WATCHDOG);
}

// What happens by itself. At one tick: all of it before the main loop.
static const struct {
    uint64_t (*time)(void);
    void (*step)(void);
} sources[] = {
    {world_input_time, apply_input},
    {lamps_time, lamps_step},
    {camera_trigger_time, camera_trigger_step},
    {microwave_time, microwave_step},
    {turntable_time, turntable_step},
    {lines_time, lines_step},
    {microwave_starving_time, microwave_starve},
    {reset_time, restart},
};

#define SOURCES (sizeof sources / sizeof sources[0])

static size_t next_source(uint64_t* const time)
{
    size_t first = 0;
    *time = NEVER;
    for (size_t source = 0; source < SOURCES; source++) {
        const uint64_t its = sources[source].time();
        if (its < *time) {
            first = source;
            *time = its;
        }
    }
    return first;
}

static uint64_t next_time(void)
{
    uint64_t time;
    next_source(&time);
    return time;
}

void native_run_until(const uint64_t tick)
{
    world.until = tick;
    for (;;) {
        uint64_t next;
        const size_t source = next_source(&next);
        const uint64_t round = time_of_round();
        const uint64_t first = (round < next) ? round : next;
        if (first > tick) {
            break;
        }
        world.now = (first > world.now) ? first : world.now;
        if (round < next) {
            time_step();
        } else {
            sources[source].step();
        }
    }
    world.now = (tick > world.now) ? tick : world.now;
}
