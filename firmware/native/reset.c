// Ways to stop: the watchdog, a restart, the boot loader.

#include "hardware.h"

#define WATCHDOG_TICKS (BOARD_WATCHDOG_MS * (uint64_t)TICKS_PER_MS)

static uint64_t kicked;
static bool wanted;

void board_watchdog_kick(void)
{
    time_look();
    kicked = world.now;
}

void board_reset(void)
{
    time_pass();
    wanted = true;
}

uint64_t reset_time(void)
{
    const uint64_t bites = wanted ? world.now : kicked + WATCHDOG_TICKS;
    return world.powered ? bites : NEVER;
}

bool reset_wanted(void)
{
    return wanted;
}

// Everything at rest: what a reset does to the hardware, and what the boot loader is left with.
static void rest(void)
{
    pinuse_start();
    lamps_start();
    microwave_start();
    turntable_start();
    camera_trigger_start();
    measure_start();
    wanted = false;
}

void reset_start(void)
{
    rest();
    kicked = world.now;
}

bool board_bootloader_reachable(void)
{
    return board_connected(LINE_USB);
}

// The main loop never comes back; only power does.
void board_bootloader(void)
{
    rest();
    world.powered = false;
    world.in_bootloader = true;
}
