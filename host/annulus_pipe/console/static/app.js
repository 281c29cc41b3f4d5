// The shell: language, theme, tabs, the head's state in one word, what to do next, who commands. Tabs are modules that
// export mount(root, app) and may return {want, show(), hide()}.

import { Connection, KIND, Refused } from "./connection.js";
import { el, write } from "./dom.js";
import * as i18n from "./i18n.js";
import { mountState } from "./state.js";

const TABS = ["scan", "job", "bench", "surveys"];
const TOASTS_MAX = 4;
const TOAST_MS = 8000;
const THEMES = { auto: "(prefers-color-scheme: dark)", light: "not all", dark: "all" }; // the medium of dark.css
const { t } = i18n;

class App {
  constructor() {
    this.connection = new Connection();
    this.t = t;
    this.word = i18n.word;
    this.latest = {}; // topic -> its last body
    this.session = null;
    this.stats = { pictures: 0, latencyMs: [], points: 0, renderer: "", updates: 0 };
    this.topics = new Map();
    this.kinds = new Map();
    this.tabs = {};
    this.tab = "";
    this.connection.onMessage = (kind, message) => this.hear(kind, message);
    this.connection.onChange = (state) => {
      document.body.dataset.link = state;
      this.emit("link", state);
    };
  }

  get language() {
    return i18n.current();
  }

  // Called with the last body at once, where there was one.
  on(topic, hear) {
    if (!this.topics.has(topic)) this.topics.set(topic, []);
    this.topics.get(topic).push(hear);
    if (topic in this.latest) hear(this.latest[topic]);
  }

  onKind(kind, hear) {
    if (!this.kinds.has(kind)) this.kinds.set(kind, []);
    this.kinds.get(kind).push(hear);
  }

  emit(topic, body) {
    this.latest[topic] = body;
    for (const hear of this.topics.get(topic) ?? []) hear(body);
    for (const hear of this.topics.get("*") ?? []) hear(topic, body);
  }

  hear(kind, message) {
    this.stats.updates += 1;
    if (kind === KIND.status) this.emit(message.topic, message.body);
    else for (const hear of this.kinds.get(kind) ?? []) hear(message);
  }

  get live() {
    return this.connection.state === "live";
  }

  get commanding() {
    return this.latest.alive?.you?.commands === true;
  }

  get(path) {
    return this.connection.get(path);
  }

  post(path, body) {
    return this.connection.post(path, body);
  }

  // A request of the daemon's; what is wrong is said, and null returned.
  async ask(request) {
    try {
      return await this.post("/api/do", request);
    } catch (error) {
      this.wrong(error);
      return null;
    }
  }

  wrong(error) {
    if (error instanceof Refused && error.status === 401) this.login();
    else this.say(error.message || t("lost.console.short"), "bad");
  }

  // One line that screen readers hear and that goes by itself.
  say(text, kind = "good") {
    const toasts = document.getElementById("toasts");
    const close = el("button", { type: "button", class: "quiet", "aria-label": t("close") }, "×");
    const toast = el("div", { class: `toast ${kind}` }, el("span", {}, text), close);
    close.addEventListener("click", () => toast.remove());
    toasts.append(toast);
    while (toasts.children.length > TOASTS_MAX) toasts.firstElementChild.remove();
    setTimeout(() => toast.remove(), TOAST_MS);
  }

  // Two steps before lamps: this asks the console for a token, and a dialog for a second, different press. Resolves to
  // the token, or null.
  async confirmLamps(what) {
    let armed;
    try {
      armed = await this.post("/api/arm");
    } catch (error) {
      this.wrong(error);
      return null;
    }
    const seconds = Math.floor(armed.expires_s) - 1;
    return (await this.confirm({ title: t("arm.title"), text: what, yes: t("arm.yes"), danger: true, seconds }))
      ? armed.confirm
      : null;
  }

  // A question in a dialog; the safe answer has the focus. `seconds`: it closes itself then.
  confirm({ title, text, yes, danger = false, seconds = 0 }) {
    return new Promise((resolve) => {
      const left = el("p", { class: "faint" });
      const no = el("button", { type: "button", class: "big" }, t("cancel"));
      const go = el("button", { type: "button", class: danger ? "big danger" : "big primary", id: "confirm-yes" }, yes);
      const dialog = el(
        "dialog", { "aria-labelledby": "confirm-title" },
        el("h2", { id: "confirm-title" }, title), el("p", {}, text), left, el("div", { class: "row end" }, no, go),
      );
      const end = (answer) => {
        clearInterval(timer);
        dialog.close();
        dialog.remove();
        resolve(answer);
      };
      let rest = seconds;
      const count = () => {
        if (seconds && rest <= 0) end(false);
        else if (seconds) write(left, t("arm.left", { s: rest }));
        rest -= 1;
      };
      const timer = setInterval(count, 1000);
      no.addEventListener("click", () => end(false));
      go.addEventListener("click", () => end(true));
      dialog.addEventListener("cancel", (event) => {
        event.preventDefault();
        end(false);
      });
      document.body.append(dialog);
      dialog.showModal();
      count();
      no.focus();
    });
  }

  async begin() {
    let session;
    try {
      session = await this.get("/api/session");
    } catch {
      document.body.dataset.link = "console";
      setTimeout(() => this.begin(), 1000);
      return;
    }
    this.session = session;
    this.connection.token = session.token;
    if (session.needs_login) this.login();
    else {
      this.connection.open();
      this.emit("session", session);
    }
  }

  login() {
    if (document.getElementById("login")) return;
    this.connection.close();
    const name = el("input", { id: "login-name", autocomplete: "username", maxlength: 60 });
    const password = el("input", { id: "login-password", type: "password", autocomplete: "current-password", required: true });
    const wrong = el("p", { class: "error", role: "alert" });
    const form = el(
      "form", { class: "login" }, el("h2", { id: "login-title" }, t("login.title")),
      el("label", { for: "login-name" }, t("login.name")), name,
      el("label", { for: "login-password" }, t("login.password")), password, wrong,
      el("button", { class: "big primary" }, t("login.go")), el("p", { class: "faint" }, t("login.where")),
    );
    const dialog = el("dialog", { id: "login", "aria-labelledby": "login-title" }, form);
    dialog.addEventListener("cancel", (event) => event.preventDefault());
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      write(wrong, "");
      try {
        const session = await this.post("/api/login", { name: name.value.trim(), password: password.value });
        this.session = session;
        this.connection.token = session.token;
        dialog.close();
        dialog.remove();
        this.connection.open();
        this.emit("session", session);
      } catch (error) {
        write(wrong, error.message || t("lost.console.short"));
        password.select();
      }
    });
    document.body.append(dialog);
    dialog.showModal();
    name.focus();
  }
}

const app = new App();
window.annulus = app; // for tests: stats, latest

async function start() {
  await i18n.load(localStorage.getItem("language") ?? navigator.language.slice(0, 2));
  i18n.translate(document);
  languages();
  theme();
  mountState(document.getElementById("state"), app);
  await makeTabs();
  window.addEventListener("hashchange", () => open(location.hash.slice(1)));
  open(location.hash.slice(1));
  await app.begin();
}

function languages() {
  const select = document.getElementById("language");
  for (const code of ["en", "de"]) select.append(el("option", { value: code, lang: code }, i18n.languageName(code)));
  select.value = i18n.current();
  select.addEventListener("change", () => {
    localStorage.setItem("language", select.value);
    location.reload();
  });
}

function theme() {
  const button = document.getElementById("theme");
  const show = () => {
    const now = localStorage.getItem("theme") ?? "auto";
    document.getElementById("dark").media = THEMES[now] ?? THEMES.auto;
    write(button, t(`theme.${now}`));
    button.setAttribute("aria-label", t("theme.label", { now: t(`theme.${now}`) }));
    app.emit("theme", now);
  };
  button.addEventListener("click", () => {
    const names = Object.keys(THEMES);
    const at = names.indexOf(localStorage.getItem("theme") ?? "auto");
    localStorage.setItem("theme", names[(at + 1) % names.length]);
    show();
  });
  show();
}

async function makeTabs() {
  const bar = document.getElementById("tabs");
  const main = document.getElementById("main");
  for (const name of TABS) {
    bar.append(el("a", { href: `#${name}`, id: `tab-${name}` }, t(`nav.${name}`)));
    const root = el("div", { class: `page page-${name}`, id: `page-${name}`, hidden: true });
    main.append(root);
    const module = await import(`./${name}.js`).catch((error) => {
      console.error(error);
      return null;
    });
    app.tabs[name] = { root, ...(module?.mount(root, app) ?? {}) };
  }
}

function open(wanted) {
  const name = TABS.includes(wanted) ? wanted : TABS[0];
  if (name === app.tab) return;
  for (const [other, tab] of Object.entries(app.tabs)) {
    const here = other === name;
    tab.root.hidden = !here;
    document.getElementById(`tab-${other}`).toggleAttribute("aria-current", here);
    if (here) document.getElementById(`tab-${other}`).setAttribute("aria-current", "page");
    else if (other === app.tab) tab.hide?.();
  }
  app.tab = name;
  document.title = `annulus · ${t(`nav.${name}`)}`;
  app.connection.want(app.tabs[name].want ?? ["status"]);
  app.tabs[name].show?.();
}

start();
