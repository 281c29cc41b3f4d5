// The serial interface to the flash: reading in place once it is set up, and commands given by hand in direct mode, where what
// stands in the FIFO when the flash is selected is one transaction, a frame every so many bits at clk_sys / BAUDR.

import { fault, hex } from './fault.mjs';

const DEPTH = 16;
const WORDS = 31 << 16;
const BYTES = 7 << 16;

export class Ssi {
  constructor(chip) {
    this.chip = chip; // the flash
    this.reset();
  }

  reset() { Object.assign(this, { enabled: true, control0: 0, control1: 0, xipControl: 0, baud: 0, selected: true, tx: [], rx: [], isReadable: false }); }

  update(now) {
    this.isReadable = this.enabled && this.control0 === 0x001f0300 && this.xipControl === 0x03000218 && this.control1 === 0 && this.baud >= 2 && this.selected;
    if (!this.enabled || !this.selected || (this.control0 !== BYTES && this.control0 !== WORDS) || !this.tx.length) return;
    if (this.baud < 4 || this.baud & 1) fault(`SSI: a clock of clk_sys / ${this.baud}: 03h is for 50 MHz at most, and nothing makes up for the way there and back`);
    const bytes = this.control0 === WORDS ? 4 : 1;
    const sent = this.tx.splice(0);
    const came = this.chip.transaction(sent.flatMap((frame) => (bytes === 1 ? [frame & 0xff] : [frame >>> 24, (frame >>> 16) & 0xff, (frame >>> 8) & 0xff, frame & 0xff])), now);
    const ticks = 8 * bytes * this.baud;
    sent.forEach((_, i) => {
      const frame = came.slice(bytes * i, bytes * (i + 1)).reduce((word, byte) => word * 256 + byte, 0);
      this.rx.push([now + ticks * (i + 1), frame]);
    });
  }

  arrived(now) { return this.rx.filter(([tick]) => tick <= now).length; }

  readUint32(offset, now) {
    if (offset === 0x24) return this.arrived(now);
    if (offset === 0x60) return this.arrived(now) ? this.rx.shift()[1] : fault('SSI: read from an empty FIFO');
    fault(`SSI: read of register ${hex(offset)} is not modelled`);
  }

  writeUint32(offset, value, now) {
    const setUp = () => { if (this.enabled) fault(`SSI: register ${hex(offset)} written while it is on`); };
    switch (offset) {
      case 0x00: setUp(); this.control0 = value; break;
      case 0x04: setUp(); this.control1 = value; break;
      case 0x08:
        if (this.rx.length && this.arrived(now) < this.rx.length) fault('SSI: switched off within a transaction');
        this.enabled = (value & 1) === 1; this.tx = []; this.rx = []; break;
      case 0x10: this.selected = (value & 1) === 1; break;
      case 0x14: setUp(); this.baud = value; break;
      case 0xf4: setUp(); this.xipControl = value; break;
      case 0x60:
        if (!this.enabled) fault('SSI: data while it is off');
        if (this.selected) fault('SSI: data while the flash is selected: a gap would end the command');
        if (this.tx.length >= DEPTH) fault('SSI: write to a full FIFO');
        this.tx.push(value >>> 0);
        break;
      default: fault(`SSI: write of register ${hex(offset)} is not modelled`);
    }
    this.update(now);
  }
}
