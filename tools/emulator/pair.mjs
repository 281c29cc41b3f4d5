// Two boards on one bench: the controller and the rig that tests it, with jumpers between them, in one process.
//
// Each has a crystal of its own: a tick of the rig is not a tick of the controller, and neither begins with the other's.
// What happens is taken in the order of one common time, which is counted in the controller's ticks: a cycle of hardware
// at the end at which its flip-flops take what stands before them, an instruction at its begin. A level that changes goes
// through the jumper at once and through the flip-flops of the board at the other end like any other. Cycles in which
// neither PIO of a board does anything are skipped, as the machine alone does it.

import { FLASH } from './bootrom.mjs';
import { INPUT_PINS, OUTPUT_PINS } from './controller.mjs';
import { Fault, Machine } from './machine.mjs';

const RAM = 0x20000000;
const MARK = 17; // of the rig: what it gives itself to begin with
const RIG = {
  inputs: OUTPUT_PINS.filter((pin) => pin < MARK),
  outputs: [...INPUT_PINS, MARK],
};

export class Pair {
  // `wires`: [controller's pin, rig's pin]; `ppm`: how much faster the rig's clock runs; `later`: ticks, not whole ones,
  // between power at the one and at the other.
  constructor(controllerUf2, rigUf2, { wires, ppm = 37.3, later = 1234.37 }) {
    this.controller = new Machine(controllerUf2);
    this.rig = new Machine(rigUf2, 'e66164084322b12f', 'pico', RIG);
    this.sides = [
      { machine: this.controller, rate: 1, began: 0, own: 0, drives: new Map() },
      { machine: this.rig, rate: 1 + ppm * 1e-6, began: later, own: 1, drives: new Map() },
    ];
    for (const [ours, theirs] of wires) {
      if (OUTPUT_PINS.includes(ours) && RIG.inputs.includes(theirs)) this.wire(0, ours, theirs);
      else if (INPUT_PINS.includes(ours) && RIG.outputs.includes(theirs)) this.wire(1, theirs, ours);
      else throw new Fault(`a jumper from GP${ours} to the rig's GP${theirs}: expected one from an output to an input`);
    }
    for (const side of this.sides) side.machine.onPin = (pin, tick) => this.carry(side, pin, this.timeOf(side, tick));
  }

  wire(from, pin, to) {
    const { drives } = this.sides[from];
    drives.set(pin, [...(drives.get(pin) ?? []), to]);
    this.carry(this.sides[from], pin, 0);
  }

  timeOf(side, tick) { return side.began + tick / side.rate; }
  tickAt(side, time) { return (time - side.began) * side.rate; }

  // An output that nobody drives leaves the level to the pull of the board that looks.
  carry(side, pin, time) {
    const ends = side.drives.get(pin);
    if (!ends) return;
    const { machine } = side;
    const gpio = machine.chip.gpio[pin];
    const other = this.sides[1 - side.own];
    const pulled = other.own === 0 || gpio.pullupEnabled ? 1 : 0;
    const level = gpio.outputEnable ? Number(gpio.outputValue) : pulled;
    const tick = Math.max(0, this.tickAt(other, time));
    for (const end of ends) {
      if (other.machine.levels.get(end) === level) continue;
      other.machine.sync(Math.max(other.machine.hardwareTick, Math.floor(tick)));
      const { core } = other.machine.chip;
      const slept = core.waiting;
      other.machine.drive(end, level);
      if (slept && !core.waiting) other.machine.now = Math.max(other.machine.now, Math.ceil(tick)); // it woke
    }
  }

  // Tick of what the processor, or a line to a host, does next.
  turnDue(machine) {
    if (machine.watchdogFired) return machine.now;
    const { core } = machine.chip;
    if (core.waiting && core.PM && core.checkForInterrupts()) core.waiting = false; // pending before it slept
    const held = Math.max(machine.heldUntil, machine.stalledUntil);
    if (machine.now >= held && !core.waiting) return machine.now;
    if (core.waiting) machine.loop.slept ??= machine.now;
    const alarm = machine.alarmTick;
    const next = Math.min(machine.now < held ? held : Infinity, alarm, machine.uart.next, machine.host.next);
    return Math.max(next, machine.now);
  }

  turn(machine, due) {
    const wasAwake = machine.now >= Math.max(machine.heldUntil, machine.stalledUntil) && !machine.chip.core.waiting;
    machine.now = due;
    machine.nextDue = 0;
    if (machine.watchdogFired) {
      machine.sync();
      machine.resets.push(machine.now);
      machine.scratch.set(machine.watchdog.scratchData);
      machine.boot(machine.watchdog.reason);
      if (machine.bootloader) machine.heldUntil = Infinity;
      return;
    }
    machine.tickClock();
    if (machine.uart.next <= due) machine.uart.run(due);
    if (machine.host.next <= due) machine.host.run(due);
    if (!wasAwake) return;
    const pc = machine.chip.core.registers[15];
    const wait = pc >= FLASH && pc < RAM ? machine.cache.wait(pc) : 0;
    if (wait > 0) { // fetched first: what it does is done when it is there
      machine.now += wait;
      return;
    }
    const cycles = machine.chip.core.executeInstruction() + machine.waits;
    machine.waits = 0;
    machine.now += cycles;
  }

  // Until this time, in the controller's ticks.
  run(until) {
    const [a, b] = this.sides;
    for (;;) {
      let first = null;
      let isTurn = false;
      let earliest = until;
      let tick = 0;
      for (const side of [a, b]) {
        const { machine } = side;
        const cycleEnds = Math.max(machine.hardwareTick, machine.quietUntil) + 1;
        const cycleTime = this.timeOf(side, cycleEnds);
        if (cycleTime < earliest) { earliest = cycleTime; first = side; isTurn = false; tick = cycleEnds; }
        const due = this.turnDue(machine);
        const dueTime = this.timeOf(side, due);
        if (dueTime < earliest) { earliest = dueTime; first = side; isTurn = true; tick = due; }
      }
      if (first === null) return;
      if (isTurn) this.turn(first.machine, tick);
      else first.machine.runHardware(tick);
    }
  }
}
