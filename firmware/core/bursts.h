// Trains of on/off chips for the microwave gate: which codes there are, and what may be sent.

#ifndef ANNULUS_BURSTS_H
#define ANNULUS_BURSTS_H

#include <stdbool.h>
#include <stdint.h>

#include "events.h"
#include "messages.h"

#define OUTPUT_MICROWAVE 3U  // in the `detail` of a status or a fault, beside the lamps

typedef struct {
    command_pattern_t uploaded;  // burst code 0; length 0 = none
    bool running;
    uint8_t fault;  // that cut the running train, or FAULT_NONE
} bursts_t;

// Take chips for burst code 0. A status.
uint8_t bursts_upload(bursts_t* self, const command_pattern_t* pattern, uint8_t* detail);

// Check a train against the limits and start it. A status; `refused` = the board would not (FAULT_LIMIT).
uint8_t bursts_fire(bursts_t* self, const command_burst_t* command, reply_burst_t* reply, bool* refused);

// The microwave has been cut because of `fault`: the train, if one ran, ends with it.
void bursts_cut(bursts_t* self, uint8_t fault);

// Has a train ended that was not reported yet? `done` becomes its complete bursts.
bool bursts_ended(const bursts_t* self, uint16_t* done);

void bursts_report(bursts_t* self, events_t* events, uint16_t done, uint32_t now);

#endif
