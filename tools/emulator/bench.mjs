#!/usr/bin/env node
// A controller and the rig that tests it, wired to each other, in real time as far as it can:
//
//   bench.mjs CONTROLLER.uf2 RIG.uf2 --serve PORT --serve-rig PORT    UART0 of each as TCP for socket://; 0: any port, which is told
//             --serve-usb PORT --serve-rig-usb PORT                   the USB port of each likewise, instead or as well
//             --ppm 37.3                                              how much faster the rig's crystal runs
//             --jumpers 2,3,7-7,4-3                                   a pin of both boards, or controller's-rig's; all there can be

import { readFileSync } from 'node:fs';
import { INPUT_PINS, OUTPUT_PINS, TICK_HZ } from './controller.mjs';
import { listen } from './listen.mjs';
import { Pair } from './pair.mjs';

const VALUES = ['--serve', '--serve-rig', '--serve-usb', '--serve-rig-usb', '--ppm', '--jumpers'];
const ALL = [...INPUT_PINS, ...OUTPUT_PINS].filter((pin) => pin < 17).map((pin) => [pin, pin]);
const STEP = 50_000; // ticks between two looks at the sockets: what a host on a cable would wait, no more
const STARTED = 5_000_000; // ticks in which both boards do; nobody connects before
const BEHIND_MAX = 50_000_000n; // what the wall clock is ahead by more than this is given up

function usage(message) {
  process.stderr.write(`bench.mjs: ${message}\n  bench.mjs CONTROLLER.uf2 RIG.uf2 --serve PORT --serve-rig PORT [--serve-usb PORT] [--serve-rig-usb PORT] [--ppm N] [--jumpers PIN,PIN-PIN,..]\n`);
  process.exit(2);
}

function options(args) {
  const given = { images: [] };
  for (let i = 0; i < args.length; i++) {
    if (VALUES.includes(args[i])) given[args[i].slice(2)] = args[++i] ?? usage(`${args[i - 1]} needs a value`);
    else if (!args[i].startsWith('--') && given.images.length < 2) given.images.push(args[i]);
    else usage(`unknown argument ${args[i]}`);
  }
  if (given.images.length < 2) usage('say which two images');
  return given;
}

function fail(error, pair) {
  const where = pair ? ` (controller: tick ${pair.controller.now}, rig: tick ${pair.rig.now}, pc 0x${pair.rig.chip.core.PC.toString(16)})` : '';
  process.stderr.write(`bench.mjs: ${error.message}${where}\n`);
  process.exit(1);
}

const given = options(process.argv.slice(2));
const wires = given.jumpers === undefined ? ALL : given.jumpers.split(',').filter((text) => text).map((text) => text.split('-').map(Number)).map(([ours, theirs]) => [ours, theirs ?? ours]);
let pair;
try {
  pair = new Pair(readFileSync(given.images[0]), readFileSync(given.images[1]), { wires, ppm: Number(given.ppm ?? 37.3) });
} catch (error) {
  fail(error);
}

function serveUsb(machine, port, name) { // plugged in from the start; whoever connects opens the port
  const tell = (what, more) => machine.host.do({ do: what, ...more }, machine.now);
  tell('attach');
  tell('close');
  let send; // a port is there once the host has configured its device, and goes with it: then it hangs up, as a tty does
  return () => {
    if (!send && machine.host.state === 'configured') send = listen(Number(port), name, (bytes) => tell('write', { hex: bytes.toString('hex') }), () => tell('open'), () => tell('close'));
    if (machine.host.state === 'detached') send?.hangUp();
    send?.(machine.host.read());
  };
}

pair.run(STARTED);
const lines = [];
for (const [machine, uart, usb, name] of [[pair.controller, given.serve, given['serve-usb'], 'controller'], [pair.rig, given['serve-rig'], given['serve-rig-usb'], 'rig']]) {
  const toUart = uart === undefined ? () => {} : listen(Number(uart), name, (bytes) => machine.write_serial(bytes));
  const toUsb = usb === undefined ? () => {} : serveUsb(machine, usb, `${name}'s USB`);
  lines.push(() => {
    toUart(Buffer.from(machine.read_serial().map(([, byte]) => byte)));
    toUsb();
    machine.pins();
  });
}

const TICK_NS = BigInt(1e9 / TICK_HZ);
const began = process.hrtime.bigint() - TICK_NS * BigInt(STARTED);
let now = STARTED;
let lost = 0n;
function step() {
  const wall = (process.hrtime.bigint() - began) / TICK_NS - lost;
  const behind = wall - BigInt(now);
  if (behind > BEHIND_MAX) lost += behind;
  if (now < Number(wall)) {
    now += STEP;
    pair.run(now);
    for (const line of lines) line();
  }
  if (now < Number(wall)) setImmediate(guarded);
  else setTimeout(guarded, 1);
}
function guarded() { try { step(); } catch (error) { fail(error, pair); } }
process.on('uncaughtException', (error) => fail(error, pair));
for (const signal of ['SIGINT', 'SIGTERM']) process.on(signal, () => process.exit(0));
guarded();
