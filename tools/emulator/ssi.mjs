// The serial interface to the flash: reading in place once it is set up, and the one command the firmware gives by hand, 4Bh,
// the unique id. In direct mode what stands in the FIFO when the flash is selected is one transaction.

import { fault, hex } from './fault.mjs';

const DEPTH = 16;

export class Ssi {
  constructor(id) {
    this.id = id; // eight bytes
    this.reset();
  }

  reset() { Object.assign(this, { enabled: true, control0: 0, control1: 0, xipControl: 0, baud: 0, selected: true, tx: [], rx: [], isReadable: false }); }

  // As the boot ROM's flash functions leave it: bytes by hand, out of reading in place.
  takeByRom() { Object.assign(this, { enabled: true, control0: 7 << 16, baud: 6, selected: true, tx: [], rx: [] }); this.update(); }

  update() {
    this.isReadable = this.enabled && this.control0 === 0x001f0300 && this.xipControl === 0x03000218 && this.control1 === 0 && this.baud >= 2 && this.selected;
    if (!this.enabled || !this.selected || this.control0 !== 7 << 16 || !this.tx.length) return;
    const sent = this.tx.splice(0);
    const isId = sent[0] === 0x4b;
    this.rx.push(...sent.map((_, i) => (isId && i >= 5 && i < 13 ? this.id[i - 5] : 0xff)));
  }

  readUint32(offset) {
    if (offset === 0x24) return this.rx.length;
    if (offset === 0x60) return this.rx.length ? this.rx.shift() : fault('SSI: read from an empty FIFO');
    fault(`SSI: read of register ${hex(offset)} is not modelled`);
  }

  writeUint32(offset, value) {
    const setUp = () => { if (this.enabled) fault(`SSI: register ${hex(offset)} written while it is on`); };
    switch (offset) {
      case 0x00: setUp(); this.control0 = value; break;
      case 0x04: setUp(); this.control1 = value; break;
      case 0x08: this.enabled = (value & 1) === 1; this.tx = []; this.rx = []; break;
      case 0x10: this.selected = (value & 1) === 1; break;
      case 0x14: setUp(); this.baud = value; break;
      case 0xf4: setUp(); this.xipControl = value; break;
      case 0x60:
        if (!this.enabled) fault('SSI: data while it is off');
        if (this.tx.length + this.rx.length >= DEPTH) fault('SSI: write to a full FIFO');
        this.tx.push(value & 0xff);
        break;
      default: fault(`SSI: write of register ${hex(offset)} is not modelled`);
    }
    this.update();
  }
}
