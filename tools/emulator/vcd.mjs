// Pin transitions as a value change dump, 10 ns a step; `sigrok-cli -I vcd` and GTKWave read it. The serial line out is
// drawn from the bytes the UART sent and when: its bits are not emulated one by one.

import { OUTPUT_PINS, PIN, TICK_HZ } from './controller.mjs';

const NAMES = Object.fromEntries(Object.entries(PIN).filter(([, pin]) => pin === PIN.UART_TX || OUTPUT_PINS.includes(pin)).map(([name, pin]) => [pin, name.toLowerCase()]));
const BIT_TICKS = TICK_HZ / 1e6; // 1 Mbaud
const BYTE_TICKS = 10 * BIT_TICKS;

// [end of the stop bit, byte] as transitions of the line, idle high; equal bits make none.
function bitsOf(end, byte) {
  const start = end - BYTE_TICKS;
  const levels = [0, ...Array.from({ length: 8 }, (_, i) => (byte >> i) & 1), 1];
  return levels.flatMap((level, i) => (level === (i ? levels[i - 1] : 1) ? [] : [[start + BIT_TICKS * i, PIN.UART_TX, level]]));
}

export class VcdWriter {
  constructor(stream) {
    this.stream = stream;
    this.waiting = [];
    this.ids = new Map(Object.keys(NAMES).map((pin, i) => [Number(pin), String.fromCharCode(33 + i)]));
    stream.write('$timescale 10 ns $end\n$scope module annulus $end\n');
    for (const [pin, id] of this.ids) stream.write(`$var wire 1 ${id} ${NAMES[pin]} $end\n`);
    stream.write('$upscope $end\n$enddefinitions $end\n#0\n');
    for (const [pin, id] of this.ids) stream.write(`${pin === PIN.UART_TX ? 1 : 0}${id}\n`);
    this.last = 0;
  }

  // A byte is known when it has left, so what is younger than a byte waits for the next call.
  write(transitions, sent, now) {
    this.waiting.push(...transitions, ...sent.flatMap(([end, byte]) => bitsOf(end, byte)));
    this.waiting.sort((a, b) => a[0] - b[0]);
    let at = 0;
    for (; at < this.waiting.length && this.waiting[at][0] < now - BYTE_TICKS; at++) {
      const [tick, pin, level] = this.waiting[at];
      if (tick !== this.last) this.stream.write(`#${(this.last = tick)}\n`);
      this.stream.write(`${level}${this.ids.get(pin)}\n`);
    }
    this.waiting.splice(0, at);
  }

  end(now) {
    this.write([], [], now + 2 * BYTE_TICKS);
    this.stream.write(`#${now}\n`);
    this.stream.end();
  }
}
