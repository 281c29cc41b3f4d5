// The wall unrolled: clock round the pipe downwards, distance to the right; defects and marks stand on it as buttons.
//
// Rows come again and again (README, kind 4): each is kept by its number, per step, within bounds, and drawn from there.

import { KIND } from "./connection.js";
import { el, set, write } from "./dom.js";
import { DISTANCE, MEASURE, clockFace, digits, quoted } from "./rounding.js";

const UNSEEN = -32768;
const ROWS_MAX = 2200; // of either map
const REDRAW_MS = 300;
const HOURS = [0, 3, 6, 9, 12];
const MARKS_MAX = 100;

export function mountMap(app, open) {
  const { t } = app;
  const canvas = el("canvas", { role: "img", "aria-label": t("map.label") });
  const clockAxis = el("div", { class: "clock-axis", "aria-hidden": "true" }, HOURS.map((hour) => el("span", {}, String(hour || 12))));
  const marks = el("div", { class: "marks" });
  const axis = el("div", { class: "z-axis", "aria-hidden": "true" });
  const plot = el("div", { class: "map-plot" }, canvas, marks);
  const note = el("p", { class: "note faint" }, t("map.none"));
  const choice = el("select", { "aria-label": t("map.which") }, el("option", { value: "recent" }, t("map.recent")), el("option", { value: "whole" }, t("map.whole")));
  const bar = el("div", { class: "colour-bar", role: "img" });
  const scale = el("div", { class: "scale" }, el("span", {}), bar, el("span", {}));
  const root = el(
    "figure", { class: "map" }, el("div", { class: "map-body" }, clockAxis, el("div", { class: "map-wide" }, plot, axis)),
    el("figcaption", {}, note, el("span", { class: "tools" }, scale, choice)),
  );
  const walls = { recent: fresh(), whole: fresh() };
  let table = null; // 256 colours
  let ends = 1;
  let changed = true;
  let drawn = null; // {from, to} mm

  app.on("hello", (hello) => {
    const told = hello.deviation;
    if (!told) return;
    ends = told.ends_mm;
    table = colours(told.colours);
    bar.style.background = `linear-gradient(to right, ${told.colours.join(", ")})`;
    bar.setAttribute("aria-label", t("map.scale", { ends: digits(ends, MEASURE) }));
    write(scale.firstChild, `−${digits(ends, MEASURE)}`);
    write(scale.lastChild, `+${digits(ends, MEASURE)} mm`);
    changed = true;
  });
  app.onKind(KIND.wall, (data) => {
    const view = new DataView(data);
    const wall = view.getUint8(1) === 0 ? walls.recent : walls.whole;
    const columns = view.getUint16(2, true);
    const rows = view.getUint32(4, true);
    const first = view.getInt32(8, true);
    const step = view.getFloat32(12, true);
    const scan = view.getUint32(20, true);
    if (data.byteLength < 24 + 2 * rows * columns) return;
    if (wall.scan !== scan || wall.step !== step || wall.columns !== columns) Object.assign(wall, fresh(), { scan, step, columns });
    const cells = new Int16Array(data, 24, rows * columns);
    for (let r = 0; r < rows; r++) wall.rows.set(first + r, cells.slice(r * columns, (r + 1) * columns));
    if (wall.rows.size > ROWS_MAX) {
      const numbers = [...wall.rows.keys()].sort((a, b) => a - b);
      for (const old of numbers.slice(0, wall.rows.size - ROWS_MAX)) wall.rows.delete(old);
    }
    changed = true;
  });
  const forget = () => {
    walls.recent = fresh();
    walls.whole = fresh();
    changed = true;
  };
  app.on("begun", forget);
  app.on("defects", () => (changed = true));
  let told = [];
  app.on("mark", (mark) => {
    if (typeof mark.z_mm !== "number") return;
    told = [...told, mark].slice(-MARKS_MAX);
    changed = true;
  });
  app.on("begun", () => (told = []));
  choice.addEventListener("change", () => (changed = true));
  new ResizeObserver(() => (changed = true)).observe(plot);

  const draw = () => {
    if (!changed || document.hidden || root.offsetParent === null || !table) return;
    changed = false;
    const wall = walls[choice.value];
    const numbers = [...wall.rows.keys()];
    if (numbers.length === 0) {
      write(note, t("map.none"));
      canvas.width = canvas.height = 1;
      marks.replaceChildren();
      axis.replaceChildren();
      return;
    }
    const [low, high] = [Math.min(...numbers), Math.max(...numbers)];
    const wide = high - low + 1;
    if (canvas.width !== wide || canvas.height !== wall.columns) {
      canvas.width = wide;
      canvas.height = wall.columns;
    }
    const context = canvas.getContext("2d");
    const image = context.createImageData(wide, wall.columns);
    const pixels = new Uint32Array(image.data.buffer);
    for (const [number, cells] of wall.rows) {
      const x = number - low;
      for (let c = 0; c < wall.columns; c++) {
        const cell = cells[c];
        if (cell === UNSEEN) continue;
        const at = Math.max(0, Math.min(255, Math.round(127.5 + (cell / 100 / ends) * 127.5)));
        pixels[c * wide + x] = table[at];
      }
    }
    context.putImageData(image, 0, 0);
    drawn = { from: low * wall.step, to: (high + 1) * wall.step };
    write(note, t("map.note", { from: digits(drawn.from, DISTANCE), to: quoted(drawn.to, DISTANCE), step: wall.step }));
    ticks(axis, drawn);
    place();
  };
  const place = () => {
    const inside = (z) => z >= drawn.from && z <= drawn.to;
    const at = (z, degrees) => [`${(100 * (z - drawn.from)) / (drawn.to - drawn.from)}%`, `${(100 * degrees) / 360}%`];
    const wanted = [];
    for (const defect of app.latest.defects?.defects ?? []) {
      if (!inside(defect.z_mm)) continue;
      wanted.push({ key: `d${defect.id}`, name: describe(app, defect), style: `defect ${defect.kind}`, at: at(defect.z_mm, defect.clock_deg), press: () => open(defect), text: `#${defect.id}` });
    }
    told.forEach((mark, n) => {
      if (!inside(mark.z_mm)) return;
      const where = mark.clock_deg ?? 0;
      wanted.push({ key: `m${n}`, name: `${t("events.mark")}: ${mark.text}`, style: "noted", at: at(mark.z_mm, where), press: () => app.say(`${mark.text}, ${quoted(mark.z_mm, DISTANCE)}`), text: t("map.mark") });
    });
    const there = new Map([...marks.children].map((one) => [one.dataset.key, one]));
    for (const one of wanted) {
      let button = there.get(one.key);
      if (!button) {
        button = el("button", { type: "button" });
        button.dataset.key = one.key;
        button.addEventListener("click", () => button.press());
        marks.append(button);
      }
      there.delete(one.key);
      button.press = one.press;
      set(button, { class: one.style, "aria-label": one.name, title: one.name });
      write(button, one.text);
      [button.style.left, button.style.top] = one.at;
    }
    for (const gone of there.values()) gone.remove();
  };
  setInterval(draw, REDRAW_MS);
  return { root };
}

const fresh = () => ({ rows: new Map(), scan: null, step: 0, columns: 0 });

export function describe(app, defect) {
  const depth = quoted(defect.depth_mm, MEASURE, defect.depth_k2_mm, defect.floor_seen === false) ?? app.t("unmeasured");
  return app.t("defect.named", {
    depth, kind: app.word("kind", defect.kind), z: quoted(defect.z_mm, DISTANCE) ?? "?", clock: defect.clock ?? clockFace(defect.clock_deg),
  });
}

function colours(stops) {
  const rgb = stops.map((stop) => [1, 3, 5].map((i) => parseInt(stop.slice(i, i + 2), 16)));
  return Uint32Array.from({ length: 256 }, (_, i) => {
    const at = (i / 255) * (rgb.length - 1);
    const low = Math.min(Math.floor(at), rgb.length - 2);
    const [r, g, b] = [0, 1, 2].map((c) => Math.round(rgb[low][c] + (rgb[low + 1][c] - rgb[low][c]) * (at - low)));
    return (255 << 24) | (b << 16) | (g << 8) | r;
  });
}

// Ticks at 1, 2 or 5 times a power of ten, in metres as the report has them.
function ticks(axis, { from, to }) {
  const rough = (to - from) / 6;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= rough);
  const made = [];
  for (let z = Math.ceil(from / step) * step; z <= to - 0.07 * (to - from); z += step) { // there the unit stands
    const tick = el("span", {}, digits(z, DISTANCE));
    tick.style.left = `${(100 * (z - from)) / (to - from)}%`;
    made.push(tick);
  }
  made.push(el("span", { class: "unit" }, "m"));
  axis.replaceChildren(...made);
}
