// The flash chip (W25Q16JV): contents that outlive resets and power, sectors that erase to ones, pages that programming can
// only clear bits of, and the time that takes, in which it answers nothing but its status. Power cut meanwhile leaves what
// silicon might: bits anywhere in between.

import { TICK_HZ } from './controller.mjs';
import { fault, hex } from './fault.mjs';

export const FLASH_BYTES = 2 * 1024 * 1024;
const SECTOR = 4096;
const PAGE = 256;
const MS = TICK_HZ / 1000;
const PROGRAM_TICKS = 0.4 * MS; // typically; 3 at most

export class Flash {
  constructor(contents, id, changed) {
    this.contents = contents;
    this.id = id; // eight bytes
    this.changed = changed; // (at, size) => tells who reads it in place
    this.eraseTicks = 45 * MS; // typically, 400 at most
    this.erased = 0; // sectors, since the beginning
    this.programmed = 0; // pages, or parts of them
    this.work = undefined; // what the chip is about: {at, before, from, until}
    this.canWrite = false;
  }

  isBusy(now) { return this.work !== undefined && now < this.work.until; }

  // Bytes out, as many in.
  transaction(sent, now) {
    const [command] = sent;
    const at = sent.length >= 4 ? (sent[1] << 16) | (sent[2] << 8) | sent[3] : undefined;
    const came = sent.map(() => 0xff);
    if (this.isBusy(now) && command !== 0x05) fault(`flash: command ${hex(command)} while it is at work`);
    switch (command) {
      case 0x05: came.fill((this.isBusy(now) ? 1 : 0) | (this.canWrite ? 2 : 0), 1); break;
      case 0x06: if (sent.length !== 1) fault('flash: write enable of more than a byte is none'); this.canWrite = true; break;
      case 0x4b: for (let i = 5; i < 13; i++) came[i] = this.id[i - 5]; break;
      case 0x03: for (let i = 4; i < sent.length; i++) came[i] = this.contents[at + i - 4]; break;
      case 0x20: if (sent.length !== 4) fault('flash: a sector erase is four bytes'); this.erase(at, now); break;
      case 0x02: this.program(at, sent.slice(4), now); break;
      default: fault(`flash: command ${hex(command)} is not modelled`);
    }
    return came;
  }

  // The new contents are there at the end, unless power goes.
  erase(at, now) {
    if (!this.canWrite) fault('flash: erase without write enable');
    if (at % SECTOR || at >= FLASH_BYTES) fault(`flash: erase at ${hex(at)}: no sector begins there`);
    this.erased++;
    this.begin(at, SECTOR, now, this.eraseTicks);
    this.contents.fill(0xff, at, at + SECTOR);
    this.changed(at, SECTOR);
  }

  program(at, bytes, now) {
    if (!this.canWrite) fault('flash: program without write enable');
    if (!bytes.length || (at % PAGE) + bytes.length > PAGE || at + bytes.length > FLASH_BYTES) fault(`flash: ${bytes.length} bytes at ${hex(at)} are not of one page`);
    this.programmed++;
    this.begin(at, bytes.length, now, PROGRAM_TICKS);
    bytes.forEach((byte, i) => {
      const old = this.contents[at + i];
      if (byte !== 0xff && byte & ~old) fault(`flash: ${hex(at + i)} was not erased`);
      this.contents[at + i] = old & byte;
    });
    this.changed(at, bytes.length);
  }

  begin(at, size, now, ticks) {
    this.canWrite = false;
    this.work = { at, before: this.contents.slice(at, at + size), from: now, until: now + ticks };
  }

  // Every bit that was to change has changed, or not, the likelier the later.
  losePower(now) {
    const { work } = this;
    this.work = undefined;
    this.canWrite = false;
    if (!work || now >= work.until) return;
    const done = (now - work.from) / (work.until - work.from);
    let random = (work.at ^ now) | 1;
    work.before.forEach((old, i) => {
      for (let bit = 1; bit < 256; bit <<= 1) {
        random = (Math.imul(random, 1103515245) + 12345) & 0x7fffffff;
        if ((random >>> 8) / 0x800000 >= done) this.contents[work.at + i] = (this.contents[work.at + i] & ~bit) | (old & bit);
      }
    });
  }
}
