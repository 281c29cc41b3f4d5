// Why something must go dark, and what follows from it: faults latch, and disarm everything until they are cleared.

#ifndef ANNULUS_SAFETY_H
#define ANNULUS_SAFETY_H

#include "controller.h"

// Latch a fault, disarm everything, report it.
void safety_trip(controller_t* self, uint8_t fault, uint32_t detail);

// What the board refuses is beyond a compiled-in limit: never try again before the host has seen it. `output` goes into
// the fault: LAMP_*, or OUTPUT_MICROWAVE.
void safety_insist(controller_t* self, bool accepted, uint32_t output);

// Once a round: interlock, host timeout, and a host that has gone.
void safety_run(controller_t* self, uint32_t now);

// Absolute. A status; refused, nothing changes.
uint8_t safety_arm(controller_t* self, uint8_t outputs);

// Which inputs the interlock has, INTERLOCK_ANTIVALENT or 0. A status; refused, nothing changes.
uint8_t safety_interlock(controller_t* self, uint8_t inputs);

// A status; unsafe while the cause lasts.
uint8_t safety_clear(controller_t* self);

#endif
