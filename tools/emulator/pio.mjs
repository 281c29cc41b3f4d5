// One PIO block, cycle by cycle: delays, enables, stalls, flags that are seen one cycle later, inputs through two
// flip-flops, the highest-numbered machine's write winning. What the firmware does not use is refused, not guessed:
// clock dividers, side-set, FIFO join, autopull, OUT EXEC and the like.
//
// `quiet` tells for how many cycles nothing can happen that anybody outside sees, as long as nobody outside does
// anything; `skip` then goes through them at once.

import { fault, hex } from './fault.mjs';

const FIFO_DEPTH = 4;
const LOOP_MAX = 6; // instructions of an idle loop that `quiet` recognises

class Machine {
  constructor(pio, index) {
    this.pio = pio;
    this.index = index;
    this.enabled = false;
    this.clkdiv = 1 << 16;
    this.execctrl = 0x1f << 12;
    this.shiftctrl = 3 << 18;
    this.pinctrl = 5 << 26;
    this.x = 0;
    this.y = 0;
    this.isr = 0;
    this.isrCount = 0;
    this.osr = 0;
    this.osrCount = 32;
    this.pc = 0;
    this.delay = 0;
    this.forced = null; // an instruction that takes the next cycle
    this.tx = [];
    this.rx = [];
  }

  get wrapTop() { return (this.execctrl >>> 12) & 31; }
  get wrapBottom() { return (this.execctrl >>> 7) & 31; }
  get autopush() { return ((this.shiftctrl >>> 16) & 1) === 1; } // every 32 bits

  wouldPush(count) { return this.autopush && this.isrCount + count >= 32; }

  writePins(kind, value, base, count) {
    const pio = this.pio;
    for (let i = 0; i < count; i++) {
      const bit = 1 << ((base + i) & 31);
      if ((value >>> i) & 1) pio[kind] |= bit;
      else pio[kind] &= ~bit;
    }
  }

  outPins(value) { this.writePins('nextValues', value, this.pinctrl & 31, (this.pinctrl >>> 20) & 63); }
  setPins(kind, value) { this.writePins(kind, value, (this.pinctrl >>> 5) & 31, (this.pinctrl >>> 26) & 7); }

  inPins() {
    const base = (this.pinctrl >>> 15) & 31;
    const v = this.pio.visible >>> 0;
    return (base ? (v >>> base) | (v << (32 - base)) : v) >>> 0;
  }

  source(code) {
    switch (code) {
      case 0: return this.inPins();
      case 1: return this.x;
      case 2: return this.y;
      case 3: return 0;
      case 6: return this.isr;
      case 7: return this.osr;
    }
    fault(`PIO${this.pio.number} machine ${this.index}: source ${code} is not modelled`);
  }

  // Carry out one instruction. False: stalled. Sets `jumped` when it chose the next pc itself.
  execute(word) {
    const pio = this.pio;
    const arg = word & 31;
    this.jumped = false;
    switch (word >>> 13) {
      case 0: {
        let take;
        switch ((word >>> 5) & 7) {
          case 0: take = true; break;
          case 1: take = this.x === 0; break;
          case 2: take = this.x !== 0; this.x = (this.x - 1) >>> 0; break;
          case 3: take = this.y === 0; break;
          case 4: take = this.y !== 0; this.y = (this.y - 1) >>> 0; break;
          case 5: take = this.x !== this.y; break;
          case 6: take = ((pio.visible >>> ((this.execctrl >>> 24) & 31)) & 1) === 1; break;
          default: fault('JMP !OSRE is not modelled');
        }
        if (take) { this.pc = arg; this.jumped = true; }
        return true;
      }
      case 1: {
        const polarity = (word >>> 7) & 1;
        switch ((word >>> 5) & 3) {
          case 0: return ((pio.visible >>> arg) & 1) === polarity;
          case 1: return ((pio.visible >>> ((arg + ((this.pinctrl >>> 15) & 31)) & 31)) & 1) === polarity;
          case 2:
            if (arg & 0x10) fault('relative flags are not modelled');
            if (((pio.flags >>> (arg & 7)) & 1) !== polarity) return false;
            if (polarity) pio.flagsCleared |= 1 << (arg & 7);
            return true;
        }
        fault('WAIT with reserved source');
        break;
      }
      case 2: {
        const count = arg || 32;
        const mask = count === 32 ? 0xffffffff : (1 << count) - 1;
        if (this.wouldPush(count) && this.rx.length === FIFO_DEPTH) { pio.debug |= 1 << this.index; return false; }
        const value = (this.source((word >>> 5) & 7) & mask) >>> 0;
        if ((this.shiftctrl >>> 18) & 1) fault('IN to the right is not modelled');
        this.isr = count === 32 ? value : ((this.isr << count) | value) >>> 0;
        this.isrCount = Math.min(32, this.isrCount + count);
        if (this.autopush && this.isrCount === 32) {
          this.rx.push(this.isr);
          this.isr = 0;
          this.isrCount = 0;
          pio.touched = true;
        }
        return true;
      }
      case 3: {
        const count = arg || 32;
        if (!((this.shiftctrl >>> 19) & 1)) fault('OUT to the left is not modelled');
        if (this.osrCount + count > 32) fault(`PIO${pio.number} machine ${this.index}: OUT from an empty OSR`);
        const value = (count === 32 ? this.osr : this.osr & ((1 << count) - 1)) >>> 0;
        this.osr = count === 32 ? 0 : this.osr >>> count;
        this.osrCount += count;
        switch ((word >>> 5) & 7) {
          case 0: this.outPins(value); return true;
          case 1: this.x = value; return true;
          case 2: this.y = value; return true;
          case 3: return true;
        }
        fault('this OUT is not modelled');
        break;
      }
      case 4: {
        if (word & 0x5f) fault('this PUSH or PULL is not modelled');
        const block = (word >>> 5) & 1;
        if ((word >>> 7) & 1) {
          if (this.tx.length > 0) this.osr = this.tx.shift();
          else if (block) { pio.debug |= 1 << (24 + this.index); return false; }
          else this.osr = this.x;
          this.osrCount = 0;
          pio.touched = true;
        } else {
          if (this.rx.length === FIFO_DEPTH) {
            pio.debug |= 1 << this.index;
            if (block) return false;
            pio.dropped[this.index]++;
          } else this.rx.push(this.isr);
          this.isr = 0;
          this.isrCount = 0;
          pio.touched = true;
        }
        return true;
      }
      case 5: {
        let value = this.source(word & 7);
        const operation = (word >>> 3) & 3;
        if (operation === 1) value = ~value >>> 0;
        else if (operation !== 0) fault('this MOV is not modelled');
        switch ((word >>> 5) & 7) {
          case 0: this.outPins(value); return true;
          case 1: this.x = value; return true;
          case 2: this.y = value; return true;
          case 6: this.isr = value; this.isrCount = 0; return true;
          case 7: this.osr = value; this.osrCount = 0; return true;
        }
        fault('this MOV is not modelled');
        break;
      }
      case 6:
        if (word & 0xb8) fault('this IRQ is not modelled');
        if (word & 0x40) pio.flagsCleared |= 1 << (arg & 7);
        else pio.flagsSet |= 1 << (arg & 7);
        return true;
      case 7:
        switch ((word >>> 5) & 7) {
          case 0: this.setPins('nextValues', arg); return true;
          case 1: this.x = arg; return true;
          case 2: this.y = arg; return true;
          case 4: this.setPins('nextDirections', arg); return true;
        }
        fault('this SET is not modelled');
    }
    return true;
  }

  step() {
    if (this.forced !== null) {
      const word = this.forced;
      this.forced = null;
      this.carryOut(word);
      return;
    }
    if (this.delay > 0) { this.delay--; return; }
    const at = this.pc;
    const word = this.pio.memory[at];
    if (word === undefined) fault(`PIO${this.pio.number} machine ${this.index} runs at ${at}, where no program is`);
    if (!this.execute(word)) return;
    if (!this.jumped) this.pc = at === this.wrapTop ? this.wrapBottom : (at + 1) & 31;
    this.delay = (word >>> 8) & 31;
  }

  // By SMx_INSTR. A machine that runs does it in its next cycle, in place of what its program has there (datasheet
  // 3.5.7): an instruction that drives a pin in every cycle then does not drive it in that one. One that stands does it
  // at once. A stalled instruction written so is not modelled.
  force(word) {
    if ((word >>> 8) & 31) fault('a forced instruction with a delay is not modelled');
    if (!this.enabled) { this.carryOut(word); return; }
    if (this.forced !== null) fault(`PIO${this.pio.number}: two forced instructions within a cycle`);
    this.forced = word;
  }

  carryOut(word) {
    const before = this.pc;
    if (!this.execute(word)) fault(`PIO${this.pio.number}: forced instruction ${hex(word)} stalls`);
    this.delay = 0;
    if (!this.jumped) this.pc = before;
  }

  // Cycles in which this machine does nothing anybody sees, all else being equal.
  quiet() {
    if (!this.enabled) return Infinity;
    if (this.forced !== null) return 0;
    if (this.delay > 0) return this.delay;
    const { pio, pc: pc0, x: x0, y: y0, isr: isr0, osr: osr0, osrCount: count0 } = this;
    this.loop = null;
    let cycles = 0;
    let result = 0;
    for (let i = 0; i < LOOP_MAX; i++) {
      const word = pio.memory[this.pc];
      const kind = word >>> 13;
      if (kind === 6 || (kind === 3 && ((word >>> 5) & 7) === 0)) break;
      if (kind === 2 && this.autopush) {
        if (i === 0 && this.wouldPush((word & 31) || 32) && this.rx.length === FIFO_DEPTH) result = Infinity;
        break;
      }
      if (kind === 1 || kind === 4) {
        if (kind === 1 ? this.wouldWait(word) : this.wouldBlock(word)) result = i === 0 ? Infinity : 0;
        break;
      }
      if (kind === 5 && ((word >>> 5) & 7) === 0) break;
      if (kind === 7) {
        if (((word >>> 5) & 7) !== 0) break;
        const before = pio.nextValues;
        this.setPins('nextValues', word & 31);
        const same = before === pio.nextValues;
        pio.nextValues = before;
        if (!same) break;
        this.jumped = false;
      } else this.execute(word);
      const at = this.pc;
      if (!this.jumped) this.pc = at === this.wrapTop ? this.wrapBottom : (at + 1) & 31;
      cycles += 1 + ((word >>> 8) & 31);
      if (this.pc === pc0) {
        const dx = (x0 - this.x) >>> 0;
        const dy = (y0 - this.y) >>> 0;
        if (dx <= 1 && dy <= 1 && this.isr === isr0 && this.osr === osr0) {
          const times = Math.min(dx ? x0 - 1 : Infinity, dy ? y0 - 1 : Infinity);
          if (times > 0) {
            this.loop = { cycles, dx, dy };
            result = times === Infinity ? Infinity : times * cycles;
          }
        }
        break;
      }
    }
    this.pc = pc0; this.x = x0; this.y = y0; this.isr = isr0; this.osr = osr0; this.osrCount = count0;
    return result;
  }

  wouldWait(word) {
    const arg = word & 31;
    const polarity = (word >>> 7) & 1;
    if (((word >>> 5) & 3) === 2) return ((this.pio.flags >>> (arg & 7)) & 1) !== polarity;
    return ((this.pio.visible >>> arg) & 1) !== polarity;
  }

  wouldBlock(word) {
    return (word & 0x20) !== 0 && ((word & 0x80) !== 0 ? this.tx.length === 0 : this.rx.length === FIFO_DEPTH);
  }

  skip(cycles) {
    if (!this.enabled) return;
    if (this.delay > 0) { this.delay -= cycles; return; }
    if (this.loop) {
      const times = Math.floor(cycles / this.loop.cycles);
      if (this.loop.dx) this.x = (this.x - times) >>> 0;
      if (this.loop.dy) this.y = (this.y - times) >>> 0;
      cycles -= times * this.loop.cycles;
      for (; cycles > 0; cycles--) this.step();
      this.loop = null; // the phase has changed
    }
  }
}

export class Pio {
  constructor(number) {
    this.number = number;
    this.reset();
  }

  reset() {
    this.machines = []; // rp2040js looks through these at input changes: let it find none
    this.state = [0, 1, 2, 3].map((i) => new Machine(this, i));
    this.memory = new Array(32).fill(undefined);
    this.flags = 0;
    this.flagsSet = 0;
    this.flagsCleared = 0;
    this.pinValues = 0;
    this.pinDirections = 0;
    this.nextValues = 0;
    this.nextDirections = 0;
    this.visible = 0;
    this.first = 0; // flip-flop behind the pads
    this.touched = false;
    this.dropped = [0, 0, 0, 0];
    this.debug = 0; // FDEBUG: bits 3:0 a full RX FIFO was met, 27:24 an empty TX FIFO
  }

  // One clk_sys cycle; `raw` = levels at the pads, where their inputs are enabled. True: an output changed.
  step(raw) {
    for (const machine of this.state) if (machine.enabled) machine.step();
    this.settleFlags();
    this.visible = this.first;
    this.first = raw;
    return this.settlePins();
  }

  settleFlags() {
    this.flags = (this.flags & ~this.flagsCleared) | this.flagsSet;
    this.flagsSet = 0;
    this.flagsCleared = 0;
  }

  settlePins() {
    const changed = (this.nextValues ^ this.pinValues) | (this.nextDirections ^ this.pinDirections);
    this.pinValues = this.nextValues;
    this.pinDirections = this.nextDirections;
    return changed;
  }

  quiet(raw) {
    if (this.first !== raw || this.visible !== raw) return 0;
    let least = Infinity;
    for (const machine of this.state) {
      const q = machine.quiet();
      if (q < least) least = q;
      if (least === 0) return 0;
    }
    return least;
  }

  skip(cycles) {
    for (const machine of this.state) machine.skip(cycles);
  }

  readUint32(offset) {
    if (offset >= 0xc8 && offset < 0xc8 + 4 * 0x18) {
      const machine = this.state[Math.floor((offset - 0xc8) / 0x18)];
      switch ((offset - 0xc8) % 0x18) {
        case 0x00: return machine.clkdiv;
        case 0x04: return machine.execctrl;
        case 0x08: return machine.shiftctrl;
        case 0x0c: return machine.pc;
        case 0x10: return this.memory[machine.pc] ?? 0;
        case 0x14: return machine.pinctrl;
      }
    }
    const by = (bit) => this.state.reduce((sum, m, i) => sum | (bit(m) ? 1 << i : 0), 0);
    switch (offset) {
      case 0x00: return by((m) => m.enabled);
      case 0x04:
        return (by((m) => m.tx.length === 0) << 24) | (by((m) => m.tx.length === FIFO_DEPTH) << 16) |
               (by((m) => m.rx.length === 0) << 8) | by((m) => m.rx.length === FIFO_DEPTH);
      case 0x08: return this.debug >>> 0;
      case 0x0c:
        return this.state.reduce((sum, m, i) => sum | (m.tx.length << (8 * i)) | (m.rx.length << (8 * i + 4)), 0);
      case 0x20: case 0x24: case 0x28: case 0x2c: {
        const fifo = this.state[(offset - 0x20) >> 2].rx;
        if (fifo.length === 0) fault(`PIO${this.number}: read from an empty RX FIFO`);
        return fifo.shift();
      }
      case 0x30: return this.flags;
    }
    fault(`PIO${this.number}: read of register ${hex(offset)} is not modelled`);
  }

  writeUint32(offset, value) {
    value >>>= 0;
    if (offset >= 0xc8 && offset < 0xc8 + 4 * 0x18) {
      const machine = this.state[Math.floor((offset - 0xc8) / 0x18)];
      switch ((offset - 0xc8) % 0x18) {
        case 0x00:
          if (value !== 1 << 16) fault('a PIO clock divider other than 1 is not modelled');
          return;
        case 0x04:
          if (value & 0x60ffc07f & ~(0x1f << 12)) fault(`EXECCTRL ${hex(value)} is not modelled`);
          machine.execctrl = value;
          return;
        case 0x08:
          if (value & 0xc1f20000) fault('FIFO join, autopull and autopush before 32 bits are not modelled');
          machine.shiftctrl = value;
          return;
        case 0x10: machine.force(value); return this.settleFlags();
        case 0x14:
          if (value >>> 29) fault('side-set is not modelled');
          machine.pinctrl = value;
          return;
      }
    }
    if (offset >= 0x48 && offset < 0xc8) { this.memory[(offset - 0x48) >> 2] = value & 0xffff; return; }
    switch (offset) {
      case 0x00:
        this.state.forEach((m, i) => {
          m.enabled = ((value >>> i) & 1) === 1;
          if ((value >>> (4 + i)) & 1) { m.delay = 0; m.isr = 0; m.isrCount = 0; m.osrCount = 32; }
        });
        return;
      case 0x10: case 0x14: case 0x18: case 0x1c: {
        const fifo = this.state[(offset - 0x10) >> 2].tx;
        if (fifo.length === FIFO_DEPTH) fault(`PIO${this.number}: write to a full TX FIFO`);
        fifo.push(value);
        return;
      }
      case 0x08: this.debug &= ~value; return;
      case 0x30: this.flags &= ~value; return;
    }
    fault(`PIO${this.number}: write of register ${hex(offset)} is not modelled`);
  }
}
