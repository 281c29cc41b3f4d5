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

static int32_t direction(void)
{
    return (native_pin(PIN_DIRECTION) == 1U) ? 1 : -1;
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
        motor.position += direction();
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

void board_turntable_pace(const uint32_t period_ticks)
{
    time_pass();
    motor.period = period_ticks;
}

static uint32_t steps_left(void)
{
    const int32_t under_way = (native_pin(PIN_STEP) == 1U) ? 1 : 0;
    return motor.moving ? (uint32_t)((motor.target - motor.position) * direction() - under_way) : 0U;
}

uint32_t board_turntable_left(void)
{
    time_look();
    return steps_left();
}

uint32_t board_turntable_shorten(const uint32_t steps)
{
    time_pass();
    const uint32_t left = steps_left();
    const uint32_t taken = (left > steps) ? left - steps : 0U;
    motor.target -= (int32_t)taken * direction();
    return taken;
}

void board_turntable_cut(void)
{
    time_pass();
    if (native_pin(PIN_STEP) == 1U) {
        motor.position += direction();
    }
    motor.moving = false;
    pinuse_drive(PIN_STEP, 0);
    pinuse_drive(PIN_ENABLE, 1);
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
