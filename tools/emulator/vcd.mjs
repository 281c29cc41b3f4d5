// Pin transitions as a value change dump, 10 ns a step; `sigrok-cli -I vcd` and GTKWave read it.

export const NAMES = { 3: 'projector', 4: 'led', 5: 'microwave', 6: 'trigger', 8: 'step', 9: 'direction', 10: 'enable', 25: 'status' };

export class VcdWriter {
  constructor(stream) {
    this.stream = stream;
    this.ids = new Map(Object.keys(NAMES).map((pin, i) => [Number(pin), String.fromCharCode(33 + i)]));
    stream.write('$timescale 10 ns $end\n$scope module annulus $end\n');
    for (const [pin, id] of this.ids) stream.write(`$var wire 1 ${id} ${NAMES[pin]} $end\n`);
    stream.write('$upscope $end\n$enddefinitions $end\n#0\n');
    for (const id of this.ids.values()) stream.write(`0${id}\n`);
    this.last = 0;
  }

  write(transitions) {
    for (const [tick, pin, level] of transitions) {
      if (tick !== this.last) this.stream.write(`#${(this.last = tick)}\n`);
      this.stream.write(`${level}${this.ids.get(pin)}\n`);
    }
  }

  end(tick) {
    this.stream.write(`#${tick}\n`);
    this.stream.end();
  }
}
