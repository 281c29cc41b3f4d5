// What the files of this folder know of each other. The core sees ../board.h only.

#ifndef ANNULUS_HARDWARE_H
#define ANNULUS_HARDWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// In the order in which they must be called after reset.
void system_start(void);  // watchdog, time, serial line, pins at rest
void lamps_start(void);   // sync follower, lamps, odometer: PIO0, and the odometer's machine of PIO1
void microwave_start(void);
void stage_start(void);
void usb_start(void);

// Every output that can fire: low now, its machines back in reset. There is no way on from here but a restart.
void outputs_off(void);

// Once a round: without it the microwave goes dark by itself.
void microwave_feed(void);

// Until something happens, 100 us at most.
void system_sleep(void);

// Raw falling edges of the sync input so far, as the pins' interrupt counted them; `accepted` corrects it upwards.
uint32_t system_sync_edges(uint32_t accepted);

// Around what must not be interrupted; never nested.
static inline void interrupts_off(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

static inline void interrupts_on(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

// Give a pin to a peripheral, with this pad.
void pin_use(uint32_t pin, uint32_t function, uint32_t pad);

// Load a PIO program at `first`.
void pio_load(uint32_t pio, uint32_t first, const uint16_t* program, uint32_t length);

// Deepest use of the stack so far, bytes.
uint32_t stack_used(void);

void alarm_handler(void);
void pins_handler(void);
void serial_handler(void);
void usb_handler(void);

// USB as one of the lines of ../board.h, and what keeps it going: once a round.
bool usb_connected(void);
size_t usb_receive(uint8_t* bytes, size_t size);
size_t usb_transmit(const uint8_t* bytes, size_t size);
bool usb_transmitted(void);
bool usb_has_received(void);
void usb_run(void);

// Sixteen digits, different on every board.
const char* system_serial_number(void);

// Who owns which DMA channel and PIO machine.
enum { DMA_STAMP = 0, DMA_AT_EDGE = 1, DMA_ODOMETER = 2, DMA_CHIPS = 3, DMA_TRIGGER = 4, DMA_STEPS = 5 };
enum { SYNC_MACHINE = 0, LAMP_MACHINE = 1, STEP_MACHINE = 2 };                            // PIO0
enum { CHIP_MACHINE = 0, TRIGGER_MACHINE = 1, ODOMETER_MACHINE = 2, GUARD_MACHINE = 3 };  // PIO1

// Entry points of the programs that more than one file needs: the stage borrows the lamps' pulse.
enum { LAMP_IDLE = 16, LAMP_LAST_PULL = 20, LAMP_DELAY = 27 };
#define ODOMETER_PROGRAM 12U  // in PIO1, behind the microwave's

#endif
