// Elements, made by name: the page has no markup but its frame, and no text that is not in strings/.

export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  set(made, attributes);
  made.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return made;
}

export function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  set(made, attributes);
  made.append(...children.flat(Infinity));
  return made;
}

export function set(element, attributes) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value === false || value === null || value === undefined) element.removeAttribute(name);
    else element.setAttribute(name, value);
  }
  return element;
}

// Only what changed is written: a screen reader hears of nothing else, and nothing is laid out anew for nothing.
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

let numbered = 0;
export const unique = (stem) => `${stem}-${++numbered}`;
