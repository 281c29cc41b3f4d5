// A burst of the microwave source, edited: drawn and judged by `annulus burst show`.

import { el, unique, write } from "./dom.js";
import { digits } from "./rounding.js";
import { Board, us } from "./timeline.js";

const ASK_MS = 400;
const OWN = "own";
const USUAL = "mpsl25-stuffed";
const NUMBERS = { chip_us: 0.5, repeat: 1, period_us: 1000, trigger_offset_us: 0 };

export function mountBurst(app) {
  const { t } = app;
  const [codeId, chipsId, chipsError] = [unique("burst-code"), unique("burst-chips"), unique("burst-error")];
  const code = el("select", { id: codeId });
  const chips = el("input", { id: chipsId, value: "1010011", spellcheck: "false", autocomplete: "off", inputmode: "numeric", "aria-describedby": chipsError });
  const own = el("div", { class: "field", hidden: true }, el("label", { for: chipsId }, t("burst.chips")), chips);
  const verdict = el("p", { class: "note", id: chipsError, role: "status" });
  const near = new Board(t("burst.drawing"));
  const far = new Board(t("burst.period"));
  const limits = el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": t("burst.limits") });
  const numbers = new Map();
  const form = el("form", { class: "sheet" }, el("div", { class: "field" }, el("label", { for: codeId }, t("burst.code")), code), own);
  for (const [name, usual] of Object.entries(NUMBERS)) {
    const id = unique("burst");
    const input = el("input", { id, type: "number", step: name === "repeat" ? 1 : "any", value: usual });
    numbers.set(name, input);
    form.append(el("div", { class: "field" }, el("label", { for: id }, t(`burst.${name}`)), input));
  }
  form.addEventListener("submit", (event) => event.preventDefault());
  let timer = 0;
  let asking = false;
  let again = false;
  let known = false;
  const soon = () => {
    own.hidden = code.value !== OWN;
    clearTimeout(timer);
    timer = setTimeout(ask, ASK_MS);
  };
  form.addEventListener("input", soon);

  const ask = async () => {
    if (asking) {
      again = true;
      return;
    }
    asking = true;
    write(verdict, t("burst.asking"));
    verdict.dataset.kind = "";
    const request = { code: code.value === OWN ? chips.value.trim() : code.value };
    for (const [name, input] of numbers) request[name] = input.value === "" ? null : Number(input.value);
    try {
      const { burst, why } = await app.post("/api/burst", request);
      verdict.dataset.kind = burst.ok ? "good" : "bad";
      write(verdict, burst.ok ? t("burst.ok", { chips: burst.chips, ones: burst.ones, burst: us(burst.burst_us) }) : why);
      draw(app, near, far, burst);
      tellLimits(app, limits, burst.limits ?? []);
    } catch (error) {
      verdict.dataset.kind = "bad";
      write(verdict, error.message || t("lost.console.short"));
    }
    asking = false;
    if (again) {
      again = false;
      ask();
    }
  };
  const show = async () => {
    if (known || !app.session || app.session.needs_login) return;
    known = true;
    try {
      const { codes } = await app.get("/api/bench");
      code.replaceChildren(...codes.map((one) => el("option", { value: one }, one)), el("option", { value: OWN }, t("burst.own")));
      if (codes.includes(USUAL)) code.value = USUAL;
      ask();
    } catch {
      known = false;
    }
  };
  app.on("session", () => app.tab === "bench" && show());
  return { root: el("div", {}, form, verdict, near.root, far.root, limits), show };
}

function draw(app, near, far, burst) {
  const { t } = app;
  const [trigger, triggerLength] = burst.trigger_us;
  const pulses = burst.pulses_us;
  const both = (board, from, to, name, repeats) => {
    board.show(t("burst.named", { code: burst.code, pulses: pulses.length, from: us(from), to: us(to), trigger: us(trigger) }), () => {
      board.span(from, to, 122);
      board.axis(92, 8);
      for (const [label, y] of [["burst.gate", 38], ["burst.trigger", 78]]) board.name(t(label), y - 6);
      const gate = [[from, 40]];
      const line = [[from, 80]];
      for (const shift of repeats) {
        for (const { start, length } of pulses) gate.push([start + shift, 40], [start + shift, 14], [start + length + shift, 14], [start + length + shift, 40]);
        line.push([trigger + shift, 80], [trigger + shift, 54], [trigger + triggerLength + shift, 54], [trigger + triggerLength + shift, 80]);
      }
      board.line([...gate, [to, 40]], "gate");
      board.line([...line, [to, 80]], "trigger");
    });
  };
  const margin = 0.05 * burst.burst_us + burst.chip_us;
  both(near, Math.min(-margin, trigger - margin), Math.max(burst.burst_us, trigger + triggerLength) + margin, "burst.drawing", [0]);
  both(far, -0.05 * burst.period_us, 1.05 * burst.period_us, "burst.period", burst.repeat > 1 ? [0, burst.period_us] : [0]);
}

function tellLimits(app, root, limits) {
  const { t } = app;
  const number = (value) => digits(value, { places: 3 }).replace(/\.0+$|(\.\d*[1-9])0+$/, "$1");
  const row = (one) =>
    el("tr", { class: one.ok ? "" : "bad" }, el("th", { scope: "row" }, app.word("limit", one.name.replaceAll(" ", "_"))),
      el("td", {}, `${number(one.value)} ${app.word("unit", one.unit)}`), el("td", {}, `${number(one.allowed[0])} – ${number(one.allowed[1])} ${app.word("unit", one.unit)}`),
      el("td", {}, t(one.ok ? "limit.ok" : "limit.refused")));
  root.replaceChildren(
    el("table", {}, el("caption", {}, t("burst.limits")),
      el("thead", {}, el("tr", {}, ["what", "is", "allowed", "verdict"].map((name) => el("th", { scope: "col" }, t(`limit.head.${name}`))))),
      el("tbody", {}, limits.map(row))),
  );
}
