// The flash chip as the boot ROM's functions treat it: contents that outlive resets and power, sectors that erase to ones,
// pages that programming can only clear bits of. Power cut meanwhile leaves what silicon might: bits anywhere in between.

import { TICK_HZ } from './controller.mjs';
import { fault, hex } from './fault.mjs';

export const FLASH_BYTES = 2 * 1024 * 1024;
const SECTOR = 4096;
const PAGE = 256;
const MS = TICK_HZ / 1000;
const PROGRAM_TICKS = 0.5 * MS; // W25Q16JV: 0.4 typically, and its bytes over the line

export class Flash {
  constructor(contents) {
    this.contents = contents;
    this.eraseTicks = 45 * MS; // W25Q16JV: 45 typically, 400 at most
    this.erased = 0; // sectors, since the beginning
    this.programmed = 0; // pages
    this.work = undefined; // what the chip is about: {at, before, from, until}
    this.reset();
  }

  // Of what the ROM set up: connected, then out of reading in place; reading again is for whoever sets up the interface.
  reset() { this.state = 'in place'; }

  connect() { this.state = 'connected'; }

  exitXip() {
    if (this.state === 'in place') fault('flash_exit_xip before connect_internal_flash');
    this.state = 'commands';
  }

  flush() { this.state = 'in place'; }

  check(what, at, size, unit) {
    if (this.state !== 'commands') fault(`${what} while the flash is still read in place`);
    if (at % unit || size % unit || size === 0 || at + size > FLASH_BYTES) fault(`${what}: ${size} bytes at ${hex(at)} are not whole units of ${unit}`);
  }

  // Both give the ticks it takes; the new contents are there at their end, unless power goes.
  erase(at, size, now) {
    this.check('flash_range_erase', at, size, SECTOR);
    this.erased += size / SECTOR;
    const ticks = (size / SECTOR) * this.eraseTicks;
    this.begin(at, size, now, ticks);
    this.contents.fill(0xff, at, at + size);
    return ticks;
  }

  program(at, bytes, now) {
    this.check('flash_range_program', at, bytes.length, PAGE);
    this.programmed += bytes.length / PAGE;
    const ticks = (bytes.length / PAGE) * PROGRAM_TICKS;
    this.begin(at, bytes.length, now, ticks);
    bytes.forEach((byte, i) => {
      const old = this.contents[at + i];
      if (byte !== 0xff && byte & ~old) fault(`flash_range_program: ${hex(at + i)} was not erased`);
      this.contents[at + i] = old & byte;
    });
    return ticks;
  }

  begin(at, size, now, ticks) {
    this.work = { at, before: this.contents.slice(at, at + size), from: now, until: now + ticks };
  }

  // Every bit that was to change has changed, or not, the likelier the later.
  losePower(now) {
    const { work } = this;
    this.work = undefined;
    this.reset();
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
