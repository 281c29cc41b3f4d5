// UART0 at line speed: two FIFOs of 32, bytes that take their ten bits, the receive interrupt at its threshold. No
// receive time-out (the firmware must not need it), no DMA requests.

import { fault, hex } from './fault.mjs';

const DEPTH = 32;
const THRESHOLDS = [4, 8, 16, 24, 28];

export class Uart {
  constructor(interrupt) {
    this.interrupt = interrupt;
    this.reset();
    this.line = []; // bytes on their way to the controller
    this.arrival = Infinity;
    this.sent = []; // {tick of the stop bit's end, byte}
  }

  reset() {
    this.rx = [];
    this.tx = [];
    this.departure = Infinity;
    this.ibrd = 0;
    this.fbrd = 0;
    this.lcr = 0;
    this.cr = 0x300;
    this.ifls = 0x12;
    this.imsc = 0;
    this.overruns = 0;
    this.txPinReady = false;
  }

  get byteTicks() {
    return Math.round(((this.ibrd + this.fbrd / 64) * 16) * 10);
  }

  get on() {
    return (this.cr & 1) !== 0;
  }

  feed(bytes, now) {
    if (this.line.length === 0) this.arrival = Math.max(now, 0) + 1000;
    this.line.push(...bytes);
  }

  get next() {
    return Math.min(this.line.length ? this.arrival : Infinity, this.tx.length ? this.departure : Infinity);
  }

  // What is due at `now`.
  run(now) {
    while (this.line.length && this.arrival <= now) {
      const byte = this.line.shift();
      this.arrival += 1000; // the host's line is at 1 Mbaud whatever the controller believes
      if (this.on) {
        if (this.byteTicks !== 1000 || (this.lcr & 0x70) !== 0x70) fault('UART0 is not at 1 Mbaud 8N1 with FIFOs');
        if (this.rx.length === DEPTH) this.overruns++;
        else this.rx.push(byte);
        this.update();
      }
    }
    while (this.tx.length && this.departure <= now) {
      this.sent.push([this.departure, this.tx.shift()]);
      this.departure += this.byteTicks;
    }
  }

  update() {
    this.interrupt((this.imsc & 0x10) !== 0 && this.rx.length >= THRESHOLDS[(this.ifls >>> 3) & 7]);
  }

  readUint32(offset, now) {
    switch (offset) {
      case 0x00: {
        if (this.rx.length === 0) fault('UART0: read from an empty FIFO');
        const byte = this.rx.shift();
        this.update();
        return byte;
      }
      case 0x18:
        return (this.tx.length ? 8 : 0x80) | (this.rx.length ? 0 : 0x10) | (this.tx.length >= DEPTH ? 0x20 : 0) |
               (this.rx.length >= DEPTH ? 0x40 : 0);
      case 0x30: return this.cr;
      case 0x38: return this.imsc;
    }
    fault(`UART0: read of register ${hex(offset)} is not modelled`);
  }

  writeUint32(offset, value, now) {
    switch (offset) {
      case 0x00:
        if (!this.on || this.byteTicks !== 1000) fault('UART0: a byte to send before it is set up');
        if (this.tx.length >= DEPTH) fault('UART0: write to a full FIFO');
        if (this.tx.length === 0) this.departure = now + this.byteTicks;
        this.tx.push(value & 0xff);
        return;
      case 0x24: this.ibrd = value & 0xffff; return;
      case 0x28: this.fbrd = value & 0x3f; return;
      case 0x2c: this.lcr = value; return;
      case 0x30: this.cr = value; return;
      case 0x34: this.ifls = value; return;
      case 0x38: this.imsc = value; return this.update();
      case 0x44: return;
    }
    fault(`UART0: write of register ${hex(offset)} is not modelled`);
  }
}
