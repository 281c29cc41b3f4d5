// Input pins that nobody drives, and jumpers to them.

import { fault } from './fault.mjs';

// An input that nobody drives is what its pad pulls it to.
export function pull(machine, pin) {
  if (!machine.inputPins.includes(pin) || machine.held.has(pin)) return;
  const pulls = (machine.chip.gpio[pin].padValue >>> 2) & 3; // 1: down, 2: up
  if (pulls === 0 || pulls === 3) fault(`GP${pin} is driven by nobody and pulled ${pulls ? 'both ways' : 'nowhere'}: its level is anybody's guess`);
  machine.sync();
  machine.put(pin, pulls >> 1);
}

// Its wire is off.
export function letGo(machine, pin) {
  machine.held.delete(pin);
  pull(machine, pin);
}

// Jumpers, [output, input] each, in place of those before.
export function setWires(machine, wires) {
  for (const [from, to] of wires) if (!machine.outputPins.includes(from) || !machine.inputPins.includes(to)) fault(`a wire from GP${from} to GP${to}: expected from an output to an input`);
  machine.sync();
  for (const to of machine.wires.values()) letGo(machine, to);
  machine.wires = new Map(wires);
  for (const [from, to] of wires) machine.drive(to, machine.pinLevels.get(from) ?? 0);
}
