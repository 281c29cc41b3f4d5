// 100 MHz from the 12 MHz crystal, for the loader and, anew, for the application. No wait without an end: where crystal
// or PLL do not come, the ring oscillator stays (some 6 MHz), and whoever called learns which it was.

#ifndef ANNULUS_CLOCKS_H
#define ANNULUS_CLOCKS_H

#include <stdbool.h>
#include <stdint.h>

#include "registers.h"

#define CLOCK_PATIENCE                                                                                                 \
    100000U  // looks of ten cycles or so: 10 ms at 100 MHz, 0.1 s at 12; a crystal takes 1 ms, a PLL 0.1

enum { CLOCKS_RUN, CLOCKS_NO_CRYSTAL, CLOCKS_NO_PLL, CLOCKS_NO_USB_PLL };

static inline __attribute__((always_inline)) bool clock_came(const uint32_t address, const uint32_t bits)
{
    uint32_t looks = CLOCK_PATIENCE;
    while (((REGISTER(address) & bits) != bits) && (looks > 0U)) {
        looks--;
    }
    return looks > 0U;
}

// VCO 12 MHz * 100 = 1.2 GHz, divided by both dividers.
static inline bool pll_starts(const uint32_t pll, const uint32_t reset, const uint32_t first, const uint32_t second)
{
    SET_BITS(RESETS_RESET) = reset;
    CLEAR_BITS(RESETS_RESET) = reset;
    if (!clock_came(RESETS_DONE, reset)) {
        return false;
    }
    REGISTER(PLL_CS(pll)) = 1U;
    REGISTER(PLL_FBDIV(pll)) = 100U;
    CLEAR_BITS(PLL_PWR(pll)) = (1U << 0) | (1U << 5);  // power and VCO
    if (!clock_came(PLL_CS(pll), 1U << 31)) {          // locked
        return false;
    }
    REGISTER(PLL_PRIM(pll)) = (first << 16) | (second << 12);
    CLEAR_BITS(PLL_PWR(pll)) = 1U << 3;  // dividers
    return true;
}

// Both PLLs, and the clocks they drive. What fails leaves the clocks before it.
static inline uint32_t clocks_start(void)
{
    microseconds_start();
    REGISTER(XOSC_CTRL) = 0xAA0U;  // 1..15 MHz
    REGISTER(XOSC_STARTUP) = 47U;  // 1 ms in units of 256 cycles
    SET_BITS(XOSC_CTRL) = 0xFABU << 12;
    REGISTER(CLK_SYS_CTRL) = 0U;  // from clk_ref while the PLL is set up
    if (!clock_came(CLK_SYS_SELECTED, 1U << 0) || !clock_came(XOSC_STATUS, 1U << 31)) {
        return CLOCKS_NO_CRYSTAL;
    }
    REGISTER(CLK_REF_CTRL) = 2U;  // crystal
    if (!clock_came(CLK_REF_SELECTED, 1U << 2)) {
        return CLOCKS_NO_CRYSTAL;
    }
    if (!pll_starts(PLL_SYS, RESET_PLL_SYS, 6U, 2U)) {  // 100 MHz
        return CLOCKS_NO_PLL;
    }
    REGISTER(CLK_SYS_CTRL) = 0U << 5;         // its second source: the PLL
    REGISTER(CLK_SYS_CTRL) = (0U << 5) | 1U;  // take it
    if (!clock_came(CLK_SYS_SELECTED, 1U << 1)) {
        return CLOCKS_NO_PLL;
    }
    if (!pll_starts(PLL_USB, RESET_PLL_USB, 5U, 5U)) {  // 48 MHz
        return CLOCKS_NO_USB_PLL;
    }
    REGISTER(CLK_PERI_CTRL) = 1U << 11;  // clk_sys, on
    REGISTER(CLK_USB_CTRL) = 1U << 11;   // the USB's PLL, on
    return CLOCKS_RUN;
}

#endif
