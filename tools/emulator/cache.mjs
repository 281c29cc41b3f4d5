// The cache between processor and flash: 16 KiB in two ways of 8 bytes, the least recently used goes. A line that is not there is read
// by the flash's serial interface: 8 bits of command, 24 of address, 64 of data at 25 MHz, and some cycles to begin and to end.

export const MISS_TICKS = 400;
const SETS = 1024;

export class Cache {
  constructor(missTicks) { this.missTicks = missTicks; this.lines = new Int32Array(2 * SETS); this.reset(); }

  reset() {
    this.lines.fill(-1); // the newer of a set first
    this.last = -1;
    this.misses = 0;
  }

  // Ticks that whoever reads here waits.
  wait(address) {
    const line = address >>> 3;
    if (line === this.last) return 0;
    this.last = line;
    const at = 2 * (line & (SETS - 1));
    if (this.lines[at] === line) return 0;
    const isThere = this.lines[at + 1] === line;
    this.lines[at + 1] = this.lines[at];
    this.lines[at] = line;
    if (isThere) return 0;
    this.misses++;
    return this.missTicks;
  }
}
