// Who asked for the scan, where, which pipe: kept in the recording, printed on the report. What is being written here is
// never overwritten: another operator's save is shown beside it.

import { el, unique, write } from "./dom.js";
import { ARC, EXTENT, quoted } from "./rounding.js";

const DRAFT = "job-draft"; // of this browser's tab, over a reload too

export function mount(root, app) {
  const { t } = app;
  const state = el("p", { class: "note", role: "status" });
  const form = el("form", { class: "sheet", novalidate: true, autocomplete: "on" });
  const save = el("button", { class: "big primary", id: "job-save" }, t("job.save"));
  const back = el("button", { type: "button", class: "big", id: "job-back" }, t("job.back"));
  const head = el("dl", { class: "readouts" });
  const made = el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("job.provenance") });
  root.append(
    el("h2", { class: "visually-hidden" }, t("nav.job")),
    el("section", { class: "box box-sheet", "aria-labelledby": "h-sheet" }, el("h2", { id: "h-sheet" }, t("job.title")), state, form),
    el("section", { class: "box box-about", "aria-labelledby": "h-about" }, el("h2", { id: "h-about" }, t("job.head.title")), head, made),
  );
  const fields = new Map(); // name -> {spec, input, error, other, base}
  let saved = null; // what the head has; null: not heard yet
  const draft = remembered();

  const shown = (name) => (saved?.[name] === undefined || saved[name] === null ? "" : String(saved[name]));
  const edited = () => [...fields.keys()].filter((name) => name in draft && draft[name] !== shown(name));

  // A number as JSON wants it, whichever sign its writer puts before the decimals; what is none goes as it is, to be told why.
  const value = ({ spec, input }) => {
    const text = input.value.trim();
    if (spec.kind !== "number" || text === "") return text;
    const number = Number(text.replace(",", "."));
    return Number.isFinite(number) ? number : text;
  };

  const show = () => {
    const names = edited();
    for (const [name, field] of fields) {
      const mine = name in draft;
      if (mine && draft[name] === shown(name)) delete draft[name];
      if (!(name in draft) && document.activeElement !== field.input) field.input.value = shown(name);
      if (!(name in draft)) field.base = shown(name);
      const other = name in draft && field.base !== shown(name);
      field.other.hidden = !other;
      if (other) write(field.otherText, t("job.other", { value: shown(name) || t("job.empty") }));
      field.input.disabled = saved === null;
    }
    sessionStorage.setItem(DRAFT, JSON.stringify(draft));
    const recording = app.latest.telemetry?.recording;
    const words = [];
    if (saved === null) words.push(t("job.wait"));
    else if (names.length) words.push(t("job.unsaved", { fields: names.map((name) => t(`job.${name}`)).join(", ") }));
    else words.push(t("job.saved"));
    if (saved !== null) words.push(recording ? t("job.recording", { file: recording.split("/").pop() }) : t("job.next"));
    write(state, words.join(" "));
    state.dataset.kind = names.length ? "warn" : "good";
    save.disabled = saved === null || names.length === 0 || !app.live;
    back.disabled = names.length === 0;
  };

  const make = (spec) => {
    const [id, wrong, conflict] = [unique("job"), unique("job-error"), unique("job-other")];
    const common = { id, "aria-describedby": `${wrong} ${conflict}`, disabled: true, name: `job-${spec.name}` };
    const input =
      spec.kind === "long"
        ? el("textarea", { ...common, rows: 4, maxlength: spec.most })
        : el("input", { ...common, ...(spec.kind === "date" ? { type: "date" } : spec.kind === "number" ? { inputmode: "decimal", autocomplete: "off" } : { maxlength: spec.most }) });
    const error = el("p", { id: wrong, class: "error" });
    const otherText = el("span");
    const take = el("button", { type: "button", class: "quiet" }, t("job.take"));
    const other = el("p", { id: conflict, class: "warn", hidden: true }, otherText, " ", take);
    const field = { spec, input, error, other, otherText, base: "" };
    if (spec.name in draft) input.value = draft[spec.name];
    input.addEventListener("input", () => {
      draft[spec.name] = input.value;
      complain(field, "");
      show();
    });
    take.addEventListener("click", () => {
      delete draft[spec.name];
      input.value = shown(spec.name);
      show();
      input.focus();
    });
    fields.set(spec.name, field);
    const hint = spec.kind === "number" ? ` (${spec.name.endsWith("_mm") ? "mm, " : ""}${spec.low}–${spec.high})` : "";
    form.append(el("div", { class: spec.kind === "long" ? "field wide" : "field" }, el("label", { for: id }, t(`job.${spec.name}`) + hint), input, error, other));
  };

  const complain = (field, line) => {
    write(field.error, line);
    if (line) field.input.setAttribute("aria-invalid", "true");
    else field.input.removeAttribute("aria-invalid");
  };

  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const names = edited();
    const job = Object.fromEntries(names.map((name) => [name, value(fields.get(name))]));
    try {
      const { errors } = await app.post("/api/job/check", { job });
      for (const [name, field] of fields) complain(field, errors[name] ?? "");
      const first = names.find((name) => name in errors);
      if (first !== undefined) {
        fields.get(first).input.focus();
        return;
      }
      await app.post("/api/do", { do: "job", job });
      saved = { ...saved, ...job };
      for (const name of names) {
        fields.get(name).base = draft[name];
        delete draft[name];
      }
      app.say(t("job.said"));
      show();
    } catch (error) {
      app.wrong(error);
    }
  });
  back.addEventListener("click", () => {
    for (const name of Object.keys(draft)) delete draft[name];
    for (const [name, field] of fields) {
      field.input.value = shown(name);
      complain(field, "");
    }
    show();
  });

  const heard = (job) => {
    saved = job;
    show();
  };
  app.on("telemetry", (now) => (now.job ? heard(now.job) : show()));
  app.on("about", (about) => {
    if (about.job && !app.latest.telemetry?.job) heard(about.job);
    tellHead(app, about, head, made);
  });
  app.on("link", show);
  app.on("session", async () => {
    if (fields.size) return;
    try {
      for (const spec of (await app.get("/api/job")).fields) make(spec);
      form.append(el("div", { class: "row" }, save, back));
      show();
    } catch (error) {
      app.wrong(error);
    }
  });
  return { want: ["status"], show };
}

function remembered() {
  try {
    const kept = JSON.parse(sessionStorage.getItem(DRAFT) ?? "{}");
    return Object.fromEntries(Object.entries(kept).filter(([, text]) => typeof text === "string"));
  } catch {
    return {};
  }
}

export function age(app, days) {
  const { t } = app;
  if (typeof days !== "number") return t("job.age.unknown");
  const whole = quoted(days, { ...EXTENT, unit: "" });
  return days < 1 ? t("job.age.today") : t(whole === "1" ? "job.age.one" : "job.age", { days: whole });
}

function tellHead(app, about, head, made) {
  const { t } = app;
  const calibration = about.calibration;
  const controller = about.controller;
  const rows = [
    ["serial", app.latest.telemetry?.job?.head ?? about.job?.head ?? ""],
    ["calibration", calibration ? (calibration.file ?? t("job.about.carried")) : t("job.about.none")],
    ["age", calibration ? age(app, calibration.age_days) : ""],
    ["diameter", calibration ? (quoted(calibration.nominal_diameter_mm, { ...EXTENT, places: 1 }) ?? "") : ""],
    ["controller", controller ? [controller.board, controller.version, controller.commit].filter(Boolean).join(", ") : t("job.about.none")],
    ["certificate", about.certificate?.text ?? ""],
    ["cameras", (about.cameras ?? []).map((one) => `${one.number}: ${one.width} × ${one.height}`).join("; ")],
    ["record", about.record ? `${about.record.folder}, ${about.record.codec}` : t("job.about.unrecorded")],
    ["version", about.version ?? ""],
  ];
  head.replaceChildren(...rows.map(([name, text]) => el("div", {}, el("dt", {}, t(`job.about.${name}`)), el("dd", {}, text || t("unknown")))));
  const sections = Object.entries(calibration?.provenance ?? {});
  if (sections.length === 0) {
    made.replaceChildren(el("p", { class: "faint" }, t("job.provenance.none")));
    return;
  }
  const line = ([name, one]) => {
    const rest = Object.entries(one).filter(([key]) => key !== "utc").map(([key, value]) => `${key.replaceAll("_", " ")} ${typeof value === "number" ? quoted(value, { ...ARC, unit: "", places: 3 }) : value}`);
    return el("tr", {}, el("th", { scope: "row" }, name.replaceAll("_", " ")), el("td", {}, String(one.utc ?? t("unknown")).slice(0, 10)), el("td", {}, rest.join(", ")));
  };
  made.replaceChildren(
    el("table", {}, el("caption", {}, t("job.provenance")),
      el("thead", {}, el("tr", {}, ["section", "made", "how"].map((name) => el("th", { scope: "col" }, t(`job.provenance.${name}`))))),
      el("tbody", {}, sections.map(line))),
  );
}
