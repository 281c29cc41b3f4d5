#!/usr/bin/env node
// Runs the shipped image.
//
//   emulate.mjs IMAGE.uf2 --serve PORT [--sync-hz 25] [--vcd FILE]   in real time as far as it can; UART0 as TCP for socket://
//   emulate.mjs IMAGE.uf2 --drive [--vcd FILE]                       in virtual time; a JSON object a line on stdin, its answer on stdout
//
// Objects: {"op": "run", "until": T} | {"op": "input", "edges": [[tick, pin, level], ..]} | {"op": "write", "hex": ".."}
//   | {"op": "stall", "ticks": N} | {"op": "reset"}, as if the watchdog bit now. "run" takes "edges" and "hex" as well, which
// come first. The answer always has now, pins [[tick, pin, level], ..], sent [[tick, byte], ..], resets, stack (bytes used at
// most), origin (tick at which the controller's own count began, 0 before it does), overruns (bytes the UART had no room for).

import { readFileSync, createWriteStream } from 'node:fs';
import { createServer } from 'node:net';
import { createInterface } from 'node:readline';
import { Fault, Machine } from './machine.mjs';
import { VcdWriter } from './vcd.mjs';

function usage(message) {
  process.stderr.write(`emulate.mjs: ${message}\n  emulate.mjs IMAGE.uf2 --serve PORT [--sync-hz HZ] [--vcd FILE] | --drive [--vcd FILE]\n`);
  process.exit(2);
}

function options(args) {
  const given = { image: undefined };
  for (let i = 0; i < args.length; i++) {
    if (args[i] === '--drive') given.drive = true;
    else if (['--serve', '--sync-hz', '--vcd'].includes(args[i])) given[args[i].slice(2)] = args[++i] ?? usage(`${args[i - 1]} needs a value`);
    else if (!args[i].startsWith('--') && given.image === undefined) given.image = args[i];
    else usage(`unknown argument ${args[i]}`);
  }
  if (given.image === undefined || (!given.drive && given.serve === undefined)) usage('say which image, and --serve PORT or --drive');
  return given;
}

function answer(machine, op) {
  switch (op.op) {
    case 'run':
      if (op.hex) machine.write_serial(Buffer.from(op.hex, 'hex'));
      for (const [tick, pin, level] of op.edges ?? []) machine.input(tick, pin, level);
      machine.run(op.until);
      break;
    case 'input': for (const [tick, pin, level] of op.edges) machine.input(tick, pin, level); break;
    case 'reset': machine.reset(); break;
    case 'write': machine.write_serial(Buffer.from(op.hex, 'hex')); break;
    case 'stall': machine.stall(op.ticks); break;
    case 'usb': machine.host.do(op, machine.now); break;
    case 'leave-bootloader': machine.leaveBootloader(); break;
    default: throw new Fault(`no such op: ${op.op}`);
  }
  return { now: machine.now, pins: machine.pins(), sent: machine.read_serial(), resets: machine.resets, stack: machine.stackUsed(), bootloader: machine.bootloader ?? null, usb: op.op === 'usb' || machine.host.state !== 'detached' ? machine.host.report() : null, origin: machine.tickOrigin ?? 0, overruns: machine.uart.overruns };
}

function drive(machine, vcd) {
  createInterface({ input: process.stdin }).on('close', () => vcd?.end(machine.now)).on('line', (line) => {
    let reply;
    try {
      reply = answer(machine, JSON.parse(line));
      vcd?.write(reply.pins, reply.sent, reply.now);
    } catch (error) {
      reply = { fault: error instanceof Fault ? error.message : error.stack, now: machine.now, pc: machine.chip.core.PC };
    }
    process.stdout.write(JSON.stringify(reply) + '\n');
  });
}

// Steps of 2 ms of virtual time, never ahead of the wall clock; behind it when the machine is too slow, which is said.
function serve(machine, port, syncHz, vcd) {
  const STEP = 200_000;
  let client;
  let edge = 20_000_000;
  const began = process.hrtime.bigint();
  let lost = 0n;
  const server = createServer((socket) => {
    client?.destroy();
    client = socket.setNoDelay(true);
    socket.on('data', (bytes) => machine.write_serial(bytes)).on('error', () => {}).on('close', () => { if (client === socket) client = undefined; });
  });
  server.listen(port, '127.0.0.1', () => process.stdout.write(`listening on socket://127.0.0.1:${server.address().port}\n`));
  const step = () => {
    const wall = (process.hrtime.bigint() - began) / 10n - lost;
    const behind = wall - BigInt(machine.now);
    if (behind > 50_000_000n) lost += behind;
    for (let i = 0; i < 10 && machine.now < Number(wall); i++) {
      for (; syncHz && edge < machine.now + 2 * STEP; edge += Math.round(1e8 / syncHz)) {
        machine.input(edge, 2, 0);
        machine.input(edge + 10_000, 2, 1);
      }
      machine.run(machine.now + STEP);
      const sent = machine.read_serial();
      vcd?.write(machine.pins(), sent, machine.now);
      if (client && sent.length) client.write(Buffer.from(sent.map(([, byte]) => byte)));
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
  machine = new Machine(readFileSync(given.image));
} catch (error) {
  process.stderr.write(`emulate.mjs: ${given.image}: ${error.message}\n`);
  process.exit(1);
}
machine.input(0, 7, 0); // interlock closed
const vcd = given.vcd && new VcdWriter(createWriteStream(given.vcd));
if (given.drive) drive(machine, vcd);
else serve(machine, Number(given.serve), Number(given['sync-hz'] ?? 0), vcd);
