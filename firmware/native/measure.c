// The controller looks at its own pins: their levels in every tick of a look, kept as they change.

#include <string.h>

#include "hardware.h"

#define LOOK_TICKS (8U * BOARD_LOOK_WORDS)
#define BEGIN_TICKS 2U  // from the edge to the first sample of a look without delay, as on the Pico

static struct {
    bool measuring;
    bool looking;
    bool seen;  // the edge of this look, at `edge`
    bool differs;
    uint64_t edge;
    uint32_t filled;  // samples of this look
    uint16_t taken;
    board_look_t look;
    uint32_t words[2][BOARD_LOOK_WORDS];
} measure;

void measure_start(void)
{
    memset(&measure, 0, sizeof measure);
}

static uint32_t levels_now(void)
{
    uint32_t levels = 0;
    for (uint32_t i = 0; i < 4U; i++) {
        const uint32_t pin = measure.look.first + i;
        const uint32_t level = (pin < PIN_COUNT) ? world.levels[pin] : 0U;
        const bool turned = (pin == PIN_SYNC) && ((world.inverted & POLARITY_SYNC) != 0U);
        levels |= (turned ? 1U - level : level) << i;
    }
    return levels;
}

static void fill(void)
{
    const uint64_t begin = measure.edge + measure.look.delay_ticks + BEGIN_TICKS;
    const uint32_t levels = levels_now();
    uint32_t* const words = measure.words[(measure.taken > 0U) ? 1 : 0];
    for (; (measure.filled < LOOK_TICKS) && (begin + measure.filled < world.now); measure.filled++) {
        words[measure.filled / 8U] = (words[measure.filled / 8U] << 4) | levels;
    }
}

void measure_before(void)
{
    if (measure.looking && measure.seen) {
        fill();
    }
}

void measure_after(const uint8_t pin, const uint8_t level)
{
    if (measure.looking && !measure.seen && (pin == measure.look.pin) && (level == measure.look.level)) {
        measure.seen = true;
        measure.edge = world.now;
        measure.filled = 0;
    }
}

void board_measure(const board_look_t* const look)
{
    time_pass();
    measure_start();
    measure.look = *look;
    measure.measuring = look->looks > 0U;
    measure.looking = measure.measuring;
}

bool measure_is_measuring(void)
{
    return measure.measuring;
}

bool board_measuring(void)
{
    time_look();
    return measure.measuring;
}

void board_measure_run(void)
{
    time_look();
    measure_before();
    if (!measure.looking || !measure.seen || (measure.filled < LOOK_TICKS)) {
        return;
    }
    measure.seen = false;
    measure.taken++;
    measure.differs =
        (measure.taken > 1U) && (memcmp(measure.words[0], measure.words[1], sizeof measure.words[0]) != 0);
    measure.looking = (measure.taken < measure.look.looks) && !measure.differs;
}

uint16_t board_measured(const bool latest, const uint8_t word, uint8_t bits[const BOARD_SAMPLE_BYTES],
                        bool* const differs)
{
    time_look();
    *differs = measure.differs;
    memcpy(bits, &measure.words[latest ? 1 : 0][word], BOARD_SAMPLE_BYTES);
    return measure.taken;
}
