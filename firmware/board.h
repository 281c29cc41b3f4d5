// The only door between core and hardware. The core calls every function here, from its main loop (controller_start,
// controller_run) and from nowhere else: no function is called from an interrupt, and none calls back into the core.
//
// The board does the timing. The core decides one flash ahead and loads it; the board fires it on the edge by itself,
// stamps the edge, and says which load it fired. A core that comes late therefore costs a dark frame, never a wrong
// one.

#ifndef ANNULUS_BOARD_H
#define ANNULUS_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/messages.h"

#define BOARD_WATCHDOG_MS 100U  // a main loop silent for this long is restarted
#define BOARD_STARVED_MS 4U     // and for this long leaves the microwave dark, until it is armed again

// ---- identity and time ----

// Ticks of 10 ns since reset; wraps after 43 s.
uint32_t board_tick(void);

// Differs from the one before the reset; after a loss of power, from the one before in 255 of 256 cases.
uint8_t board_boot(void);

// A number of this boot. That two have the same one is a matter of 1 in 2^32.
uint32_t board_nonce(void);

// Why the controller started, BOOT_CAUSE_*.
uint8_t board_cause(void);

// Eight ASCII characters, zero-padded.
const uint8_t* board_name(void);

// What carries the chip, BOARD_KIND_*, and whether there are 5 V at its USB socket, PRESENCE_*; unknown where nothing
// tells for sure.
uint8_t board_kind(void);
uint8_t board_vbus(void);

// Sixteen ASCII digits and a zero, different on every board.
const uint8_t* board_serial_number(void);

// Once a round of the main loop; see BOARD_WATCHDOG_MS.
void board_watchdog_kick(void);

// Restart with BOOT_CAUSE_HOST_RESET. May return; the core then does nothing more than to return itself.
void board_reset(void);

// Is a host there on the line the boot loader speaks, whichever line asks? Without one nothing could end its silence.
bool board_bootloader_reachable(void);

// Stop for good, every output low, and wait to be flashed anew: the boot loader's part. May return, as board_reset.
void board_bootloader(void);

// ---- what a crash leaves behind ----

// Where the main loop is. The core writes it as it goes, `longest` excepted; the board keeps it through a reset.
typedef struct {
    uint8_t part;     // PART_*
    uint8_t command;  // last one carried out, or BOARD_NO_COMMAND
    uint32_t rounds;
    uint32_t tick;     // at which this round began
    uint32_t longest;  // round of this boot, ticks, sleep not counted; the board's to measure
} board_trail_t;

#define BOARD_NO_COMMAND 0xFFU

board_trail_t* board_trail(void);

// Kept until the power goes.
typedef struct {
    uint16_t boots;    // since power came on, this one included
    uint16_t crashes;  // and those of them that ended unasked; what follows is of the last one
    uint16_t boot;     // which it ended
    uint8_t kind;      // CRASH_*
    uint32_t pc;       // 0: not known
    uint32_t lr;
    uint32_t psr;
    board_trail_t trail;
} board_crash_t;

const board_crash_t* board_crash(void);

// ---- applications (application.h) ----

// Which one runs, IMAGE_*.
typedef struct {
    uint8_t slot;
    uint8_t starts;  // unconfirmed so far, this one included; 0: confirmed
    uint8_t why;
    uint8_t flash;
    uint32_t crc;
} board_image_t;

void board_image(board_image_t* image);

// A host understood it: it is no longer on trial.
void board_image_confirm(void);

// Keep UPDATE_CHUNK_BYTES of a new one beside it; chunks come in order. Flash is slow: a write only begins here, and
// goes on in board_update_run, 0.4 s for the first chunk of every 4 KiB at worst. No round waits for it.
void board_update_write(uint32_t offset, const uint8_t* chunk);

// Once a round. Is the flash still at work? Then nothing of the below is called, nor board_update_write.
bool board_update_run(void);

// What was kept, from a multiple of 4 on; `size` is one, too, and UPDATE_CHUNK_BYTES at most.
void board_update_read(uint32_t offset, uint8_t* bytes, uint32_t size);

// Does this entry point lie in the room an application has when it runs?
bool board_update_starts_at(uint32_t entry);

// What was kept is whole, with this CRC, but for its head, the chunk at BOARD_UPDATE_HEAD_AT, which comes now: it runs
// from the next reset on, for a trial.
#define BOARD_UPDATE_HEAD_AT 192U
void board_update_commit(uint32_t crc, const uint8_t* head);

// ---- lines to hosts ----

enum { LINE_UART, LINE_USB, LINES };

// Is a host there? A plain serial line cannot tell and always says yes.
bool board_connected(uint8_t line);

// Up to `size` received bytes; how many. While the core is busy the board keeps at least 256, or lets the host wait.
size_t board_receive(uint8_t line, uint8_t* bytes, size_t size);

// Hand over bytes to send; how many were taken, the rest must be offered again. Without a host all are taken and lost.
size_t board_transmit(uint8_t line, const uint8_t* bytes, size_t size);

// True when every byte handed over has left the line.
bool board_transmitted(uint8_t line);

// ---- which level means what ----

#define POLARITY_LAMPS (POLARITY_PROJECTOR | POLARITY_LED)
#define POLARITY_BURSTS (POLARITY_MICROWAVE | POLARITY_TRIGGER)
#define POLARITY_OUTPUTS (POLARITY_LAMPS | POLARITY_BURSTS | POLARITY_CAMERA_TRIGGER)

// From now on these outputs are driven, each at its dark level, which is high for those that are `inverted`; and a sync
// input among `pins` counts rising edges if it is. Until then, from a reset on, no output of these is driven: a
// resistor outside keeps it dark, whichever level that is. Everything else in this file speaks of them as if none were
// inverted. Only while nothing is armed.
void board_polarity(uint8_t pins, uint8_t inverted);

// Outputs that are driven.
uint8_t board_driven(void);

// From now on the lamps of so many slides are driven as well, dark until a flash says otherwise; inverted as the
// projector's is, which is the first of them. Those that were driven before go on being so, dark. Only while nothing is
// armed, and after board_polarity.
void board_slides(uint8_t count);

// Slides whose lamp is driven: the projector's included, 0 where not even that one is.
uint8_t board_slides_driven(void);

// ---- sync input and lamp gates ----

typedef struct {
    uint8_t tag;             // 1..255, comes back with the edge that took this flash
    uint8_t lamp;            // LAMP_*; dark fires nothing but still carries the hold-off
    uint8_t slide;           // of the projector: which slide's lamp, from 0; one of those that board_slides drives
    uint32_t delay_ticks;    // falling edge -> lamp on
    uint32_t width_ticks;    // lamp on -> lamp off
    uint32_t holdoff_ticks;  // after the edge that takes this flash, further edges are refused for so long
} board_flash_t;

typedef struct {
    uint32_t tick;     // of the falling edge, stamped by hardware
    uint8_t tag;       // of the flash this edge took; 0 = none was loaded, so nothing fires
    int32_t odometer;  // quadrature counts since reset, at this edge
} board_edge_t;

// The most that one flash can owe: after a reset nobody knows what the last one before it was.
#define BOARD_FLASH_OWES_MAX (LAMP_WIDTH_MAX_TICKS * (1000U / LAMP_DUTY_MAX_PERMILLE))

// Load the flash for the NEXT accepted edge. One edge takes it; a second load before that replaces the first. With
// nothing loaded an edge is still stamped, nothing fires, and the last hold-off stays in force. False: refused, because
// the width is over the compiled-in limit, or the flash outlasts its own hold-off or takes more than the duty's share
// of it; then nothing is loaded. Where the lamp would still owe dark time at the next edge, as after a reset, or the
// board cannot be sure of the hold-off, it loads nothing lit either, and says true: the edge then finds none, and takes
// the hold-off.
bool board_flash_load(const board_flash_t* flash);

// Once a round, before the edges: find out what they took, and follow the odometer.
void board_lamps_run(void);

// The oldest accepted edge found by board_lamps_run and not yet reported. The board keeps at least 8; further ones
// count as refused.
bool board_edge(board_edge_t* edge);

// Both gates low now: the flash being timed ends, the loaded one is dropped. The hold-off stays in force.
void board_lamps_cut(void);

// Edges refused since reset: inside the hold-off, or not taken in time by the core. Of a line that rings, over
// sixty edges a round, not every one.
uint32_t board_edges_refused(void);

// Quadrature counts since reset, four per cycle, A before B counts up; as of this round.
int32_t board_odometer(void);

// What went wrong at the board since reset.
typedef struct {
    uint32_t odometer_lost;        // transitions overwritten before they were decoded
    uint32_t odometer_impossible;  // both lines changed at once
    uint32_t edges_dropped;        // accepted, but there was no room to keep them
    uint32_t usb_hangs;            // of the USB block, after which it was reset
} board_health_t;

void board_health(board_health_t* health);

// ---- the cameras' clock ----

typedef struct {
    uint32_t width_ticks;   // 0: none, and edges are those of the sync input
    uint32_t delay_ticks;   // from an accepted edge of the sync input, which begins it; 0: one a period
    uint32_t period_ticks;  // meaningful without a delay
} board_trigger_t;

// Triggers for cameras; they need no main loop. Without a delay the end of each is the sync edge from now on, and what
// the sync input does is nobody's; the first one may last longer, and the edge at its end is as good as any. With one
// edges stay those of the sync input, and a trigger begins BOARD_TRIGGER_LATE_TICKS later than asked for at most. It
// must be over, and CAMERA_TRIGGER_MIN_TICKS have passed, before another edge can be accepted. What runs already goes
// on without a break. Only while nothing is armed, and after board_polarity.
#define BOARD_TRIGGER_LATE_TICKS 60U
void board_camera_trigger(const board_trigger_t* trigger);

// ---- microwave ----

typedef struct {
    uint8_t chips[32];  // chip 0 is bit 0 of byte 0
    uint16_t length;    // chips
    uint16_t chip_ticks;
    uint16_t repeat;
    uint32_t period_ticks;   // chip 0 -> chip 0
    int32_t trigger_offset;  // digitizer trigger relative to chip 0
} board_burst_t;

// The most that one burst can owe: after a reset nobody knows what the last one before it was.
#define BOARD_BURST_OWES_MAX (CHIPS_MAX / 2U * CHIP_MAX_TICKS * (1000U / MICROWAVE_DUTY_MAX_PERMILLE))

// Is this chip on? Those past the end are not.
static inline bool board_chip(const board_burst_t* const burst, const uint32_t chip)
{
    return (chip < burst->length) && (((burst->chips[chip / 8U] >> (chip % 8U)) & 1U) != 0U);
}

// Eight chips from 8 * `index` on.
static inline uint32_t board_chips(const board_burst_t* const burst, const uint32_t index)
{
    const uint32_t left = (burst->length > 8U * index) ? burst->length - 8U * index : 0U;
    return (left == 0U) ? 0U : burst->chips[index] & ((left < 8U) ? (1U << left) - 1U : 0xFFU);
}

static inline uint32_t board_ones(uint32_t bits)
{
    uint32_t ones = 0;
    for (; bits != 0U; bits &= bits - 1U) {
        ones++;
    }
    return ones;
}

// How long the gate is high in one burst.
static inline uint32_t board_on_ticks(const board_burst_t* const burst)
{
    uint32_t on_chips = 0;
    for (uint32_t i = 0; i < sizeof burst->chips; i++) {
        on_chips += board_ones(board_chips(burst, i));
    }
    return on_chips * burst->chip_ticks;
}

// Runs of on-chips: every one ends with a chip whose next one is off.
static inline uint32_t board_pulses(const board_burst_t* const burst)
{
    uint32_t pulses = 0;
    uint32_t chips = board_chips(burst, 0U);
    for (uint32_t i = 0; i < sizeof burst->chips; i++) {
        const uint32_t next = board_chips(burst, i + 1U);
        pulses += board_ones(chips & ~((chips >> 1) | (next << 7)));
        chips = next;
    }
    return pulses;
}

// Chips before the first one that is on; 0 when none is.
static inline uint32_t board_first_on_chip(const board_burst_t* const burst)
{
    uint32_t chip = 0;
    while ((chip < burst->length) && !board_chip(burst, chip)) {
        chip += (board_chips(burst, chip / 8U) == 0U) ? 8U : 1U;
    }
    return (chip >= burst->length) ? 0U : chip;
}

// Chips up to and with the last one that is on; 0 when none is.
static inline uint32_t board_on_end(const board_burst_t* const burst)
{
    uint32_t chips = burst->length;
    while ((chips > 0U) && !board_chip(burst, chips - 1U)) {
        chips--;
    }
    return chips;
}

// Whether the interlock has a second input, antivalent to the first: closed = high. Not while the microwave is enabled.
// After a reset it has none, and its pin is looked at by nobody.
void board_interlock_watch(bool antivalent);

// What the inputs say now, INTERLOCK_*: that a second one is used, and which of them say open.
uint8_t board_interlock(void);

// One of the inputs says open.
static inline bool board_interlock_open(void)
{
    return (board_interlock() & (INTERLOCK_OPEN | INTERLOCK_ANTIVALENT_OPEN)) != 0U;
}

// Did one of the inputs open since the last call, however briefly? If it was open for BOARD_INTERLOCK_SEEN_TICKS,
// hardware has already cut the microwave and keeps it cut until board_microwave(true): within one chip and without the
// core (the second input: for 13 ticks, and within two chips). What cuts looks at the pin every second to fourth tick,
// so that a shorter bounce may slip between two looks; its edge is kept all the same, this function tells of it, and
// the core cuts in the same round: pulses until then are still made.
#define BOARD_INTERLOCK_SEEN_TICKS 4U
bool board_interlock_tripped(void);

// Did hardware cut the microwave since the last call because the main loop was late? It is kept cut as after the
// interlock: a main loop that stands still leaves the gate low after BOARD_STARVED_MS at most, long before the watchdog
// bites.
bool board_microwave_starved(void);

// False: gate low now, a running train ends. True: a train may be started.
void board_microwave(bool enabled);

// Once a round of the main loop: the credit on which the microwave lives for the next BOARD_STARVED_MS.
void board_microwave_feed(void);

// Start a train; `start` becomes the tick of chip 0 of the first burst. The duty limit is kept here over time, across
// trains, stops, arming and resets: every burst begun owes the dark that goes with its on-chips (duty.h), and a train
// whose first pulse would come before all is paid is over the limit. Whatever is not started leaves the gate low.
typedef enum {
    BOARD_BURST_STARTED,
    BOARD_BURST_CUT,         // hardware holds the gate low: interlock or starvation, which the next round finds
    BOARD_BURST_OVER_LIMIT,  // it would break the duty limit
} board_burst_started_t;
board_burst_started_t board_burst(const board_burst_t* burst, uint32_t* start);

// End the train after the burst now being sent.
void board_burst_stop(void);

// Is a train running? `done` becomes the number of complete bursts of this train, or of the last one.
bool board_burst_running(uint16_t* done);

// ---- the board's own pins, measured ----

#define BOARD_LOOK_WORDS 64U    // of a look; a word is eight ticks of four pins, the first tick in the highest bits
#define BOARD_SAMPLE_BYTES 32U  // fetched at once

typedef struct {
    uint16_t looks;        // 0 ends the measurement
    uint8_t pin;           // whose edge begins a look
    uint8_t level;         // after that edge
    uint8_t first;         // the lowest of the four pins
    uint32_t delay_ticks;  // edge -> first sample, and 2 more
} board_look_t;

// Begin anew, or end. While measuring the odometer stands still.
void board_measure(const board_look_t* look);
bool board_measuring(void);

// Once a round of the main loop: the next look.
void board_measure_run(void);

// Looks taken so far. `bits`: eight words from `word` on, of the first look or the latest; they differ: no more follow.
uint16_t board_measured(bool latest, uint8_t word, uint8_t bits[BOARD_SAMPLE_BYTES], bool* differs);

// ---- turntable and status light ----

// The motor's power. Only while it stands.
void board_turntable_power(bool on);

// Step to an absolute position. The first step rises half a period from now, and `wait_ticks` from now at the earliest.
void board_turntable_move(int32_t position, uint32_t period_ticks, uint32_t wait_ticks);

// Another period, from at most three steps on.
void board_turntable_pace(uint32_t period_ticks);

// Steps of this move that nothing has begun to make; at most three more are under way.
uint32_t board_turntable_left(void);

// Leave at most so many of these; how many were taken away.
uint32_t board_turntable_shorten(uint32_t steps);

// No further step, and the motor's power away, also when it stood. A step whose STEP had risen counts as made.
void board_turntable_cut(void);

bool board_turntable_moving(void);
int32_t board_turntable_position(void);

// Which end switches are there, TURNTABLE_END_*; and which of these are reached, or were since the last call, however
// briefly.
void board_turntable_watch(uint8_t switches);
uint8_t board_turntable_reached(void);

void board_status_light(bool on);

#endif
