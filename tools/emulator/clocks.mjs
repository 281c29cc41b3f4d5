// The clocks that USB and ADC take from the USB's PLL, in MHz; 0 = off.

const PLL_USB_RESET = 13;

// It runs, within the VCO's range.
function pllUsbMHz(machine) {
  const pll = machine.chip.peripherals[0x4002c];
  const vco = (12 / (pll.cs & 63)) * pll.fbdivInt;
  const isOn = !(pll.pwr & 0x29) && vco >= 750 && vco <= 1600;
  return isOn && !((machine.inReset >>> PLL_USB_RESET) & 1) ? pll.frequency / 1e6 : 0;
}

// The PLL, and the clock is let through.
const through = (machine, control) => (machine.chip.peripherals[0x40008].readUint32(control) & (1 << 11) ? pllUsbMHz(machine) : 0);

export const usbMHz = (machine) => through(machine, 0x54);
export const adcMHz = (machine) => through(machine, 0x60);
