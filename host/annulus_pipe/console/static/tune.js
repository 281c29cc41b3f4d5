// `annulus tune` from the page: asked for in two steps, watched, and what it proposes staged for a press of its own.

import { el, write } from "./dom.js";
import { us } from "./timeline.js";

export function mountTune(app, stage) {
  const { t } = app;
  const lamp = el("select", { id: "tune-lamp" }, ["projector", "led"].map((name) => el("option", { value: name }, t(`label.${name}`))));
  const go = el("button", { type: "button", class: "big", id: "tune-go" }, t("tune.go"));
  const cancel = el("button", { type: "button", class: "big", id: "tune-cancel", hidden: true }, t("cancel"));
  const apply = el("button", { type: "button", class: "big primary", id: "tune-apply", hidden: true }, t("tune.apply"));
  const bar = el("progress", { "aria-label": t("bench.tune"), hidden: true, max: 1, value: 0 });
  const words = el("p", { class: "note", role: "status" });
  const found = el("ul", { class: "plain" });
  let proposed = {};
  go.addEventListener("click", async () => {
    const confirm = await app.confirmLamps(t("arm.tune"));
    if (confirm === null) return;
    try {
      await app.post("/api/tune", { confirm, lamp: lamp.value });
    } catch (error) {
      app.wrong(error);
    }
  });
  cancel.addEventListener("click", () => app.post("/api/tune/cancel").catch((error) => app.wrong(error)));
  apply.addEventListener("click", () => {
    stage(proposed);
    app.say(t("tune.staged"));
  });
  const show = () => {
    const now = app.latest.tune ?? { state: "never" };
    const running = now.state === "running";
    cancel.hidden = bar.hidden = !running;
    go.hidden = running;
    lamp.disabled = running;
    go.disabled = !app.live || (app.latest.state?.state ?? app.latest.telemetry?.state) !== "idle";
    if (running) {
      bar.max = Math.max(1, now.total ?? 1);
      bar.value = now.done ?? 0;
    }
    proposed = now.proposed ?? {};
    const names = Object.entries(proposed).filter(([, value]) => typeof value === "number");
    apply.hidden = running || names.length === 0;
    const text = `tune.${now.state}`;
    write(words, t(text, { what: now.what ?? "", why: now.error ?? "" }));
    words.dataset.kind = now.state === "failed" ? "bad" : now.state === "done" ? "good" : "";
    const lines = [...names.map(([name, value]) => `${t(`lamp.${name}`)}: ${us(value)} µs`), ...(now.remarks ?? [])];
    if (found.dataset.text !== lines.join("\n")) {
      found.dataset.text = lines.join("\n");
      found.replaceChildren(...lines.map((line) => el("li", {}, line)));
    }
  };
  for (const topic of ["tune", "state", "telemetry", "link"]) app.on(topic, show);
  show();
  return { root: el("div", {}, el("p", { class: "faint" }, t("tune.note")), el("div", { class: "row" }, el("label", { for: "tune-lamp" }, t("tune.lamp")), lamp, go, cancel, apply), bar, words, found) };
}
