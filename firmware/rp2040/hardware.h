// What the files of this folder know of each other. The core sees ../board.h only.

#ifndef ANNULUS_HARDWARE_H
#define ANNULUS_HARDWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../quadrature.h"
#include "registers.h"

// In the order in which they must be called after reset.
void identity_start(void);
void serial_number_start(void);
void reset_start(void);           // the watchdog
void pinuse_start(void);          // pins at rest, and which board this is
void lines_start(void);           // the UART
void time_begin(bool by_loader);  // first of all
void time_start(void);
void lamps_start(void);  // sync follower and lamps: PIO0; and the odometer, which is read at every edge
void microwave_start(void);
void turntable_start(void);
void camera_trigger_start(void);
void usb_start(void);

// The gates that are driven: at their dark level now, whatever PIO does.
void pinuse_darken(void);

// Every output that can fire: dark now, its machines back in reset. There is no way on from here but a restart.
void outputs_off(void);

// Until something happens, 100 us at most.
void sleep_start(void);
void sleep_round(void);

// Ticks at least from the reset to tick 0, in which every output was dark.
uint32_t time_before(void);

// Write a register, and the tick two before: nothing comes between.
uint32_t time_of_write(uint32_t address, uint32_t value);

// The application itself: what the loader handed over, and, a little each round, whether it is still what was flashed.
extern const uint8_t image_start[];
void image_begin(uint32_t mark, uint32_t handover);
void image_run(bool flash_is_free);
uint32_t image_slot(void);
uint32_t image_record(void);  // page of the newest record, or RECORD_PAGES
bool image_confirmed(void);   // was it on trial until now?
bool staging_is_idle(void);   // nobody is waiting for the flash

// Bytes wait, and the core has just fetched others: its next round is due at once.
bool lines_waiting(void);

// GUARD, which cuts the microwave (guard.c): loaded and cutting; let go, with a credit; another credit when one was
// taken; made to cut. When it cut by its own count, and whether for want of a credit: not while a machine that drives
// the pins runs.
void guard_load(void);
void guard_start(void);
void guard_feed(void);
void guard_cut(void);
bool guard_is_cutting(void);
uint32_t guard_cut_tick(bool* starved);

// A train is to end, and every round tries to find the moment for it.
bool microwave_hurries(void);

// Outlives every reset but the loss of power, in WATCHDOG_KEPT_CAUSE: this firmware ran before. The low byte: how it
// ended.
#define SCRATCH_MAGIC 0x616E6E00U
#define SCRATCH_BY_HOST 1U

// Once a round: the pins' interrupts, of which a round takes so many, go on.
void pinuse_run(void);

// An interlock or VBUS went since this was last asked: the round under way may have looked before.
bool pinuse_hurries(void);

// Count the interlock's openings, those of its second input too or not.
void pinuse_watch_interlock(bool antivalent);

// Raw falling edges of the sync input so far, as the pins' interrupt counted them; `accepted` corrects it upwards.
uint32_t pinuse_sync_edges(uint32_t accepted);
void pinuse_count_sync(bool counts, uint32_t before);  // on from `before`; or edges of the sync input are nobody's

// The odometer: its machine of PIO1, and transitions as its DMA counts them. `odometer_decode`: the place there.
// It hands all that and its ring to whoever measures, standing still until it is started again.
#define ODOMETER_RING_BYTES QUADRATURE_KEPT
void odometer_start(void);
uint32_t odometer_transitions(uint32_t count);
uint32_t odometer_now(void);
int32_t odometer_decode(uint32_t until);
const quadrature_t* odometer_state(void);
volatile uint32_t* odometer_lend(void);

// Which board carries the chip. VBUS: never gone where nothing senses it; once it was, however briefly, gone until
// `variant_vbus_back` is asked and it is there. From the pins' interrupt: an edge of it.
void variant_prepare(void);  // before identity_start: a divider has to settle
void variant_start(void);
bool variant_senses_vbus(void);
void variant_vbus_gone(void);
bool variant_vbus(void);
bool variant_vbus_back(void);

// Around what must not be interrupted; never nested.
static inline void interrupts_off(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

static inline void interrupts_on(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

static inline void irq_enable(const uint32_t irq)
{
    REGISTER(NVIC_ENABLE(irq)) = 1U << (irq % 32U);
}

// In force when it returns (ARM's application note 321, 4.9): the write may be on its way for longer than the next
// instruction takes, which would still be interrupted.
static inline void irq_disable(const uint32_t irq)
{
    REGISTER(NVIC_DISABLE(irq)) = 1U << (irq % 32U);
    __asm volatile("dsb\n isb" ::: "memory");
}

// Give a pin to a peripheral, with this pad.
void pin_use(uint32_t pin, uint32_t function, uint32_t pad);

// End what a channel does, without another word; the one it is chained to does not go on.
void dma_stop(uint32_t channel);

// Load a PIO program at `first`.
void pio_load(uint32_t pio, uint32_t first, const uint16_t* program, uint32_t length);

// Eight bytes that no other board has, one a word.
void unique_id(uint32_t id[8]);

// Boot byte of the start before this one, if the memory still knows it; until crash_start.
bool crash_knows_boot(uint8_t* boot);
void crash_start(uint8_t cause, uint8_t boot);

// The round of the main loop is over, but for its sleep.
void crash_measure(void);

// The application's own code is no longer what it was: outputs off, and start anew.
void crash_damaged(void);

void fault_handler(void);
void stuck_handler(void);
void alarm_handler(void);
void pins_handler(void);
void serial_handler(void);
void usb_handler(void);

// USB as one of the lines of ../board.h, and what keeps it going: once a round.
bool usb_connected(void);
bool usb_hosted(void);  // configured by a host that keeps the bus busy, whether or not anybody has the port open
size_t usb_receive(uint8_t* bytes, size_t size);
size_t usb_transmit(const uint8_t* bytes, size_t size);
bool usb_transmitted(void);
void usb_run(void);
void usb_let_go(void);     // D+, at once: from an interrupt
uint32_t usb_hangs(void);  // so often the device controller hung and was reset

// Who owns which DMA channel and PIO machine.
enum {
    DMA_STAMP = 0,
    DMA_AT_EDGE = 1,
    DMA_ODOMETER = 2,
    DMA_CHIPS = 3,
    DMA_TRIGGER = 4,
    DMA_STEPS = 5,
    DMA_ODOMETER_AGAIN = 6,
    DMA_CAMERA = 7,
    DMA_CAMERA_AGAIN = 8,
    DMA_CHANNELS
};
enum { SYNC_MACHINE = 0, LAMP_MACHINE = 1, STEP_MACHINE = 2, CAMERA_MACHINE = 3 };        // PIO0
enum { CHIP_MACHINE = 0, TRIGGER_MACHINE = 1, ODOMETER_MACHINE = 2, GUARD_MACHINE = 3 };  // PIO1

// The pin whose falling edges are the sync edges from now on; another one than PIN_SYNC must stand high.
// `holdoff_ticks`: until a flash brings one; 0: as it was. `then`: the DMA channel that every stamp sets off, and which
// sets off DMA_STAMP in the end; or DMA_STAMP itself. No flash is loaded afterwards.
void lamps_follow(uint32_t pin, uint32_t holdoff_ticks, uint32_t then);

// Entry points of the programs that more than one file needs: turntable and cameras borrow the lamps' pulse.
enum { LAMP_IDLE = 16, LAMP_LAST_PULL = 20, LAMP_DELAY = 27 };
enum { GUARD_TAKE = 4, GUARD_WATCH = 5, GUARD_SPENT = 7, GUARD_CUT = 11 };
// From the tick that time_of_write gives to the first level of the machine of PIO1 that it starts: 2 cycles from LDR to
// STR, 1 until the machine runs, 1 until the level is at the pin.
#define START_OFFSET 4U
#define ODOMETER_PROGRAM 12U  // in PIO1, behind the microwave's
#define ODOMETER_PROGRAM_LENGTH 7U
#define MEASURE_PROGRAM 26U  // in PIO1, at the end

#endif
