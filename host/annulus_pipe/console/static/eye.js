// From where the wall is looked at: turned, tilted, nearer, along the pipe; by mouse, touch, keys, or the buttons beside it.

import { el, svg } from "./dom.js";

const TURN = 0.1; // radians a key press
const NEARER = 0.85;
const ALONG = 0.15; // of the distance
const [NEAREST_MM, FARTHEST_MM] = [40, 20_000];
const STRIDE = 0.12; // of the distance: where drawing is slow, the head is followed in strides

const BUTTONS = [ // what, its key, its sign
  ["left", "ArrowLeft", "M15 15A7 7 0 1 0 4 8M4 3v5h5"],
  ["right", "ArrowRight", "M5 15A7 7 0 1 1 16 8M16 3v5h-5"],
  ["nearer", "+", "M4 10h12M10 4v12"],
  ["farther", "-", "M4 10h12"],
  ["back", "PageDown", "M12 4l-6 6 6 6"],
  ["ahead", "PageUp", "M8 4l6 6-6 6"],
];

export class Eye {
  constructor(canvas, tools, app, changed) {
    this.turn = 0.9;
    this.tilt = 0.35;
    this.far = 420;
    this.target = 0;
    this.following = true;
    this.changed = changed;
    const { t } = app;
    this.followed = el("button", { type: "button", class: "quiet", "aria-pressed": "true" }, t("cloud.follow"));
    this.followed.addEventListener("click", () => {
      this.following = !this.following;
      this.moved();
    });
    for (const [name, key, path] of BUTTONS) {
      const sign = svg("svg", { viewBox: "0 0 20 20", width: 20, height: 20, "aria-hidden": "true" }, svg("path", { d: path }));
      const button = el("button", { type: "button", class: "quiet sign", "aria-label": t(`cloud.${name}`), title: t(`cloud.${name}`) }, sign);
      button.addEventListener("click", () => this.press(key));
      tools.append(button);
    }
    tools.append(this.followed);
    canvas.style.touchAction = "pan-y"; // the page scrolls past it; across and with two fingers is ours
    canvas.addEventListener("keydown", (event) => {
      if (!event.ctrlKey && !event.metaKey && !event.altKey && this.press(event.key)) event.preventDefault();
    });
    this.hearPointers(canvas);
  }

  press(key) {
    const act = {
      ArrowLeft: () => (this.turn += TURN), ArrowRight: () => (this.turn -= TURN),
      ArrowUp: () => (this.tilt += TURN), ArrowDown: () => (this.tilt -= TURN),
      "+": () => (this.far *= NEARER), "=": () => (this.far *= NEARER), "-": () => (this.far /= NEARER),
      PageUp: () => this.go(ALONG * this.far), PageDown: () => this.go(-ALONG * this.far),
      Home: () => (this.following = true),
    }[key];
    if (!act) return false;
    act();
    this.moved();
    return true;
  }

  hearPointers(canvas) {
    const held = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, [event.clientX, event.clientY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (held.size === 2) {
        const [other] = [...held].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
        const was = Math.hypot(before[0] - other[0], before[1] - other[1]);
        const is = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
        if (is > 1 && was > 1) this.far *= was / is;
        this.go((-dx * this.far) / 1500);
      } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) {
        this.go((-dx * this.far) / 600);
      } else {
        this.turn -= dx * 0.006;
        this.tilt += dy * 0.006;
      }
      this.moved();
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      canvas.addEventListener(name, (event) => held.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    // the page is scrolled by the wheel until the wall was chosen by a press
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      this.far *= Math.exp(Math.max(-200, Math.min(200, event.deltaY)) * 0.001);
      this.moved();
    }, { passive: false });
  }

  // Along the pipe, by hand: the head is not followed any more.
  go(mm) {
    this.target += mm;
    this.following = false;
  }

  // Towards the newest points; whether that changed the view.
  follow(z, slow) {
    const off = z - this.target;
    if (!this.following || Math.abs(off) < (slow ? STRIDE * this.far : 0.1)) return false;
    const jump = slow || Math.abs(off) > this.far || matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.target += jump ? off : 0.5 * off;
    return true;
  }

  moved() {
    this.tilt = Math.max(-1.5, Math.min(1.5, this.tilt));
    this.far = Math.max(NEAREST_MM, Math.min(FARTHEST_MM, this.far));
    this.followed.setAttribute("aria-pressed", String(this.following));
    this.changed();
  }

  // The pipe's y points down: up is -y.
  place(camera) {
    const flat = Math.cos(this.tilt) * this.far;
    camera.up.set(0, -1, 0);
    camera.position.set(Math.sin(this.turn) * flat, -Math.sin(this.tilt) * this.far, this.target - Math.cos(this.turn) * flat);
    camera.lookAt(0, 0, this.target);
  }
}
