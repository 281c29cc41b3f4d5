// The machine that holds gate and trigger low whatever the others do.
//
// GUARD waits for the interlock to open, or for its credit to run out, and then drives gate and trigger low in every
// cycle; of several machines that write a pin in one cycle the highest-numbered wins (datasheet 3.5.6.1), so nothing
// the others do is seen any more. Of two inputs of the interlock it sees the first as a jump's pin, and the second in a
// loop of its own, GUARD_BOTH, which samples it every sixth cycle and still looks at the first every third. A credit is
// 2 ms of time; the main loop lays out the next one when the last has been taken. So a main loop that stands still
// leaves both pins low 4 ms later at most, long before the watchdog bites.

#include "../board.h"
#include "hardware.h"
#include "../pins.h"
#include "../ticks.h"
#include "registers.h"

enum { GUARD_BOTH = 19, GUARD_BOTH_LENGTH = 7 };

// In place of GUARD_WATCH and what follows it, where the interlock has two inputs. OSR and Y are free until the credit
// is spent.
static const uint16_t guard_both[GUARD_BOTH_LENGTH] = {
    JMP_PIN(GUARD_CUT),
    MOV_OSR_PINS,  // the second input in bit 0
    OUT_Y(1U),
    JMP_PIN(GUARD_CUT),
    JMP_NOT_Y(GUARD_CUT),  // low: open, or its wire is broken
    JMP_X_DEC(GUARD_BOTH),
    JMP(GUARD_SPENT),
};
_Static_assert(GUARD_BOTH == ODOMETER_PROGRAM + ODOMETER_PROGRAM_LENGTH, "behind the odometer's program");
_Static_assert(GUARD_BOTH + GUARD_BOTH_LENGTH == MEASURE_PROGRAM, "and before that which measures");

#define CREDIT_GONE UINT32_MAX  // GUARD's count after the last one

// How GUARD lives on a credit, with one input to look at and with both. 2 ms either way.
typedef struct {
    uint32_t watch;   // where it counts a credit down
    uint32_t credit;  // from here to 0
    uint32_t step;    // ticks to count one
    uint32_t more;    // ticks from a credit that is spent to the first step of the next one
} guard_t;
static const guard_t guard_one = {.watch = GUARD_WATCH, .credit = 100000U, .step = 2U, .more = 5U};
static const guard_t guard_two = {.watch = GUARD_BOTH, .credit = 33332U, .step = 6U, .more = 7U};

static const guard_t* guard;
static uint32_t guarded;  // tick at which GUARD took its first credit
static uint32_t credits;  // laid out since, the first one not counted

static void execute(const uint32_t instruction)
{
    REGISTER(PIO_INSTRUCTION(PIO1, GUARD_MACHINE)) = instruction;
}

bool guard_is_cutting(void)
{
    return REGISTER(PIO_ADDRESS(PIO1, GUARD_MACHINE)) == GUARD_CUT;
}

static uint32_t credits_waiting(void)
{
    return (REGISTER(PIO_FLEVEL(PIO1)) >> (8U * GUARD_MACHINE)) & 0xFU;
}

// How long one lasts.
static uint32_t credit_ticks(void)
{
    return guard->step * (guard->credit + 1U) + guard->more;
}

static void lay_out_credit(void)
{
    REGISTER(PIO_TX(PIO1, GUARD_MACHINE)) = guard->credit;
    credits++;
}

void guard_feed(void)
{
    if (credits_waiting() == 0U) {
        lay_out_credit();
    }
}

void guard_start(void)
{
    for (uint32_t i = 0; i < 4U; i++) {
        execute(PULL_NO_BLOCK);  // credits left from before
    }
    lay_out_credit();
    execute(PULL_NO_BLOCK);
    execute(MOV_X_OSR);
    credits = 0;
    lay_out_credit();
    // One tick more: forced upon a machine that runs, it is carried out in the cycle after.
    guarded = time_of_write(PIO_INSTRUCTION(PIO1, GUARD_MACHINE), JMP(guard->watch)) + START_OFFSET + 1U;
}

// When GUARD cut, by its own count, and why.
uint32_t guard_cut_tick(bool* const starved)
{
    execute(MOV_ISR_X);
    execute(PUSH_NO_BLOCK);
    const uint32_t left = REGISTER(PIO_RX(PIO1, GUARD_MACHINE));
    const uint32_t taken = credits - credits_waiting();
    *starved = left == CREDIT_GONE;
    const uint32_t tick =
        guarded + taken * credit_ticks() + (*starved ? credit_ticks() : guard->step * (guard->credit - left));
    const uint32_t now = board_tick();  // cut while it changed from one credit to the next, its count is of neither
    return tick_is_past(tick, now) ? now : tick;
}

// Nothing is forced upon a machine that may be cutting: the word that it comes by every second tick, or after ten
// (every sixth, or after 13), sends it there.
void guard_cut(void)
{
    REGISTER(PIO_MEMORY(PIO1, guard->watch)) = JMP(GUARD_CUT);
    while (!guard_is_cutting()) {
    }
    REGISTER(PIO_MEMORY(PIO1, guard->watch)) = JMP_PIN(GUARD_CUT);
}

void board_interlock_watch(const bool antivalent)
{
    pinuse_watch_interlock(antivalent);
    guard = antivalent ? &guard_two : &guard_one;
    // A spent credit's way to the next one leads through here; GUARD stands at GUARD_CUT and does not come by.
    REGISTER(PIO_MEMORY(PIO1, GUARD_WATCH)) = antivalent ? JMP(GUARD_BOTH) : JMP_PIN(GUARD_CUT);
}

void guard_load(void)
{
    pio_load(PIO1, GUARD_BOTH, guard_both, GUARD_BOTH_LENGTH);
    guard = &guard_one;
    REGISTER(PIO_EXECCTRL(PIO1, GUARD_MACHINE)) = EXEC_JUMP_PIN(PIN_INTERLOCK) | EXEC_WRAP(GUARD_CUT, GUARD_CUT);
    REGISTER(PIO_SHIFTCTRL(PIO1, GUARD_MACHINE)) = SHIFT_OUT_RIGHT;
    REGISTER(PIO_PINCTRL(PIO1, GUARD_MACHINE)) =
        PINS_SET(PIN_MICROWAVE, 2U) | PINS_IN(PIN_INTERLOCK_ANTIVALENT);  // and the trigger next to it
    execute(JMP(GUARD_CUT));
    SET_BITS(PIO_CTRL(PIO1)) = PIO_MACHINE(GUARD_MACHINE);
}
