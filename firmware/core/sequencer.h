// Decides which lamp the next frame gets, and when; says what every edge really took. Knows nothing of pins: the board
// fires what it is handed.

#ifndef ANNULUS_SEQUENCER_H
#define ANNULUS_SEQUENCER_H

#include <stdbool.h>
#include <stdint.h>

#include "events.h"
#include "messages.h"
#include "preamble.h"

#define PLANS_KEPT 2U  // loads an edge may still report: the one that stands and the one it replaced

// A flash as it was loaded, remembered until its edge is reported.
typedef struct {
    uint8_t slot;
    uint8_t lamp;
    uint8_t slide;  // of the projector's flash, from 0
    uint32_t delay_ticks;
    uint32_t width_ticks;
    uint8_t generation;
    bool armed;
    bool preamble;  // its slot is a place in one
} plan_t;

// What goes with a configuration and is no field of `stage`.
typedef struct {
    uint8_t inverted;              // POLARITY_*
    uint8_t slides;                // that take the projector's flashes in turn, 1 or more
    uint32_t trigger_ticks;        // how long a camera's trigger lasts; 0 = none
    uint32_t trigger_delay_ticks;  // after an edge; 0 = one a frame period
} wiring_t;

// What is small comes first: the processor reaches it with one instruction.
typedef struct {
    preamble_t preamble;
    bool is_staged;
    bool is_committed;  // staged waits for slot 0
    bool armed;
    bool just_armed;  // since the edges were last asked for
    bool reload;      // what the board holds is taken or out of date
    uint8_t slot;     // of the next edge, in the lamp cycle or in a preamble; 0 while not armed
    uint8_t tag;      // of the last load
    bool has_last;
    bool synced;
    bool odometer_stood;  // since the last edge, or still
    uint16_t late;
    uint32_t armed_at;  // tick, meaningful with just_armed
    uint32_t edges;
    uint32_t last_tick;  // of the last accepted edge, meaningful with has_last
    uint32_t period;     // last interval
    plan_t plans[PLANS_KEPT];
    command_stage_t config;  // in force; generation 0 = none
    command_stage_t staged;
    wiring_t wiring;         // in force
    wiring_t staged_wiring;  // with `staged`
} sequencer_t;

// After reset, all else zero.
void sequencer_start(sequencer_t* self);

// Once a round, first: report all edges so far; notice a lost sync.
void sequencer_edges(sequencer_t* self, events_t* events, uint32_t now);

// Once a round, after whatever may change the plan: load the flash for the next edge, if that is due. False: the board
// refused it.
bool sequencer_load(sequencer_t* self, events_t* events, uint32_t now);

// Of the flash loaded last, LAMP_*.
uint8_t sequencer_lamp(const sequencer_t* self);

// Validate a configuration as a whole and stage it. A status; on refusal `detail` says which field or lamp.
uint8_t sequencer_stage(sequencer_t* self, const command_stage_t* config, reply_stage_t* reply);

// Which pins are inverted with the configuration that is staged. False: it is another, or it is committed already.
bool sequencer_polarity(sequencer_t* self, const command_polarity_t* config);

// How long a trigger for cameras lasts with the configuration that is staged. A status; on refusal `detail` says which
// field.
uint8_t sequencer_camera_trigger(sequencer_t* self, const command_camera_trigger_t* config, uint8_t* detail);

// How many slides are lit in turn with the configuration that is staged. A status; on refusal `detail` says which
// field.
uint8_t sequencer_slides(sequencer_t* self, const command_slides_t* config, uint8_t* detail);

// Put the staged configuration in force: at the next slot 0, or now when not armed. False: it is not staged; or it
// changes the wiring while something is `live`.
bool sequencer_commit(sequencer_t* self, uint8_t generation, bool live);

// Preambles from the flash after the loaded one on; one that runs goes on, but for what is over the length.
void sequencer_preamble(sequencer_t* self, const command_preamble_t* config);

// The board measures its own pins from now on: until it no longer does, and for one edge more, edges say that the
// odometer stood still.
void sequencer_measures(sequencer_t* self);

// From slot 0, after a preamble. Needs a configuration in force.
void sequencer_arm(sequencer_t* self);

// Gates low now; edges are still reported.
void sequencer_disarm(sequencer_t* self);

#endif
