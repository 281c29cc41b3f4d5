// Steps for the turntable.

#include <string.h>

#include "hardware.h"

static struct {
    int32_t position;
    int32_t target;
    uint32_t period;
    bool hold;
    bool moving;
    uint64_t next;
} motor;

void turntable_start(void)
{
    memset(&motor, 0, sizeof motor);
}

uint64_t turntable_time(void)
{
    return motor.moving ? motor.next : NEVER;
}

void turntable_step(void)
{
    if (motor.position == motor.target) {
        motor.moving = false;
        pinuse_drive(PIN_ENABLE, motor.hold ? 0 : 1);
        time_wake();
        return;
    }
    if (native_pin(PIN_STEP) == 0U) {
        pinuse_drive(PIN_STEP, 1);
        motor.next += motor.period / 2U;
    } else {
        pinuse_drive(PIN_STEP, 0);
        motor.position += (native_pin(PIN_DIRECTION) == 1U) ? 1 : -1;
        motor.next += motor.period - motor.period / 2U;
    }
}

void board_turntable_move(const int32_t position, const uint32_t period_ticks, const bool hold)
{
    time_pass();
    motor.target = position;
    motor.period = period_ticks;
    motor.hold = hold;
    motor.moving = true;
    motor.next = world.now + period_ticks;  // the driver wants direction and power some time before the first step
    pinuse_drive(PIN_DIRECTION, (position >= motor.position) ? 1 : 0);
    pinuse_drive(PIN_ENABLE, 0);
}

bool board_turntable_moving(void)
{
    time_look();
    return motor.moving;
}

int32_t board_turntable_position(void)
{
    time_look();
    return motor.position;
}
