// The wall in 3-D as it grows, drawn so that it never keeps the pictures waiting.
//
// Where software draws, a million points take 0.3 s of both cores. So no more is drawn at once than takes SLICE_MS, as the
// slices before showed, and then it rests. A slice after the view has changed begins anew: some of the points of the whole wall,
// and all of the newest; later ones add the rest on top of it, chunk by chunk, until all is there or the view changes again.
// Nothing is drawn when nothing changed, ten times a second at most, and never while nobody can see it.
//
// When there is no more room the console is asked for the cloud so far, which it has thinned: the wall is shown whole,
// however long the scan. The old points stay until all new ones are there.

import { Chunks } from "./chunks.js";
import { KIND } from "./connection.js";
import { el, write } from "./dom.js";
import { Eye } from "./eye.js";
import { DISTANCE, quoted } from "./rounding.js";
import * as THREE from "./vendor/three/three.module.min.js";

const POINTS_MAX = 5_000_000;
const FRAME_MS = 100; // from one picture to the next
const SLICE_MS = 35;
const REST = 2; // times as long as the slice took
const LEAST = 20_000; // points of a slice, however slow
const FIRST_US = 0.4; // a point, until one is measured
const ANEW = 1;
const LAST = 2;
const RING_MM = 100; // from one circle of the nominal diameter to the next
const RINGS = 40;
const PAPER = { light: 0x39424b, dark: 0x0c1014 }; // the middle of the scale is nearly white
const INK = { light: 0x8b96a1, dark: 0x56626e };

export function mountCloud(app) {
  const { t } = app;
  const canvas = el("canvas", { tabindex: 0, role: "application", "aria-label": t("cloud.label"), "aria-describedby": "cloud-note cloud-keys" });
  const note = el("p", { class: "note faint", id: "cloud-note" }, t("cloud.none"));
  const keys = el("p", { class: "note faint", id: "cloud-keys" }, t("cloud.keys"));
  const tools = el("span", { class: "tools" });
  const root = el("figure", { class: "cloud" }, canvas, el("figcaption", {}, note, tools), keys);
  let renderer = null;
  try {
    // what was drawn stays: slices are added to it
    renderer = new THREE.WebGLRenderer({ canvas, antialias: false, powerPreference: "low-power", preserveDrawingBuffer: true });
  } catch {
    write(note, t("cloud.no.webgl"));
    canvas.hidden = keys.hidden = true;
    return { root, show: () => {}, hide: () => {} };
  }
  renderer.autoClear = false;
  const gl = renderer.getContext();
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  app.stats.renderer = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  app.stats.drawn = 0;
  app.stats.drawnMs = [];

  const scene = new THREE.Scene();
  scene.matrixAutoUpdate = false;
  const camera = new THREE.PerspectiveCamera(50, 4 / 3, 1, 1e5);
  const material = new THREE.PointsMaterial({ size: 1.6, sizeAttenuation: false, vertexColors: true, toneMapped: false });
  const chunks = new Chunks(POINTS_MAX, material);
  scene.add(chunks.group);
  const rings = circles();
  scene.add(rings);
  const eye = new Eye(canvas, tools, app, () => (anew = true));

  let anew = true; // the next slice begins the picture anew
  let radius = 0;
  let newest = 0; // mm
  let usPerPoint = FIRST_US;
  let slice = null; // {fence, since, points}
  let restUntilMs = 0;
  let begunMs = 0; // the newest picture
  let inView = true;
  let shown = true;
  let asked = false; // for the cloud so far

  app.onKind(KIND.points, (data) => {
    const view = new DataView(data);
    const flags = view.getUint8(1);
    const n = view.getUint32(8, true);
    if (data.byteLength < 12 + 15 * n) return;
    if (flags & ANEW) {
      asked = false;
      chunks.stage();
    }
    if (n > 0) {
      const xyz = new Float32Array(data, 12, 3 * n);
      const fits = chunks.add(xyz, new Uint8Array(data, 12 + 12 * n, 3 * n));
      if (!chunks.staged || flags & LAST) newest = xyz[3 * n - 1];
      if (!fits && !asked) {
        asked = true;
        app.connection.tell({ want: app.connection.wants.filter((one) => one !== "points") });
        app.connection.tell({ want: app.connection.wants });
      }
    }
    if (flags & LAST && chunks.shift()) anew = true;
    app.stats.points = chunks.held;
    app.stats.pointsMost = Math.max(app.stats.pointsMost ?? 0, chunks.held);
  });
  app.onKind(KIND.wall, (data) => {
    const told = new DataView(data).getFloat32(16, true);
    if (told !== radius && told > 0) {
      radius = told;
      anew = true;
    }
  });

  const size = () => {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (width === 0 || height === 0) return;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 1.5));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    anew = true;
  };
  new ResizeObserver(size).observe(canvas);
  new IntersectionObserver((seen) => (inView = seen.at(-1).isIntersecting)).observe(canvas);
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    slice = null;
  });
  canvas.addEventListener("webglcontextrestored", () => (anew = true));
  document.addEventListener("visibilitychange", () => (anew = true));
  const preferred = matchMedia("(prefers-color-scheme: dark)");
  const paint = () => {
    const now = matchMedia(document.getElementById("dark").media).matches ? "dark" : "light";
    renderer.setClearColor(PAPER[now]);
    rings.material.color.setHex(INK[now]);
    anew = true;
  };
  app.on("theme", paint);
  preferred.addEventListener("change", paint);

  // Whether the last slice is done; what it took says how large the next may be.
  const done = (now) => {
    if (slice === null) return true;
    if (gl.getSyncParameter(slice.fence, gl.SYNC_STATUS) !== gl.SIGNALED) return false;
    const took = now - slice.since;
    gl.deleteSync(slice.fence);
    if (slice.points >= LEAST) usPerPoint = 0.7 * usPerPoint + 0.3 * ((1000 * took) / slice.points);
    app.stats.drawnMs.push(took);
    if (app.stats.drawnMs.length > 200) app.stats.drawnMs.shift();
    restUntilMs = now + REST * took;
    slice = null;
    return true;
  };

  const draw = () => {
    const now = performance.now();
    if (!done(now) || now < restUntilMs || document.hidden || !inView || !shown || gl.isContextLost()) return;
    const most = Math.max(LEAST, (1000 * SLICE_MS) / usPerPoint);
    if (eye.follow(newest - radius, most < POINTS_MAX)) anew = true;
    let points = 0;
    if (anew && now - begunMs >= FRAME_MS) {
      anew = false;
      begunMs = now;
      rings.visible = radius > 0;
      rings.scale.set(radius || 1, radius || 1, 1);
      rings.position.z = Math.round(eye.target / RING_MM) * RING_MM;
      eye.place(camera);
      renderer.clear();
      points = chunks.begin(most);
    } else if (!anew) {
      points = chunks.more(most);
      rings.visible = false;
      if (points === 0) return;
    } else return;
    renderer.render(scene, camera);
    slice = { fence: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), since: now, points };
    gl.flush();
    app.stats.drawn += 1;
    const count = chunks.held.toLocaleString(app.language);
    write(note, chunks.held ? t("cloud.note", { n: count, z: quoted(newest, DISTANCE) }) : t("cloud.none"));
  };
  setInterval(draw, FRAME_MS / 4);
  paint();
  return {
    root,
    show: () => {
      shown = true;
      size();
    },
    hide: () => (shown = false),
  };
}

// Of radius 1 along z, and lines at 12 o'clock and, shorter, at 3, 6 and 9.
function circles() {
  const at = [];
  const sides = 72;
  for (let ring = -RINGS / 2; ring <= RINGS / 2; ring++) {
    for (let side = 0; side < sides; side++) {
      for (const one of [side, side + 1]) {
        const turn = (2 * Math.PI * one) / sides;
        at.push(Math.sin(turn), -Math.cos(turn), ring * RING_MM);
      }
    }
    for (const [x, y, depth] of [[0, -1, 0.2], [1, 0, 0.08], [0, 1, 0.08], [-1, 0, 0.08]]) {
      at.push(x, y, ring * RING_MM, x * (1 + depth), y * (1 + depth), ring * RING_MM);
    }
  }
  at.push(0, -1, (-RINGS / 2) * RING_MM, 0, -1, (RINGS / 2) * RING_MM);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(at, 3));
  const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ toneMapped: false }));
  lines.frustumCulled = false;
  return lines;
}

