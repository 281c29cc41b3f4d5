// What was found so far as a list, and one defect from close by: texture, section, profile along, depth, who saw it.

import { el } from "./dom.js";
import { describe } from "./map.js";
import { ARC, DISTANCE, EXTENT, MEASURE, clockFace, quoted } from "./rounding.js";
import uPlot from "./vendor/uplot/uPlot.esm.js";

export function mountDefects(app) {
  const { t } = app;
  const none = el("p", { class: "faint" }, t("defects.none"));
  const body = el("tbody");
  const table = el(
    "table", { class: "table", hidden: true }, el("caption", { class: "visually-hidden" }, t("scan.defects")),
    el("thead", {}, el("tr", {}, ["number", "kind", "depth", "place", "clock", "size"].map((name) => el("th", { scope: "col" }, t(`defect.${name}`))))), body,
  );
  const list = el("div", { class: "defects" }, el("h3", {}, t("scan.defects")), none, el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("scan.defects") }, table));
  const panel = el("dialog", { class: "panel", "aria-labelledby": "defect-title" });
  let scan = null;

  app.on("defects", (told) => {
    scan = told.scan;
    const found = told.defects ?? [];
    none.hidden = found.length > 0;
    table.hidden = found.length === 0;
    body.replaceChildren(
      ...found.map((one) => {
        const show = el("button", { type: "button", class: "link", "aria-label": describe(app, one) }, `#${one.id}`);
        show.addEventListener("click", () => open(one));
        const size = `${quoted(one.length_mm, EXTENT) ?? "–"} × ${quoted(one.arc_deg, ARC) ?? "–"}`;
        const cells = [app.word("kind", one.kind), quoted(one.depth_mm, MEASURE, one.depth_k2_mm, one.floor_seen === false) ?? t("unmeasured"), quoted(one.z_mm, DISTANCE), one.clock ?? clockFace(one.clock_deg), size];
        return el("tr", {}, el("td", {}, show), cells.map((cell) => el("td", {}, cell)));
      }),
    );
  });

  async function open(defect) {
    let close;
    try {
      close = await app.get(`/api/defect/${scan}/${defect.id}`);
    } catch (error) {
      if (error.status !== 404) {
        app.wrong(error);
        return;
      }
      close = null; // its close-up is not there yet
    }
    const shut = el("button", { type: "button", class: "big" }, t("close"));
    shut.addEventListener("click", () => panel.close());
    const inside = [
      el("div", { class: "panel-top" }, el("h2", { id: "defect-title" }, describe(app, defect)), shut),
      el("dl", { class: "readouts" }, [
        [t("defect.depth"), `${quoted(defect.depth_mm, MEASURE, defect.depth_k2_mm, defect.floor_seen === false) ?? t("unmeasured")} (k = 2)`],
        [t("defect.size"), `${quoted(defect.length_mm, EXTENT) ?? "–"} × ${quoted(defect.arc_deg, ARC) ?? "–"}`],
        [t("defect.place"), quoted(defect.z_mm, DISTANCE)], [t("defect.clock"), defect.clock ?? clockFace(defect.clock_deg)],
      ].map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value ?? t("unknown"))))),
    ];
    const plots = [];
    if (close === null) inside.push(el("p", { class: "faint" }, t("defect.later")));
    else {
      if (close.picture) inside.push(el("img", { src: `/api/defect/${scan}/${defect.id}/picture`, alt: t("defect.picture"), class: "close-up" }));
      plots.push(chart(t("defect.section"), close.section_mm, 0, 1, close.nominal_mm, "°"), chart(t("defect.along"), close.along_mm, close.along_from_mm / 1000, close.along_step_mm / 1000, close.nominal_mm, "m"));
      const frames = close.frames ?? [];
      inside.push(
        ...plots.map((one) => one.root), el("h3", {}, t("defect.frames", { n: (defect.frames ?? []).length })),
        el("div", { class: "thumbs" }, frames.map((one) => el("img", { src: `/api/frame/${one.camera}/${one.index}`, alt: t("pictures.frame", { n: one.index }), loading: "lazy", width: 208, height: 154 }))),
      );
      if (frames.length === 0) inside.push(el("p", { class: "faint" }, t("defect.frames.gone")));
    }
    panel.replaceChildren(...inside);
    if (!panel.open) panel.showModal();
    for (const one of plots) one.draw();
    shut.focus();
  }

  // Deviation from the nominal radius; gaps where nothing was seen.
  function chart(title, radii, from, step, nominal, unit) {
    const root = el("figure", { class: "chart" }, el("figcaption", {}, title));
    const known = (radii ?? []).filter((one) => one !== null);
    const range = known.length ? `${Math.min(...known.map((one) => one - nominal)).toFixed(2)} .. ${Math.max(...known.map((one) => one - nominal)).toFixed(2)} mm` : t("unmeasured");
    const host = el("div", { role: "img", "aria-label": `${title}: ${range}` });
    root.append(host);
    const draw = () => {
      const x = (radii ?? []).map((_, i) => from + i * step);
      const y = (radii ?? []).map((one) => (one === null ? null : one - nominal));
      const ink = getComputedStyle(document.body).getPropertyValue("--ink").trim();
      const line = getComputedStyle(document.body).getPropertyValue("--line").trim();
      const axis = { stroke: ink, grid: { stroke: line }, ticks: { stroke: line } };
      const options = {
        width: Math.max(260, host.clientWidth || 520), height: 180, legend: { show: false }, cursor: { show: false }, scales: { x: { time: false } },
        axes: [{ ...axis, values: (_, values) => values.map((one) => `${unit === "m" ? one.toFixed(2) : one}${unit === "°" ? "°" : ""}`), label: unit === "m" ? t("axis.place") : t("axis.clock") }, { ...axis, label: t("axis.deviation"), size: 60 }],
        series: [{}, { stroke: getComputedStyle(document.body).getPropertyValue("--accent").trim(), width: 1.5, points: { show: false }, spanGaps: false }],
      };
      host.replaceChildren();
      new uPlot(options, [x, y], host);
    };
    return { root, draw };
  }
  return { list, panel, open };
}
