// The USB device served over USB/IP, protocol 1.1.1: the kernel of another machine (vhci-hcd, `usbip attach`) is its host,
// and every packet it asks for is a transaction with the firmware's device controller.
//
// That kernel numbers devices and resets ports by itself and sends neither: here the bus is reset and the device
// addressed before it is offered, and anew after whoever had it is gone. A device that leaves the bus ends the connection.

import { createServer } from 'node:net';
import { TICK_HZ } from './controller.mjs';
import { fault } from './fault.mjs';
import { UsbHost } from './usbhost.mjs';

const VERSION = 0x0111;
const REQ_DEVLIST = 0x8005, REP_DEVLIST = 0x0005, REQ_IMPORT = 0x8003, REP_IMPORT = 0x0003;
const SUBMIT = 1, UNLINK = 2, RET_SUBMIT = 3, RET_UNLINK = 4;
const REQUEST_BYTES = 8, BUSID_BYTES = 32, COMMAND_BYTES = 48;
const BUSID = '1-1', BUS = 1, DEVICE = 2, FULL_SPEED = 2;
const UNAVAILABLE = 1;
const EPIPE = -32, EPROTO = -71, EOVERFLOW = -75, ECONNRESET = -104;
const ZERO_PACKET = 0x40; // of a URB's flags: an empty packet ends one of whole packets
const US = TICK_HZ / 1e6;
const PACKET = 64;

export class UsbIp extends UsbHost {
  // `clock`: now, in ticks; bytes come between two runs.
  constructor(usb, port, clock) {
    super(usb);
    this.clock = clock;
    this.requests = []; // {tick, setup}: what the kernel asked of endpoint 0, and nothing when it went away
    this.server = createServer((socket) => this.connected(socket));
    this.server.listen(port, '127.0.0.1', () => { this.port = this.server.address().port; });
  }

  clear() {
    super.clear();
    this.client?.destroy();
    this.client = undefined;
    this.queues = new Map(); // endpoint => {urbs, busy}: the first of them is being worked on
    this.toggle = [];        // by endpoint
    this.submitted = 0;      // the latest
    this.unborn = new Map(); // URB => who took it back before it came
  }

  close() {
    this.server.close();
    this.client?.destroy();
  }

  *enumerate() { if (yield* this.meet()) this.state = 'offered'; }

  report() { return { ...super.report(), port: this.port, requests: this.requests.splice(0) }; }

  // ---- the connection ----

  connected(socket) {
    let unread = Buffer.alloc(0);
    socket.setNoDelay(true).on('error', () => {}).on('close', () => { if (this.client === socket) this.abandoned(); });
    socket.on('data', (bytes) => {
      this.now = Math.max(this.now, this.clock());
      unread = Buffer.concat([unread, bytes]);
      for (let taken; (taken = this.client === socket ? this.command(unread) : this.request(socket, unread)); ) unread = unread.subarray(taken);
    });
  }

  // Whoever had it is gone: as if its host had been switched off and another one on.
  abandoned() {
    this.client = undefined;
    this.requests.push({ tick: this.clock(), setup: '' });
    this.do({ do: 'reset' }, this.clock());
  }

  // Before there is a client. How many bytes were taken, 0 = not all of them are here.
  request(socket, bytes) {
    if (bytes.length < REQUEST_BYTES) return 0;
    const code = bytes.readUInt16BE(2);
    if (code === REQ_DEVLIST) {
      const offered = this.state === 'offered';
      socket.end(Buffer.concat([reply(REP_DEVLIST, 0), words(offered ? 1 : 0), ...(offered ? [this.device(), this.interfaces()] : [])]));
      return REQUEST_BYTES;
    }
    if (code !== REQ_IMPORT) { socket.destroy(); return 0; }
    if (bytes.length < REQUEST_BYTES + BUSID_BYTES) return 0;
    const busid = bytes.toString('latin1', REQUEST_BYTES, REQUEST_BYTES + BUSID_BYTES).replace(/\0.*/s, '');
    if (this.state !== 'offered' || busid !== BUSID) { socket.end(reply(REP_IMPORT, UNAVAILABLE)); return REQUEST_BYTES + BUSID_BYTES; }
    this.client = socket;
    this.state = 'imported';
    socket.write(Buffer.concat([reply(REP_IMPORT, 0), this.device()]));
    return REQUEST_BYTES + BUSID_BYTES;
  }

  device() {
    const { device, configuration } = this.found;
    const text = Buffer.alloc(256 + BUSID_BYTES);
    text.write('/sys/devices/annulus/usb1/1-1', 0);
    text.write(BUSID, 256);
    const numbers = [8, 10, 12].flatMap((at) => [device[at + 1], device[at]]); // vendor, product, release
    return Buffer.concat([text, words(BUS, DEVICE, FULL_SPEED), Buffer.from([...numbers, ...device.slice(4, 7), 0, device[17], configuration[4]])]);
  }

  interfaces() {
    const { configuration } = this.found;
    const found = [];
    for (let at = 0; at < configuration.length; at += configuration[at]) {
      if (configuration[at + 1] === 4) found.push(...configuration.slice(at + 5, at + 8), 0);
    }
    return Buffer.from(found);
  }

  // ---- URBs ----

  command(bytes) {
    if (bytes.length < COMMAND_BYTES) return 0;
    const [kind, id, , inward, number, second] = [0, 4, 8, 12, 16, 20].map((at) => bytes.readUInt32BE(at));
    if (kind === UNLINK) { this.unlink(id, second); return COMMAND_BYTES; }
    const length = bytes.readUInt32BE(24);
    const whole = COMMAND_BYTES + (inward ? 0 : length);
    if (kind !== SUBMIT || number > 15) { this.client.destroy(); return 0; }
    if (bytes.length < whole) return 0;
    const endpoint = number === 0 ? 0 : 2 * number + (inward ? 0 : 1);
    const data = inward ? [] : [...bytes.subarray(COMMAND_BYTES, whole)];
    this.submit(endpoint, { id, inward, length, endsShort: (second & ZERO_PACKET) !== 0, interval: bytes.readUInt32BE(36), setup: [...bytes.subarray(40, 48)], data });
    return whole;
  }

  submit(endpoint, urb) {
    this.submitted = urb.id;
    if (this.unborn.has(urb.id)) {
      this.unlinked(this.unborn.get(urb.id), ECONNRESET);
      this.unborn.delete(urb.id);
      return;
    }
    const queue = this.queues.get(endpoint) ?? { urbs: [], busy: false };
    this.queues.set(endpoint, queue);
    queue.urbs.push(urb);
    if (!queue.busy) this.start(this.serve(endpoint, queue), endpoint === 0);
    queue.busy = true;
  }

  *serve(endpoint, queue) {
    while (queue.urbs.length) {
      const urb = queue.urbs[0];
      const work = endpoint === 0 ? this.controlled(urb) : endpoint & 1 ? this.outward(endpoint, urb) : this.inward(endpoint, urb);
      const status = yield* work;
      if (urb.gone) continue;
      queue.urbs.shift();
      this.complete(urb, status);
    }
    queue.busy = false;
  }

  complete({ id, inward, length, data }, status) {
    const actual = inward ? data.length : length;
    this.client?.write(Buffer.concat([words(RET_SUBMIT, id, 0, 0, 0, status, actual, 0, 0, 0, 0, 0), Buffer.from(inward ? data : [])]));
  }

  // One that has ended already was answered by its end. One that is yet to come: the kernel looks through what it has to
  // submit first, and what is added and taken back right after that look is taken back before it is submitted. Whoever
  // answered both would have the kernel drop the connection.
  unlink(id, which) {
    let status = 0;
    if (which > this.submitted) { this.unborn.set(which, id); return; }
    for (const { urbs } of this.queues.values()) {
      const at = urbs.findIndex((urb) => urb.id === which);
      if (at < 0) continue;
      status = ECONNRESET;
      urbs.splice(at, 1)[0].gone = true;
    }
    this.unlinked(id, status);
  }

  unlinked(id, status) { this.client.write(words(RET_UNLINK, id, 0, 0, 0, status, 0, 0, 0, 0, 0, 0)); }

  *controlled(urb) {
    this.requests.push({ tick: this.now, setup: Buffer.from(urb.setup).toString('hex') });
    const { status, data } = yield* this.transfer(urb.setup, [...urb.data]);
    const [type, number, , , index] = urb.setup;
    if (status === 'ok' && type === 0 && number === 9) this.toggle = []; // a configuration begins anew
    if (status === 'ok' && type === 2 && number === 1) this.toggle[2 * (index & 15) + (index & 0x80 ? 0 : 1)] = 0;
    if (urb.inward) urb.data = data;
    return status === 'ok' ? 0 : status === 'stall' ? EPIPE : EPROTO;
  }

  *inward(endpoint, urb) {
    for (;;) {
      const due = this.toggle[endpoint] ?? 0;
      const result = yield* this.packet(endpoint, urb);
      if (result?.answer !== 'ack') return result?.answer === 'stall' ? EPIPE : EPROTO;
      if (result.toggle !== due) fault('USB: the device sent the wrong toggle: the host would drop the packet');
      urb.data.push(...result.data);
      if (urb.data.length > urb.length) return EOVERFLOW;
      if (result.data.length < PACKET || urb.data.length === urb.length) return 0;
    }
  }

  *outward(endpoint, urb) {
    let at = 0;
    do {
      const result = yield* this.packet(endpoint, urb, Uint8Array.from(urb.data.slice(at, at + PACKET)));
      if (result?.answer !== 'ack') return result?.answer === 'stall' ? EPIPE : EPROTO;
      at += PACKET;
    } while (at < urb.length || (at === urb.length && urb.endsShort));
    return 0;
  }

  // Asks until the device takes or gives the packet; undefined when nobody wants it any more.
  *packet(endpoint, urb, data) {
    for (let naks = 0; !urb.gone; naks++) {
      yield* this.room(12 + (data?.length ?? PACKET));
      const result = yield this.transact(endpoint, data, this.toggle[endpoint] ?? 0);
      if (result.answer !== 'nak') {
        if (result.answer === 'ack') this.toggle[endpoint] = (this.toggle[endpoint] ?? 0) ^ 1;
        return result;
      }
      yield { wait: (urb.interval ? 1000 * urb.interval : naks < 16 ? 20 : 200) * US };
    }
    return undefined;
  }
}

function reply(code, status) {
  const header = Buffer.alloc(REQUEST_BYTES);
  header.writeUInt16BE(VERSION, 0);
  header.writeUInt16BE(code, 2);
  header.writeUInt32BE(status, 4);
  return header;
}

function words(...values) {
  const buffer = Buffer.alloc(4 * values.length);
  values.forEach((value, at) => buffer.writeInt32BE(value | 0, 4 * at));
  return buffer;
}
