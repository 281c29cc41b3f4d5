// What the files of the rig know of each other.

#ifndef ANNULUS_RIG_H
#define ANNULUS_RIG_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../pins.h"
#include "wire.h"

#define PIN_MARK 17U  // the rig's own: everything begins when it rises

// Pins the rig may drive: the controller's inputs that a player's list reaches. Those it only looks at: its outputs.
#define RIG_DRIVES (INPUT_PINS & 0x0000FFFFU)
#define RIG_LOOKS (OUTPUT_PINS & ((1U << PIN_MARK) - 1U))

// ---- bench.c: pins, player, recorder ----

void bench_start(void);
void bench_run(void);  // once a round

// Drive these pins to these levels and let go of all others; what is played begins from there. False: not the rig's.
bool bench_levels(uint16_t drive, uint16_t levels);

bool bench_list(uint32_t at, const uint8_t* words, uint32_t count);

typedef struct {
    uint8_t tracks[RIG_TRACKS];  // pin and phase, or RIG_NONE
    uint8_t sample;              // first of four pins, or RIG_NONE; it takes the place of the fourth track
    uint8_t cue;                 // the list waits for this pin to rise; RIG_NONE: for nothing
    uint16_t slow;               // pins whose changes an interrupt stamps
    uint32_t sample_delay;
    uint32_t sample_words;
} bench_record_t;

bool bench_record(const bench_record_t* record);

// Play so many words of the list and record, from now on.
bool bench_go(uint32_t words);
void bench_stop(void);

typedef struct {
    uint32_t tick;  // since the mark
    uint32_t levels;
    uint32_t sampled;   // words
    uint16_t unplayed;  // words of the list
    uint16_t slow;      // changes
    uint8_t flags;      // BENCH_*
    uint16_t tracked[RIG_TRACKS];
    uint16_t room;  // words of a track
} bench_state_t;

enum { BENCH_RUNS = 1, BENCH_PLAYED = 2, BENCH_LOST = 4 };

void bench_state(bench_state_t* state);

// Word of what was recorded; 0 beyond its end.
uint32_t bench_word(uint8_t area, uint32_t at);
uint32_t bench_words(uint8_t area);

void bench_pins_handler(void);

// ---- talk.c: frames ----

void talk_run(void);
bool talk_is_busy(void);

#endif
