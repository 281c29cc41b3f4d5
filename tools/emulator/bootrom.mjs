// What the boot ROM does before an image runs, and what of it an image may call.

import { OUTPUT_PINS, OUTPUTS_HIGH_AT_RESET } from './controller.mjs';
import { fault, hex } from './fault.mjs';
import { FLASH_BYTES } from './flash.mjs';

export const FLASH = 0x10000000;
const ROM_TABLE = 0x7a;
const ROM_LOOKUP = 0x1d0;
const ROM_TO_USB_BOOT = 0x1e0;
const FUNCTIONS = { UB: ROM_TO_USB_BOOT };

export function readUf2(file) {
  return writeUf2(file, new Uint8Array(FLASH_BYTES).fill(0xff));
}

// As the boot ROM's drive does: only the sectors a block lies in are erased.
export function writeUf2(file, flash) {
  const view = new DataView(file.buffer, file.byteOffset, file.byteLength);
  if (file.length === 0 || file.length % 512) fault('not a UF2: its length is no multiple of 512');
  for (let at = 0; at < file.length; at += 512) {
    const [one, two, flags, address, size, number, count, family] = Array.from({ length: 8 }, (_, i) => view.getUint32(at + 4 * i, true));
    if (one !== 0x0a324655 || two !== 0x9e5d5157 || view.getUint32(at + 508, true) !== 0x0ab16f30) fault('not a UF2: bad magic');
    if (!(flags & 0x2000) || family !== 0xe48bff56) fault('this UF2 is for another board');
    if (number !== at / 512 || count !== file.length / 512 || size !== 256) fault('this UF2 is incomplete');
    if (number === 0 || (address & 4095) === 0) flash.fill(0xff, (address & ~4095) - FLASH, (address & ~4095) - FLASH + 4096);
    flash.set(file.subarray(at + 32, at + 32 + size), address - FLASH);
  }
  let crc = 0xffffffff;
  for (let i = 0; i < 252; i++) {
    crc ^= flash[i] << 24;
    for (let bit = 0; bit < 8; bit++) crc = crc & 0x80000000 ? (crc << 1) ^ 0x04c11db7 : crc << 1;
  }
  if ((crc >>> 0) !== new DataView(flash.buffer).getUint32(252, true)) fault('boot ROM: second stage has a wrong CRC32, nothing would start');
  return flash;
}

// Of the ROM itself only what a program may call: the header's two halfwords, the table of functions, and a breakpoint in
// place of each function's code.
export function loadRom(memory) {
  const rom = new Uint8Array(memory.buffer, memory.byteOffset, memory.length * 4);
  const view = new DataView(rom.buffer, rom.byteOffset, rom.byteLength);
  rom.set([0x4d, 0x75, 0x01, 0x03], 0x10); // 'M', 'u', version, boot ROM of the B2 stepping
  view.setUint16(0x14, ROM_TABLE, true);
  view.setUint16(0x18, ROM_LOOKUP | 1, true);
  Object.entries(FUNCTIONS).forEach(([name, at], i) => {
    view.setUint16(ROM_TABLE + 4 * i, name.charCodeAt(0) | (name.charCodeAt(1) << 8), true);
    view.setUint16(ROM_TABLE + 4 * i + 2, at | 1, true);
  });
  view.setUint32(ROM_TABLE + 4 * Object.keys(FUNCTIONS).length, 0, true);
  for (const at of [ROM_LOOKUP, ...Object.values(FUNCTIONS)]) {
    view.setUint16(at, 0xbe00, true); // bkpt
    view.setUint16(at + 2, 0x4770, true); // bx lr
  }
  return view;
}

// A function of the ROM's that the program called.
export function callRom(machine) {
  const { core } = machine.chip;
  const [r0, r1] = core.registers;
  switch ((core.PC - 2) & ~1) {
    case ROM_LOOKUP:
      for (let at = r0; machine.read(at, 2) !== 0; at += 4) if (machine.read(at, 2) === (r1 & 0xffff)) { core.registers[0] = machine.read(at + 2, 2); return; }
      core.registers[0] = 0;
      return;
    case ROM_TO_USB_BOOT: {
      // Resets by the watchdog and never comes back to flash; scratch 0 and 1 carry the arguments through the reset.
      const rest = (pin) => machine.pulls.get(pin) ?? (OUTPUTS_HIGH_AT_RESET.includes(pin) ? 1 : 0); // a resistor outside: the driver wants it
      const high = OUTPUT_PINS.filter((pin) => machine.pinLevels.get(pin) === 1 && rest(pin) === 0);
      machine.bootloader = { tick: machine.now, activity: r0 >>> 0, disabled: r1 >>> 0, high };
      machine.watchdog.scratchData[0] = r0;
      machine.watchdog.scratchData[1] = r1;
      machine.watchdog.reason = 2;
      machine.watchdogFired = true;
      machine.heldUntil = machine.now + 1;
      return;
    }
  }
  fault(`breakpoint at ${hex(core.PC - 2)}`);
}
