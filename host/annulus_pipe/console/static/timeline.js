// Drawings over time as SVG: an axis in microseconds, bands, bars, pulses. What they draw the console has computed.

import { el, set, svg, unique } from "./dom.js";
import { digits } from "./rounding.js";

const LEFT = 92; // px for names
const RIGHT = 14;
const TICK_PX = 90;

export const us = (value) => digits(value, { places: Number.isInteger(value) ? 0 : 2 });

// A drawing as wide as its place; `draw(board)` is called anew whenever that changes.
export class Board {
  constructor(name) {
    this.svg = svg("svg", { role: "img", class: "timeline", "aria-label": name });
    this.root = el("div", { class: "timeline-place" }, this.svg);
    this.draw = null;
    new ResizeObserver(() => this.again()).observe(this.root);
  }

  show(label, draw) {
    this.draw = draw;
    this.svg.setAttribute("aria-label", label);
    this.again();
  }

  again() {
    const width = this.root.clientWidth;
    if (!this.draw || width < 50) return;
    this.width = width;
    this.svg.replaceChildren();
    this.draw(this);
  }

  // From here on x is a time: from..to over the width beside the names.
  span(from, to, height) {
    this.from = from;
    this.to = to;
    this.height = height;
    this.left = this.width < 500 ? 80 : LEFT;
    set(this.svg, { viewBox: `0 0 ${this.width} ${height}`, width: this.width, height });
    const inside = unique("inside");
    const frame = svg("rect", { x: this.left, y: 0, width: this.width - this.left - RIGHT, height });
    this.svg.append(svg("defs", {}, svg("clipPath", { id: inside }, frame)));
    this.inside = this.add("g", { "clip-path": `url(#${inside})` }); // what reaches beyond is cut off, not bent
  }

  x(time) {
    return this.left + ((time - this.from) / (this.to - this.from)) * (this.width - this.left - RIGHT);
  }

  add(tag, attributes, ...children) {
    const made = svg(tag, attributes, ...children);
    this.svg.append(made);
    return made;
  }

  band(from, to, top, bottom, kind) {
    if (to < this.from || from > this.to || to < from) return;
    const [x, width] = [this.x(from), Math.max(1, this.x(to) - this.x(from))];
    this.inside.append(svg("rect", { class: kind, x, y: top, width, height: bottom - top }));
  }

  shape(points, kind) {
    this.inside.append(svg("polygon", { class: kind, points: this.joined(points) }));
  }

  line(points, kind) {
    this.inside.append(svg("polyline", { class: kind, points: this.joined(points) }));
  }

  joined(points) {
    return points.map(([time, y]) => `${this.x(time).toFixed(1)},${y}`).join(" ");
  }

  upright(time, top, bottom, kind) {
    if (time < this.from || time > this.to) return;
    this.inside.append(svg("line", { class: kind, x1: this.x(time), x2: this.x(time), y1: top, y2: bottom }));
  }

  name(text, y) {
    this.add("text", { class: "name", x: this.left - 8, y, "text-anchor": "end" }, text);
  }

  axis(y, top) {
    const step = stepFor((this.to - this.from) / Math.max(2, (this.width - this.left) / TICK_PX));
    this.add("line", { class: "axis", x1: this.left, x2: this.width - RIGHT, y1: y, y2: y });
    for (let k = Math.ceil(this.from / step); k * step <= this.to; k++) {
      const at = k * step;
      this.upright(at, top, y + 4, "grid");
      this.add("text", { class: "tick", x: this.x(at), y: y + 17, "text-anchor": "middle" }, us(Number(at.toPrecision(9))));
    }
    this.add("text", { class: "tick", x: this.left - 8, y: y + 17, "text-anchor": "end" }, "µs");
  }
}

function stepFor(least) {
  const unit = 10 ** Math.floor(Math.log10(least));
  return unit * [1, 2, 5, 10].find((k) => unit * k >= least);
}
