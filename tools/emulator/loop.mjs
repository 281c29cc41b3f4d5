// The main loop, watched from outside: a round lasts from one kick of the watchdog until the processor sleeps, or to the next kick.

import { fault } from './fault.mjs';

export class Loop {
  constructor() { this.reset(); }

  reset() {
    this.began = undefined;
    this.slept = undefined;
    this.longest = 0;
    this.when = 0;
  }

  kicked(now) {
    const ticks = (this.slept ?? now) - this.began; // NaN in the first, which lasts from reset
    if (ticks > this.longest) [this.longest, this.when] = [ticks, this.began];
    this.began = now;
    this.slept = undefined;
  }

  // The longest since the last time, and when it began.
  take() {
    const { longest, when } = this;
    this.longest = 0;
    return [longest, when];
  }

  // Somebody held the processor: a round that was under way says nothing.
  stalled() { this.began = undefined; }
}

// Counts down from its reload value to 0, reload + 1 cycles a turn; rp2040js drops one of them.
export class SysTick {
  constructor() { this.on = false; this.reload = 0; this.from = 0; }

  read(now) {
    if (!this.on) fault('SysTick read while it stands still');
    const turn = this.reload + 1;
    return (turn - ((now - this.from) % turn)) % turn;
  }

  control(value, now) {
    if (value & 1 && (value & 7) !== 5) fault('SysTick from another clock than clk_sys, or with its interrupt, is not modelled');
    if (value & 1 && !this.on) this.from = now;
    this.on = (value & 1) === 1;
  }
}

// Deepest use of the stack, where start-up painted it (rp2040.ld: 4 KiB from 0x20040000).
export function stackUsed(ramView) {
  let at = 0x40000;
  while (at < 0x41000 && ramView.getUint32(at, true) === 0xa5a5a5a5) at += 4;
  return 0x41000 - at;
}
