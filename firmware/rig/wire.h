// What the rig and its host say to each other: README.md. host/annulus_pipe/selftest/rig/wire.py has the same numbers.

#ifndef ANNULUS_RIG_WIRE_H
#define ANNULUS_RIG_WIRE_H

#define RIG_PROTOCOL 2  // 1: had no GP13 and no GP16

#define RIG_PAYLOAD_MAX 240   // bytes
#define RIG_WORDS_MAX 56      // of a `list` or `data` frame
#define RIG_LIST_WORDS 8192   // of what is played
#define RIG_AREA_WORDS 49152  // of what is recorded: 192 KiB
#define RIG_TRACKS 7
#define RIG_SLOW_MAX 512  // changes of slow pins

// A track's byte: the pin, and which of the two phases.
#define RIG_TRACK_ODD 0x80
#define RIG_NONE 0xFF

// A word of the list: levels of GP2 to GP15, and the ticks until the next word less RIG_GAP_MIN.
#define RIG_LIST_FIRST_PIN 2
#define RIG_LIST_PINS 14
#define RIG_GAP_MIN 4

// Ticks from the mark (tick 0) to what each machine does first.
#define RIG_PLAYED_AT 7   // first word of the list, at the pad
#define RIG_CUED_AT 5     // the same from the rise of its cue on
#define RIG_TRACK_AT 2    // first look of an even track; an odd one's is a tick later
#define RIG_SAMPLED_AT 2  // first sample without delay
#define RIG_RISE_DEAD 2   // ticks in which a track does not look after a rise
#define RIG_FALL_DEAD 4   // .. and after a fall

enum rig_operation {
    RIG_HELLO = 1,
    RIG_LEVELS = 2,
    RIG_LIST = 3,
    RIG_RECORD = 4,
    RIG_GO = 5,
    RIG_STATE = 6,
    RIG_READ = 7,
    RIG_STOP = 8,
    RIG_BOOTLOADER = 9,
    RIG_DATA = 16,
};

enum rig_status {
    RIG_OK = 0,
    RIG_BAD_LENGTH = 1,
    RIG_OUT_OF_RANGE = 2,
    RIG_BUSY = 3,
    RIG_UNKNOWN = 4,
};

enum rig_area {
    RIG_AREA_RECORDED = 0,
    RIG_AREA_SLOW = 1,
};

#endif
