// The sync follower and the lamps.

#include <string.h>

#include "../duty.h"
#include "hardware.h"

#define EDGES_KEPT 8U

static struct {
    board_flash_t loaded;
    bool is_loaded;
    uint64_t refuse_until;
    uint64_t accepted;  // the last edge that was, 0: none yet
    uint32_t holdoff;
    uint32_t refused;
    uint32_t dropped;
    board_edge_t edges[EDGES_KEPT];
    uint32_t transitions[EDGES_KEPT];  // of the odometer, at each edge
    size_t edge_count;
    size_t decoded;  // edges whose odometer is known
    duty_t duty[2];  // of the projector and the LED
    uint8_t pin;     // of the flash being timed, 0 = none
    uint64_t on;
    uint64_t off;
} lamps;

// Slides share one duty: what one of them may be lit, they may be together.
static duty_t* duty_of(const uint8_t lamp)
{
    return &lamps.duty[(lamp == LAMP_LED) ? 1 : 0];
}

void lamps_start(void)
{
    memset(&lamps, 0, sizeof lamps);
    odometer_start();
    const duty_t owed = {.owing = board_cause() != BOOT_CAUSE_POWER_ON, .paid_at = BOARD_FLASH_OWES_MAX};
    lamps.duty[0] = owed;
    lamps.duty[1] = owed;
}

// Edges come from another pin from now on, or triggers from them: a hold-off under way was of what was before.
void lamps_follow(const uint32_t holdoff_ticks)
{
    lamps.refuse_until = world.now;
    lamps.holdoff = (holdoff_ticks != 0U) ? holdoff_ticks : lamps.holdoff;
}

uint64_t lamps_accepted(void)
{
    return lamps.accepted;
}

void lamps_edge(void)
{
    const bool is_full = lamps.edge_count == EDGES_KEPT;
    if ((world.now < lamps.refuse_until) || is_full) {
        lamps.refused++;
        lamps.dropped += is_full ? 1U : 0U;
        return;
    }
    const board_flash_t* const flash = &lamps.loaded;
    board_edge_t* const edge = &lamps.edges[lamps.edge_count];
    *edge = (board_edge_t){.tick = time_now(), .tag = 0};
    lamps.transitions[lamps.edge_count++] = odometer_now();
    if (lamps.pin != 0U) {  // ends with this very tick; board_flash_load let no longer one through
        pinuse_drive(lamps.pin, 0);
        lamps.pin = 0;
    }
    if (lamps.is_loaded) {
        lamps.is_loaded = false;
        edge->tag = flash->tag;
        lamps.holdoff = flash->holdoff_ticks;
        if ((flash->lamp != LAMP_DARK) && (flash->width_ticks > 0U)) {
            lamps.pin = (flash->lamp == LAMP_LED) ? PIN_LED : slide_pin(flash->slide);
            lamps.on = world.now + flash->delay_ticks;
            lamps.off = lamps.on + flash->width_ticks;
            duty_charge(duty_of(flash->lamp), edge->tick + flash->delay_ticks, flash->width_ticks,
                        LAMP_DUTY_MAX_PERMILLE);
        }
    }
    lamps.accepted = world.now;
    lamps.refuse_until = world.now + lamps.holdoff;
}

uint64_t lamps_time(void)
{
    if (lamps.pin == 0U) {
        return NEVER;
    }
    return (pinuse_driven(lamps.pin) == 0U) ? lamps.on : lamps.off;
}

void lamps_step(void)
{
    const uint8_t pin = lamps.pin;
    if (pinuse_driven(pin) == 0U) {
        pinuse_drive(pin, 1);
    } else {
        pinuse_drive(pin, 0);
        lamps.pin = 0;
    }
}

// As on the RP2040; here the hold-off always comes with its flash.
static bool is_allowed(const board_flash_t* const flash)
{
    const uint64_t width = flash->width_ticks;
    return (width <= LAMP_WIDTH_MAX_TICKS) && (flash->delay_ticks + width <= flash->holdoff_ticks) &&
           (width * 1000U <= (uint64_t)LAMP_DUTY_MAX_PERMILLE * flash->holdoff_ticks) && !world_refuses();
}

static bool would_owe(const board_flash_t* const flash)
{
    const uint64_t first_edge = (world.now < lamps.refuse_until) ? lamps.refuse_until : world.now;
    return !duty_allows(duty_of(flash->lamp), (uint32_t)(first_edge - world.boot_tick) + flash->delay_ticks);
}

bool board_flash_load(const board_flash_t* const flash)
{
    time_pass();
    lamps.is_loaded = false;
    if ((flash->lamp != LAMP_DARK) && !is_allowed(flash)) {
        return false;
    }
    if ((flash->lamp != LAMP_DARK) && would_owe(flash)) {
        lamps.holdoff = flash->holdoff_ticks;  // the next edge, which finds nothing, takes it all the same
        return true;
    }
    lamps.loaded = *flash;
    lamps.is_loaded = true;
    return true;
}

void board_lamps_run(void)
{
    time_look();
    for (; lamps.decoded < lamps.edge_count; lamps.decoded++) {
        lamps.edges[lamps.decoded].odometer = odometer_decode(lamps.transitions[lamps.decoded]);
    }
    odometer_decode(odometer_now());
    duty_run(duty_of(LAMP_PROJECTOR), time_now());
    duty_run(duty_of(LAMP_LED), time_now());
}

bool board_edge(board_edge_t* const edge)
{
    time_look();
    if (lamps.decoded == 0U) {
        return false;
    }
    *edge = lamps.edges[0];
    lamps.edge_count--;
    lamps.decoded--;
    memmove(lamps.edges, lamps.edges + 1, lamps.edge_count * sizeof lamps.edges[0]);
    memmove(lamps.transitions, lamps.transitions + 1, lamps.edge_count * sizeof lamps.transitions[0]);
    return true;
}

void board_lamps_cut(void)
{
    time_pass();
    lamps.is_loaded = false;
    lamps.pin = 0;
    pinuse_drive(PIN_LED, 0);
    for (uint8_t slide = 0; slide < SLIDES_MAX; slide++) {
        pinuse_drive(slide_pin(slide), 0);
    }
}

uint32_t board_edges_refused(void)
{
    time_look();
    return lamps.refused;
}

int32_t board_odometer(void)
{
    return odometer_state()->position;
}

void board_health(board_health_t* const health)
{
    *health = (board_health_t){.odometer_lost = odometer_state()->lost,
                               .odometer_impossible = odometer_state()->impossible,
                               .edges_dropped = lamps.dropped,
                               .usb_hangs = 0};
}
