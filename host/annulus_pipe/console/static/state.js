// The head in one word, what to do next, and the few things that change it.

import { el, write } from "./dom.js";

export function mountState(root, app) {
  const { t } = app;
  const word = root.querySelector("#state-word");
  const next = root.querySelector("#state-next");
  const actions = root.querySelector("#state-actions");
  const command = root.querySelector("#command");

  const button = (name, style, press) => {
    const made = el("button", { type: "button", class: `big ${style}`, id: `do-${name}`, hidden: true }, t(`do.${name}`));
    made.addEventListener("click", press);
    actions.append(made);
    return made;
  };
  const buttons = {
    start: button("start", "primary", async () => {
      const confirm = await app.confirmLamps(t("arm.scan"));
      if (confirm !== null && (await app.ask({ do: "start", confirm }))) app.say(t("said.started"));
    }),
    pause: button("pause", "", () => app.ask({ do: "pause" })),
    resume: button("resume", "primary", async () => {
      const confirm = await app.confirmLamps(t("arm.resume"));
      if (confirm !== null) await app.ask({ do: "resume", confirm });
    }),
    stop: button("stop", "", async () => {
      const trial = app.latest.telemetry?.trial !== null && app.latest.telemetry?.trial !== undefined;
      const sure = trial || (await app.confirm({ title: t("stop.title"), text: t("stop.text"), yes: t("do.stop") }));
      if (sure && (await app.ask({ do: "stop" }))) app.say(t(trial ? "said.dark" : "said.ended"));
    }),
  };
  const whose = el("p", { class: "command-who", "aria-live": "polite" });
  const take = el("button", { type: "button", class: "quiet", id: "command-take" });
  const name = el("input", { id: "operator", maxlength: 60, size: 12, autocomplete: "name", "aria-label": t("command.name") });
  name.value = localStorage.getItem("operator") ?? "";
  name.addEventListener("change", () => localStorage.setItem("operator", name.value.trim()));
  command.append(whose, name, take);
  take.addEventListener("click", async () => {
    if (app.commanding) {
      await app.ask({ do: "release" });
      return;
    }
    const other = app.latest.telemetry?.command;
    if (other) {
      const text = t("command.take.text", { name: other.name });
      if (!(await app.confirm({ title: t("command.take.title"), text, yes: t("command.take") }))) return;
    }
    const wanted = name.value.trim();
    if (wanted && wanted !== app.session?.name && !app.session?.needs_login && !app.session?.password) {
      try {
        app.session = await app.post("/api/login", { name: wanted, password: "" });
        app.connection.token = app.session.token;
      } catch {
        // a console with a password has the name from the login
      }
    }
    await app.ask({ do: "command", take: Boolean(other) });
  });

  const show = () => {
    const link = app.connection.state;
    const telemetry = app.latest.telemetry ?? {};
    const health = app.latest.health ?? {};
    let state = app.latest.state?.state ?? telemetry.state ?? "off";
    const trial = telemetry.trial ?? null;
    const beingTried = trial !== null && ["armed", "scanning"].includes(state);
    if (link !== "live") state = `lost-${link}`;
    else if (beingTried) state = "trial";
    else if (state === "idle" && telemetry.disk?.refuses) state = "blocked"; // Start would be refused
    root.dataset.state = state;
    write(word, t(`state.${state}`));
    let hint = t(`next.${state}`, { s: trial === null ? "" : Math.ceil(trial) });
    if (state === "blocked") hint = t("next.blocked", { why: telemetry.disk.refuses });
    else if (state === "fault") hint = t("next.fault", { why: app.latest.state?.why || telemetry.problem || health.why || "" });
    else if (link === "live" && health.health && health.health !== "ok") hint = `${app.word("health", health.health)}: ${health.why}`;
    write(next, hint);
    root.dataset.health = link === "live" ? (health.health ?? "") : "";
    const paused = state === "paused";
    const running = ["armed", "scanning"].includes(state) || (state === "fault" && Boolean(telemetry.recording));
    show1(buttons.start, state === "idle");
    show1(buttons.pause, ["armed", "scanning"].includes(state) || (state === "fault" && Boolean(telemetry.recording)));
    show1(buttons.resume, paused);
    show1(buttons.stop, running || paused || state === "trial");
    const who = telemetry.command;
    const mine = app.commanding;
    write(whose, mine ? t("command.you") : who ? t("command.other", { name: who.name }) : t("command.nobody"));
    command.dataset.who = mine ? "you" : who ? "other" : "nobody";
    write(take, mine ? t("command.release") : t("command.take"));
    name.hidden = mine;
    take.disabled = link !== "live";
  };
  const show1 = (one, visible) => {
    if (one.hidden !== visible) return;
    const had = document.activeElement === one;
    one.hidden = !visible;
    if (had) root.querySelector("#state-actions button:not([hidden])")?.focus();
  };
  for (const topic of ["state", "telemetry", "health", "alive", "link", "session"]) app.on(topic, show);
  show();
}
