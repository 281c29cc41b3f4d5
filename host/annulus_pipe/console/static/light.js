// How bright each band of rows is, newest frame of either lamp: what banding looks like while a flash is moved.

import { el, write } from "./dom.js";
import { digits } from "./rounding.js";
import uPlot from "./vendor/uplot/uPlot.esm.js";

const ROWS = 5; // the message's kind
const LABELS = { 1: "projector", 2: "led" };
const DRAW_MS = 200;
const HEIGHT = 220;
const BANDS = 64;

export function mountLight(app) {
  const { t } = app;
  const place = el("div", { class: "plot", role: "img", "aria-label": t("light.label") });
  const said = el("dl", { class: "readouts" });
  const values = {};
  for (const lamp of ["projector", "led"]) {
    values[lamp] = el("dd", {}, t("light.none"));
    said.append(el("div", {}, el("dt", {}, t(`label.${lamp}`)), values[lamp]));
  }
  const bands = { projector: null, led: null };
  let plot = null;
  let drawn = 0;
  let wanted = false;
  let visible = false;

  const probe = el("span", { hidden: true });
  const colour = (name) => {
    probe.className = `ink-${name}`;
    return getComputedStyle(probe).color; // as a canvas takes it, whatever the style sheet calls it
  };
  const make = () => {
    plot?.destroy();
    const axis = { stroke: colour("text"), grid: { stroke: colour("line") }, ticks: { stroke: colour("line") } };
    plot = new uPlot(
      {
        width: Math.max(200, place.clientWidth), height: HEIGHT, cursor: { show: false }, legend: { show: false },
        scales: { x: { time: false, range: [0, BANDS - 1] }, y: { range: [0, 255] } },
        axes: [{ ...axis, label: t("light.rows"), labelSize: 20 }, { ...axis, label: t("light.level"), labelSize: 20, size: 44 }],
        series: [{}, { stroke: colour("projector"), width: 2, spanGaps: false }, { stroke: colour("led"), width: 2, dash: [6, 3] }],
      },
      data(), place,
    );
  };
  const data = () => {
    const count = Math.max(bands.projector?.length ?? 0, bands.led?.length ?? 0, 1);
    const none = new Array(count).fill(null);
    return [Array.from({ length: count }, (_, band) => band), bands.projector ?? none, bands.led ?? none];
  };
  const draw = () => {
    wanted = false;
    if (!visible || document.hidden) return;
    drawn = performance.now();
    if (plot === null) make();
    else plot.setData(data());
  };
  const soon = () => {
    if (wanted || !visible) return;
    wanted = true;
    setTimeout(() => requestAnimationFrame(draw), Math.max(0, DRAW_MS - (performance.now() - drawn)));
  };
  new ResizeObserver(() => {
    if (plot && visible && place.clientWidth > 0) plot.setSize({ width: place.clientWidth, height: HEIGHT });
  }).observe(place);
  app.onKind(ROWS, (message) => {
    const view = new DataView(message);
    const lamp = LABELS[view.getUint8(2)];
    if (lamp === undefined) return;
    bands[lamp] = Array.from(new Float32Array(message, 12, view.getUint16(8, true)));
    soon();
  });
  app.on("light", (now) => {
    if (!(now.label in values)) return;
    const spread = typeof now.banding_percent === "number" ? digits(now.banding_percent, { places: 0 }) : null;
    write(values[now.label], spread === null ? t("light.dark") : t("light.said", { mean: digits(now.mean, { places: 0 }), spread }));
  });
  app.on("theme", () => plot !== null && visible && make());
  app.on("link", () => {
    if (app.live) return;
    bands.projector = bands.led = null; // nothing old is shown as live
    for (const value of Object.values(values)) write(value, t("light.none"));
    soon();
  });
  return {
    root: el("div", {}, probe, place, said, el("p", { class: "faint" }, t("light.note"))),
    show: () => {
      visible = true;
      soon();
    },
    hide: () => (visible = false),
  };
}
