// The frames of the USB: the host begins one each millisecond and numbers it. The device controller must be kept clear
// of their ends, and is known by them to live: erratum RP2040-E15.
//
// With some hosts (the hub of a Pi 4 or 400) a packet fetched at the very end of a frame is acknowledged by garbage,
// and from that the controller never recovers: it answers no packet, sees no bus reset and counts no frame until the
// whole block is reset. Hosts fetch a packet for bulk in as soon as there is one, so none is handed over late in a
// frame.
//
// Nobody says when a frame began. It was after the last look that still read the number before, so a frame is taken to
// be older than it is, never younger; who has not looked for long waits for the next one.
//
// From the look to the hand-over passes time too: half a microsecond, and the interrupts that come between, none of
// which takes 10. 20 are kept for them; the emulator holds the image to the 800.

#include "../ticks.h"
#include "hardware.h"
#include "registers.h"
#include "endpoints.h"

#define EARLY_US 780U    // of a frame's 1000: 800 is TinyUSB's bound, from the maker; the rest is below
#define STILL_US 20000U  // so many frames are not lost in a row on a bus that is awake
#define WAKE_US 100000U  // hosts signal the end of a suspension for 20 to 40 ms, and only then begin frames

static struct {
    uint32_t number;
    uint32_t looked_us;
    uint32_t began_us;    // at the earliest
    uint32_t overdue_us;  // when the next one should long have begun
} frame;

static uint32_t look(void)
{
    const uint32_t now_us = REGISTER(TIMER_RAW_LOW);  // before the number: what is read later may have begun later
    const uint32_t number = REGISTER(USB_SOF_RD);
    if (number != frame.number) {
        frame.number = number;
        frame.began_us = frame.looked_us;
        frame.overdue_us = now_us + STILL_US;
    }
    frame.looked_us = now_us;
    return now_us;
}

void usb_frame_wake(void)
{
    frame.overdue_us = look() + WAKE_US;
}

bool usb_frame_early(void)
{
    return look() - frame.began_us < EARLY_US;
}

bool usb_frame_overdue(void)
{
    return tick_is_past(look(), frame.overdue_us);
}
