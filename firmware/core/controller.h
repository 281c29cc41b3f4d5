// The controller as a whole: what a main loop starts and runs. Everything it owns is in one structure.

#ifndef ANNULUS_CONTROLLER_H
#define ANNULUS_CONTROLLER_H

#include <stdbool.h>
#include <stdint.h>

#include "../board.h"
#include "bursts.h"
#include "events.h"
#include "link.h"
#include "messages.h"
#include "sequencer.h"
#include "turntable.h"
#include "update.h"

// Where a controller goes that was told to stop.
enum { LEAVE_NOT, LEAVE_TO_START, LEAVE_TO_BOOTLOADER };

// Two inputs that must not contradict each other for long.
typedef struct {
    bool disagrees;   // as of the last round
    uint32_t since;   // tick of the first round that found it so
    bool distrusted;  // it lasted too long; until `clear` finds both closed
} safety_interlock_t;

typedef struct {
    link_t links[LINES];
    bool connected[LINES];  // at the last look
    uint8_t first_line;     // to be looked at in the next round
    uint8_t session;        // line whose host identified last: it commands, and gets the events
    bool schema_ok;         // and speaks our schema
    uint8_t asking;         // line whose command is being carried out
    uint8_t level[LINES];   // at which a line's host is spoken to
    rereads_t rereads[LINES];
    command_t held[LINES];  // an update's, while the flash is at work
    bool holds[LINES];
    events_t events;
    sequencer_t sequencer;
    bursts_t bursts;
    update_t update;
    bool flash_busy;  // in this round
    uint8_t armed;    // ARM_*
    uint8_t fault;    // latched, FAULT_*
    safety_interlock_t interlock;
    turntable_t turntable;
    uint8_t leaving;  // LEAVE_*, once the acknowledgement has left
    uint32_t leaving_since;
    uint32_t heard;            // tick of the session's last valid frame, meaningful while something is live
    uint32_t odometer_missed;  // transitions lost or impossible, as last reported
    bool odometer_hushed;      // reported a moment ago
    uint32_t odometer_hushed_until;
} controller_t;

// After reset: every output is low. Reports BOOTED.
void controller_start(controller_t* self);

// One round of the main loop; call it again and again, at least every 100 us while edges and bytes come.
void controller_run(controller_t* self);

#endif
