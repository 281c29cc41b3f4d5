// Strings of one language; strings/en.json has every key, and the others the same (tests/unit/console/test_page.py).

const NAMES = { en: "English", de: "Deutsch" };
let strings = {};
let language = "en";

export const languageName = (code) => NAMES[code] ?? code;
export const current = () => language;

export async function load(wanted) {
  const code = Object.hasOwn(NAMES, wanted) ? wanted : "en";
  const answer = await fetch(`/static/strings/${code}.json`);
  strings = await answer.json();
  language = code;
  document.documentElement.lang = code;
}

// t("map.defect", {z: "0.246 m"}): {z} in the string is replaced.
export function t(key, values = {}) {
  const text = strings[key] ?? key;
  return text.replace(/\{(\w+)\}/g, (whole, name) => (name in values ? String(values[name]) : whole));
}

// A word of the daemon's where there is one for it, else as it came.
export const word = (prefix, name) => strings[`${prefix}.${name}`] ?? String(name).replaceAll("_", " ");

export function translate(root) {
  for (const one of root.querySelectorAll("[data-t]")) one.textContent = t(one.dataset.t);
  for (const one of root.querySelectorAll("[data-t-label]")) one.setAttribute("aria-label", t(one.dataset.tLabel));
}
