// The scan: what the head does, what it sees, and the wall as it grows.

import { mountCloud } from "./cloud.js";
import { mountDefects } from "./defects.js";
import { el, unique, write } from "./dom.js";
import { events } from "./events.js";
import { mountMap } from "./map.js";
import { mountPictures } from "./pictures.js";
import { DISTANCE, quoted } from "./rounding.js";

const PHOTO_MAX = 46 << 10; // bytes
const PHOTO_SIDES = [960, 720, 480, 320];

export function mount(root, app) {
  const { t } = app;
  const box = (name, ...inside) =>
    el("section", { class: `box box-${name}`, "aria-labelledby": `h-${name}` }, el("h2", { id: `h-${name}` }, t(`scan.${name}`)), inside);
  const readouts = mountReadouts(app);
  const pictures = mountPictures(app);
  const cloud = mountCloud(app);
  const defects = mountDefects(app);
  const map = mountMap(app, (defect) => defects.open(defect));
  root.append(
    el("h2", { class: "visually-hidden" }, t("nav.scan")),
    box("ring", pictures.ring), box("led", pictures.led), box("wall", cloud.root),
    box("map", map.root, defects.list), box("head", readouts.head), box("counts", readouts.counts),
    box("mark", markForm(app)), box("events", events(app)),
  );
  root.append(defects.panel);
  return {
    want: ["pictures", "points", "wall", "slits", "status"],
    show: () => cloud.show(),
    hide: () => cloud.hide(),
  };
}

function mountReadouts(app) {
  const { t } = app;
  const head = el("dl", { class: "readouts" });
  const counts = el("div");
  const rows = new Map();
  const row = (list, key, label) => {
    if (!rows.has(key)) {
      const value = el("dd");
      const line = el("div", {}, el("dt", {}, label), value);
      list.append(line);
      rows.set(key, { line, value });
    }
    return rows.get(key);
  };
  const put = (key, text, kind = "") => {
    const one = row(head, key, t(`head.${key}`));
    write(one.value, text);
    one.line.className = kind;
  };
  for (const key of ["place", "speed", "interlock", "recording", "disk", "seconds"]) put(key, t("unknown"));
  const frames = el("dl", { class: "readouts" });
  const lost = el("div", { class: "lost" });
  counts.append(frames, lost);

  app.on("telemetry", (now) => {
    const z = now.z_mm;
    put("place", z === null || z === undefined ? t("unknown") : quoted(z, DISTANCE) + (now.z_assumed ? ` ± ${quoted(now.z_bound_mm, DISTANCE)} ${t("assumed")}` : ""), now.z_assumed ? "warn" : "");
    put("speed", typeof now.speed_mm_s === "number" ? `${now.speed_mm_s.toFixed(0)} mm/s` : t("unknown"));
    put("interlock", t(`interlock.${now.interlock ?? "unknown"}`), now.interlock === "open" ? "bad" : now.interlock === "closed" ? "good" : "");
    put("recording", now.recording ? now.recording.split("/").pop() : t("none"));
    const minutes = now.disk?.minutes_left;
    const free = now.disk?.free_gb;
    put("disk", typeof minutes === "number" ? t("disk.left", { minutes: minutes.toFixed(0), gb: (free ?? 0).toFixed(1) }) : typeof free === "number" ? t("disk.free", { gb: free.toFixed(1) }) : t("unknown"), typeof minutes === "number" && minutes < 10 ? "bad" : "");
    put("seconds", now.seconds > 0 ? clock(now.seconds) : t("none"));
    for (const [label, count] of Object.entries(now.frames ?? {})) {
      const one = row(frames, `frames.${label}`, app.word("label", label));
      write(one.value, String(count));
    }
    write(row(frames, "profiles", t("counts.profiles")).value, String(now.profiles ?? 0));
    write(row(frames, "recorded", t("counts.recorded")).value, String(now.recorded ?? 0));
    const unknown = Object.entries(now.unknown ?? {}).sort((a, b) => b[1] - a[1]);
    const drops = Object.entries(now.drops ?? {}).sort((a, b) => b[1] - a[1]);
    const text = JSON.stringify([unknown, drops]);
    if (lost.dataset.text !== text) {
      lost.dataset.text = text;
      lost.replaceChildren(
        ...counted(t("counts.unknown"), unknown, (name) => name),
        ...counted(t("counts.lost"), drops, (name) => app.word("drop", name)),
      );
    }
  });
  const counted = (title, pairs, name) =>
    pairs.length === 0
      ? [el("p", { class: "faint" }, `${title}: ${t("nothing")}`)]
      : [el("h3", {}, title), el("ul", { class: "plain counted" }, pairs.map(([what, count]) => el("li", {}, el("span", {}, name(what)), el("b", {}, String(count)))))];
  app.on("*", (topic, body) => {
    if (!topic.startsWith("sensor/") || topic === "sensor/odometer" || !body.values) return;
    for (const [name, value] of Object.entries(body.values)) {
      if (typeof value !== "number") continue;
      const key = `${topic}.${name}`;
      const unit = body.units?.[name] ?? "";
      const one = row(head, key, `${body.sensor} ${app.word("sensor", withoutUnit(name, unit))}`);
      write(one.value, `${value.toFixed(unit === "deg" || unit === "V" ? 1 : 2)} ${unit === "deg" ? "°" : unit === "degC" ? "°C" : unit}`);
    }
  });
  return { head: [head, el("button", { type: "button", class: "quiet", id: "zero", onclick: () => zero(app) }, t("do.zero"))], counts };
}

async function zero(app) {
  const { t } = app;
  if (await app.confirm({ title: t("zero.title"), text: t("zero.text"), yes: t("do.zero") })) {
    if (await app.ask({ do: "zero" })) app.say(t("said.zeroed"));
  }
}

// "roll_rate_deg_s", "deg/s" -> "roll_rate": names say their unit, and the number has it already.
const withoutUnit = (name, unit) => {
  const end = `_${{ degC: "c", A: "a", V: "v" }[unit] ?? unit.toLowerCase().replaceAll("/", "_")}`;
  return name.endsWith(end) ? name.slice(0, -end.length) : name;
};

const clock = (seconds) => {
  const s = Math.floor(seconds);
  return `${Math.floor(s / 3600)}:${String(Math.floor(s / 60) % 60).padStart(2, "0")}:${String(s % 60).padStart(2, "0")}`;
};

// An observation: a text, where on the clock, and a photograph.
function markForm(app) {
  const { t } = app;
  const [text, hour, photo, error] = [unique("mark-text"), unique("mark-clock"), unique("mark-photo"), unique("mark-error")];
  const words = el("input", { id: text, maxlength: 500, required: true, autocomplete: "off", "aria-describedby": error });
  const where = el("select", { id: hour }, el("option", { value: "" }, t("mark.round")));
  for (let h = 0; h < 12; h += 0.5) where.append(el("option", { value: h * 30 }, `${Math.floor(h) || 12}:${h % 1 ? "30" : "00"}`));
  const picture = el("input", { id: photo, type: "file", accept: "image/*", capture: "environment" });
  const wrong = el("p", { id: error, class: "error", role: "alert" });
  const form = el(
    "form", { class: "mark" },
    el("div", { class: "field wide" }, el("label", { for: text }, t("mark.text")), words),
    el("div", { class: "field" }, el("label", { for: hour }, t("mark.clock")), where),
    el("div", { class: "field" }, el("label", { for: photo }, t("mark.photo")), picture),
    el("button", { class: "big" }, t("do.mark")), wrong,
  );
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    write(wrong, "");
    const request = { do: "mark", text: words.value.trim() };
    if (where.value !== "") request.clock_deg = Number(where.value);
    try {
      if (picture.files.length) request.photo = await smaller(picture.files[0]);
      await app.post("/api/do", request);
      app.say(t("said.marked"));
      form.reset();
    } catch (problem) {
      write(wrong, problem.message || t("mark.unreadable"));
    }
  });
  return form;
}

// A photograph as a JPEG that fits a mark, in base64.
async function smaller(file) {
  const bitmap = await createImageBitmap(file, { imageOrientation: "from-image" });
  for (const side of PHOTO_SIDES) {
    const scale = Math.min(1, side / Math.max(bitmap.width, bitmap.height));
    const canvas = el("canvas", { width: Math.round(bitmap.width * scale), height: Math.round(bitmap.height * scale) });
    canvas.getContext("2d").drawImage(bitmap, 0, 0, canvas.width, canvas.height);
    for (const quality of [0.85, 0.7, 0.5]) {
      const url = canvas.toDataURL("image/jpeg", quality);
      if ((url.length - 23) * 0.75 < PHOTO_MAX) return url.slice(23);
    }
  }
  throw new Error("");
}
