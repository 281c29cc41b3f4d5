// The bench: when lamps fire and what that does to the picture, while looking; the burst of a microwave source.

import { mountBurst } from "./burst.js";
import { el, unique, write } from "./dom.js";
import { mountLight } from "./light.js";
import { Board, us } from "./timeline.js";
import { mountTune } from "./tune.js";

const LAMPS = ["projector", "led"];
const TIMES = LAMPS.flatMap((lamp) => [`${lamp}_delay_us`, `${lamp}_width_us`]);
const STAGE_MS = 250;
const HOLD_MS = 3000;
const HOLD_S = 10;
const SLIDER_STEP_US = 50;

export function mount(root, app) {
  const { t } = app;
  const box = (name, ...inside) =>
    el("section", { class: `box box-${name}`, "aria-labelledby": `h-${name}` }, el("h2", { id: `h-${name}` }, t(`bench.${name}`)), inside);
  let timing = null; // what the console said of this camera mode
  const exposure = new Board(t("bench.exposure"));
  const lamps = mountLamps(app, () => timing !== null && draw());
  const light = mountLight(app);
  const trial = mountTrial(app);
  const tune = mountTune(app, (proposed) => lamps.stage(proposed));
  const burst = mountBurst(app);
  const windowNote = el("p", { class: "note" });
  root.append(
    el("h2", { class: "visually-hidden" }, t("nav.bench")),
    box("exposure", exposure.root, windowNote), box("lamps", lamps.root, trial.root), box("light", light.root),
    box("tune", tune.root), box("burst", burst.root),
  );

  const draw = () => {
    if (timing === null) return;
    const now = lamps.values();
    const spans = LAMPS.map((lamp) => t("bench.flash.named", { lamp: t(`label.${lamp}`), from: us(now[`${lamp}_delay_us`]), to: us(now[`${lamp}_delay_us`] + now[`${lamp}_width_us`]) }));
    const around = timing.window ? t("bench.window.named", { from: us(timing.opens_us), to: us(timing.closes_us) }) : timing.why;
    write(windowNote, [around, ...spans].join("; "));
    exposure.show([t("bench.exposure"), around, ...spans].join("; "), (board) => drawExposure(app, board, timing, now, lamps.inForce()));
  };
  let asked = "";
  app.on("about", async (about) => {
    lamps.about(about);
    const mode = about.timing ?? about.cameras?.[0];
    const { fps, exposure_us, readout_us } = mode ?? {};
    if (JSON.stringify([fps, exposure_us, readout_us]) === asked) return draw();
    try {
      timing = await app.post("/api/timing", { fps, exposure_us, readout_us });
      asked = JSON.stringify([fps, exposure_us, readout_us]);
      draw();
    } catch (error) {
      write(windowNote, error.message || t("lost.console.short"));
    }
  });
  app.on("telemetry", (now) => now.lamps && lamps.told(now.lamps));
  return {
    want: ["rows", "status"],
    show: () => {
      draw();
      light.show();
      burst.show();
    },
    hide: () => {
      light.hide();
      trial.leave();
    },
  };
}

function drawExposure(app, board, timing, now, before) {
  const { t } = app;
  const period = timing.period_us;
  board.span(-0.06 * period, 1.06 * period, 236);
  const [top, rows, projector, led, axis] = [8, 34, 132, 168, 206];
  board.band(timing.opens_us, timing.window ? timing.closes_us : timing.opens_us - 1, top, axis, "window");
  board.axis(axis, top);
  board.name(t("bench.sync"), 24);
  for (const at of [0, period]) {
    board.line([[at - 0.03 * period, 12], [at, 12], [at, 28], [at + 0.03 * period, 28]], "sync");
    board.upright(at, 28, axis, "fall");
  }
  board.name(t("bench.rows.first"), rows + 14);
  board.name(t("bench.rows.last"), rows + 80);
  const [first, last] = [timing.first_row_us, timing.last_row_us];
  for (const shift of [-period, 0, period]) {
    board.shape(
      [[first[0] + shift, rows], [first[1] + shift, rows], [last[1] + shift, rows + 84], [last[0] + shift, rows + 84]],
      shift === 0 ? "exposed" : "exposed other",
    );
  }
  for (const [lamp, y] of [["projector", projector], ["led", led]]) {
    board.name(t(`label.${lamp}`), y + 19);
    const [from, width] = [now[`${lamp}_delay_us`], now[`${lamp}_width_us`]];
    const fits = timing.window && from >= timing.opens_us && from + width <= timing.closes_us;
    board.band(from, from + width, y, y + 28, `flash ${lamp}${fits ? "" : " outside"}`);
    const [old, oldWidth] = [before[`${lamp}_delay_us`], before[`${lamp}_width_us`]];
    if (old !== from || oldWidth !== width) board.band(old, old + oldWidth, y, y + 28, "flash before");
  }
}

// Times of the flashes: staged here, judged by the daemon, put in force by a press.
function mountLamps(app, changed) {
  const { t } = app;
  const verdict = el("p", { class: "note", role: "status" });
  const commit = el("button", { type: "button", class: "big primary", id: "lamps-commit" }, t("bench.commit"));
  const back = el("button", { type: "button", class: "big", id: "lamps-back" }, t("bench.back"));
  const grid = el("div", { class: "sliders" });
  const controls = new Map();
  let force = {}; // as the daemon has them
  let staged = {}; // what is to be another
  let allowed = false;
  let timer = 0;
  let turn = 0;

  const values = () => ({ ...force, ...staged });
  const show = () => {
    for (const [name, { slider, number }] of controls) {
      const now = values()[name];
      if (now === undefined) continue;
      slider.value = now;
      if (document.activeElement !== number || Number(number.value) !== now) number.value = now;
      slider.closest(".slider").classList.toggle("staged", name in staged);
    }
    const any = Object.keys(staged).length > 0;
    commit.disabled = !any || !allowed || !app.live;
    back.disabled = !any;
    if (!any) tellVerdict("good", t("bench.inforce"));
    changed();
  };
  const tellVerdict = (kind, line) => {
    verdict.dataset.kind = kind;
    write(verdict, line);
  };
  const ask = (now = false) => {
    clearTimeout(timer);
    allowed = false;
    commit.disabled = true;
    if (Object.keys(staged).length === 0) return show();
    timer = setTimeout(judge, now ? 0 : STAGE_MS);
  };
  const judge = async () => {
    const mine = ++turn;
    try {
      await app.post("/api/do", { do: "lamps", lamps: staged, commit: false });
      if (mine !== turn) return;
      allowed = true;
      tellVerdict("good", t("bench.allowed"));
    } catch (error) {
      if (mine !== turn) return;
      allowed = false;
      tellVerdict("bad", error.message || t("lost.console.short"));
    }
    show();
  };
  const put = (name, value) => {
    if (!Number.isFinite(value) || value < 0) return;
    if (value === force[name]) delete staged[name];
    else staged[name] = value;
    turn += 1;
    show();
    ask();
  };
  for (const name of TIMES) {
    const [label, id] = [unique("lamp-label"), unique("lamp")];
    const slider = el("input", { type: "range", min: 0, max: 20000, step: SLIDER_STEP_US, "aria-labelledby": label, "aria-valuetext": "" });
    const number = el("input", { id, type: "number", min: 0, step: "any", name });
    slider.addEventListener("input", () => put(name, Number(slider.value)));
    number.addEventListener("input", () => number.value !== "" && put(name, Number(number.value)));
    number.addEventListener("blur", show);
    controls.set(name, { slider, number });
    grid.append(el("div", { class: "slider" }, el("label", { for: id, id: label }, t(`lamp.${name}`)), slider, number, el("span", { "aria-hidden": "true" }, "µs")));
  }
  commit.addEventListener("click", async () => {
    const wanted = { ...staged };
    if (!(await app.ask({ do: "lamps", lamps: wanted, commit: true }))) return;
    force = { ...force, ...wanted };
    staged = {};
    app.say(t("bench.committed"));
    show();
  });
  back.addEventListener("click", () => {
    staged = {};
    turn += 1;
    show();
  });
  app.on("link", show);
  return {
    root: el("div", {}, grid, verdict, el("div", { class: "row" }, commit, back)),
    values, inForce: () => force,
    about: (about) => {
      const most = { delay: about.window?.closes_us, width: about.limits?.width_max_us ?? about.limits?.width_us };
      for (const [name, { slider }] of controls) {
        const limit = most[name.includes("delay") ? "delay" : "width"];
        if (limit > 0) slider.max = Math.ceil(limit / SLIDER_STEP_US) * SLIDER_STEP_US;
        slider.setAttribute("aria-valuetext", `${us(values()[name] ?? 0)} µs`);
      }
      if (about.lamps) force = about.lamps;
      show();
    },
    told: (now) => {
      force = now;
      for (const name of Object.keys(staged)) if (staged[name] === force[name]) delete staged[name];
      for (const [name, { slider }] of controls) slider.setAttribute("aria-valuetext", `${us(values()[name] ?? 0)} µs`);
      show();
    },
    stage: (proposed) => {
      for (const [name, value] of Object.entries(proposed)) if (controls.has(name) && value !== force[name]) staged[name] = value;
      turn += 1;
      show();
      ask(true);
    },
  };
}

// Lamps on without a recording: held by this page while it is looked at, and by nothing else.
function mountTrial(app) {
  const { t } = app;
  const on = el("button", { type: "button", class: "big", id: "trial-on" }, t("bench.trial.on"));
  const off = el("button", { type: "button", class: "big", id: "trial-off", hidden: true }, t("bench.trial.off"));
  const left = el("p", { class: "note", role: "timer" });
  let timer = 0; // while this page holds a trial
  let begun = 0;
  let mine = null; // its number

  const letGo = () => {
    clearInterval(timer);
    timer = 0;
  };
  const hold = async () => {
    if (document.hidden || app.tab !== "bench") return;
    try {
      await app.post("/api/do", { do: "hold", hold_s: HOLD_S, scan: mine });
    } catch (error) {
      letGo();
      app.wrong(error);
    }
  };
  const end = () => {
    letGo();
    return app.ask({ do: "stop" });
  };
  // Who leaves ends what he began; when that is over, another may have begun something since.
  const leave = () => {
    letGo();
    return app.post("/api/do", { do: "stop", scan: mine }).catch(() => null);
  };
  on.addEventListener("click", async () => {
    const confirm = await app.confirmLamps(t("arm.trial"));
    const told = confirm === null ? null : await app.ask({ do: "start", record: false, hold_s: HOLD_S, confirm });
    if (!told) return;
    mine = told.scan ?? null;
    begun = performance.now();
    letGo();
    timer = setInterval(hold, HOLD_MS);
    if (app.tab !== "bench") leave();
  });
  off.addEventListener("click", end);
  const show = () => {
    const now = app.latest.telemetry ?? {};
    const going = typeof now.trial === "number" && app.live;
    if (timer && !going && performance.now() - begun > HOLD_MS) letGo();
    const had = document.activeElement;
    off.hidden = !going;
    on.hidden = going;
    if (had === on && on.hidden) off.focus();
    if (had === off && off.hidden) on.focus();
    on.disabled = !app.live || (app.latest.state?.state ?? now.state) !== "idle";
    write(left, going ? t(timer ? "bench.trial.held" : "bench.trial.left", { s: Math.ceil(now.trial) }) : t("bench.trial.none"));
  };
  for (const topic of ["telemetry", "state", "link"]) app.on(topic, show);
  return { root: el("div", { class: "trial" }, el("div", { class: "row" }, on, off), left), leave: () => timer && leave() };
}
