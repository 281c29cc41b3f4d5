// The turntable: where it may go, how fast it is at every step, and why it stops.

#ifndef ANNULUS_TURNTABLE_H
#define ANNULUS_TURNTABLE_H

#include <stdbool.h>
#include <stdint.h>

#include "events.h"
#include "messages.h"

typedef struct {
    command_turntable_t config;
    bool moving;          // TURNTABLE_DONE is due
    bool hold;            // powered after this move, or since the last one
    bool powered;         // ENABLE is low
    bool awake;           // for TURNTABLE_LEAD_MS: the driver takes steps
    bool swings;          // the last step is no longer ago than TURNTABLE_LAG_MS
    uint32_t powered_at;  // tick; of no meaning once it is awake
    uint32_t stood_at;    // tick; of no meaning unless it swings
    bool lost;            // ended at once from above the start speed since it was last configured
    uint8_t cause;        // STOP_CAUSE_* of this move, or 0: it arrives by itself
    uint8_t towards;      // TURNTABLE_END_*: the switch that this move may meet
    uint32_t period;      // asked for
    uint32_t pace;        // period in force
    uint32_t steps;       // of this move, as it will end
} turntable_t;

// After a reset: the widest limits, no ramp, no switches.
void turntable_reset(turntable_t* self);

// A status; on OUT_OF_RANGE `detail` names the field.
uint8_t turntable_configure(turntable_t* self, const command_turntable_t* command, uint8_t* detail);

// A status; on UNSAFE `detail` is the STOP_CAUSE of the switch it would move towards.
uint8_t turntable_move(turntable_t* self, const command_move_t* command, uint8_t* detail);

// Along the ramp, to end where that does.
void turntable_stop(turntable_t* self, uint8_t cause);

// Now, and its power taken away.
void turntable_cut(turntable_t* self);

// Once a round: switches, pace, and the report once it stands.
void turntable_run(turntable_t* self, events_t* events, uint32_t now);

#endif
