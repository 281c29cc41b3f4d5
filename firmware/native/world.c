// The world around the board: its time, and the levels it will put on input pins.

#include <string.h>

#include "hardware.h"

#define INPUTS_MAX 65536U

struct world world;

static input_t inputs[INPUTS_MAX];  // binary heap
static size_t input_count;
static uint64_t input_order;

void world_begin(void)
{
    memset(&world, 0, sizeof world);
    input_count = 0;
    input_order = 0;
}

static bool is_before(const input_t* const a, const input_t* const b)
{
    return (a->tick != b->tick) ? a->tick < b->tick : a->order < b->order;
}

static void swap_inputs(const size_t a, const size_t b)
{
    const input_t kept = inputs[a];
    inputs[a] = inputs[b];
    inputs[b] = kept;
}

input_t world_input(void)
{
    const input_t first = inputs[0];
    inputs[0] = inputs[--input_count];
    for (size_t at = 0;;) {
        size_t least = at;
        for (size_t child = 2U * at + 1U; child <= 2U * at + 2U; child++) {
            if ((child < input_count) && is_before(&inputs[child], &inputs[least])) {
                least = child;
            }
        }
        if (least == at) {
            return first;
        }
        swap_inputs(at, least);
        at = least;
    }
}

uint64_t world_input_time(void)
{
    return (input_count > 0U) ? inputs[0].tick : NEVER;
}

bool native_input(const uint64_t tick, const uint8_t pin, const uint8_t level)
{
    const bool is_input = (pin < PIN_COUNT) && (((INPUT_PINS >> pin) & 1U) != 0U);
    if (!is_input || (level > 1U) || (tick < world.now) || (input_count == INPUTS_MAX)) {
        world.lost.inputs++;
        return false;
    }
    size_t at = input_count++;
    inputs[at] = (input_t){.tick = tick, .order = input_order++, .pin = pin, .level = level};
    while ((at > 0U) && is_before(&inputs[at], &inputs[(at - 1U) / 2U])) {
        swap_inputs(at, (at - 1U) / 2U);
        at = (at - 1U) / 2U;
    }
    return true;
}

uint64_t native_tick(void)
{
    return world.now;
}

uint64_t native_boot_tick(void)
{
    return world.boot_tick;
}

bool native_in_bootloader(void)
{
    return world.in_bootloader;
}

void native_refuse_next(void)
{
    world.refuse_next = true;
}

bool world_refuses(void)
{
    const bool refused = world.refuse_next;
    world.refuse_next = false;
    return refused;
}

void native_lost(native_lost_t* const lost)
{
    *lost = world.lost;
}
