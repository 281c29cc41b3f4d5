// Something goes wrong where a test wants it: once the program comes to `at`, it takes a hard `fault`, or does `hang`, while
// interrupts are served. Until then and without one, what silicon would not forgive stops the emulator.

export class Trap {
  constructor(at, what) {
    this.at = at;
    this.what = what;
    this.isSprung = false;
  }

  // One instruction; its cycles.
  step(core) {
    if (core.interruptsUpdated && core.checkForInterrupts()) core.waiting = false;
    if ((core.PC & ~1) !== this.at || this.isSprung) return core.executeInstruction();
    if (this.what === 'hang') return 2; // a branch to itself
    this.isSprung = true;
    core.exceptionEntry(3);
    return 15;
  }
}
