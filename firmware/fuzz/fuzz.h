// What the parts of the fuzz target share.

#ifndef ANNULUS_FUZZ_H
#define ANNULUS_FUZZ_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../native/native.h"
#include "link.h"

void require(bool condition);

// The payload of this command as a host that means well would send it, made of `bytes`: what stands behind checks that
// no fuzzer passes by chance (a magic, a schema hash, a CRC over a whole application), and numbers near their limits.
void meant_payload(const layout_t* layout, const uint8_t bytes[PAYLOAD_MAX], uint8_t payload[PAYLOAD_MAX]);

// After a power-on, a plug pulled or put in: the frame under way on this line is cut short.
void watch_begin(void);
void watch_cut(uint8_t line);

// Let the world go on for so long, and check everything that must hold whatever comes.
void watch_run(uint64_t ticks);

// Commands answered with status ok since the process began, id 0 in bit 0.
uint64_t watch_carried_out(void);

#endif
