// Small helpers around the document: elements are made of data, text is never markup.

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
    for (const name of ["ink", "soft", "faint", "line", "card", "accent", "good", "warn", "bad", "sheet", "metal"]) {
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

export function toast(words, tone = "warn") {
  const made = element("div", { className: "toast", data: { tone } }, words);
  $("toasts").append(made);
  while ($("toasts").childElementCount > 4) $("toasts").firstElementChild.remove();
  setTimeout(() => made.remove(), 7000);
}
