// What befalls an image: power that goes and comes back, the BOOTSEL button, a UF2 on the drive, bits that rot.

import { writeUf2 } from './bootrom.mjs';
import { fault } from './fault.mjs';

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

// A bit of the RAM that flips: an address, and what is there then.
export function spoilRam(machine, address, bytes) {
  machine.chip.sram.set(bytes, address - 0x20000000);
}

// The timer's count goes on by so much, as if the image had slept.
export function ageTimer(machine, microseconds) {
  machine.tickClock();
  const { clock } = machine.chip;
  for (let alarm = clock.nextAlarm; alarm; alarm = alarm.next) alarm.nanos += 1000 * microseconds;
  clock.nanosCounter += 1000 * microseconds;
}
