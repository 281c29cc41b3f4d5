// What befalls an image: the boot ROM's flash functions, power that goes and comes back, the BOOTSEL button, a UF2 on the
// drive, bits that rot.

import { ROM_FLASH, writeUf2 } from './bootrom.mjs';
import { fault, hex } from './fault.mjs';

const RAM = 0x20000000;

// A flash function of the boot ROM. The processor stands in it for as long as the flash works; all else goes on.
export function callFlash(machine, at) {
  const [r0, r1, r2] = machine.chip.core.registers;
  const { flash, flashChip, ssi, now } = machine;
  switch (at) {
    case ROM_FLASH.connect: ssi.takeByRom(); flashChip.connect(); return true;
    case ROM_FLASH.exit: flashChip.exitXip(); return true;
    case ROM_FLASH.flush: flashChip.flush(); machine.cache.reset(); return true;
    case ROM_FLASH.erase: machine.heldUntil = now + flashChip.erase(r0 >>> 0, r1, now); break;
    case ROM_FLASH.program:
      if (r1 < RAM || r1 + r2 > RAM + 0x42000) fault(`flash_range_program from ${hex(r1)}: the flash cannot be read meanwhile`);
      machine.heldUntil = now + flashChip.program(r0 >>> 0, machine.chip.sram.slice(r1 - RAM, r1 - RAM + r2), now);
      break;
    default: return false;
  }
  if (!machine.chip.core.PM) fault('the flash is written with interrupts on: their code is in it');
  machine.chip.flash.set(flash.subarray(r0, r0 + (at === ROM_FLASH.erase ? r1 : r2)), r0);
  return true;
}

// Power off and on again: only the flash remembers, and the RAM if it was for an instant; what is wired to the pins stays.
export function powerCycle(machine, isShort = false) {
  machine.keepsRam = isShort;
  machine.flashChip.losePower(machine.now);
  machine.scratch.fill(0);
  machine.watchdogFired = false;
  machine.bootloader = undefined;
  machine.trap = undefined;
  machine.stalledUntil = 0;
  machine.boot(0);
}

// Power comes back with BOOTSEL held: the ROM's own USB, which is silence here.
export function holdBootsel(machine) {
  powerCycle(machine);
  machine.bootloader = { tick: machine.now, activity: 0, disabled: 0, high: [] };
  machine.heldUntil = Infinity;
}

// The boot loader has been told to start the image (a UF2 was copied, or PICOBOOT's reboot).
export function leaveBootloader(machine) {
  if (!machine.bootloader) fault('not in the boot loader');
  machine.bootloader = undefined;
  machine.resets.push(machine.now);
  machine.boot(2);
}

// A UF2 copied to its drive.
export function copyUf2(machine, uf2) {
  if (!machine.bootloader) fault('not in the boot loader');
  writeUf2(uf2, machine.flash);
  leaveBootloader(machine);
}

export function spoilFlash(machine, at, bytes) {
  machine.flash.set(bytes, at);
  machine.chip.flash.set(bytes, at);
}
