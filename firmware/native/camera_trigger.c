// Triggers for cameras, whose ends are sync edges.

#include <string.h>

#include "hardware.h"

static struct {
    uint32_t period;
    uint32_t width;  // 0: none runs
    uint64_t next;   // it rises, or falls
} camera;

void camera_trigger_start(void)
{
    memset(&camera, 0, sizeof camera);
}

bool camera_trigger_runs(void)
{
    return camera.width != 0U;
}

uint64_t camera_trigger_time(void)
{
    return camera_trigger_runs() ? camera.next : NEVER;
}

void camera_trigger_step(void)
{
    const uint8_t level = (pinuse_driven(PIN_CAMERA_TRIGGER) == 0U) ? 1U : 0U;
    pinuse_drive(PIN_CAMERA_TRIGGER, level);
    camera.next += (level == 1U) ? camera.width : camera.period - camera.width;
    if (level == 0U) {
        lamps_edge();
        time_wake();
    }
}

void board_camera_trigger(const uint32_t period_ticks, const uint32_t width_ticks)
{
    time_pass();
    if ((camera.width == width_ticks) && ((width_ticks == 0U) || (camera.period == period_ticks))) {
        return;
    }
    pinuse_drive(PIN_CAMERA_TRIGGER, 0);
    lamps_follow();
    camera.period = period_ticks;
    camera.width = width_ticks;
    camera.next = world.now;
}
