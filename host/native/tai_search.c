// The first bipolar code of a length whose aperiodic autocorrelation stays within a bound at every lag but 0. A chip is
// a bit, so a lag is one exclusive or and a count of bits: sum c(i) c(i + s) = chips that meet - 2 chips that differ.
#include "native.h"

#define CHIPS_MOST 64  // of a word; twice the time for each more, so no search reaches it

INLINE bool within(const uint64_t code, const int64_t lag, const int64_t meet, const int64_t bound)
{
    const uint64_t differ = (code ^ code >> lag) & (~UINT64_C(0) >> (64 - meet));
    const int64_t sum = meet - 2 * (int64_t)__builtin_popcountll(differ);
    return (sum < 0 ? -sum : sum) <= bound;
}

// Bit i is set where chip i is +1; 0 where there is no such code. Chips are set in pairs from both ends inwards, +1
// before -1; a branch is given up where the lag at which only chips that are set meet is over the bound.
DOOR uint64_t tai_code(const int64_t length, const int64_t bound)
{
    if (length < 2 || length > CHIPS_MOST) {
        return 0;
    }
    const int64_t half = (length + 1) / 2;
    uint64_t code = 0;
    uint8_t choice[CHIPS_MOST / 2] = {0};  // of each pair: bit 1 its first chip, bit 0 its last, set where that is -1
    int64_t depth = 0;
    while (depth >= 0) {
        const int64_t opposite = length - 1 - depth;
        // negatives are left out: the first chip is +1
        if (choice[depth] >= (opposite == depth || depth == 0 ? 2 : 4)) {
            depth--;
            if (depth >= 0) {
                choice[depth]++;
            }
            continue;
        }
        const uint64_t last = ~(uint64_t)choice[depth] & 1;
        const uint64_t first = opposite == depth ? last : ~(uint64_t)choice[depth] >> 1 & 1;
        code &= ~(UINT64_C(1) << depth | UINT64_C(1) << opposite);
        code |= first << depth | last << opposite;
        bool good = within(code, opposite, depth + 1, bound);
        if (good && depth == half - 1) {
            for (int64_t lag = 1; lag < length && good; lag++) {
                good = within(code, lag, length - lag, bound);
            }
            if (good) {
                return code;
            }
        }
        if (good && depth < half - 1) {
            depth++;
            choice[depth] = 0;
        } else {
            choice[depth]++;
        }
    }
    return 0;
}
