// The USB device controller as far as the firmware uses it (single buffers, no isochronous endpoints), seen from both
// sides: registers and DPSRAM for the firmware, transactions for the host. What silicon would answer with a lost or
// doubled packet stops the run.

import { fault, hex } from './fault.mjs';

const FULL = 1 << 15, DATA1 = 1 << 13, STALL = 1 << 11, AVAILABLE = 1 << 10, LENGTH = 0x3ff;
const KNOWN_BITS = FULL | DATA1 | STALL | AVAILABLE | LENGTH;
const SUSPENDED = 1 << 4, RESUME = 1 << 11, SETUP = 1 << 17, BUS_RESET = 1 << 19;
const STATUS_BITS = SUSPENDED | RESUME | SETUP | BUS_RESET;
const SETTLE_TICKS = 7; // three cycles of 48 MHz between a buffer's control bits and its AVAILABLE
const ENDPOINTS = 16;

export class Usb {
  constructor(interrupt, clockMHz) {
    this.interrupt = interrupt; // (level)
    this.clockMHz = clockMHz;   // () => of clk_usb, 0 = off
    this.onPull = () => {};     // D+ pulled up, or no longer
    this.onCable = () => {};    // (isIn): the host's 5 V are there, or gone
    this.frameAt = () => undefined; // (now) => {number, age} of the bus's frame, undefined while none are sent
    this.lateFrom = Infinity;   // age from which on a buffer for bulk in may not be handed over
    this.latest = 0;            // age of the frame in which one was handed over latest
    this.reset();
  }

  reset() {
    const wasUp = this.pulledUp;
    this.memory = new DataView(new ArrayBuffer(4096));
    this.changed = new Float64Array(2 * ENDPOINTS).fill(-Infinity); // tick at which a buffer control last changed
    Object.assign(this, { address: 0, main: 0, sie: 0, status: 0, done: 0, abort: 0, abortDone: 0, stallArm: 0, muxing: 0, power: 0, inte: 0 });
    this.busy = 0; // endpoints of transactions under way
    this.hung = false; // erratum E15 has struck: deaf and mute until the block is reset
    this.frame = 0; // number of the last frame heard
    if (wasUp) this.onPull();
  }

  get pulledUp() { return (this.main & 3) === 1 && (this.muxing & 9) === 9 && (this.power & 12) === 12 && ((this.sie >>> 16) & 1) === 1; }

  update() {
    const raised = (this.done ? 1 << 4 : 0) | (this.status & BUS_RESET ? 1 << 12 : 0) | (this.status & SUSPENDED ? 1 << 14 : 0) |
                   (this.status & RESUME ? 1 << 15 : 0) | (this.status & SETUP ? 1 << 16 : 0);
    this.interrupt((raised & this.inte) !== 0);
  }

  raise(bits) { if (!this.hung) this.status |= bits; this.update(); }

  // Brings the number of the last frame heard up to date; whoever stops the frames calls it before.
  hearFrames(now) {
    if (this.pulledUp && !this.hung) this.frame = this.frameAt(now)?.number ?? this.frame;
    return this.frame;
  }

  // As after a garbled acknowledgement late in a frame: no packet is answered, no frame counted, nothing on the bus seen.
  hang(now) { this.hearFrames(now); this.hung = true; }

  // ---- the firmware's side: DPSRAM ----

  control(endpoint) { return this.memory.getUint32(0x80 + 4 * endpoint, true); }

  setControl(endpoint, value) { this.memory.setUint32(0x80 + 4 * endpoint, value, true); }

  // Where an endpoint's packets lie, or undefined while it is off.
  bufferAt(endpoint) {
    if (endpoint < 2) return 0x100;
    const control = this.memory.getUint32(4 * endpoint, true);
    return control >>> 31 ? control & 0xffc0 : undefined;
  }

  isBulkIn(endpoint) { return endpoint >= 2 && !(endpoint & 1) && ((this.memory.getUint32(4 * endpoint, true) >>> 26) & 3) === 2; }

  checkOwner(at, what) {
    for (let endpoint = 0; endpoint < 6; endpoint++) {
      if (!(this.control(endpoint) & AVAILABLE)) continue;
      const start = this.bufferAt(endpoint);
      const size = this.control(endpoint) & LENGTH;
      if (at >= start && at < start + size) fault(`USB: ${what} of a packet that belongs to the controller (endpoint ${endpoint >> 1} ${endpoint & 1 ? 'out' : 'in'})`);
    }
  }

  readMemory(at, bytes) {
    if (at >= 0x100) this.checkOwner(at, 'read');
    return bytes === 4 ? this.memory.getUint32(at, true) : bytes === 2 ? this.memory.getUint16(at, true) : this.memory.getUint8(at);
  }

  writeMemory(at, bytes, value, now) {
    if (at >= 0x100) {
      this.checkOwner(at, 'write');
      if (bytes === 4) this.memory.setUint32(at, value, true);
      else if (bytes === 2) this.memory.setUint16(at, value, true);
      else this.memory.setUint8(at, value);
      return;
    }
    if (bytes !== 4) fault('USB: part of a control word written');
    if (at >= 0x80) this.writeControl((at - 0x80) >> 2, value >>> 0, now);
    else if (at >= 8) {
      const type = (value >>> 26) & 3;
      if (value && (!(value >>> 31) || !((value >>> 29) & 1) || (value & 0x5000003f) || type < 2 || (value & 0xffc0) < 0x180 || (value & 0xffc0) > 0xfc0)) {
        fault(`USB: endpoint control ${hex(value)} is not modelled`);
      }
      this.memory.setUint32(at, value, true);
    } else this.memory.setUint32(at, value, true);
  }

  writeControl(endpoint, value, now) {
    const old = this.control(endpoint);
    const name = `endpoint ${endpoint >> 1} ${endpoint & 1 ? 'out' : 'in'}`;
    if (value & ~KNOWN_BITS) fault(`USB: buffer control ${hex(value)} of ${name} is not modelled`);
    if (old & AVAILABLE && !((this.abortDone >>> endpoint) & 1)) fault(`USB: buffer control of ${name} written while the controller has the buffer`);
    if (value & AVAILABLE) {
      if ((value & ~AVAILABLE) !== old) fault(`USB: AVAILABLE of ${name} set together with other bits`);
      if (now - this.changed[endpoint] < SETTLE_TICKS) fault(`USB: AVAILABLE of ${name} set too soon after the other bits`);
      if (this.bufferAt(endpoint) === undefined) fault(`USB: buffer for ${name}, which is off`);
      if ((value & LENGTH) > 64) fault(`USB: packet of ${value & LENGTH} bytes for ${name}`);
      if (Boolean(value & FULL) === Boolean(endpoint & 1)) fault(`USB: FULL is wrong for ${name}`);
      const late = this.frameAt(now)?.age;
      if (this.isBulkIn(endpoint) && late > this.latest) this.latest = late;
      if (this.isBulkIn(endpoint) && late >= this.lateFrom) fault(`USB: ${name} handed over ${late} ticks into a frame: erratum E15`);
    }
    if (value !== old) this.changed[endpoint] = now;
    this.setControl(endpoint, value);
  }

  // ---- the firmware's side: registers ----

  readUint32(offset, now) {
    if (Math.abs(this.clockMHz() - 48) > 0.1) fault('USB: its clock is not 48 MHz');
    switch (offset) {
      case 0x00: return this.address;
      case 0x40: return this.main;
      case 0x48: return this.hearFrames(now);
      case 0x4c: return this.sie >>> 0;
      case 0x50: return this.status >>> 0;
      case 0x58: return this.done >>> 0;
      case 0x60: return this.abort >>> 0;
      case 0x64: return this.abortDone >>> 0;
      case 0x68: return this.stallArm;
      case 0x74: return this.muxing;
      case 0x78: return this.power;
      case 0x90: return this.inte;
    }
    fault(`USB: read of register ${hex(offset)} is not modelled`);
  }

  // `written`: what stands on the bus, for registers where a one clears; `value`: with the alias worked out.
  writeUint32(offset, value, written) {
    if (Math.abs(this.clockMHz() - 48) > 0.1) fault('USB: its clock is not 48 MHz');
    const wasUp = this.pulledUp;
    switch (offset) {
      case 0x00: this.address = value & 0x7f; break;
      case 0x40: if (value & 2) fault('USB: host mode is not modelled'); this.main = value; break;
      case 0x4c: if (value & ~((1 << 29) | (1 << 16))) fault(`USB: SIE_CTRL ${hex(value)} is not modelled`); this.sie = value; break;
      case 0x50: this.status &= ~(written & STATUS_BITS); break;
      case 0x58: this.done &= ~written; break;
      case 0x60: this.abort = value; if (!this.hung) this.abortDone |= value & ~this.busy; break;
      case 0x64: this.abortDone &= ~written; break;
      case 0x68: this.stallArm = value & 3; break;
      case 0x74: this.muxing = value; break;
      case 0x78: this.power = value; break;
      case 0x90: this.inte = value; break;
      default: fault(`USB: write of register ${hex(offset)} is not modelled`);
    }
    if (this.pulledUp !== wasUp) this.onPull();
    this.update();
  }

  // ---- the host's side ----

  hears(address) { return this.pulledUp && !this.hung && address === this.address; }

  // A transaction begins: 'timeout' (nobody there), 'nak', 'stall', or the packet it would send / undefined for one it takes.
  begin(address, endpoint) {
    if (!this.hears(address) || this.bufferAt(endpoint) === undefined) return { answer: 'timeout' };
    if ((this.abort >>> endpoint) & 1) return { answer: 'nak' };
    const control = this.control(endpoint);
    if (control & STALL && (endpoint >= 2 || (this.stallArm >>> endpoint) & 1)) return { answer: 'stall' };
    if (!(control & AVAILABLE)) return { answer: 'nak' };
    this.busy |= 1 << endpoint;
    const at = this.bufferAt(endpoint);
    const data = endpoint & 1 ? undefined : new Uint8Array(this.memory.buffer.slice(at, at + (control & LENGTH)));
    return { answer: 'ack', data, toggle: control & DATA1 ? 1 : 0 };
  }

  // It has ended well; `data` is what an out transaction carried.
  end(endpoint, data, toggle) {
    if (this.hung) return;
    const control = this.control(endpoint);
    if (data) {
      if (Boolean(control & DATA1) !== Boolean(toggle)) fault(`USB: DATA${toggle} came where the device waits for the other: it would be taken for a repeat and dropped`);
      if (data.length > (control & LENGTH)) fault('USB: a packet longer than its buffer');
      new Uint8Array(this.memory.buffer).set(data, this.bufferAt(endpoint));
      this.setControl(endpoint, (control & ~(AVAILABLE | LENGTH)) | FULL | data.length);
    } else this.setControl(endpoint, control & ~(AVAILABLE | FULL));
    this.busy &= ~(1 << endpoint);
    this.abortDone |= this.abort & (1 << endpoint);
    if (endpoint > 1 || (this.sie >>> 29) & 1) this.done |= 1 << endpoint;
    this.update();
  }

  // Lost on the wire: nothing changes hands.
  cancel(endpoint) { this.busy &= ~(1 << endpoint); this.abortDone |= this.abort & (1 << endpoint); }

  // A setup packet is always taken.
  setup(address, packet) {
    if (!this.hears(address)) return 'timeout';
    new Uint8Array(this.memory.buffer).set(packet, 0);
    this.stallArm = 0;
    this.raise(SETUP);
    return 'ack';
  }

  busReset() { this.raise(BUS_RESET); }
  suspend() { if (this.pulledUp) this.raise(SUSPENDED); }
  resume() { if (this.pulledUp) this.raise(RESUME); }
}
