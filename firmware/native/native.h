// The controller's core on a simulated board, as a shared library. One board a process, virtual time: nothing happens
// except inside native_run_until, and the same calls always give the same pins.
//
// Times are WORLD ticks of 10 ns since native_begin. The controller counts its own ticks from its last reset.

#ifndef ANNULUS_NATIVE_H
#define ANNULUS_NATIVE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../pins.h"

#define NATIVE_BYTE_TICKS 1000U    // 1 Mbaud, ten bits a byte
#define NATIVE_ROUND_TICKS 10000U  // idle main loop: a round at least every 100 us
#define NATIVE_LATENCY_TICKS 200U  // from a hardware event to the round that sees it

typedef struct {
    uint64_t tick;
    uint8_t pin;
    uint8_t level;
    uint8_t padding[6];
} native_transition_t;

typedef struct {
    uint64_t transitions;  // pin transitions nobody drained in time
    uint64_t received;     // bytes that met a full receive buffer
    uint64_t sent;         // bytes nobody read in time
    uint64_t inputs;       // scheduled in the past or beyond the queue
} native_lost_t;

// Forget everything: tick 0, no power, sync high, interlock open, odometer at rest.
void native_begin(void);

// Power comes on, or comes back: a reset with a given boot byte and BOOT_CAUSE_*. Inputs scheduled stay scheduled;
// bytes the controller was sending are lost.
void native_power_on(uint8_t boot, uint8_t cause);

// Schedule a level on an input pin, not before the current tick. False: refused.
bool native_input(uint64_t tick, uint8_t pin, uint8_t level);

// A jumper: from now on this output drives that input, a tick later; 0 takes it away.
void native_wire(uint8_t from, uint8_t to);

// A resistor outside that pulls this output while nobody drives it; at first each is pulled to its level at reset.
void native_pull(uint8_t pin, uint8_t level);

// Send bytes to the controller from now on, one after another at line speed; how many were taken.
size_t native_serial_write(const uint8_t* bytes, size_t size);

// Bytes that have arrived from the controller by now.
size_t native_serial_read(uint8_t* bytes, size_t size);

// The second line, which stands for USB: nobody is there at first; plugging in or out loses whatever is under way. It
// runs at the serial line's speed.
void native_usb_connect(bool connected);
// The host there fetches nothing, until told otherwise.
void native_usb_hold(bool held);

size_t native_usb_write(const uint8_t* bytes, size_t size);
size_t native_usb_read(uint8_t* bytes, size_t size);

// How long each of the core's calls of the board takes is drawn from this; native_begin sets 0. Same seed, same pins,
// whatever pieces of time native_run_until is given.
void native_seed(uint32_t seed);

// Let the world go on to this tick.
void native_run_until(uint64_t tick);
uint64_t native_tick(void);

// The controller left for the boot loader: it answers nothing more until native_power_on.
bool native_in_bootloader(void);

// World tick of the controller's last reset.
uint64_t native_boot_tick(void);

// Drain transitions of output pins, oldest first.
size_t native_pins(native_transition_t* transitions, size_t size);
uint8_t native_pin(uint8_t pin);

// From now on the main loop stands still for so long; hardware goes on. The watchdog bites after BOARD_WATCHDOG_MS.
void native_stall_cpu(uint64_t ticks);

// The board refuses the next lamp flash that is lit, or the next burst, as if it were beyond a limit.
void native_refuse_next(void);

void native_lost(native_lost_t* lost);

#endif
