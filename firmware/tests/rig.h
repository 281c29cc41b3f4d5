// A host and a camera for tests: sends commands over the simulated line, makes sync edges, keeps what came back.

#ifndef ANNULUS_RIG_H
#define ANNULUS_RIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../native/native.h"
#include "messages.h"

#define US ((uint64_t)TICKS_PER_US)
#define MS ((uint64_t)TICKS_PER_MS)
#define PERIOD (40ULL * MS)
#define ROUND (MS / 20U)  // what a byte or an edge may wait until a round has dealt with it

typedef struct {
    uint8_t id;
    uint16_t sequence;
    uint8_t boot;
    uint8_t payload[PAYLOAD_MAX];
} got_t;

// A fresh world with the controller just started and nothing said to it.
void rig_power_on(void);

// The same, identified with the right schema, spoken to at our level, and the interlock closed.
void rig_start(void);

// With the right schema, spoken to at our level from now on.
void rig_identify(void);

// Timing at 25 fps: exposure 38 ms, readout 28 ms, so that all rows expose 2..12 ms after an edge.
command_stage_t rig_config(uint8_t generation, uint8_t ratio);

// Stage, commit and arm; every step has to succeed.
void rig_configure(const command_stage_t* config);
void rig_arm(uint8_t outputs);

// rig_start, such a configuration, lamps armed, nothing left to take.
void rig_scan(uint8_t ratio);

// Send a command with the next sequence and let 2 ms go by. The reply's payload, or NULL.
const uint8_t* rig_command(uint8_t id, const uint8_t* payload);
uint8_t rig_status_of(uint8_t id, const uint8_t* payload);
reply_status_t rig_status(void);

// Send a frame as it is, with a sequence of its own; nothing goes by.
void rig_send(uint8_t id, uint8_t sequence, const uint8_t* payload);
void rig_raw(const uint8_t* bytes, size_t size);

void rig_pass(uint64_t ticks);

// From now on talk and listen on the second line, or on the first again. What comes on the other one waits there.
void rig_over_usb(bool usb);

// A ping that keeps the host timeout at bay, and a sync pulse, falling now, high again 10 us later; then the rest of
// `period` goes by. World tick of the edge.
uint64_t rig_edge(uint64_t period);

// A falling edge now and the line high again 10 us later; only those go by.
uint64_t rig_pulse(void);

// The oldest message of this id not yet taken, or NULL.
const got_t* rig_take(uint8_t id);
event_edge_t rig_take_edge(void);
size_t rig_count(uint8_t id);
void rig_forget(void);

// Drain pin transitions; the first of this pin and level since the last rig_look, as a world tick, or 0.
void rig_look(void);
uint64_t rig_rise(uint8_t pin, size_t index);
uint64_t rig_fall(uint8_t pin, size_t index);
size_t rig_rises(uint8_t pin);

// Bursts of MPSL25, chips of 0.5 us, 5 kHz; the status.
uint8_t rig_start_train(uint16_t repeat);

// The oldest fault not yet taken.
event_fault_t rig_take_fault(void);

#endif
