// Recordings and results on the console's machine: found again, opened, reconstructed with another calibration.

import { el, unique, write } from "./dom.js";
import { age } from "./job.js";
import { DISTANCE, EXTENT, MEASURE, digits, quoted } from "./rounding.js";

const AGAIN_MS = 15000; // while it is looked at
const SHOWN = 100; // rows at once
const ENDED_MS = 60000; // that a reconstruction which is over stays in view

export function mount(root, app) {
  const { t } = app;
  const [filterId] = [unique("filter")];
  const filter = el("input", { id: filterId, type: "search", autocomplete: "off" });
  const count = el("p", { class: "note", role: "status" });
  const jobs = el("ul", { class: "plain jobs" });
  const jobsBox = el("section", { class: "box box-jobs", "aria-labelledby": "h-jobs", hidden: true }, el("h2", { id: "h-jobs" }, t("surveys.jobs")), jobs);
  const body = el("tbody", { role: "rowgroup" });
  const more = el("button", { type: "button", class: "big", hidden: true }, t("surveys.more"));
  const head = ["what", "length", "found", "state", "do"].map((name) => el("th", { scope: "col", role: "columnheader" }, t(`surveys.head.${name}`)));
  const table = el(
    "table", { class: "surveys", role: "table", hidden: true }, el("caption", { class: "visually-hidden" }, t("surveys.title")),
    el("thead", { role: "rowgroup" }, el("tr", { role: "row" }, head)), body,
  );
  root.append(
    el("h2", { class: "visually-hidden" }, t("nav.surveys")), jobsBox,
    el("section", { class: "box box-surveys", "aria-labelledby": "h-surveys" }, el("h2", { id: "h-surveys" }, t("surveys.title")),
      el("div", { class: "field" }, el("label", { for: filterId }, t("surveys.filter")), filter), count, table, more),
  );
  let listing = null;
  let shown = SHOWN;
  let timer = 0;
  let text = "";

  const look = async () => {
    if (!app.session) return;
    try {
      const heard = await app.get(`/api/surveys?known=${listing?.stamp ?? ""}`);
      listing = heard.same ? { ...listing, jobs: heard.jobs } : heard;
    } catch (error) {
      if (app.tab === "surveys") write(count, error.message || t("lost.console.short"));
      return;
    }
    tell(listing.jobs);
    show();
  };
  const show = () => {
    if (listing === null) return;
    const words = filter.value.toLocaleLowerCase().split(/\s+/).filter(Boolean);
    const found = listing.entries.filter((one) => {
      const all = [one.name, one.folder, one.of, one.verdict, one.utc, t(`surveys.kind.${one.kind}`), ...Object.values(one.job ?? {})].join(" ").toLocaleLowerCase();
      return words.every((word) => all.includes(word));
    });
    const none = listing.folders.length === 0 ? t("surveys.folders.none") : t("surveys.none");
    const left = (listing.left_out > 0 ? ` ${t("surveys.left", { n: listing.left_out })}` : "")
      + (listing.waiting > 0 ? ` ${t("surveys.waiting", { n: listing.waiting })}` : "");
    write(count, (listing.entries.length === 0 ? none : t("surveys.count", { n: found.length, of: listing.entries.length })) + left);
    more.hidden = found.length <= shown;
    table.hidden = found.length === 0;
    const rows = found.slice(0, shown);
    const now = JSON.stringify(rows);
    if (now === text) return; // whoever stands on a button keeps it
    text = now;
    body.replaceChildren(...rows.map((one) => row(app, one, () => again(one))));
  };

  const again = async (one) => {
    const calibration = await choose(app, one, listing.calibrations);
    if (calibration === undefined) return;
    try {
      await app.post("/api/surveys/reconstruct", { scan: one.id, calibration });
      app.say(t("surveys.begun", { name: one.name }));
    } catch (error) {
      app.wrong(error);
    }
  };

  const lines = new Map(); // a job's id -> its elements
  const tell = (all) => {
    const recent = all.filter((one) => one.state === "running" || one.state === "waiting" || !lines.has(one.id) || performance.now() - (lines.get(one.id).over ?? performance.now()) < ENDED_MS);
    for (const one of recent) {
      if (!lines.has(one.id)) lines.set(one.id, jobLine(app, one));
      const line = lines.get(one.id);
      if (line.show(one)) look();
      if (line.root.parentNode !== jobs) jobs.prepend(line.root);
    }
    for (const [id, line] of lines) {
      if (!recent.some((one) => one.id === id)) line.root.remove();
      if (!all.some((one) => one.id === id)) lines.delete(id);
    }
    jobsBox.hidden = jobs.children.length === 0;
  };

  filter.addEventListener("input", () => {
    shown = SHOWN;
    show();
  });
  more.addEventListener("click", () => {
    shown += SHOWN;
    show();
  });
  app.on("reconstruct", (now) => tell(now.jobs));
  for (const topic of ["ended", "session"]) app.on(topic, () => app.tab === "surveys" && look());
  return {
    want: ["status"],
    show: () => {
      look();
      clearInterval(timer);
      timer = setInterval(() => document.hidden || look(), AGAIN_MS);
    },
    hide: () => clearInterval(timer),
  };
}

const when = (app, one) => {
  const at = one.utc ? new Date(one.utc) : new Date(one.changed_s * 1000);
  const words = at.toLocaleString(app.language, { dateStyle: "medium", timeStyle: "short" });
  return one.utc ? words : app.t("surveys.file.date", { date: words });
};

export function bytes(size) {
  if (typeof size !== "number") return null;
  for (const [unit, one] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) {
    if (size >= one) return `${digits(size / one, { places: size / one < 10 ? 1 : 0 })} ${unit}`;
  }
  return `${size} B`;
}

function row(app, one, again) {
  const { t } = app;
  const job = one.job ?? {};
  const cell = (name, ...inside) => el("td", { role: "cell", class: `c-${name}`, "data-head": t(`surveys.head.${name}`) }, inside.flat());
  const of = one.kind === "result" && one.of ? t("surveys.of", { name: one.of }) : null;
  const what = el(
    "th", { scope: "row", role: "rowheader", class: "c-what" },
    el("b", {}, one.name), el("span", { class: "faint" }, [t(`surveys.kind.${one.kind}`), of].filter(Boolean).join(", ")),
    el("span", {}, when(app, one)), el("span", {}, [job.pipe, job.site, job.client].filter(Boolean).join(" · ")),
  );
  const found = [];
  if (typeof one.defects === "number") {
    found.push(el("span", {}, one.defects === 0 ? t("surveys.defects.none") : t("surveys.defects", { n: one.defects, worst: quoted(one.worst_mm, MEASURE) ?? t("unmeasured") })));
    if (typeof one.diameter_mm === "number") found.push(el("span", {}, t("surveys.diameter", { d: quoted(one.diameter_mm, MEASURE, one.k2_mm) })));
  }
  if (one.verdict) found.push(el("b", {}, app.word("verdict", one.verdict)));
  if (one.verdict && one.open) found.push(el("span", {}, t("surveys.open_places", { n: one.open })));
  const length = [quoted(one.length_mm, DISTANCE), typeof one.frames === "number" ? t("surveys.frames", { n: one.frames }) : null];
  const state = [one.state === "whole" ? null : el("b", { class: one.state === "torn" ? "warn" : "" }, t(`surveys.state.${one.state}`)), one.kind === "result" ? null : el("span", {}, one.calibrated ? t("surveys.calibrated", { age: age(app, one.age_days) }) : t("surveys.uncalibrated"))];
  const size = [bytes(one.size), one.parts > 1 ? t("surveys.parts", { n: one.parts }) : null].filter(Boolean).join(", ");
  const press = [];
  if (one.files?.includes("report.html")) {
    press.push(el("a", { class: "button", href: `/api/surveys/file/${one.id}/report.html`, target: "_blank", rel: "noopener", "aria-label": t("surveys.open.named", { name: one.name }) }, t("surveys.open")));
  }
  if (one.files?.includes("report.pdf")) {
    press.push(el("a", { class: "button", href: `/api/surveys/file/${one.id}/report.pdf`, download: `${one.name}.pdf`, "aria-label": t("surveys.pdf.named", { name: one.name }) }, "PDF"));
  }
  if (one.kind !== "result") {
    press.push(el("button", { type: "button", disabled: one.state === "open", onclick: again, "aria-label": t("surveys.again.named", { name: one.name }) }, t("surveys.again")));
  }
  return el(
    "tr", { role: "row" }, what, cell("length", length.filter(Boolean).map((line) => el("span", {}, line))), cell("found", found),
    cell("state", state, el("span", { class: "faint" }, size)), cell("do", el("div", { class: "row" }, press)),
  );
}

// Which calibration: its own (null) or one of the folders (an id); undefined where nobody chose.
function choose(app, one, calibrations) {
  const { t } = app;
  return new Promise((resolve) => {
    const [title, id] = [unique("again"), unique("again-calibration")];
    const select = el("select", { id });
    if (one.calibrated) select.append(el("option", { value: "" }, t("surveys.calibration.own", { age: age(app, one.age_days) })));
    for (const other of calibrations) {
      const diameter = quoted(other.nominal_diameter_mm, { ...EXTENT, places: 1 });
      select.append(el("option", { value: other.id }, [other.name, diameter, age(app, other.age_days), other.folder.split("/").pop()].filter(Boolean).join(", ")));
    }
    const no = el("button", { type: "button", class: "big" }, t("cancel"));
    const go = el("button", { class: "big primary", disabled: select.options.length === 0 }, t("surveys.go"));
    const form = el(
      "form", {}, el("h2", { id: title }, t("surveys.again.title", { name: one.name })), el("p", {}, t("surveys.again.text")),
      el("div", { class: "field" }, el("label", { for: id }, t("surveys.calibration")), select),
      select.options.length === 0 ? el("p", { class: "error" }, t("surveys.calibration.none")) : null,
      el("div", { class: "row end" }, no, go),
    );
    const dialog = el("dialog", { "aria-labelledby": title }, form);
    const end = (answer) => {
      dialog.close();
      dialog.remove();
      resolve(answer);
    };
    no.addEventListener("click", () => end(undefined));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      end(select.value || null);
    });
    dialog.addEventListener("cancel", (event) => {
      event.preventDefault();
      end(undefined);
    });
    document.body.append(dialog);
    dialog.showModal();
    select.focus();
  });
}

// One reconstruction; `show` returns whether something new lies in the folders.
function jobLine(app, first) {
  const { t } = app;
  const name = el("b", {}, first.scan);
  const words = el("span", { class: "note", role: "status" });
  const time = el("span", { class: "faint" });
  const bar = el("progress", { "aria-label": t("surveys.progress", { name: first.scan }) });
  const cancel = el("button", { type: "button", "aria-label": t("surveys.cancel.named", { name: first.scan }) }, t("cancel"));
  cancel.addEventListener("click", () => app.post("/api/surveys/cancel", { id: first.id }).catch((error) => app.wrong(error)));
  const line = {
    root: el("li", { class: "job" }, el("div", {}, name, " ", el("span", { class: "faint" }, first.calibration ?? t("surveys.own"))), bar, words, time, cancel),
    over: null,
    was: "",
    show: (one) => {
      const going = one.state === "running" || one.state === "waiting";
      const ended = !going && line.was !== "" && line.was !== one.state;
      line.was = one.state;
      if (!going) line.over ??= performance.now();
      bar.hidden = !going;
      cancel.hidden = !going;
      if (one.state === "running" && one.total > 0) {
        bar.max = one.total;
        bar.value = one.done;
      } else bar.removeAttribute("value");
      words.dataset.kind = { done: "good", failed: "bad" }[one.state] ?? "";
      write(words, t(`surveys.job.${one.state}`, { what: one.what ? app.word("step", one.what) : "", place: one.place ?? "", error: one.error }));
      const parts = [];
      if (one.seconds !== null) parts.push(t("surveys.seconds", { s: digits(one.seconds, { places: 0 }) }));
      if (going && one.left_s !== null) parts.push(t("surveys.seconds.left", { s: digits(one.left_s, { places: 0 }) }));
      write(time, parts.join(", "));
      return ended && one.state === "done";
    },
  };
  return line;
}
