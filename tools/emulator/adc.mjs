// The ADC as far as the firmware uses it: one conversion at a time of one input. And what hangs on it and on GP24 on the
// boards there are (their schematics): a Pico, a Pico W, or one of another maker ("other") where both pins are open.

import { fault, hex } from './fault.mjs';
import { adcMHz } from './clocks.mjs';
import { PIN } from './controller.mjs';
import { pull } from './inputs.mjs';

const VSYS_PIN = 29, VSYS_INPUT = 3;
const READY_TICKS = 100; // after it is switched on; the datasheet names no time
const CONVERSION_TICKS = 200; // 96 cycles of 48 MHz
const TAU_TICKS = 6_600; // the divider's 200 and 100 kohm with the 1 nF at the pin
const REFERENCE = 3.3;
const PULL_KOHM = 60, DIVIDER_KOHM = 200 / 3; // a pad's pull: 50 to 80
const OFF_V = 0.02; // the W's divider, with its transistor off
const OPEN_V = 0.31; // an open pin of the ADC: anything, so what is neither

export const BOARDS = ['pico', 'pico-w', 'other'];

class Adc {
  constructor(kind, clockMHz) {
    if (!BOARDS.includes(kind)) fault(`board ${kind}: expected one of ${BOARDS.join(', ')}`);
    this.kind = kind;
    this.clockMHz = clockMHz; // () => of clk_adc, 0 = off
    this.vsys = 4.7; // 5 V behind the board's diode
    this.volts = 0;
    this.since = 0;
    this.selected = false; // GP25 is high
    this.pad = 0x56;
    this.reset();
  }

  reset() { this.control = 0; this.readyAt = Infinity; this.result = undefined; }

  get target() {
    const isPulled = (this.pad >>> 2) & 3; // 1: down, 2: up
    if (this.kind === 'other') return isPulled === 2 ? REFERENCE : isPulled === 1 ? 0 : OPEN_V;
    if (this.kind === 'pico-w' && !this.selected) return OFF_V;
    const open = this.vsys / 3;
    return isPulled === 0 ? open : (open * PULL_KOHM + (isPulled === 2 ? REFERENCE : 0) * DIVIDER_KOHM) / (PULL_KOHM + DIVIDER_KOHM);
  }

  at(now) { return this.target + (this.volts - this.target) * Math.exp(-(now - this.since) / TAU_TICKS); }

  // Before anything of it changes.
  settle(now) { this.volts = this.at(now); this.since = now; }

  padWritten(pin, value, now) { if (pin === VSYS_PIN) { this.settle(now); this.pad = value; } }

  select(level, now) { this.settle(now); this.selected = level === 1; }

  readUint32(offset, now) {
    if (offset === 0) return this.control | (now >= this.readyAt ? 1 << 8 : 0);
    if (offset !== 4) fault(`ADC: read of register ${hex(offset)} is not modelled`);
    if (this.result === undefined || now < this.readyAt) fault('ADC: RESULT read before a conversion was over');
    return this.result;
  }

  writeUint32(offset, value, now) {
    if (offset !== 0) fault(`ADC: write of register ${hex(offset)} is not modelled`);
    if (value & ~0x7005) fault(`ADC: CS ${hex(value)} is not modelled`);
    if (this.clockMHz() !== 48) fault(`ADC used with clk_adc at ${this.clockMHz()} MHz, expected 48`);
    const wasOn = this.control & 1;
    this.control = value & 0x7001;
    if (!(value & 1)) this.readyAt = Infinity;
    else if (!wasOn) this.readyAt = now + READY_TICKS;
    if (!(value & 4)) return;
    if (!wasOn || now < this.readyAt) fault('ADC: a conversion started before it was ready');
    if (((value >>> 12) & 7) !== VSYS_INPUT) fault(`ADC: input ${(value >>> 12) & 7} is not modelled`);
    if (this.pad & 0x4c) fault(`GP${VSYS_PIN} is measured with its pad's pulls or its digital input on`);
    this.readyAt = now + CONVERSION_TICKS;
    this.result = Math.max(0, Math.min(4095, Math.round((this.at(now) / REFERENCE) * 4096) + 8)); // some counts off
  }
}

// GP24 on the board: what its divider makes of VBUS on a Pico, whatever the pad pulls. On a Pico W the radio drives it.
function checkVbusPad(kind, pin, value) {
  if (kind === 'pico-w' && pin === PIN.VBUS && value & 0x48) fault('GP24 is taken for an input or pulled up: on a Pico W it is the data line of the radio');
}

// What is around the chip: the ADC's divider, and VBUS where it is sensed.
export function fitBoard(machine, board) {
  machine.adc = new Adc(board, () => adcMHz(machine));
  if (board !== 'pico') return;
  machine.usb.onCable = (isIn) => { machine.sync(); machine.drive(PIN.VBUS, isIn ? 1 : 0); };
  machine.held.add(PIN.VBUS);
  machine.levels.set(PIN.VBUS, 0);
}

export function padWritten(machine, pin) {
  const { padValue } = machine.chip.gpio[pin];
  checkVbusPad(machine.adc.kind, pin, padValue);
  machine.adc.padWritten(pin, padValue, machine.now);
  pull(machine, pin);
}
