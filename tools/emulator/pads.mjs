// What stands between pads and peripherals (RP2040 datasheet, 2.19): the overrides that invert or force an input or an
// output, which rp2040js has for values and not for interrupts, and resistors outside for pads that nobody drives.

import { GPIOPinState } from 'rp2040js';
import { fault } from './fault.mjs';

const EDGE_HIGH = 8;
const EDGE_LOW = 4;
const LEVEL_HIGH = 2;
const LEVEL_LOW = 1;

// The interrupt's edges and levels are of what the override makes of the pad, as every peripheral sees it.
export function putBehindOverride(pin) {
  let seen = pin.inputValue;
  pin.setInputValue = (value) => {
    pin.rawInputValue = value;
    const before = pin.irqValue;
    const now = pin.inputValue;
    if (now !== seen) {
      pin.irqStatus = (pin.irqStatus & ~(LEVEL_HIGH | LEVEL_LOW)) | (now ? EDGE_HIGH | LEVEL_HIGH : EDGE_LOW | LEVEL_LOW);
      seen = now;
    }
    if (pin.irqValue !== before) pin.rp2040.updateIOInterrupt();
  };
}

// Level at an output's pad. `outside`: of a resistor there, stronger than the pad's own.
export function padLevel(pin, outside) {
  const value = pin.value;
  if (value === GPIOPinState.High) return 1;
  if (value === GPIOPinState.Low) return 0;
  return outside ?? (value === GPIOPinState.InputPullUp ? 1 : 0);
}

// Function and overrides of a pin: whoever looks at it may see another level from here on.
export function writePinControl(machine, offset, value, kind) {
  const { chip } = machine;
  machine.sync();
  machine.quietUntil = machine.hardwareTick;
  chip.findPeripheral(0x40014000).writeUint32Atomic(offset, value, kind);
  const index = offset >> 3;
  if (machine.inputPins.includes(index)) chip.gpio[index].setInputValue(machine.levels.get(index) === 1);
  else if (machine.outputPins.includes(index)) machine.note(index);
}

// Resistors outside, [output, level] each, in place of those before: what its pad shows while nobody drives it.
export function setPulls(machine, pulls) {
  machine.sync();
  machine.pulls = new Map(pulls);
  for (const pin of machine.outputPins) machine.note(pin);
}
