// Which board carries the chip, measured and not guessed; and the 5 V of its USB socket, where it senses them.
//
// "Connecting to the Internet with Raspberry Pi Pico W", chapter "Which hardware am I running on?": with GP25 driven
// low, ADC input 3 (GP29) is a third of VSYS on a Pico, whose divider is always connected, and near 0 on a Pico W,
// where GP25 selects the radio and connects that divider only while it is high. Each is then asked for a second proof,
// so that a board of another maker is neither. A Pico W must show VSYS with GP25 high. A Pico must hold GP24 against
// both of the pad's pulls, as its divider from VBUS (5.6 kohm over 10 kohm) does with or without power; an open pin
// follows them. GP24 is touched on no other board: on a Pico W it is the radio's data line.

#include "../board.h"
#include "../core/messages.h"
#include "../pins.h"
#include "../ticks.h"
#include "hardware.h"
#include "registers.h"

#define PIN_VSYS 29U
#define ADC_INPUT_VSYS 3U
#define COUNTS(millivolts) ((millivolts)*4096U / 3300U)  // 12 bits of 3.3 V
#define NEAR_ZERO COUNTS(200U)                           // a transistor that is off lets 20 mV through
#define VSYS_LEAST COUNTS(500U)                          // 1.8 V at the least, by three, and tolerance
#define VSYS_MOST COUNTS(2000U)                          // 5.5 V at the most
#define DIVIDER_US 500U                                  // 66 kohm and 1 nF: seven times their 66 us
#define PULL_US 20U                                      // a pad's 80 kohm at most and an open pin's 50 pF: five times
#define CONVERSION_US 20U                                // takes 2; then it has failed

static uint8_t kind;
static uint32_t settled_us;      // when the divider has settled
static volatile bool vbus_fell;  // since somebody asked whether it is back

static void let_pass(const uint32_t microseconds)
{
    const uint32_t until = REGISTER(TIMER_RAW_LOW) + microseconds + 1U;
    while (!tick_is_past(REGISTER(TIMER_RAW_LOW), until)) {
    }
}

static bool adc_ready(void)
{
    const uint32_t until = REGISTER(TIMER_RAW_LOW) + CONVERSION_US;
    while ((REGISTER(ADC_CS) & ADC_READY) == 0U) {
        if (tick_is_past(REGISTER(TIMER_RAW_LOW), until)) {
            return false;
        }
    }
    return true;
}

// UINT32_MAX: it does not answer.
static uint32_t vsys_third(void)
{
    while (!tick_is_past(REGISTER(TIMER_RAW_LOW), settled_us)) {
    }
    if (!adc_ready()) {
        return UINT32_MAX;
    }
    REGISTER(ADC_CS) = ADC_ENABLE | ADC_INPUT(ADC_INPUT_VSYS) | ADC_START_ONCE;
    return adc_ready() ? REGISTER(ADC_RESULT) : UINT32_MAX;
}

static bool is_vsys(const uint32_t counts)
{
    return (counts >= VSYS_LEAST) && (counts <= VSYS_MOST);
}

static bool level_pulled(const uint32_t pull)
{
    REGISTER(PAD(PIN_VBUS)) = PAD_SCHMITT | pull;  // looked at only when it has been pulled: erratum RP2350-E9
    let_pass(PULL_US);
    SET_BITS(PAD(PIN_VBUS)) = PAD_INPUT;
    let_pass(0U);
    return ((REGISTER(SIO_GPIO_IN) >> PIN_VBUS) & 1U) != 0U;
}

// Once again if it seems to follow: the plug may have been moved in between.
static bool is_vbus_held(void)
{
    for (uint32_t i = 0; i < 2U; i++) {
        const bool up = level_pulled(PAD_PULL_UP);
        if (!up || level_pulled(PAD_PULL_DOWN)) {
            return true;
        }
    }
    return false;
}

static uint8_t find_kind(void)
{
    const uint32_t unselected = vsys_third();
    if (is_vsys(unselected)) {
        return is_vbus_held() ? BOARD_KIND_PICO : BOARD_KIND_UNKNOWN;
    }
    if (unselected > NEAR_ZERO) {
        return BOARD_KIND_UNKNOWN;
    }
    REGISTER(SIO_GPIO_OUT_SET) = 1U << PIN_STATUS;
    settled_us = REGISTER(TIMER_RAW_LOW) + DIVIDER_US;
    const uint32_t selected = vsys_third();
    REGISTER(SIO_GPIO_OUT_CLEAR) = 1U << PIN_STATUS;
    return is_vsys(selected) ? BOARD_KIND_PICO_W : BOARD_KIND_UNKNOWN;
}

void variant_prepare(void)
{
    REGISTER(PAD(PIN_VSYS)) = PAD_OUTPUT_DISABLE;  // no pull and no input
    settled_us = REGISTER(TIMER_RAW_LOW) + DIVIDER_US;
}

void variant_start(void)
{
    REGISTER(CLK_ADC_CTRL) = 1U << 11;  // the USB's PLL, 48 MHz, on
    CLEAR_BITS(RESETS_RESET) = RESET_ADC;
    while ((REGISTER(RESETS_DONE) & RESET_ADC) == 0U) {
    }
    REGISTER(ADC_CS) = ADC_ENABLE;
    kind = find_kind();
    if (variant_senses_vbus()) {
        pin_use(PIN_VBUS, FUNCTION_SIO, PAD_INPUT | PAD_SCHMITT);
    }
    SET_BITS(RESETS_RESET) = RESET_ADC;
    REGISTER(CLK_ADC_CTRL) = 0U;
}

uint8_t board_kind(void)
{
    return kind;
}

bool variant_senses_vbus(void)
{
    return VBUS_READS_TRUE && (kind == BOARD_KIND_PICO);
}

static bool has_vbus(void)
{
    return ((REGISTER(SIO_GPIO_IN) >> PIN_VBUS) & 1U) != 0U;
}

uint8_t board_vbus(void)
{
    if (!variant_senses_vbus()) {
        return PRESENCE_UNKNOWN;
    }
    return has_vbus() ? PRESENCE_PRESENT : PRESENCE_ABSENT;
}

void variant_vbus_gone(void)
{
    vbus_fell = true;
}

bool variant_vbus(void)
{
    return !variant_senses_vbus() || (!vbus_fell && has_vbus());
}

bool variant_vbus_back(void)
{
    vbus_fell = false;
    return variant_vbus();
}
