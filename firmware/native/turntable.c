// Steps for the turntable.

#include <string.h>

#include "hardware.h"

static struct {
    int32_t position;
    int32_t target;
    uint32_t period;
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
    if (motor.position != motor.target) {
        const bool rises = native_pin(PIN_STEP) == 0U;
        pinuse_drive(PIN_STEP, rises ? 1 : 0);
        motor.position += rises ? 0 : direction();
        motor.next += rises ? motor.period / 2U : motor.period - motor.period / 2U;
    }
    if (motor.position == motor.target) {
        motor.moving = false;
        time_wake();
    }
}

void board_turntable_power(const bool on)
{
    time_pass();
    pinuse_drive(PIN_ENABLE, on ? 0 : 1);
}

void board_turntable_move(const int32_t position, const uint32_t period_ticks, const uint32_t wait_ticks)
{
    time_pass();
    const uint32_t half_period = period_ticks / 2U;
    motor.target = position;
    motor.period = period_ticks;
    motor.moving = position != motor.position;
    motor.next = world.now + ((wait_ticks > half_period) ? wait_ticks : half_period);
    pinuse_drive(PIN_DIRECTION, (position >= motor.position) ? 1 : 0);
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
    motor.moving = motor.moving && (motor.target != motor.position);
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
