// The sync follower, the lamps and the odometer.

#include <string.h>

#include "hardware.h"

#define EDGES_KEPT 8U

static struct {
    board_flash_t loaded;
    bool is_loaded;
    uint64_t refuse_until;
    uint32_t holdoff;
    uint32_t refused;
    board_edge_t edges[EDGES_KEPT];
    size_t edge_count;
    uint8_t pin;  // of the flash being timed, 0 = none
    uint64_t on;
    uint64_t off;
} lamps;

static uint8_t quadrature;
static int32_t odometer;

static uint8_t quadrature_now(void)
{
    return (uint8_t)(native_pin(PIN_ODOMETER_A) * 2U + native_pin(PIN_ODOMETER_B));
}

void lamps_start(void)
{
    memset(&lamps, 0, sizeof lamps);
    quadrature = quadrature_now();
    odometer = 0;
}

void lamps_edge(void)
{
    const bool is_full = lamps.edge_count == EDGES_KEPT;
    if ((world.now < lamps.refuse_until) || is_full) {
        lamps.refused++;
        return;
    }
    const board_flash_t* const flash = &lamps.loaded;
    board_edge_t* const edge = &lamps.edges[lamps.edge_count++];
    *edge = (board_edge_t){.tick = time_now(), .tag = 0, .odometer = odometer};
    if (lamps.pin != 0U) {  // ends with this very tick; board_flash_load let no longer one through
        pinuse_drive(lamps.pin, 0);
        lamps.pin = 0;
    }
    if (lamps.is_loaded) {
        lamps.is_loaded = false;
        edge->tag = flash->tag;
        lamps.holdoff = flash->holdoff_ticks;
        if ((flash->lamp != LAMP_DARK) && (flash->width_ticks > 0U)) {
            lamps.pin = (flash->lamp == LAMP_LED) ? PIN_LED : PIN_PROJECTOR;
            lamps.on = world.now + flash->delay_ticks;
            lamps.off = lamps.on + flash->width_ticks;
        }
    }
    lamps.refuse_until = world.now + lamps.holdoff;
}

// Steps of A, B as a Gray code: +1 when A leads. A jump of two says nothing and counts nothing.
static int32_t quadrature_step(const uint8_t before, const uint8_t after)
{
    static const int8_t steps[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};
    return steps[before * 4U + after];
}

void lamps_odometer(void)
{
    const uint8_t before = quadrature;
    quadrature = quadrature_now();
    odometer += quadrature_step(before, quadrature);
}

uint64_t lamps_time(void)
{
    if (lamps.pin == 0U) {
        return NEVER;
    }
    return (native_pin(lamps.pin) == 0U) ? lamps.on : lamps.off;
}

void lamps_step(void)
{
    const uint8_t pin = lamps.pin;
    if (native_pin(pin) == 0U) {
        pinuse_drive(pin, 1);
    } else {
        pinuse_drive(pin, 0);
        lamps.pin = 0;
    }
}

bool board_flash_load(const board_flash_t* const flash)
{
    time_pass();
    lamps.is_loaded = false;
    const bool lit = flash->lamp != LAMP_DARK;
    const bool outlasts = (uint64_t)flash->delay_ticks + flash->width_ticks > flash->holdoff_ticks;
    if (lit && ((flash->width_ticks > LAMP_WIDTH_MAX_TICKS) || outlasts || world_refuses())) {
        return false;
    }
    lamps.loaded = *flash;
    lamps.is_loaded = true;
    return true;
}

bool board_edge(board_edge_t* const edge)
{
    time_look();
    if (lamps.edge_count == 0U) {
        return false;
    }
    *edge = lamps.edges[0];
    lamps.edge_count--;
    memmove(lamps.edges, lamps.edges + 1, lamps.edge_count * sizeof *edge);
    return true;
}

void board_lamps_cut(void)
{
    time_pass();
    lamps.is_loaded = false;
    lamps.pin = 0;
    pinuse_drive(PIN_PROJECTOR, 0);
    pinuse_drive(PIN_LED, 0);
}

uint32_t board_edges_refused(void)
{
    time_look();
    return lamps.refused;
}

int32_t board_odometer(void)
{
    time_look();
    return odometer;
}
