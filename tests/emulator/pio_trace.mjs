// What the emulator's PIO holds after boot, and what one machine does with given words and inputs, cycle by cycle. For
// test_pio_words.py: `pio_trace.mjs IMAGE.uf2`, then a JSON object a line: {machine, memory, start, tx, inputs, pins, cycles}.
// `pins` are the output levels to begin with. The first line of the answer is the state after boot; then one a question.

import { readFileSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { Machine } from '../../tools/emulator/machine.mjs';
import { Pio } from '../../tools/emulator/pio.mjs';

const board = new Machine(readFileSync(process.argv[2]));
board.run(3_000_000);
const settings = ({ execctrl, shiftctrl, pinctrl, enabled }) => ({ execctrl, shiftctrl, pinctrl, enabled });
process.stdout.write(JSON.stringify(board.pios.map((pio) => ({
  memory: pio.memory.map((word) => word ?? null), machines: pio.state.map(settings),
}))) + '\n');

function trace({ machine, memory, start, tx, inputs, pins, cycles }) {
  const pio = new Pio(0);
  pio.memory = memory.map((word) => word ?? undefined);
  const one = Object.assign(pio.state[0], machine, { enabled: true, pc: start, tx: [...tx] });
  pio.pinValues = pio.nextValues = pins;
  return Array.from({ length: cycles }, (_, cycle) => {
    pio.step(inputs[cycle] ?? 0);
    return [one.pc, one.x, one.y, one.isr, one.osr, pio.pinValues >>> 0, one.tx.length, one.rx.splice(0)];
  });
}

createInterface({ input: process.stdin }).on('line', (line) => process.stdout.write(JSON.stringify(trace(JSON.parse(line))) + '\n'));
