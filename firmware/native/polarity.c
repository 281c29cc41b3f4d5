// Pins that the wiring inverts. Whoever looks at the sync input while it is turned over may see it fall.

#include "hardware.h"

void board_polarity(const uint8_t pins, const uint8_t inverted)
{
    time_pass();
    const uint8_t before = pinuse_seen(PIN_SYNC);
    pinuse_polarity(pins, inverted);
    if ((before == 1U) && (pinuse_seen(PIN_SYNC) == 0U) && !camera_trigger_leads()) {
        lamps_edge();
    }
}
