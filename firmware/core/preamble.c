// An optical preamble: edges lit in an order that does not repeat, so that a host can tell which frame is which.
//
// Two bits an edge of a maximal-length sequence of 15 bits, x^15 + x^14 + 1: half of the edges projector, a quarter
// LED, a quarter dark. The register runs on from preamble to preamble until the reset, and begins somewhere else in
// every boot: so 32 767 edges pass before the order repeats, and no two preambles of less than that are alike.

#include "preamble.h"

#define REGISTER_MASK 0x7FFFU

// Of the two bits that are due: 0 and 3 projector, 1 LED, 2 dark. Others shift into themselves or the lamp cycle more
// often (tests/unit/firmware/test_preamble.py).
#define LAMPS ((LAMP_PROJECTOR << 0) | (LAMP_LED << 2) | (LAMP_DARK << 4) | (LAMP_PROJECTOR << 6))

void preamble_seed(preamble_t* const self, const uint32_t nonce)
{
    self->sequence = (uint16_t)((nonce & REGISTER_MASK) | 1U);
}

uint8_t preamble_lamp(const preamble_t* const self, const uint8_t ratio)
{
    const uint32_t bits = self->sequence & 3U;
    if (ratio == 0U) {
        return ((bits & 1U) != 0U) ? LAMP_LED : LAMP_DARK;
    }
    return (LAMPS >> (2U * bits)) & 3U;
}

bool preamble_cycle(preamble_t* const self)
{
    self->cycles++;  // comes round to 0 after 65 536 cycles, which is no interval
    return (self->config.interval > 0U) && (self->cycles == self->config.interval);
}

void preamble_step(preamble_t* const self)
{
    const uint32_t bits = self->sequence;
    const uint32_t next = ((bits >> 13) ^ (bits >> 12)) & 3U;  // two steps at once
    self->sequence = (uint16_t)(((bits << 2) | next) & REGISTER_MASK);
}
