// The newest pictures: of the rings, with the slits that were decoded in them, and of the LED light.
//
// A picture of half the size is drawn as soon as it is decoded. Its slits come a frame or two later, and belong to it and
// no other: with them shown, the ring picture is the newest whose slits are there; where none come, it is shown without.

import { KIND } from "./connection.js";
import { el, write } from "./dom.js";
import { DISTANCE, quoted } from "./rounding.js";

const KEPT = 12; // pictures that wait for their slits; each is decoded, 1.4 MB
const PATIENCE_MS = 500;
const LATENCIES = 500;
const SLIT_COLOURS = ["#ffffff", "#ffe14d", "#ff9de2", "#9dfff0", "#ffffff", "#ffe14d"];

export function mountPictures(app) {
  const { t } = app;
  const make = (name) => {
    const canvas = el("canvas", { width: 832, height: 616, role: "img", "aria-label": t(`pictures.${name}`) });
    const note = el("p", { class: "note faint" }, t("pictures.none"));
    return { canvas, note, context: canvas.getContext("2d", { alpha: false }), shownMs: 0 };
  };
  const ring = make("ring");
  const led = make("led");
  const slitsOn = el("input", { type: "checkbox", id: "slits", checked: true });
  slitsOn.checked = localStorage.getItem("slits") !== "off";
  slitsOn.addEventListener("change", () => localStorage.setItem("slits", slitsOn.checked ? "on" : "off"));
  const waiting = new Map(); // index -> {bitmap, z, published}
  const early = new Map(); // index -> slits
  let camera = 0;
  const cameraChoice = el("select", { id: "camera", hidden: true, "aria-label": t("pictures.camera") });
  cameraChoice.addEventListener("change", () => (camera = Number(cameraChoice.value)));
  app.on("hello", (hello) => {
    const count = hello.cameras?.length ?? 1;
    cameraChoice.replaceChildren(...Array.from({ length: count }, (_, n) => el("option", { value: n }, t("pictures.camera.n", { n }))));
    cameraChoice.hidden = count < 2;
  });

  const draw = (where, bitmap, z, index, published, slits) => {
    const { canvas, context } = where;
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
      canvas.width = bitmap.width;
      canvas.height = bitmap.height;
    }
    context.drawImage(bitmap, 0, 0);
    if (slits) {
      const { xy, rings } = slits;
      for (let i = 0; i < rings.length; i++) {
        context.fillStyle = SLIT_COLOURS[rings[i] % SLIT_COLOURS.length];
        context.fillRect(xy[2 * i] / 8 - 0.75, xy[2 * i + 1] / 8 - 0.75, 1.5, 1.5);
      }
    }
    where.shownMs = performance.now();
    const place = Number.isNaN(z) ? t("unknown") : quoted(z, DISTANCE);
    const found = slits ? `, ${t("pictures.slits", { n: slits.rings.length })}` : "";
    write(where.note, `${t("pictures.frame", { n: index })}, ${place}${found}`);
    app.stats.pictures += 1;
    if (published > 0) {
      app.stats.latencyMs.push(Date.now() - published * 1000);
      if (app.stats.latencyMs.length > LATENCIES) app.stats.latencyMs.shift();
    }
  };

  const together = (index, one, slits) => {
    draw(ring, one.bitmap, one.z, index, 0, slits);
    app.stats.withSlitsMs ??= [];
    app.stats.withSlitsMs.push(Date.now() - one.published * 1000);
    if (app.stats.withSlitsMs.length > LATENCIES) app.stats.withSlitsMs.shift();
  };

  let decoding = 0;
  app.onKind(KIND.picture, async (data) => {
    const view = new DataView(data);
    if (view.getUint8(1) !== camera || decoding > 3) return; // it cannot keep up: the next will do
    const label = view.getUint8(2);
    const index = view.getUint32(4, true);
    const z = view.getFloat32(8, true);
    const published = view.getFloat64(12, true);
    decoding += 1;
    let bitmap;
    try {
      bitmap = await createImageBitmap(new Blob([new Uint8Array(data, 20)], { type: "image/jpeg" }));
    } catch {
      return;
    } finally {
      decoding -= 1;
    }
    if (label === 2) {
      draw(led, bitmap, z, index, published, null);
      bitmap.close();
    } else if (label === 1 || label === 0) {
      const now = performance.now();
      if (!slitsOn.checked || label === 0 || now - ring.shownMs > PATIENCE_MS) {
        draw(ring, bitmap, z, index, published, null);
        if (label === 0 || !slitsOn.checked) {
          bitmap.close();
          return;
        }
      }
      const one = { bitmap, z, published };
      const slits = early.get(index);
      if (slits) {
        early.delete(index);
        together(index, one, slits);
        bitmap.close();
        return;
      }
      waiting.set(index, one);
      for (const [old, one] of waiting) {
        if (waiting.size <= KEPT) break;
        one.bitmap.close();
        waiting.delete(old);
      }
    }
  });

  app.onKind(KIND.slits, (data) => {
    const view = new DataView(data);
    if (view.getUint8(1) !== camera || !slitsOn.checked) return;
    const n = view.getUint16(2, true);
    const index = view.getUint32(4, true);
    if (data.byteLength < 8 + 5 * n) return;
    const slits = { xy: new Int16Array(data, 8, 2 * n), rings: new Uint8Array(data, 8 + 4 * n, n) };
    const one = waiting.get(index);
    if (!one) {
      early.set(index, slits); // its picture is still being decoded
      if (early.size > KEPT) early.delete(early.keys().next().value);
      return;
    }
    together(index, one, slits);
    for (const [old, before] of waiting) {
      if (old > index) continue;
      before.bitmap.close();
      waiting.delete(old);
    }
  });

  const stale = () => {
    for (const where of [ring, led]) {
      const old = performance.now() - where.shownMs > 2000 || !app.live;
      where.canvas.parentElement?.classList.toggle("stale", old);
    }
  };
  setInterval(stale, 500);
  app.on("link", stale);
  const figure = (where, ...tools) => el("figure", { class: "picture stale" }, where.canvas, el("figcaption", {}, where.note, el("span", { class: "tools" }, tools)));
  return {
    ring: figure(ring, el("label", { class: "check", for: "slits" }, slitsOn, t("pictures.show.slits")), cameraChoice),
    led: figure(led),
  };
}
