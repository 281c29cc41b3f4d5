// What happened, the latest first: events, marks, ends of scans.

import { el } from "./dom.js";
import { DISTANCE, quoted } from "./rounding.js";

const EVENTS_MAX = 100;

export function events(app) {
  const { t } = app;
  const list = el("ol", { class: "plain events", tabindex: 0, "aria-label": t("scan.events") });
  const none = el("p", { class: "faint" }, t("events.none"));
  // The latest first, each at its own time: who comes later, or again, is told what had happened before.
  const add = (body, text, kind) => {
    const at = typeof body.utc_s === "number" ? body.utc_s : null;
    const key = `${at} ${text}`;
    const items = [...list.children];
    if (at !== null && items.some((one) => one.dataset.key === key)) return;
    none.hidden = true;
    const made = el("li", { class: kind, "data-key": key, "data-at": at }, el("time", {}, when(at)), " ", text);
    list.insertBefore(made, items.find((one) => at === null || Number(one.dataset.at) <= at) ?? null);
    while (list.children.length > EVENTS_MAX) list.lastElementChild.remove();
  };
  const when = (at) => {
    if (at === null) return t("unknown");
    const then = new Date(at * 1000);
    const today = then.toDateString() === new Date().toDateString();
    return today ? then.toLocaleTimeString([], { hour12: false }) : then.toLocaleString(app.language, { hour12: false });
  };
  app.on("event", (event) => add(event, event.text, event.kind === "fault" ? "bad" : ""));
  app.on("mark", (mark) => add(mark, `${t("events.mark")}: ${mark.text}${typeof mark.z_mm === "number" ? `, ${quoted(mark.z_mm, DISTANCE)}` : ""}`, "mark"));
  app.on("ended", (ended) => add(ended, t("events.ended", { s: ended.seconds?.toFixed?.(1) ?? "?" }), ""));
  return el("div", {}, none, list);
}
