// Trains of chips for the microwave gate and its digitizer trigger.

#include <stdlib.h>
#include <string.h>

#include "hardware.h"
#include "../duty.h"

#define TRAIN_STEPS_MAX (CHIPS_MAX + 8U)
#define STARVED_TICKS (BOARD_STARVED_MS * (uint64_t)TICKS_PER_MS)

typedef struct {
    int64_t offset;  // from chip 0
    uint8_t pin;     // 0 = end of the burst
    uint8_t level;
} train_step_t;

static struct {
    bool enabled;
    bool starved;
    bool running;
    bool stopping;
    train_step_t steps[TRAIN_STEPS_MAX];
    size_t step_count;
    size_t step;
    uint64_t chip0;  // of the current burst
    uint32_t period;
    uint16_t repeat;
    uint16_t done;
    uint32_t on_ticks;  // of one burst
    bool charged;       // the current one
} train;

static duty_t owed;

static uint64_t fed;

void microwave_start(void)
{
    memset(&train, 0, sizeof train);
    owed = (duty_t){.owing = board_cause() != BOOT_CAUSE_POWER_ON, .paid_at = BOARD_BURST_OWES_MAX};
}

void board_microwave_feed(void)
{
    time_look();
    fed = world.now;
    duty_run(&owed, time_now());
}

static void end_train(void)
{
    train.running = false;
    pinuse_drive(PIN_MICROWAVE, 0);
    pinuse_drive(PIN_TRIGGER, 0);
    time_wake();
}

// The interlock opened.
void microwave_cut(void)
{
    train.enabled = false;
    end_train();
}

uint64_t microwave_time(void)
{
    return train.running ? train.chip0 + (uint64_t)train.steps[train.step].offset : NEVER;
}

void microwave_step(void)
{
    const train_step_t* const step = &train.steps[train.step++];
    if ((step->pin == PIN_MICROWAVE) && !train.charged) {
        train.charged = true;
        duty_charge(&owed, time_now(), train.on_ticks, MICROWAVE_DUTY_MAX_PERMILLE);
    }
    if (step->pin != 0U) {
        pinuse_drive(step->pin, step->level);
        return;
    }
    train.done++;
    train.step = 0;
    train.charged = false;
    train.chip0 += train.period;
    if (train.stopping || (train.done == train.repeat)) {
        end_train();
    }
}

// The main loop's credit for the microwave is used up.
uint64_t microwave_starving_time(void)
{
    return train.enabled ? fed + STARVED_TICKS : NEVER;
}

void microwave_starve(void)
{
    train.enabled = false;
    train.starved = true;
    end_train();
}

bool board_microwave_starved(void)
{
    time_look();
    const bool starved = train.starved;
    train.starved = false;
    return starved;
}

void board_microwave(const bool enabled)
{
    time_pass();
    train.enabled = enabled && !board_interlock_open();
    if (!enabled) {
        end_train();
    }
}

static int compare_steps(const void* const a, const void* const b)
{
    const int64_t first = ((const train_step_t*)a)->offset;
    const int64_t second = ((const train_step_t*)b)->offset;
    return (first > second) - (first < second);
}

static void add_step(const int64_t offset, const uint8_t pin, const uint8_t level)
{
    train.steps[train.step_count++] = (train_step_t){.offset = offset, .pin = pin, .level = level};
}

board_burst_started_t board_burst(const board_burst_t* const burst, uint32_t* const start)
{
    time_pass();
    if (!train.enabled) {
        return BOARD_BURST_CUT;
    }
    const int64_t trigger = burst->trigger_offset;
    const uint64_t chip0 = world.now + NATIVE_ROUND_TICKS + (uint64_t)((trigger < 0) ? -trigger : 0);
    const uint32_t first_rise = (uint32_t)(chip0 - world.boot_tick) + board_first_on_chip(burst) * burst->chip_ticks;
    const uint32_t on_ticks = board_on_ticks(burst);
    if (world_refuses() || duty_exceeds(on_ticks, burst->period_ticks, MICROWAVE_DUTY_MAX_PERMILLE) ||
        ((on_ticks > 0U) && !duty_allows(&owed, first_rise))) {
        return BOARD_BURST_OVER_LIMIT;
    }
    train.step_count = 0;
    uint8_t level = 0;
    for (uint16_t chip = 0; chip <= burst->length; chip++) {
        const bool on = board_chip(burst, chip);
        if (level != (on ? 1U : 0U)) {
            level = on ? 1U : 0U;
            add_step((int64_t)chip * burst->chip_ticks, PIN_MICROWAVE, level);
        }
    }
    add_step(trigger, PIN_TRIGGER, 1);
    add_step(trigger + TRIGGER_TICKS, PIN_TRIGGER, 0);
    const int64_t chips_end = (int64_t)burst->length * burst->chip_ticks;
    const int64_t trigger_end = trigger + TRIGGER_TICKS;
    qsort(train.steps, train.step_count, sizeof train.steps[0], compare_steps);
    add_step((chips_end > trigger_end) ? chips_end : trigger_end, 0, 0);
    train.step = 0;
    train.done = 0;
    train.repeat = burst->repeat;
    train.period = burst->period_ticks;
    train.running = true;
    train.stopping = false;
    train.on_ticks = on_ticks;
    train.charged = false;
    train.chip0 = chip0;
    *start = (uint32_t)(chip0 - world.boot_tick);
    return BOARD_BURST_STARTED;
}

void board_burst_stop(void)
{
    time_pass();
    const bool in_gap = train.running && (train.done > 0U) && (train.step == 0U);
    train.stopping = true;
    if (in_gap) {
        end_train();
    }
}

bool board_burst_running(uint16_t* const done)
{
    time_look();
    *done = train.done;
    return train.running;
}
