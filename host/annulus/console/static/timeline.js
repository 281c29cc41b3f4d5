// Drawings over time as SVG: an axis in microseconds, bands, bars, pulses. What they draw the console has computed.

import { el, set, svg } from "./dom.js";
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
    this.left = this.width < 500 ? 66 : LEFT;
    set(this.svg, { viewBox: `0 0 ${this.width} ${height}`, width: this.width, height });
  }

  x(time) {
    const inside = Math.min(Math.max(time, this.from), this.to);
    return this.left + ((inside - this.from) / (this.to - this.from)) * (this.width - this.left - RIGHT);
  }

  add(tag, attributes, ...children) {
    const made = svg(tag, attributes, ...children);
    this.svg.append(made);
    return made;
  }

  band(from, to, top, bottom, kind) {
    if (to < this.from || from > this.to || to < from) return;
    this.add("rect", { class: kind, x: this.x(from), y: top, width: Math.max(1, this.x(to) - this.x(from)), height: bottom - top });
  }

  shape(points, kind) {
    this.add("polygon", { class: kind, points: points.map(([time, y]) => `${this.x(time).toFixed(1)},${y}`).join(" ") });
  }

  line(points, kind) {
    this.add("polyline", { class: kind, points: points.map(([time, y]) => `${this.x(time).toFixed(1)},${y}`).join(" ") });
  }

  upright(time, top, bottom, kind) {
    if (time < this.from || time > this.to) return;
    this.add("line", { class: kind, x1: this.x(time), x2: this.x(time), y1: top, y2: bottom });
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
