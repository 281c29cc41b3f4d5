// The shipped image on an RP2040: processor, timer, clocks and pads by rp2040js; PIO, DMA, UART, resets and the checks
// that make a forgiven mistake fail are ours. Time is in ticks of 10 ns since power came on.

import { RP2040 } from 'rp2040js';
import { fitBoard, padWritten } from './adc.mjs';
import { Cache, MISS_TICKS } from './cache.mjs';
import { FLASH, callRom, loadRom, readUf2 } from './bootrom.mjs';
import { usbMHz } from './clocks.mjs';
import { INPUT_PINS, OUTPUT_PINS, PIN, TICK_HZ } from './controller.mjs';
import { Dma } from './dma.mjs';
import { Fault, fault, hex } from './fault.mjs';
import { Flash } from './flash.mjs';
import { Loop, SysTick } from './loop.mjs';
import { padLevel, putBehindOverride, writePinControl } from './pads.mjs';
import { Nvic } from './nvic.mjs';
import { Pio } from './pio.mjs';
import { RESET_BITS, RESET_OF, ALWAYS_ON } from './resets.mjs';
import { Ssi } from './ssi.mjs';
import { Trap } from './trap.mjs';
import { Uart } from './uart.mjs';
import { Usb } from './usb.mjs';
import { UsbHost } from './usbhost.mjs';

const RAM = 0x20000000;
const LOADER_RAM = 0x20041000;
const USB_MEMORY = 0x50100000;
const BOOT2_AT = 0x20041f00;
const BOOT_ROM_TICKS = 100_000; // 1 ms, about what the boot ROM takes; pins are at rest meanwhile
const CONTROLLER = { inputs: INPUT_PINS, outputs: OUTPUT_PINS }; // pins that somebody outside may drive, and those that the image may

export class Machine {
  constructor(uf2, flashId = 'e6616408438a1c2f', board = 'pico', pins = CONTROLLER) {
    this.inputPins = pins.inputs;
    this.outputPins = pins.outputs;
    this.onPin = () => {}; // (pin, tick): one of the outputs may have changed
    this.flash = readUf2(uf2);
    this.flashChip = new Flash(this.flash, Buffer.from(flashId, 'hex'), (at, size) => this.chip.flash.set(this.flash.subarray(at, at + size), at));
    this.ssi = new Ssi(this.flashChip);
    this.now = 0;
    this.noise = 0x51a7; // what the RAM holds when power comes on
    this.levels = new Map(); // of inputs
    this.held = new Set(); // inputs that somebody drives; the others are what their pads pull them to
    this.pinLevels = new Map();
    this.transitions = [];
    this.inputs = []; // sorted: [tick, pin, level]
    this.wires = new Map(); // output pin => the input it drives
    this.pulls = new Map(); // output pin => level of a resistor outside
    this.stalledUntil = 0;
    this.resets = [];
    this.scratch = new Uint32Array(8);
    this.uart = new Uart((level) => this.chip?.setInterrupt(20, level));
    this.usb = new Usb((level) => this.chip?.setInterrupt(5, level), () => usbMHz(this));
    this.host = new UsbHost(this.usb);
    fitBoard(this, board);
    this.cache = new Cache(MISS_TICKS);
    this.loop = new Loop();
    this.waits = 0; // of the instruction being run, for data in flash
    this.usedInstructions = 0;
    this.bootloader = undefined; // what the image said to the ROM when it went there
    this.boot(0);
  }

  // ---- from reset ----

  boot(reason) {
    this.resetReason = reason;
    const chip = new RP2040();
    if ((reason || this.keepsRam) && this.chip) chip.sram.set(this.chip.sram); // a reset leaves the RAM as it is
    else for (let i = 0; i < chip.sram.length; i++) chip.sram[i] = (this.noise = (this.noise * 1103515245 + 12345) & 0x7fffffff) >>> 16;
    this.chip = chip;
    chip.flash.set(this.flash);
    chip.logger = { debug() {}, info() {}, warn: (name, text) => fault(`${name}: ${text}`), error: (name, text) => fault(`${name}: ${text}`) };
    chip.onBreak = () => callRom(this);
    this.romView = loadRom(this.chip.bootrom);
    this.inReset = 0x01ffffff & ~((1 << RESET_BITS.qspi) | (1 << RESET_BITS.padsQspi));
    this.pios = [new Pio(0), new Pio(1)];
    chip.pio = this.pios;
    this.dma = new Dma(
      { read: (a, n) => this.read(a, n), write: (a, n, v) => this.write(a, n, v) },
      (dreq) => {
        const fifos = this.pios[dreq >> 3]?.state[dreq & 3];
        if (!fifos) fault(`DMA request ${dreq} is not modelled`);
        return dreq & 4 ? fifos.rx.length > 0 : fifos.tx.length < 4;
      });
    chip.dma = this.dma;
    this.uart.reset();
    this.ssi.reset();
    this.adc.reset();
    this.adc.padWritten(29, 0x56, this.now);
    this.cache.reset();
    this.host.now = this.now;
    this.usb.reset();
    this.padsSet = new Set();
    this.watchdog = chip.peripherals[0x40058];
    this.watchdog.scratchData.set(this.scratch);
    this.watchdog.reason = reason;
    this.watchdog.tickEnable = false;
    this.watchdogFired = false;
    this.watchdog.onWatchdogTrigger = () => {
      this.watchdogFired = true;
      this.watchdog.alarm.enable = false; // rp2040js would fire it again and again in no time
    };
    chip.clkSys = TICK_HZ;
    this.clockedAt = this.now;
    this.hardwareTick = this.now;
    this.quietUntil = this.now;
    for (const index of [...this.inputPins, ...this.outputPins]) {
      const pin = chip.gpio[index];
      putBehindOverride(pin);
      pin.addListener(() => this.note(index));
      if (this.outputPins.includes(index)) this.note(index);
    }
    for (const pin of this.inputPins) if (!this.held.has(pin)) this.levels.set(pin, 0); // pads at reset pull down (2.19.6.3)
    for (const [pin, level] of this.levels) chip.gpio[pin].setInputValue(level === 1);
    for (const pin of chip.gpio) pin.irqStatus = 0;
    this.bindBus();
    // The boot ROM: copies 256 bytes, enters them with LR = 0.
    chip.sram.set(this.flash.subarray(0, 256), BOOT2_AT - RAM);
    const { core } = chip;
    this.nvic = new Nvic(this);
    core.registers[13] = 0x20041f00;
    core.registers[14] = 0;
    core.registers[15] = BOOT2_AT;
    this.heldUntil = Math.max(this.now, this.flashChip.work?.until ?? 0) + BOOT_ROM_TICKS; // it tries until the flash answers
    this.nextDue = 0;
    this.systick = new SysTick();
    this.loop.stalled();
    this.tickOrigin = undefined;
  }

  note(index) {
    const pin = this.chip.gpio[index];
    if (!this.outputPins.includes(index)) return;
    this.onPin(index, this.stamp ?? this.now);
    const level = padLevel(pin, this.pulls.get(index));
    if (this.stamp === undefined && pin.rawInputValue !== (level === 1)) this.sync(); // the processor did it: the PIO saw before what was before
    pin.rawInputValue = level === 1;
    if ((this.pinLevels.get(index) ?? 0) !== level) {
      this.pinLevels.set(index, level);
      this.transitions.push([this.stamp ?? this.now, index, level]);
      if (index === PIN.STATUS) this.adc.select(level, this.now);
      if (this.wires.has(index)) this.drive(this.wires.get(index), level);
      else if (pin.inputEnable) this.quietUntil = this.hardwareTick; // somebody looks at it
    }
  }

  // ---- bus ----

  bindBus() {
    const { chip } = this;
    chip.readUint32 = (address) => this.read(address >>> 0, 4);
    chip.readUint16 = (address) => this.read(address >>> 0, 2);
    chip.readUint8 = (address) => this.read(address >>> 0, 1);
    chip.writeUint32 = (address, value) => this.write(address >>> 0, 4, value);
    chip.writeUint16 = (address, value) => this.write(address >>> 0, 2, value);
    chip.writeUint8 = (address, value) => this.write(address >>> 0, 1, value);
    this.flashView = chip.flashView;
    this.ramView = chip.sramView;
  }

  read(address, bytes) {
    if (address & (bytes - 1)) fault(`HardFault: unaligned read of ${bytes} bytes at ${hex(address)}`);
    let view, at;
    if (address >= FLASH && address < FLASH + this.flash.length) { if (!this.ssi.isReadable) fault(`HardFault: flash read at ${hex(address)} while its interface is not set up for that`); view = this.flashView; at = address - FLASH; this.waits += this.cache.wait(address); }
    else if (address >= RAM && address < RAM + 0x42000) { view = this.ramView; at = address - RAM; }
    else if (address < 0x4000) { view = this.romView; at = address; }
    else if (address >= USB_MEMORY && address < USB_MEMORY + 0x1000) { this.block(address); return this.usb.readMemory(address - USB_MEMORY, bytes); }
    if (view) return bytes === 4 ? view.getUint32(at, true) : bytes === 2 ? view.getUint16(at, true) : view.getUint8(at);
    const word = this.readRegister((address & ~3) >>> 0);
    return bytes === 4 ? word : (word >>> (8 * (address & 3))) & (bytes === 2 ? 0xffff : 0xff);
  }

  write(address, bytes, value) {
    if (address & (bytes - 1)) fault(`HardFault: unaligned write of ${bytes} bytes at ${hex(address)}`);
    if (address >= RAM && address < RAM + 0x42000) {
      const at = address - RAM;
      if (bytes === 4) this.ramView.setUint32(at, value, true);
      else if (bytes === 2) this.ramView.setUint16(at, value, true);
      else this.ramView.setUint8(at, value);
      return;
    }
    if (address >= USB_MEMORY && address < USB_MEMORY + 0x1000) { this.block(address); return this.usb.writeMemory(address - USB_MEMORY, bytes, value, this.now); }
    if (bytes !== 4) fault(`${bytes}-byte write to a register at ${hex(address)}: silicon would write all four bytes`);
    this.writeRegister(address, value >>> 0);
  }

  block(address) {
    const key = (address >>> 14) << 2;
    const name = RESET_OF.get(key);
    if (name) {
      if ((this.inReset >>> RESET_BITS[name]) & 1) fault(`access to ${hex(address)}: ${name} is still in reset`);
    } else if (!ALWAYS_ON.has(key)) fault(`HardFault: nothing the firmware may use at ${hex(address)}`);
    return key;
  }

  readRegister(address) {
    const { chip } = this;
    if (!this.isTransferring) this.tickClock();
    if (address >>> 12 === 0xe000e) {
      if (address === 0xe000e018) {
        this.tickOrigin ??= this.now; // the controller's tick 0: its first look after it began anew
        return this.systick.read(this.now);
      }
      return chip.ppb.readUint32(address & 0xfff);
    }
    if (address >>> 16 === 0xd000) {
      if (address === 0xd0000004) return this.gpioIn();
      return chip.sio.readUint32(address & 0xffff) >>> 0;
    }
    const offset = address & 0xfff;
    switch (this.block(address)) {
      case 0x4000c: return offset === 0 ? this.inReset : offset === 8 ? ~this.inReset & 0x01ffffff : fault('RESETS register');
      case 0x40060: return this.ringOscillator();
      case 0x40034: return this.uart.readUint32(offset, this.now);
      case 0x4004c: return this.adc.readUint32(offset, this.now);
      case 0x18000: return this.ssi.readUint32(offset, this.now);
      case 0x50110: return this.usb.readUint32(offset, this.now);
      case 0x50000: this.sync(); this.nextDue = 0; return this.dma.readUint32(offset);
      case 0x50200: return this.readPio(0, offset);
      case 0x50300: return this.readPio(1, offset);
    }
    return chip.findPeripheral(address).readUint32(address & 0x3fff) >>> 0;
  }

  // As bad as they may be: three of four are ones, and within 0.5 us of a look the next shows the same bit.
  ringOscillator() {
    if (!(this.now - this.randomAt < 50)) this.random = ((this.random ?? 0x2f6e2b1) * 1103515245 + 12345) & 0x7fffffff;
    this.randomAt = this.now;
    return (this.random >>> 16) & 3 ? 1 : 0;
  }

  readPio(number, offset) {
    this.sync();
    if (offset >= 0x20 && offset < 0x30) this.quietUntil = this.hardwareTick; // takes a word
    this.nextDue = 0;
    return this.pios[number].readUint32(offset) >>> 0;
  }

  writeRegister(address, value) {
    const { chip } = this;
    if (!this.isTransferring) this.tickClock();
    this.nextDue = 0;
    if (address >>> 12 === 0xe000e) {
      if (address === 0xe000e010) return this.systick.control(value, this.now);
      if (address === 0xe000e014) return (this.systick.reload = value & 0xffffff);
      if (address === 0xe000e018) return ([this.systick.from, this.tickOrigin] = [this.now, undefined]); // any write makes it zero
      return chip.ppb.writeUint32(address & 0xfff, value);
    }
    if (address >>> 16 === 0xd000) return chip.sio.writeUint32(address & 0xffff, value);
    const offset = address & 0xfff;
    const kind = (address >>> 12) & 3;
    const key = this.block(address);
    const plain = (old) => (kind === 0 ? value : kind === 1 ? old ^ value : kind === 2 ? old | value : old & ~value) >>> 0;
    switch (key) {
      case 0x4000c:
        if (offset !== 0) fault('RESETS register');
        return this.setResets(plain(this.inReset));
      case 0x40034: return this.uart.writeUint32(offset, kind ? plain(this.uart.readUint32(offset, this.now)) : value, this.now);
      case 0x18000: return this.ssi.writeUint32(offset, value, this.now);
      case 0x4004c: return this.adc.writeUint32(offset, kind ? plain(this.adc.readUint32(offset, this.now)) : value, this.now);
      case 0x50110:
        this.host.now = this.now;
        return this.usb.writeUint32(offset, kind ? plain(this.usb.readUint32(offset, this.now)) : value, value);
      case 0x50000:
        this.sync();
        this.quietUntil = this.hardwareTick;
        return this.dma.writeUint32(offset, kind ? plain(this.dma.readUint32(offset)) : value);
      case 0x50200:
      case 0x50300: {
        const pio = this.pios[key === 0x50200 ? 0 : 1];
        this.sync();
        this.quietUntil = this.hardwareTick;
        pio.writeUint32(offset, kind ? plain(pio.readUint32(offset)) : value);
        if (pio.settlePins()) this.updatePins();
        return;
      }
      case 0x4001c: this.padsSet.add((offset - 4) >> 2); break;
      case 0x40014:
        if (offset < 0xf0 && (offset & 4) && (value & 31) !== 31 && !this.padsSet.has(offset >> 3)) {
          fault(`GPIO${offset >> 3} is used, but its pad is left as it was at reset`);
        }
        if (offset < 0xf0) return writePinControl(this, offset, value, kind);
        break;
      case 0x40054:
        if (!this.watchdog.tickEnable) fault('the timer stands still: nobody started the watchdog tick');
        break;
      case 0x40010: this.wdsel = value; break;
      case 0x40058: if (offset === 4) this.isApplication() ? this.loop.kicked(this.now) : this.loop.stalled(); if (offset === 0 && kind !== 3 && value & 0xc0000000 && this.wdsel !== 0x1fffc) {
        fault('a watchdog reset would not reset everything but the oscillators: PSM_WDSEL');
      }
    }
    chip.findPeripheral(address).writeUint32Atomic(offset, value, kind);
    if (key === 0x4001c) padWritten(this, (offset - 4) >> 2);
  }

  // Or the loader, which runs from flash and from the last of the RAM.
  isApplication() { return this.chip.core.registers[15] >>> 0 >= RAM && this.chip.core.registers[15] >>> 0 < LOADER_RAM; }

  setResets(value) {
    const fell = value & ~this.inReset;
    this.nvic.checkResets(fell);
    this.sync();
    this.quietUntil = this.hardwareTick;
    for (const number of [0, 1]) if ((fell >>> (10 + number)) & 1) { this.pios[number].reset(); this.updatePins(); }
    if ((fell >>> RESET_BITS.dma) & 1) this.dma.reset();
    if ((fell >>> RESET_BITS.uart0) & 1) this.uart.reset();
    if (fell & 1) this.adc.reset();
    if ((fell >>> RESET_BITS.usb) & 1) { this.host.now = this.now; this.usb.reset(); }
    this.inReset = value;
  }

  // ---- hardware ----

  rawInputs() {
    let raw = 0;
    for (const pin of this.inputPins) if (this.chip.gpio[pin].inputValue) raw |= 1 << pin;
    for (const pin of this.outputPins) if (this.chip.gpio[pin].inputValue) raw |= 1 << pin;
    return raw;
  }

  gpioIn() { return this.rawInputs() >>> 0; }

  updatePins() {
    for (const pin of this.outputPins) this.chip.gpio[pin].checkForUpdates();
  }

  // Bring the hardware to this tick.
  sync(tick = this.now) {
    if (this.isTransferring) return; // the DMA is part of the hardware being run
    this.runHardware(tick);
    if (this.hardwareTick < tick) {
      const cycles = tick - this.hardwareTick;
      for (const pio of this.pios) pio.skip(cycles);
      this.hardwareTick = tick;
      this.quietUntil = tick;
    }
  }

  runHardware(until) {
    while (this.hardwareTick < until) {
      if (this.quietUntil > this.hardwareTick) {
        if (this.quietUntil >= until) return; // still quiet; caught up lazily
        const cycles = this.quietUntil - this.hardwareTick;
        for (const pio of this.pios) pio.skip(cycles);
        this.hardwareTick = this.quietUntil;
      }
      const raw = this.rawInputs();
      this.isTransferring = true;
      this.dma.step();
      this.isTransferring = false;
      const changed = this.pios[0].step(raw) | this.pios[1].step(raw);
      this.hardwareTick++;
      if (changed) {
        this.stamp = this.hardwareTick; // registered: seen after the clock edge
        this.updatePins();
        this.stamp = undefined;
      }
      if (!changed && this.dma.quiet() > 0) { // after a change, inputs may have followed by a wire
        const quiet = Math.min(this.pios[0].quiet(raw), this.pios[0].first === raw ? this.pios[1].quiet(raw) : 0);
        this.quietUntil = this.hardwareTick + quiet;
      }
    }
  }

  // ---- time ----

  // Let rp2040js' timers catch up; its alarms fire on the way.
  tickClock() {
    if (this.clockedAt === this.now) return;
    const ticks = this.now - this.clockedAt;
    this.clockedAt = this.now;
    this.chip.clock.tick(ticks * 10);
  }

  get alarmTick() {
    const { clock } = this.chip;
    return clock.nextAlarm ? this.clockedAt + Math.ceil((clock.nextAlarm.nanos - clock.nanos) / 10) : Infinity;
  }

  // Up to this tick an instruction may run without anything else happening.
  findDue() {
    const quiet = this.quietUntil > this.hardwareTick ? this.quietUntil : this.now;
    this.nextDue = Math.min(this.inputs.length ? this.inputs[0][0] : Infinity, this.uart.next, this.host.next, this.alarmTick, quiet);
  }

  advance(tick) {
    for (;;) {
      const due = Math.min(this.inputs.length ? this.inputs[0][0] : Infinity, this.uart.next, this.host.next, tick);
      this.now = Math.max(due, this.now);
      this.tickClock();
      this.runHardware(this.now);
      if (due >= tick && !(this.inputs.length && this.inputs[0][0] <= this.now) && this.uart.next > this.now && this.host.next > this.now) break;
      while (this.inputs.length && this.inputs[0][0] <= this.now) {
        const [, pin, level] = this.inputs.shift();
        this.sync();
        this.drive(pin, level);
      }
      this.uart.run(this.now);
      this.host.run(this.now);
      if (due >= tick) break;
    }
  }

  run(until, at) {
    const { uart, host } = this;
    this.nextDue = 0; // whoever called may have given us inputs
    while (this.now < until) {
      if (this.watchdogFired) {
        this.resets.push(this.now);
        this.trap = undefined;
        this.scratch.set(this.watchdog.scratchData);
        this.boot(this.watchdog.reason);
        if (this.bootloader) this.heldUntil = Infinity; // the ROM's own USB is not modelled: silent, everything at reset
        continue;
      }
      const held = Math.max(this.heldUntil, this.stalledUntil);
      const { core } = this.chip;
      if (core.waiting && core.PM && core.checkForInterrupts()) core.waiting = false; // pending before it slept
      if (this.now < held || core.waiting) {
        if (core.waiting) this.loop.slept ??= this.now;
        const alarm = this.alarmTick;
        const wake = this.now < held ? Math.min(held, alarm) : alarm;
        const next = Math.min(wake, until, uart.next, host.next, this.inputs.length ? this.inputs[0][0] : Infinity);
        if (next === Infinity) fault('the processor sleeps and nothing will wake it');
        this.advance(Math.max(next, this.now + 1));
        this.findDue();
      } else if (core.PC === at && this.stoppedAt !== at) return void (this.stoppedAt = at); // the next run goes on from here
      else {
        const pc = core.registers[15];
        const wait = pc >= FLASH && pc < RAM ? this.cache.wait(pc) : 0;
        if (wait > 0) { // fetched first: what it does is done when it is there
          this.advance(this.now + wait);
          this.findDue();
          continue;
        }
        const cycles = (this.trap ? this.trap.step(core) : core.executeInstruction()) + this.waits;
        this.waits = 0;
        if (core.PC === this.stoppedAt + 2) this.stoppedAt = undefined; // an interrupt may have come first
        this.usedInstructions++;
        if (core.PC === pc && !core.interruptsUpdated && !this.trap) { // a branch to itself: so on until something else happens
          const next = Math.min(this.alarmTick, until, uart.next, host.next, this.inputs.length ? this.inputs[0][0] : Infinity);
          this.advance(Math.max(next, this.now + cycles));
          this.findDue();
        } else if (this.now + cycles < this.nextDue) this.now += cycles;
        else {
          this.advance(this.now + cycles);
          this.findDue();
        }
      }
    }
  }

  input(tick, pin, level) {
    if (!this.inputPins.includes(pin) || tick < this.now) fault(`input on GP${pin} at ${tick}: not an input, or in the past (${this.now})`);
    let at = this.inputs.length;
    while (at > 0 && this.inputs[at - 1][0] > tick) at--;
    this.inputs.splice(at, 0, [tick, pin, level]);
  }

  drive(pin, level) {
    this.held.add(pin);
    this.put(pin, level);
  }

  put(pin, level) {
    this.quietUntil = this.hardwareTick;
    if (this.levels.get(pin) === level) return;
    this.levels.set(pin, level);
    this.chip.gpio[pin].setInputValue(level === 1);
  }

  write_serial(bytes) { this.uart.feed(bytes, this.now); }

  read_serial() {
    const sent = this.uart.sent;
    this.uart.sent = [];
    return sent;
  }

  pins() {
    const drained = this.transitions;
    this.transitions = [];
    return drained;
  }

  reset() {
    this.watchdog.reason = 1; // timer
    this.watchdogFired = true;
  }

  stall(ticks) {
    this.stalledUntil = this.now + ticks;
    this.loop.stalled();
  }

  setTrap(at, what) { this.trap = new Trap(at, what); }
}

export { Fault };
