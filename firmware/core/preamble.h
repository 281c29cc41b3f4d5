// An optical preamble: edges lit in an order that does not repeat, so that a host can tell which frame is which. The
// lamp cycle repeats every few frames, and a count that slipped by whole cycles looks right for ever.

#ifndef ANNULUS_PREAMBLE_H
#define ANNULUS_PREAMBLE_H

#include <stdbool.h>
#include <stdint.h>

#include "messages.h"

typedef struct {
    uint16_t sequence;          // shift register of 15 bits, never 0
    uint16_t cycles;            // of the lamps, complete since the last one
    bool running;               // the next edge belongs to one
    command_preamble_t config;  // `now`: one is to begin
} preamble_t;

// Once, after reset: where the sequence begins.
void preamble_seed(preamble_t* self, uint32_t nonce);

// What is due, LAMP_*. With ratio 0 the projector's flash was never checked, so that it takes no part.
uint8_t preamble_lamp(const preamble_t* self, uint8_t ratio);

// A lamp cycle is over. Is a preamble due?
bool preamble_cycle(preamble_t* self);

// An edge took it.
void preamble_step(preamble_t* self);

#endif
