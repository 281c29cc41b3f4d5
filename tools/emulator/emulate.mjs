#!/usr/bin/env node
// Runs the shipped image.
//
//   emulate.mjs IMAGE.uf2 --serve PORT [--sync-hz 25] [--vcd FILE]   in real time as far as it can; UART0 as TCP for socket://
//                         --serve-usb PORT                           the USB port likewise, instead or as well
//                         --serve-usbip PORT                         the USB device itself, for another kernel's vhci-hcd
//                         --wires 8-2,5-7                            jumpers, from an output pin to an input
//   emulate.mjs IMAGE.uf2 --drive [--vcd FILE]                       in virtual time; a JSON object a line on stdin, its answer on stdout
//
// Objects: {"op": "run", "until": T, "at": PC or nothing} (stops before that instruction) | {"op": "input", "edges": [[tick, pin, level], ..]}
//   | {"op": "write", "hex": ".."} | {"op": "stall", "ticks": N} | {"op": "dma-count", "channel": C, "count": N} (transfers still to do) | {"op": "age", "us": N} (of the timer's count)
//   | {"op": "wires", "wires": [[from, to], ..]} | {"op": "let-go", "pin": N} (an input whose wire is off) | {"op": "pulls", "pulls": [[output, level], ..]} (resistors outside) | {"op": "leave-bootloader"} | {"op": "trap", "at": ADDRESS, "what": "hang" | "fault"}
//   | {"op": "power-cycle", "short": true | false} | {"op": "bootsel"} (the same, and that button held) | {"op": "copy-uf2", "file": PATH}
//   | {"op": "flash", "erase_ticks": N} (of a sector) | {"op": "flash", "at": N, "hex": ".."} (bits that rot) | {"op": "ram", "at": ADDRESS, "hex": ".."}
//   | {"op": "anew", "image": PATH, "flash_id": HEX or nothing, "board": KIND or nothing} (another board in place of this one)
//   | {"op": "usb", "do": "attach" | "detach" | "reset" | "suspend" | "resume" | "hang" | "open" | "close" | "write" (hex)
//   | "control" (setup, data: hex)} | {"op": "usbip", "port": N} (0: any; usb then tells it). The answer always has now, pins [[tick, pin, level], ..], sent
// [[tick, byte], ..], resets, stack (bytes used at most), bootloader (what the image told the boot ROM, or null), usb (what its host
// knows, or null), pulled_up (D+, by the device), origin (tick at which the controller's own count began), round ([ticks, when it began] of the main loop's longest that ended since the last answer). --flash-id: the flash chip's 64 bits, 16 hex digits.
// --board pico | pico-w | other: what carries the chip.

import { readFileSync, createWriteStream } from 'node:fs';
import { createInterface } from 'node:readline';
import { letGo, setWires } from './inputs.mjs';
import { stackUsed } from './loop.mjs';
import { PIN, TICK_HZ } from './controller.mjs';
import { listen } from './listen.mjs';
import { Fault, Machine } from './machine.mjs';
import { setPulls } from './pads.mjs';
import { ageTimer, copyUf2, holdBootsel, leaveBootloader, powerCycle, spoilFlash, spoilRam } from './power.mjs';
import { UsbIp } from './usbip.mjs';
import { VcdWriter } from './vcd.mjs';

function usage(message) {
  process.stderr.write(`emulate.mjs: ${message}\n  emulate.mjs IMAGE.uf2 --serve PORT [--serve-usb PORT | --serve-usbip PORT] [--sync-hz HZ] [--wires FROM-TO,..] [--vcd FILE] [--flash-id HEX] [--board KIND] | --drive [--vcd FILE] [--flash-id HEX] [--board KIND]\n`);
  process.exit(2);
}

function options(args) {
  const given = { image: undefined };
  for (let i = 0; i < args.length; i++) {
    if (args[i] === '--drive') given.drive = true;
    else if (args[i] === '--flash-waits') continue; // they always are
    else if (['--serve', '--serve-usb', '--serve-usbip', '--sync-hz', '--wires', '--vcd', '--flash-id', '--board'].includes(args[i])) given[args[i].slice(2)] = args[++i] ?? usage(`${args[i - 1]} needs a value`);
    else if (!args[i].startsWith('--') && given.image === undefined) given.image = args[i];
    else usage(`unknown argument ${args[i]}`);
  }
  if (given.image === undefined || (!given.drive && given.serve === undefined && given['serve-usb'] === undefined && given['serve-usbip'] === undefined)) usage('say which image, and --serve PORT, --serve-usb PORT, --serve-usbip PORT or --drive');
  if (given['serve-usb'] !== undefined && given['serve-usbip'] !== undefined) usage('there is one USB port: --serve-usb or --serve-usbip');
  return given;
}

function answer(machine, op) {
  switch (op.op) {
    case 'run':
      if (op.hex) machine.write_serial(Buffer.from(op.hex, 'hex'));
      for (const [tick, pin, level] of op.edges ?? []) machine.input(tick, pin, level);
      machine.run(op.until, op.at);
      break;
    case 'input': for (const [tick, pin, level] of op.edges) machine.input(tick, pin, level); break;
    case 'reset': machine.reset(); break;
    case 'write': machine.write_serial(Buffer.from(op.hex, 'hex')); break;
    case 'wires': setWires(machine, op.wires); break;
    case 'let-go': letGo(machine, op.pin); break;
    case 'pulls': setPulls(machine, op.pulls); break;
    case 'stall': machine.stall(op.ticks); break;
    case 'trap': machine.setTrap(op.at, op.what); break;
    case 'power-cycle': powerCycle(machine, op.short); break;
    case 'dma-count': machine.dma.channels[op.channel].count = op.count; break;
    case 'age': ageTimer(machine, op.us); break;
    case 'usb': machine.host.do(op, machine.now); break;
    case 'usbip': machine.host = new UsbIp(machine.usb, op.port, () => machine.now); break;
    case 'leave-bootloader': leaveBootloader(machine); break;
    case 'bootsel': holdBootsel(machine); break;
    case 'copy-uf2': copyUf2(machine, readFileSync(op.file)); break;
    case 'flash':
      if (op.erase_ticks !== undefined) machine.flashChip.eraseTicks = op.erase_ticks;
      if (op.hex !== undefined) spoilFlash(machine, op.at, Buffer.from(op.hex, 'hex'));
      break;
    case 'ram': spoilRam(machine, op.at, Buffer.from(op.hex, 'hex')); break;
    case 'anew': break;
    default: throw new Fault(`no such op: ${op.op}`);
  }
  return { now: machine.now, pins: machine.pins(), sent: machine.read_serial(), resets: machine.resets, stack: stackUsed(machine.ramView), bootloader: machine.bootloader ?? null, usb: op.op === 'usb' || machine.host.state !== 'detached' || machine.host.received?.length ? machine.host.report() : null, origin: machine.tickOrigin ?? 0, round: machine.loop.take(), overruns: machine.uart.overruns, pulled_up: machine.usb.pulledUp, flash: { erased: machine.flashChip.erased, programmed: machine.flashChip.programmed } };
}

// A board just switched on, its interlock closed.
function powered(image, flashId, board) {
  const machine = new Machine(readFileSync(image), flashId, board);
  machine.input(0, PIN.INTERLOCK, 0);
  return machine;
}

function drive(machine, vcd) {
  createInterface({ input: process.stdin }).on('close', () => { vcd?.end(machine.now); machine.host.close?.(); }).on('line', (line) => {
    let reply;
    try {
      const op = JSON.parse(line);
      if (op.op === 'anew') { // nothing of a board outlives it: all its state is the machine's
        machine.host.close?.();
        machine = powered(op.image, op.flash_id, op.board);
      }
      reply = answer(machine, op);
      vcd?.write(reply.pins, reply.sent, reply.now);
    } catch (error) {
      reply = { fault: error instanceof Fault ? error.message : error.stack, now: machine.now, pc: machine.chip.core.PC };
    }
    process.stdout.write(JSON.stringify(reply) + '\n');
  });
}

// Steps of 2 ms of virtual time, never ahead of the wall clock; behind it when the machine is too slow, which is said.
function serve(machine, given, vcd) {
  const STEP = 200_000;
  const TICK_NS = BigInt(1e9 / TICK_HZ);
  const syncHz = Number(given['sync-hz'] ?? 0);
  let edge = 20_000_000;
  const began = process.hrtime.bigint();
  let lost = 0n;
  if (given['serve-usbip'] !== undefined) machine.host = new UsbIp(machine.usb, Number(given['serve-usbip']), () => machine.now);
  const { host } = machine;
  const tell = (what, more) => host.do({ do: what, ...more }, machine.now);
  const toUart = given.serve === undefined ? () => {} : listen(Number(given.serve), 'listening', (bytes) => machine.write_serial(bytes));
  let toUsb = () => {};
  if (given['serve-usb'] !== undefined) { // plugged in from the start; whoever connects opens the port
    tell('attach');
    tell('close');
    toUsb = listen(Number(given['serve-usb']), 'USB', (bytes) => tell('write', { hex: bytes.toString('hex') }), () => tell('open'), () => tell('close'));
  }
  if (given['serve-usbip'] !== undefined) {
    tell('attach');
    host.server.on('listening', () => process.stdout.write(`USB/IP on 127.0.0.1:${host.server.address().port}\n`));
  }
  const step = () => {
    const wall = (process.hrtime.bigint() - began) / TICK_NS - lost;
    const behind = wall - BigInt(machine.now);
    if (behind > 50_000_000n) lost += behind;
    for (let i = 0; i < 10 && machine.now < Number(wall); i++) {
      for (; syncHz && edge < machine.now + 2 * STEP; edge += Math.round(TICK_HZ / syncHz)) {
        machine.input(edge, PIN.SYNC, 0);
        machine.input(edge + 10_000, PIN.SYNC, 1);
      }
      machine.run(machine.now + STEP);
      const sent = machine.read_serial();
      vcd?.write(machine.pins(), sent, machine.now);
      toUart(Buffer.from(sent.map(([, byte]) => byte)));
      toUsb(host.read());
    }
    if (machine.now < Number(wall)) setImmediate(step);
    else setTimeout(step, 1);
  };
  const guarded = () => { try { step(); } catch (error) { process.stderr.write(`emulate.mjs: ${error.message} (tick ${machine.now}, pc 0x${machine.chip.core.PC.toString(16)})\n`); process.exit(1); } };
  process.on('uncaughtException', (error) => { process.stderr.write(`emulate.mjs: ${error.message} (tick ${machine.now}, pc 0x${machine.chip.core.PC.toString(16)})\n`); process.exit(1); });
  for (const signal of ['SIGINT', 'SIGTERM']) process.on(signal, () => { vcd?.end(machine.now); process.exit(0); });
  guarded();
}

const given = options(process.argv.slice(2));
let machine;
try {
  machine = powered(given.image, given['flash-id'], given.board);
} catch (error) {
  process.stderr.write(`emulate.mjs: ${given.image}: ${error.message}\n`);
  process.exit(1);
}
if (given.wires) setWires(machine, given.wires.split(',').map((wire) => wire.split('-').map(Number)));
const vcd = given.vcd && new VcdWriter(createWriteStream(given.vcd));
if (given.drive) drive(machine, vcd);
else serve(machine, given, vcd);
