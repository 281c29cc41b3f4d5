// The DMA as far as the firmware uses it: PIO and permanent requests, rings, chains, aborts. A transfer takes four cycles
// after its request and a channel has one under way at a time, which is slower than silicon; channels take turns.

import { fault, hex } from './fault.mjs';

const TRANSFER_CYCLES = 4;
const PERMANENT = 0x3f;

export class Dma {
  constructor(bus, request) {
    this.bus = bus;         // {read(address, bytes), write(address, bytes, value)}
    this.request = request; // (dreq) => can one more word be moved?
    this.reset();
  }

  reset() {
    this.channels = Array.from({ length: 12 }, (_, index) => ({
      index, read: 0, write: 0, count: 0, reload: 0, ctrl: 0, busy: false, wait: 0, aborted: false,
    }));
    this.active = 0;
  }

  setDREQ() {}
  clearDREQ() {}

  start(channel) {
    if (channel.aborted) fault(`DMA: channel ${channel.index} is started while its last transfer is still on its way`);
    if (!(channel.ctrl & 1) || channel.busy) return;
    channel.count = channel.reload;
    channel.busy = channel.count > 0;
    channel.wait = 0;
  }

  isReady(channel) {
    const dreq = (channel.ctrl >>> 15) & 0x3f;
    return channel.busy && (channel.ctrl & 1) !== 0 && (dreq === PERMANENT || this.request(dreq));
  }

  quiet() {
    for (const channel of this.channels) if (channel.busy && (channel.wait > 0 || this.isReady(channel))) return 0;
    return Infinity;
  }

  // One cycle: at most one transfer ends.
  step() {
    let ended = false;
    for (const channel of this.channels) {
      if (!channel.busy) continue;
      if (channel.wait === 0) {
        if (this.isReady(channel)) channel.wait = TRANSFER_CYCLES;
      } else if (channel.wait > 1) channel.wait--;
      else if (!ended) {
        ended = true;
        channel.wait = 0;
        this.transfer(channel);
      }
    }
  }

  transfer(channel) {
    const { ctrl } = channel;
    const bytes = 1 << ((ctrl >>> 2) & 3);
    this.bus.write(channel.write, bytes, this.bus.read(channel.read, bytes));
    const ringBits = (ctrl >>> 6) & 15;
    const advance = (address, isRing) => {
      const next = (address + bytes) >>> 0;
      if (!isRing || ringBits === 0) return next;
      const mask = (1 << ringBits) - 1;
      return ((address & ~mask) | (next & mask)) >>> 0;
    };
    const ringIsWrite = (ctrl >>> 10) & 1;
    if (ctrl & 0x10) channel.read = advance(channel.read, !ringIsWrite);
    if (ctrl & 0x20) channel.write = advance(channel.write, ringIsWrite);
    channel.count = channel.aborted ? 0 : channel.count - 1;
    if (channel.count === 0) {
      channel.busy = false;
      channel.aborted = false;
      const next = (ctrl >>> 11) & 15;
      if (next !== channel.index) this.start(this.channels[next]);
    }
  }

  // What is between its read and its write cannot be revoked (2.5.5.3), and ends as a completed sequence does (errata
  // RP2040-E13 and RP2350-E5), so that the channel chained to it is triggered. The counter is cleared.
  abort(channel) {
    channel.count = 0;
    channel.aborted = channel.wait > 0;
    channel.busy = channel.aborted;
  }

  readUint32(offset) {
    if (offset < 0x300) {
      const channel = this.channels[offset >> 6];
      switch (offset & 0x3f) {
        case 0x00: return channel.read;
        case 0x04: return channel.write;
        case 0x08: return channel.count >>> 0;
        case 0x0c: case 0x10: return (channel.ctrl | (channel.busy ? 1 << 24 : 0)) >>> 0;
      }
    }
    fault(`DMA: read of register ${hex(offset)} is not modelled`);
  }

  writeUint32(offset, value) {
    value >>>= 0;
    if (offset < 0x300) {
      const channel = this.channels[offset >> 6];
      switch (offset & 0x3f) {
        case 0x00: channel.read = value; return;
        case 0x04: channel.write = value; return;
        case 0x08: channel.reload = value; return;
        case 0x0c: channel.ctrl = value & 0xffffff; this.start(channel); return;
        case 0x10: channel.ctrl = value & 0xffffff; return;
      }
    }
    if (offset === 0x444) {
      for (const channel of this.channels) if ((value >>> channel.index) & 1) this.abort(channel);
      return;
    }
    fault(`DMA: write of register ${hex(offset)} is not modelled`);
  }
}
