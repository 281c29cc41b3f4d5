// What the files of this folder know of each other; they bear the names of ../rp2040's. Each keeps its own state, and
// tells by `_time` when it will next do something by itself, which `_step` then does.

#ifndef ANNULUS_NATIVE_HARDWARE_H
#define ANNULUS_NATIVE_HARDWARE_H

#include "../board.h"
#include "../core/messages.h"
#include "../quadrature.h"
#include "native.h"

#define NEVER UINT64_MAX

// The lamp's output of a slide, from 0.
static inline uint8_t slide_pin(const uint8_t slide)
{
    return (slide == 0U) ? PIN_PROJECTOR : (uint8_t)(PIN_SLIDE_2 + slide - 1U);
}

// What all share.
extern struct world {
    uint64_t now;
    uint64_t until;  // end of native_run_until, nothing happens after it
    uint64_t boot_tick;
    uint8_t levels[PIN_COUNT];  // of the pins; only pinuse.c changes them
    uint8_t inverted;           // POLARITY_*; only pinuse.c changes it
    bool powered;
    bool in_bootloader;
    bool refuse_next;
    native_lost_t lost;
} world;

typedef struct {
    uint64_t tick;
    uint64_t order;  // of scheduling, breaks ties
    uint8_t pin;
    uint8_t level;
} input_t;

// Levels somebody scheduled, in order.
void world_begin(void);
uint64_t world_input_time(void);
input_t world_input(void);
bool world_refuses(void);  // the next lit flash or burst, once

// The main loop: when its next round is or the one under way goes on, and what brings it forward.
void time_start(void (*round)(void), uint64_t (*next_time)(void));  // one round of the core; when the world acts next
void time_wake(void);
uint64_t time_of_round(void);
void time_step(void);
void time_pass(void);     // first in every function of board.h: the time it takes
void time_look(void);     // the same, cheaper, in one that only looks: after it the world acts no sooner than before
uint32_t time_now(void);  // the controller's tick, for this folder: takes nothing

void pinuse_begin(void);
void pinuse_start(void);
void pinuse_drive(uint8_t pin, uint8_t level);  // as if no pin were inverted
void pinuse_polarity(uint8_t pins, uint8_t inverted);
uint8_t pinuse_driven(uint8_t pin);             // how it was last driven
uint8_t pinuse_seen(uint8_t pin);               // an input as the controller sees it
bool pinuse_input(uint8_t pin, uint8_t level);  // did it change?
bool pinuse_opens_interlock(uint8_t pin, uint8_t level);

void identity_begin(void);
void identity_start(uint8_t boot, uint8_t cause);

void crash_start(void);
void crash_measure(uint64_t since);  // the round that began then is over

void reset_start(void);
uint64_t reset_time(void);  // the core wants it, or the watchdog bites
bool reset_wanted(void);

void lines_begin(void);
void lines_start(void);
bool lines_waiting(void);
uint64_t lines_time(void);
void lines_step(void);

void lamps_start(void);
void lamps_follow(uint32_t holdoff_ticks);  // 0: as it was
uint64_t lamps_accepted(void);              // world tick of the last edge that was; 0: none yet
void lamps_edge(void);
uint64_t lamps_time(void);
void lamps_step(void);

// Transitions so far, and where the odometer stands after so many.
void odometer_start(void);
void odometer_input(void);
uint32_t odometer_now(void);
int32_t odometer_decode(uint32_t until);
const quadrature_t* odometer_state(void);

void microwave_start(void);
void microwave_cut(void);
uint64_t microwave_time(void);
void microwave_step(void);
uint64_t microwave_starving_time(void);
void microwave_starve(void);

void measure_start(void);
bool measure_is_measuring(void);                 // as board_measuring, for this folder: takes nothing
void measure_before(void);                       // any pin changes its level
void measure_after(uint8_t pin, uint8_t level);  // this one did

void camera_trigger_start(void);
bool camera_trigger_leads(void);  // the sync input is nobody's
uint64_t camera_trigger_time(void);
void camera_trigger_step(void);

void turntable_start(void);
uint64_t turntable_time(void);
void turntable_step(void);

#endif
