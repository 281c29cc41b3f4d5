// What a crash leaves behind: here the main loop can only stand still, and there is no processor to ask where.

#include <string.h>

#include "../core/count.h"
#include "hardware.h"

static board_trail_t trail;
static board_crash_t crash;

void crash_start(void)
{
    if (board_cause() == BOOT_CAUSE_POWER_ON) {
        memset(&crash, 0, sizeof crash);
    }
    if (board_cause() == BOOT_CAUSE_WATCHDOG) {
        count_one_more(&crash.crashes);
        crash.boot = crash.boots;
        crash.kind = CRASH_STUCK;
        crash.trail = trail;
    }
    count_one_more(&crash.boots);
    trail = (board_trail_t){.part = PART_START, .command = BOARD_NO_COMMAND};
}

void crash_measure(const uint64_t since)
{
    const uint32_t took = (uint32_t)(world.now - since);
    trail.longest = (took > trail.longest) ? took : trail.longest;
}

board_trail_t* board_trail(void)
{
    return &trail;
}

const board_crash_t* board_crash(void)
{
    return &crash;
}
