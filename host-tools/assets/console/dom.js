// Small helpers around the document: elements are created from data, and text is never markup.

export const $ = (id) => document.getElementById(id);

export function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "on") {
      for (const [event, listener] of Object.entries(value)) made.addEventListener(event, listener);
    } else if (name === "data") {
      Object.assign(made.dataset, value);
    } else if (name in made) {
      made[name] = value;
    } else {
      made.setAttribute(name, value);
    }
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export function text(target, value) {
  if (target.textContent !== value) target.textContent = value;
}

const shows = new WeakMap();

// Keeps one child for each item, by its key. Existing nodes stay in place and are only updated, so that presses, focus,
// selection and scroll position survive every update. `make` returns a node and the function that shows an item in it.
export function keyed(parent, items, key, make) {
  const kept = new Map([...parent.children].map((child) => [child.dataset.key, child]));
  const wanted = items.map((item) => {
    const name = String(key(item));
    let node = kept.get(name);
    kept.delete(name);
    if (!node) {
      const [made, show] = make(item);
      made.dataset.key = name;
      shows.set(made, show);
      node = made;
    }
    shows.get(node)?.(item);
    return node;
  });
  for (const gone of kept.values()) gone.remove();
  let next = parent.firstElementChild;
  for (const node of wanted) {
    if (node === next) next = next.nextElementSibling;
    else parent.insertBefore(node, next);
  }
}

// Sets a property only if it changes: writing an attribute again can end a press.
export function set(node, properties) {
  for (const [name, value] of Object.entries(properties)) if (node[name] !== value) node[name] = value;
}

export function number(value, digits) {
  return Number.isFinite(value) ? value.toFixed(digits).replace("-", "−") : "–";
}

export function duration(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  const whole = Math.round(seconds);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${String(whole % 60).padStart(2, "0")} s`;
}

// A canvas that is as sharp as the screen; calls back when its size or the colours have changed.
export class Canvas {
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.width = 0;
    this.height = 0;
    this.changed = changed;
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    document.addEventListener("themechange", () => this.recolour());
    this.recolour();
  }

  resize() {
    const box = this.canvas.parentElement.getBoundingClientRect();
    this.ratio = Math.min(globalThis.devicePixelRatio || 1, 2);
    this.width = Math.max(1, Math.floor(box.width));
    this.height = Math.max(1, Math.floor(box.height));
    this.canvas.width = Math.floor(this.width * this.ratio);
    this.canvas.height = Math.floor(this.height * this.ratio);
    this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.changed();
  }

  recolour() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    this.colours = {};
    for (const name of ["ink", "soft", "faint", "line", "card", "accent", "good", "warn", "bad", "sheet", "sheet-ink", "sheet-rest", "sheet-accent", "sheet-edge", "metal"]) {
      this.colours[name] = colour(name);
    }
    this.colours.series = Array.from({ length: 8 }, (_, index) => colour(`s${index}`));
    if (this.width > 0) this.changed();
  }

  clear() {
    this.context.clearRect(0, 0, this.width, this.height);
  }
}

export function save(name, blob) {
  const link = element("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

const TOAST_MS = 7000;
const BURST_MS = 2500;
const TOAST_LINES = 4;
let latest = null;

// A message over the page. Messages that arrive within a moment of one another are shown as one.
export function toast(words, tone = "warn") {
  const now = performance.now();
  if (!latest?.box.isConnected || latest.tone !== tone || now - latest.at > BURST_MS) {
    latest = { box: element("div", { className: "toast", data: { tone } }), tone };
    $("toasts").append(latest.box);
    while ($("toasts").childElementCount > 3) $("toasts").firstElementChild.remove();
  }
  const { box } = latest;
  latest.at = now;
  if (![...box.children].some((line) => line.textContent === words)) box.append(element("p", {}, words));
  while (box.childElementCount > TOAST_LINES) box.firstElementChild.remove();
  clearTimeout(latest.timer);
  latest.timer = setTimeout(() => box.remove(), TOAST_MS);
}

export function age(seconds) {
  return seconds < 60 ? `${Math.floor(seconds)} s ago` : `${Math.floor(seconds / 60)} min ago`;
}
