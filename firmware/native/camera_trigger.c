// Triggers for cameras: of a clock of their own, whose ends are sync edges, or begun by edges of the sync input.

#include <string.h>

#include "hardware.h"

static struct {
    board_trigger_t trigger;
    uint64_t next;    // it rises, or falls
    uint64_t served;  // the last edge that began one, or could not
} camera;

void camera_trigger_start(void)
{
    memset(&camera, 0, sizeof camera);
}

bool camera_trigger_leads(void)
{
    return (camera.trigger.width_ticks != 0U) && (camera.trigger.delay_ticks == 0U);
}

static bool is_high(void)
{
    return pinuse_driven(PIN_CAMERA_TRIGGER) != 0U;
}

uint64_t camera_trigger_time(void)
{
    if (camera.trigger.width_ticks == 0U) {
        return NEVER;
    }
    if ((camera.trigger.delay_ticks == 0U) || is_high()) {
        return camera.next;
    }
    const uint64_t edge = lamps_accepted();
    return (edge > camera.served) ? edge + camera.trigger.delay_ticks : NEVER;
}

void camera_trigger_step(void)
{
    const bool rises = !is_high();
    pinuse_drive(PIN_CAMERA_TRIGGER, rises ? 1U : 0U);
    if (rises) {
        camera.served = lamps_accepted();
        camera.next = world.now + camera.trigger.width_ticks;
    } else if (camera_trigger_leads()) {
        camera.next = world.now + camera.trigger.period_ticks - camera.trigger.width_ticks;
        lamps_edge();
        time_wake();
    }
}

void board_camera_trigger(const board_trigger_t* const trigger)
{
    time_pass();
    const bool same = (camera.trigger.width_ticks == trigger->width_ticks) &&
                      (camera.trigger.delay_ticks == trigger->delay_ticks) &&
                      ((trigger->delay_ticks != 0U) || (camera.trigger.period_ticks == trigger->period_ticks));
    if (same || ((trigger->width_ticks == 0U) && (camera.trigger.width_ticks == 0U))) {
        return;
    }
    pinuse_drive(PIN_CAMERA_TRIGGER, 0);
    lamps_follow((trigger->delay_ticks != 0U) ? trigger->delay_ticks + trigger->width_ticks + CAMERA_TRIGGER_MIN_TICKS
                                              : 0U);
    camera.trigger = *trigger;
    camera.next = world.now;
    camera.served = lamps_accepted();
}
