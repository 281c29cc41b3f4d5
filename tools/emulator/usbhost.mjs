// A host on the other end of the USB cable: enumerates as Linux does, then is its cdc-acm driver. Full speed: a byte takes
// two thirds of a microsecond, one transaction is on the wire at a time, what gets NAK is asked again.

import { TICK_HZ } from './controller.mjs';
import { fault } from './fault.mjs';

const BYTE = 67; // ticks
const US = TICK_HZ / 1e6;
const MS = 1000 * US;
const DEBOUNCE = 100 * MS; // as Linux' hub driver
const RESET = 50 * MS;
const RECOVERY = 10 * MS;
const SUSPEND_AFTER = 3 * MS; // an idle bus
const RESUMING = 40 * MS; // the signal that ends it, with no frames yet
const FRAME = 100_030; // a millisecond by the host's own clock, 300 ppm slow: its frames drift through the device's rounds
const FRAME_BEGINS = 3 * US, FRAME_ENDS = 10 * US; // the packet that starts it; no transaction reaches into the end
const LATE = 0.8; // of a frame: what is handed over for bulk in from here on is fatal with some hosts, erratum E15
const TOKEN = 3 * US; // 35 bits
const PATIENCE = 500 * MS;    // with a control transfer
const URB = 128;              // what cdc-acm asks for at a time: two packets, or up to a short one
const SETUP_OUT = (type, request, value, index, length) => [type, request, value & 255, value >> 8, index & 255, index >> 8, length & 255, length >> 8];
const descriptor = (kind, index, length, language = 0) => SETUP_OUT(0x80, 6, (kind << 8) | index, language, length);

export class UsbHost {
  constructor(usb) {
    this.usb = usb;
    usb.onPull = () => this.pulled();
    usb.frameAt = (now) => this.frameAt(now);
    usb.lateFrom = LATE * FRAME;
    this.now = 0;
    this.framesFrom = Infinity; // when the port was enabled, or the bus woke
    this.attached = 0; // so often a device was plugged in
    this.cable = false;
    this.wantOpen = true; // the port is opened as soon as there is one
    this.clear();
    this.received = []; // bytes the driver gave its user
    this.controls = []; // {setup, status, data} of those asked for by `control`
    this.found = {};    // descriptors
    this.state = 'detached';
    this.packets = { in: 0, out: 0, nak: 0 };
  }

  // Everything under way is void: the device is gone or reset.
  clear() {
    if (this.current) this.usb.cancel(this.current.endpoint);
    this.current = undefined;
    this.stopFrames();
    this.tasks = [];
    this.address = 0;
    this.toggles = { in: 0, out: 0 };
    this.outgoing = [];
    this.urb = [];
    this.isOpen = false;
    this.asleep = false; // suspended: only what may happen then does
    this.turn = 0;
  }

  get next() {
    if (this.current) return this.current.end;
    let least = Infinity;
    for (const task of this.tasks) if (task.wake < least && (!this.asleep || task.alsoAsleep)) least = task.wake;
    return least;
  }

  // What is due at `now`.
  run(now) {
    while (this.next <= now) {
      if (this.current) {
        const { end, task, finish } = this.current;
        this.now = end;
        this.current = undefined;
        task.result = finish();
        if (!this.asleep) this.resume(task);
      } else {
        const ready = this.tasks.filter((task) => task.wake <= now && (!this.asleep || task.alsoAsleep));
        const task = ready.find((each) => each.first) ?? ready[this.turn++ % ready.length];
        this.now = Math.max(this.now, task.wake);
        this.resume(task);
      }
    }
    this.now = now;
  }

  start(generator, first = false, alsoAsleep = false) { this.tasks.push({ generator, first, alsoAsleep, wake: this.now, result: undefined }); }

  // Let a task go on until it waits or puts something on the wire.
  resume(task) {
    const { result } = task;
    task.result = undefined;
    const { value, done } = task.generator.next(result);
    if (!this.tasks.includes(task)) return; // it ended everything, itself included
    if (done) this.tasks.splice(this.tasks.indexOf(task), 1);
    else if (value.wait !== undefined) task.wake = this.now + value.wait;
    else {
      task.wake = Infinity;
      this.current = { ...value, end: this.now + value.ticks, task, finish: () => { task.wake = this.now; return value.finish(); } };
    }
  }

  // ---- frames ----

  frameAt(now) {
    const age = now % FRAME;
    return now - age >= this.framesFrom ? { number: Math.floor(now / FRAME) & 0x7ff, age } : undefined;
  }

  startFrames() { this.framesFrom = this.now; }

  stopFrames() { this.usb.hearFrames(this.now); this.framesFrom = Infinity; }

  // Until a transaction of so many bytes fits into the frame.
  *room(bytes) {
    for (;;) {
      const age = this.frameAt(this.now)?.age;
      if (age === undefined || (age >= FRAME_BEGINS && age + bytes * BYTE <= FRAME - FRAME_ENDS)) return;
      yield { wait: age < FRAME_BEGINS ? FRAME_BEGINS - age : FRAME - age + FRAME_BEGINS };
    }
  }

  // ---- transactions, to be yielded ----

  sendSetup(packet) { return { ticks: 16 * BYTE, finish: () => ({ answer: this.usb.setup(this.address, packet) }) }; }

  transact(endpoint, data, toggle) {
    const begun = this.usb.begin(this.address, endpoint);
    if (begun.answer !== 'ack') {
      if (begun.answer === 'nak') this.packets.nak++;
      return { ticks: ((data?.length ?? 0) + 6) * BYTE, endpoint, finish: () => begun };
    }
    return {
      ticks: ((data ?? begun.data).length + 12) * BYTE, endpoint,
      finish: () => { this.usb.end(endpoint, data, toggle); return begun; },
    };
  }

  // Until the device takes or gives the packet.
  *insist(endpoint, data, toggle, patience) {
    const until = this.now + patience;
    for (let naks = 0; ; naks++) {
      yield* this.room(12 + (data?.length ?? 64));
      if (endpoint <= 1) yield { wait: TOKEN }; // before it is heard the device decides nothing
      const result = yield this.transact(endpoint, data, toggle);
      if (result.answer !== 'nak') return result;
      if (this.now > until) return { answer: 'nak for too long' };
      yield { wait: (naks < 16 ? 20 : 200) * US };
    }
  }

  // {status, data}: setup, data and status stage.
  *transfer(setup, outData = []) {
    const fromDevice = (setup[0] & 0x80) !== 0;
    const length = setup[6] | (setup[7] << 8);
    const data = [];
    yield* this.room(16);
    if ((yield this.sendSetup(setup)).answer !== 'ack') return { status: 'timeout', data };
    let toggle = 1;
    for (;;) {
      if (fromDevice ? length === 0 : outData.length === 0) break;
      const result = yield* this.insist(fromDevice ? 0 : 1, fromDevice ? undefined : Uint8Array.from(outData.splice(0, 64)), toggle, PATIENCE);
      if (result.answer !== 'ack') return { status: result.answer, data };
      if (fromDevice) {
        if (result.toggle !== toggle) fault('USB: endpoint 0 sent the wrong toggle: the host would drop the packet');
        data.push(...result.data);
        if (data.length > length) fault('USB: babble, more data than the host asked for');
        if (result.data.length < 64 || data.length === length) break;
      }
      toggle ^= 1;
    }
    const inward = !fromDevice || length === 0;
    const result = yield* this.insist(inward ? 0 : 1, inward ? undefined : new Uint8Array(0), 1, PATIENCE);
    if (inward && result.answer === 'ack' && (result.toggle !== 1 || result.data.length)) fault('USB: the status stage is no empty DATA1');
    return { status: result.answer === 'ack' ? 'ok' : result.answer, data };
  }

  *must(what, setup, outData) {
    const { status, data } = yield* this.transfer(setup, outData);
    if (status !== 'ok') { this.state = `failed: ${what}: ${status}`; return undefined; }
    return data;
  }

  // ---- enumeration and the driver ----

  // Reset, address, and what the device says it is; false when it does not.
  *meet() {
    yield* this.resetBus();
    this.state = 'enumerating';
    if (!(yield* this.must('first 8 bytes', descriptor(1, 0, 8)))) return false;
    if (!(yield* this.must('address', SETUP_OUT(0, 5, 5, 0, 0)))) return false;
    this.address = 5;
    yield { wait: RECOVERY };
    if (!(this.found.device = yield* this.must('device', descriptor(1, 0, 18)))) return false;
    const head = yield* this.must('configuration header', descriptor(2, 0, 9));
    if (!head) return false;
    this.found.configuration = yield* this.must('configuration', descriptor(2, 0, head[2] | (head[3] << 8)));
    return this.found.configuration !== undefined;
  }

  *plugged() {
    yield { wait: DEBOUNCE };
    yield* this.enumerate();
  }

  *enumerate() {
    if (!(yield* this.meet())) return;
    this.found.strings = [];
    for (let index = 0; index < 4; index++) {
      const string = yield* this.must(`string ${index}`, descriptor(3, index, 255, index ? 0x409 : 0));
      if (!string) return;
      this.found.strings.push(string);
    }
    if (!(yield* this.must('set configuration', SETUP_OUT(0, 9, this.found.configuration[5], 0, 0)))) return;
    this.toggles = { in: 0, out: 0 };
    if (!(yield* this.must('line coding', SETUP_OUT(0x21, 0x20, 0, 0, 7), [0x00, 0xc2, 0x01, 0x00, 0, 0, 8]))) return;
    this.state = 'configured';
    if (this.wantOpen) yield* this.open();
  }

  *resetBus() {
    this.address = 0;
    this.usb.busReset();
    yield { wait: RESET };
    this.startFrames();
    yield { wait: RECOVERY };
  }

  *open() {
    if (!(yield* this.must('line state', SETUP_OUT(0x21, 0x22, 3, 0, 0)))) return;
    this.isOpen = true;
    this.start(this.reading());
    this.start(this.writing());
  }

  *close() {
    this.isOpen = false;
    yield* this.must('line state', SETUP_OUT(0x21, 0x22, 0, 0, 0));
  }

  *reading() {
    while (this.isOpen) {
      const result = yield* this.insist(4, undefined, undefined, Infinity);
      if (result.answer !== 'ack') { this.state = `failed: bulk in: ${result.answer}`; return; }
      if (result.toggle !== this.toggles.in) fault('USB: the device sent the wrong toggle: the host would drop the packet');
      this.toggles.in ^= 1;
      this.packets.in++;
      this.urb.push(...result.data);
      if (result.data.length < 64 || this.urb.length >= URB) this.received.push(...this.urb.splice(0));
    }
  }

  *writing() {
    while (this.isOpen) {
      if (!this.outgoing.length) { yield { wait: 50 * US }; continue; }
      const packet = Uint8Array.from(this.outgoing.slice(0, 64));
      const result = yield* this.insist(5, packet, this.toggles.out, Infinity);
      if (result.answer !== 'ack') { this.state = `failed: bulk out: ${result.answer}`; return; }
      this.outgoing.splice(0, packet.length);
      this.toggles.out ^= 1;
      this.packets.out++;
    }
  }

  // ---- what the user does ----

  pulled() {
    this.clear();
    this.state = 'detached';
    if (this.cable && this.usb.pulledUp) { this.state = 'attached'; this.attached++; this.start(this.plugged(), true); }
  }

  *idle() { yield { wait: SUSPEND_AFTER }; this.usb.suspend(); }

  *wake() {
    this.usb.resume();
    yield { wait: RESUMING };
    this.startFrames();
    yield { wait: RECOVERY };
    this.asleep = false;
  }

  do(what, now) {
    this.now = Math.max(this.now, now);
    const task = (generator) => this.start(generator, true);
    switch (what.do) {
      case 'attach': this.cable = true; this.usb.onCable(true); this.pulled(); break;
      case 'detach': this.cable = false; this.usb.onCable(false); this.pulled(); this.start(this.idle(), true, true); break;
      case 'reset': this.clear(); this.state = 'attached'; task(this.enumerate()); break;
      case 'suspend': this.asleep = true; this.stopFrames(); this.start(this.idle(), true, true); break;
      case 'resume': this.start(this.wake(), true, true); break;
      case 'hang': this.usb.hang(this.now); break;
      case 'open': this.wantOpen = true; if (this.state === 'configured' && !this.isOpen) task(this.open()); break;
      case 'close': this.wantOpen = false; if (this.isOpen) task(this.close()); break;
      case 'write': for (const byte of Buffer.from(what.hex, 'hex')) this.outgoing.push(byte); break;
      case 'control': task(this.asked(what)); break;
      case 'controls': task(this.askedInTurn(what)); break;
      case 'abandon': task(this.abandoned(what)); break;
      default: fault(`USB: no such thing to do: ${what.do}`);
    }
  }

  *asked(what) {
    const setup = [...Buffer.from(what.setup, 'hex')];
    const { status, data } = yield* this.transfer(setup, [...Buffer.from(what.data ?? '', 'hex')]);
    this.controls.push({ setup: what.setup, status, data: Buffer.from(data).toString('hex') });
  }

  // One right after the other.
  *askedInTurn({ setups }) { for (const setup of setups) yield* this.asked({ setup }); }

  // The setup stage only; then the host loses interest, as macOS does whenever it closes a port.
  // `then`: what it asks next, `wait` ticks later.
  *abandoned({ setup, wait, then }) {
    yield* this.room(16);
    yield this.sendSetup([...Buffer.from(setup, 'hex')]);
    yield { wait: wait ? Number(wait) : 1000 * US };
    if (then) { yield* this.asked({ setup: then }); return; }
    this.controls.push({ setup, status: 'abandoned', data: '' });
  }

  read() { return Buffer.from(this.received.splice(0)); }

  report() {
    return { state: this.state, open: this.isOpen, attached: this.attached, latest: this.usb.latest, found: this.found, received: this.read().toString('hex'), waiting: this.outgoing.length,
             controls: this.controls.splice(0), packets: this.packets };
  }
}
