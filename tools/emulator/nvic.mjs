// The processor's interrupts where rp2040js is kinder than ARM's manuals (ARMv6-M; Cortex-M0+ Devices Generic User Guide
// 4.2, Technical Reference Manual 3.2): what is pending stays so though its line falls, until its handler is entered; and
// to enter one and to return from it takes cycles.

import { RESET_BITS } from './resets.mjs';
import { fault } from './fault.mjs';

const ENTRY_TICKS = 15; // eight registers to the stack, the vector, the first instruction
const RETURN_TICKS = 13; // and back
const INTERRUPTS = { timer: 0xf, usb: 1 << 5, io: 1 << 13, uart0: 1 << 20 };

export class Nvic {
  constructor(machine) {
    const core = (this.core = machine.chip.core);
    this.lines = 0;
    core.setInterrupt = (irq, level) => this.line(1 << irq, level);
    const { checkForInterrupts, exceptionEntry, exceptionReturn } = core;
    // What is pending ends WFI though PRIMASK holds it back, and is taken once that lets it (WFI): rp2040js takes it at once.
    core.checkForInterrupts = () => (core.waiting && core.PM ? (core.pendingInterrupts & core.enabledInterrupts) !== 0 : checkForInterrupts.call(core));
    core.exceptionEntry = (number) => {
      if (number >= 16) core.pendingInterrupts &= ~(1 << (number - 16));
      exceptionEntry.call(core, number);
      machine.waits += ENTRY_TICKS;
    };
    core.exceptionReturn = (how) => {
      const number = core.IPSR;
      exceptionReturn.call(core, how);
      machine.waits += RETURN_TICKS;
      if (number >= 16) core.pendingInterrupts |= this.lines & (1 << (number - 16));
    };
  }

  line(bit, level) {
    const { core } = this;
    const rises = level && !(this.lines & bit);
    this.lines = level ? this.lines | bit : this.lines & ~bit;
    if (!rises) return;
    core.pendingInterrupts |= bit;
    core.interruptsUpdated = true;
    if (core.waiting && core.checkForInterrupts()) core.waiting = false;
  }

  // Blocks go into reset: one of their interrupts that is pending by then would find them there.
  checkResets(blocks) {
    for (const [name, bits] of Object.entries(INTERRUPTS)) {
      if ((blocks >>> RESET_BITS[name]) & 1 && this.core.enabledInterrupts & bits) fault(`${name} is put into reset while its interrupt is enabled`);
    }
  }
}
