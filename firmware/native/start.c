// The core on this board, from power-on through its main loop: time jumps from one thing that happens to the next, so
// an hour of scanning costs what its edges and bytes cost.
//
// Stands for the RP2040's PIO, DMA, UART and watchdog as board.h promises them, without input synchronisers: an output
// follows its edge by exactly the loaded delay.

#include "../core/controller.h"
#include "hardware.h"

static controller_t controller;

void native_begin(void)
{
    world_begin();
    pinuse_begin();
    lines_begin();
}

void native_power_on(const uint8_t boot, const uint8_t cause)
{
    world.in_bootloader = false;
    world.refuse_next = false;
    world.powered = true;
    identity_start(boot, cause);
    reset_start();
    lines_start();
    time_start();
    controller_start(&controller);
}

static void apply_input(void)
{
    const input_t input = world_input();
    if (!pinuse_input(input.pin, input.level) || !world.powered) {
        return;
    }
    if ((input.pin == PIN_ODOMETER_A) || (input.pin == PIN_ODOMETER_B)) {
        lamps_odometer();
    }
    if ((input.pin == PIN_SYNC) && (input.level == 0U)) {
        lamps_edge();
        time_wake();
    }
    if ((input.pin == PIN_INTERLOCK) && (input.level == 1U)) {
        microwave_cut();
    }
}

static void round_of_cpu(void)
{
    time_begin_round();
    controller_run(&controller);
    if (reset_wanted()) {
        native_power_on((uint8_t)(board_boot() + 1U), BOOT_CAUSE_HOST_RESET);
    } else if (lines_waiting()) {
        time_wake();
    }
}

static void watchdog_bites(void)
{
    native_power_on((uint8_t)(board_boot() + 1U), BOOT_CAUSE_WATCHDOG);
}

// What happens when. At one tick: hardware before the main loop.
static const struct {
    uint64_t (*time)(void);
    void (*step)(void);
} sources[] = {
    {world_input_time, apply_input},  {lamps_time, lamps_step},     {microwave_time, microwave_step},
    {turntable_time, turntable_step}, {lines_time, lines_step},     {microwave_starving_time, microwave_starve},
    {time_of_round, round_of_cpu},    {reset_time, watchdog_bites},
};

void native_run_until(const uint64_t tick)
{
    for (;;) {
        size_t first = 0;
        uint64_t next = NEVER;
        for (size_t source = 0; source < sizeof sources / sizeof sources[0]; source++) {
            const uint64_t time = sources[source].time();
            if (time < next) {
                first = source;
                next = time;
            }
        }
        if (next > tick) {
            break;
        }
        world.now = (next > world.now) ? next : world.now;
        sources[first].step();
    }
    world.now = (tick > world.now) ? tick : world.now;
}
