// The odometer: every transition of its two lines goes into a ring, as the RP2040's DMA does it.

#include <string.h>

#include "hardware.h"

static uint8_t ring[QUADRATURE_KEPT];
static uint32_t written;
static uint64_t last;  // world tick of the last transition
static quadrature_t odometer;

static uint8_t lines_now(void)
{
    return (uint8_t)(world.levels[PIN_ODOMETER_B] * 2U + world.levels[PIN_ODOMETER_A]);
}

void odometer_start(void)
{
    memset(&odometer, 0, sizeof odometer);
    odometer.state = lines_now();
    written = 0;
    last = 0;
}

// Lines that change in the same tick change at once.
void odometer_input(void)
{
    if (measure_is_measuring()) {  // on the Pico that takes the odometer's machine and DMA
        odometer_decode(odometer_now());
        odometer.state = lines_now();
        return;
    }
    const bool at_once = (last == world.now) && (odometer_now() != odometer.decoded);
    written -= at_once ? 1U : 0U;
    ring[written++ % QUADRATURE_KEPT] = lines_now();
    last = world.now;
}

uint32_t odometer_now(void)
{
    return written % QUADRATURE_WRAP;
}

int32_t odometer_decode(const uint32_t until)
{
    return quadrature_decode(&odometer, ring, until, odometer_now);
}

const quadrature_t* odometer_state(void)
{
    return &odometer;
}
