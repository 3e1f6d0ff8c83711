// The scope: choice of signals and window, pause, zoom, cursor, triggered capture, export of the visible part.

import { $, element, save, text, toast } from "./dom.js";
import { Columns, Plot } from "./plot.js";

const WINDOWS_S = [1, 2, 5, 10, 20, 30, 60];
const DELAY_MS = 60;
const PRESETS = [
  ["following errors", (signal) => signal.name.startsWith("e")],
  ["setpoint and actual", (signal) => /^q/.test(signal.name)],
  ["velocities", (signal) => /^v/.test(signal.name)],
  ["platform", (signal) => signal.axis === 0 && signal.unit === "mm"],
  ["speed of the pen", (signal) => signal.axis === 0 && signal.unit === "mm/s"],
  ["16 signals", (signal) => /^[qv]\d/.test(signal.name)],
];

// Joins the parts of an answer.
function joined(parts) {
  const concat = (Kind, arrays) => {
    const all = new Kind(arrays.reduce((length, array) => length + array.length, 0));
    let at = 0;
    for (const array of arrays) {
      all.set(array, at);
      at += array.length;
    }
    return all;
  };
  return { ...parts[0], last: true, numbers: concat(Uint32Array, parts.map((part) => part.numbers)), spans: concat(Float32Array, parts.map((part) => part.spans)) };
}

export class Scope {
  constructor(link) {
    this.link = link;
    this.plot = new Plot($("scope"));
    this.chosen = [];
    this.windowMs = 10000;
    this.picture = 0;
    this.paused = false;
    this.live = new Columns(1, 0);
    this.clockMs = null;
    this.frames = 0;
    this.waiting = new Map();
    this.controls();
    this.pointer();
    this.triggers();
    link.on("robot", (robot) => robot && this.begin(robot));
    link.on("open", () => this.watch());
    link.on("columns", (columns) => this.take(columns));
    link.on("log", (lines) => this.mark(lines));
    link.on("status", (status) => this.dim(status));
    link.on("capture", (capture) => this.captured(capture));
    new ResizeObserver(() => this.resized()).observe($("scope").parentElement);
    requestAnimationFrame((now) => this.frame(now));
  }

  begin({ signals, axes }) {
    if (this.all) return;
    this.all = signals;
    this.presets = [...axes.map(({ name }, index) => [name, (signal) => signal.axis === index + 1]), ...PRESETS];
    $("scope-window").options = WINDOWS_S.map((seconds) => [seconds, `${seconds} s`]);
    $("scope-window").value = "10";
    $("scope-preset").options = [["", "own choice"], ...this.presets.map(([name], index) => [index, name])];
    $("trigger-signal").options = signals.map((signal, index) => [index, `${signal.label}, ${signal.unit}`]);
    $("trigger-signal").value = "0";
    signals.forEach((signal, index) => {
      const box = element("input", { type: "checkbox", value: index, on: { change: () => this.picked() } });
      $("scope-signals").append(element("label", {}, box, ` ${signal.label}`));
    });
    $("scope-preset").value = "0";
    this.preset(0);
  }

  preset(index) {
    const [, wanted] = this.presets[index];
    this.choose(this.all.map((signal, number) => (wanted(signal) ? number : -1)).filter((number) => number >= 0));
  }

  picked() {
    $("scope-preset").value = "";
    this.choose([...$("scope-signals").querySelectorAll("input:checked")].map((box) => Number(box.value)));
  }

  choose(numbers) {
    this.chosen = numbers;
    for (const box of $("scope-signals").querySelectorAll("input")) box.checked = numbers.includes(Number(box.value));
    this.plot.show(numbers.map((number) => this.all[number]));
    this.legend();
    if (this.paused) this.fetch();
    this.watch();
  }

  columnsWanted() {
    return Math.max(100, Math.min(1500, Math.floor(this.plot.screen.width || 800)));
  }

  resized() {
    clearTimeout(this.resizing);
    this.resizing = setTimeout(() => (this.paused ? this.fetch() : this.watch()), 150);
  }

  // Requests a new picture from its beginning.
  watch() {
    if (!this.all) return;
    this.picture += 1;
    // The plot stays until the new picture arrives, unless other signals were chosen.
    if (this.live.signals !== this.chosen.length) this.renew();
    this.link.send({ type: "watch", id: this.picture, signals: this.chosen, window_ms: this.windowMs, columns: this.columnsWanted() });
  }

  renew() {
    this.live = new Columns(this.columnsWanted() + 200, this.chosen.length);
    if (!this.paused) this.plot.columns = this.live;
  }

  take(columns) {
    const wanted = this.waiting.get(columns.id);
    if (wanted) {
      wanted.parts.push(columns);
      if (!columns.last) return;
      this.waiting.delete(columns.id);
      wanted.resolve(joined(wanted.parts));
    } else if (columns.id === this.picture) {
      if (columns.reset) this.renew();
      this.live.bucketMs = columns.bucketMs;
      this.live.add(columns.numbers, columns.spans);
      this.plot.dirty = true;
    }
  }

  // A part of the kept history, as columns; 0 columns for every millisecond.
  range(fromMs, toMs, columns) {
    this.picture += 1;
    const id = this.picture + 1e6;
    return new Promise((resolve) => {
      this.waiting.set(id, { resolve, parts: [] });
      this.link.send({ type: "range", id, signals: this.chosen, from_ms: Math.max(0, Math.floor(fromMs)), to_ms: Math.ceil(toMs), columns });
    });
  }

  async fetch() {
    const { fromMs, toMs } = this.plot;
    const got = await this.range(fromMs, toMs, this.columnsWanted());
    if (!this.paused || got.signals !== this.chosen.length) return;
    const kept = new Columns(Math.max(got.numbers.length, 1), this.chosen.length);
    kept.bucketMs = got.bucketMs;
    kept.add(got.numbers, got.spans);
    this.plot.columns = kept;
    this.plot.ranges.clear();
    this.plot.dirty = true;
  }

  pause(paused) {
    if (paused === this.paused) return;
    this.paused = paused;
    $("scope-pause").setAttribute("aria-pressed", String(paused));
    text($("scope-pause"), paused ? "Live" : "Pause");
    if (paused) {
      this.link.send({ type: "freeze" });
      this.home = [this.plot.fromMs, this.plot.toMs];
    } else {
      this.link.send({ type: "thaw" });
      this.plot.marks = this.plot.marks.filter((mark) => mark.tone !== "accent");
      this.plot.ranges.clear();
      this.watch();
    }
  }

  zoom(fromMs, toMs) {
    this.pause(true);
    const length = Math.min(60000, Math.max(5, toMs - fromMs));
    this.plot.fromMs = fromMs;
    this.plot.toMs = fromMs + length;
    this.plot.dirty = true;
    clearTimeout(this.zooming);
    this.zooming = setTimeout(() => this.fetch(), 60);
  }

  frame(now) {
    requestAnimationFrame((next) => this.frame(next));
    const elapsed = now - (this.framed ?? now);
    this.framed = now;
    if (!this.paused && this.live.count > 0) {
      const newest = this.live.timeMs(this.live.count - 1);
      // The axis moves with the wall clock and is drawn up to the newest data.
      this.clockMs = this.clockMs === null || Math.abs(newest - this.clockMs) > 1000 ? newest : this.clockMs + elapsed + (newest - this.clockMs - elapsed) * 0.08;
      this.plot.toMs = this.clockMs - DELAY_MS;
      this.plot.fromMs = this.plot.toMs - this.windowMs;
      this.plot.dirty = true;
    }
    if (this.plot.dirty) {
      this.plot.dirty = false;
      this.plot.draw();
      this.read();
      this.frames += 1;
    }
  }

  controls() {
    $("scope-pause").addEventListener("click", () => this.pause(!this.paused));
    $("scope-window").addEventListener("change", () => {
      this.windowMs = Number($("scope-window").value) * 1000;
      if (this.paused) this.zoom(this.plot.toMs - this.windowMs, this.plot.toMs);
      else this.watch();
    });
    $("scope-preset").addEventListener("change", () => $("scope-preset").value !== "" && this.preset(Number($("scope-preset").value)));
    $("scope-csv").addEventListener("click", () => this.csv());
    $("scope-png").addEventListener("click", () => this.png());
    document.addEventListener("click", (event) => {
      for (const open of document.querySelectorAll(".toolbar details[open]")) if (!open.contains(event.target)) open.open = false;
    });
  }

  pointer() {
    const canvas = $("scope");
    const time = (event) => this.plot.timeAt(event.clientX - canvas.getBoundingClientRect().left);
    let began = null;
    canvas.addEventListener("pointerdown", (event) => {
      began = [event.clientX, time(event)];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      this.plot.cursorMs = time(event);
      this.plot.selection = began && Math.abs(event.clientX - began[0]) > 4 ? [began[1], time(event)] : null;
      this.plot.dirty = true;
    });
    canvas.addEventListener("pointerup", () => {
      const { selection } = this.plot;
      began = null;
      this.plot.selection = null;
      if (selection) this.zoom(Math.min(...selection), Math.max(...selection));
    });
    canvas.addEventListener("pointerleave", () => {
      this.plot.cursorMs = null;
      this.plot.dirty = true;
    });
    canvas.addEventListener("dblclick", () => this.paused && this.home && this.zoom(...this.home));
    canvas.addEventListener("wheel", (event) => {
      if (!this.paused) return;
      event.preventDefault();
      const centre = time(event);
      const factor = event.deltaY > 0 ? 1.25 : 0.8;
      this.zoom(centre - (centre - this.plot.fromMs) * factor, centre + (this.plot.toMs - centre) * factor);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const length = this.plot.toMs - this.plot.fromMs;
      const centre = (this.plot.toMs + this.plot.fromMs) / 2;
      const views = { "+": [centre - length / 3, centre + length / 3], "-": [centre - length, centre + length], ArrowLeft: [this.plot.fromMs - length / 4, this.plot.toMs - length / 4], ArrowRight: [this.plot.fromMs + length / 4, this.plot.toMs + length / 4] };
      if (views[event.key] && this.paused && $("jog-keys").getAttribute("aria-pressed") !== "true") this.zoom(...views[event.key]);
    });
  }

  legend() {
    $("scope-legend").replaceChildren(...this.chosen.map((number, index) => {
      const swatch = element("canvas", { width: 44, height: 4 });
      const context = swatch.getContext("2d");
      context.strokeStyle = this.plot.colour(index);
      context.setLineDash(this.plot.dash(index).map((length) => length * 1.6));
      context.lineWidth = 4;
      context.moveTo(0, 2);
      context.lineTo(44, 2);
      context.stroke();
      return element("span", { className: "key" }, swatch, this.all[number].label, element("output"));
    }));
  }

  // For a drive that does not answer, the firmware reports expected values.
  dim(status) {
    [...$("scope-legend").children].forEach((entry, index) => {
      const slave = status?.slaves[this.all[this.chosen[index]].axis - 1];
      entry.classList.toggle("old", (slave?.silent_s ?? null) !== null);
    });
  }

  // Values at the cursor, or the newest ones.
  read() {
    const now = performance.now();
    if (now - (this.readAt ?? 0) < 100) return;
    this.readAt = now;
    const values = this.plot.readout(this.plot.cursorMs ?? this.plot.toMs);
    [...$("scope-legend").querySelectorAll("output")].forEach((output, index) => {
      const span = values[index];
      const unit = this.plot.signals[index]?.unit ?? "";
      const written = (value) => (unit === "rad" || unit === "rad/s" ? value.toFixed(5) : value.toFixed(2)).replace("-", "−");
      text(output, span ? `${written((span[0] + span[1]) / 2)} ${unit}` : "–");
    });
  }

  mark(lines) {
    for (const line of lines ?? []) if (line.level !== "info") this.plot.marks.push({ timeMs: line.time_ms, tone: line.level === "error" ? "bad" : "warn" });
    this.plot.marks = this.plot.marks.slice(-200);
  }

  triggers() {
    const state = (words) => text($("trigger-state"), words);
    this.armed = false;
    $("trigger-condition").addEventListener("change", () => {
      $("trigger-level").disabled = $("trigger-signal").disabled = $("trigger-condition").value === "fault";
    });
    $("trigger-arm").addEventListener("click", () => {
      if (this.armed) {
        this.link.send({ type: "disarm" });
        return;
      }
      this.pause(false);
      const value = (id) => Number($(id).value);
      this.link.send({ type: "arm", signal: value("trigger-signal"), condition: $("trigger-condition").value, level: value("trigger-level"), before_ms: Math.max(0, Math.round(value("trigger-before"))), after_ms: Math.max(0, Math.round(value("trigger-after"))) });
    });
    state("off");
    // The console forgets the trigger of a page that has gone.
    this.link.on("closed", () => this.captured({ state: "idle" }));
  }

  captured(capture) {
    if (!capture) return;
    const words = { armed: "armed, waiting", fired: "fired, recording", caught: "caught", idle: "off" };
    text($("trigger-state"), words[capture.state] ?? capture.state);
    this.armed = capture.state === "armed" || capture.state === "fired";
    text($("trigger-arm"), this.armed ? "Disarm" : "Arm");
    if (capture.state !== "caught") return;
    // A capture is already kept: freezing would replace it.
    this.paused = true;
    $("scope-pause").setAttribute("aria-pressed", "true");
    text($("scope-pause"), "Live");
    this.home = [capture.from_ms, capture.to_ms];
    this.plot.marks.push({ timeMs: capture.event_ms, tone: "accent" });
    this.zoom(capture.from_ms, capture.to_ms);
    toast(`Capture: the event was at ${(capture.event_ms / 1000).toFixed(3)} s`, "good");
  }

  async csv() {
    const { fromMs, toMs } = this.plot;
    const got = await this.range(fromMs, toMs, 0);
    const names = this.chosen.map((number) => this.all[number].name);
    const lines = [["t_ms", ...names].join(",")];
    for (let row = 0; row < got.numbers.length; row += 1) {
      const values = names.map((_, signal) => got.spans[(row * got.signals + signal) * 2]);
      lines.push([got.numbers[row], ...values.map((value) => (Number.isFinite(value) ? value : ""))].join(","));
    }
    this.exported = lines.length - 1;
    save("etherpen-signals.csv", new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }));
  }

  png() {
    const source = $("scope");
    const { ratio, colours, width } = this.plot.screen;
    const lineHeight = 18;
    const perRow = Math.max(1, Math.floor(width / 220));
    const rows = Math.ceil(this.chosen.length / perRow);
    const picture = element("canvas", { width: source.width, height: source.height + Math.ceil(rows * lineHeight * ratio) + 8 });
    const context = picture.getContext("2d");
    context.fillStyle = colours.card;
    context.fillRect(0, 0, picture.width, picture.height);
    context.drawImage(source, 0, 0);
    context.setTransform(ratio, 0, 0, ratio, 0, source.height);
    context.font = "12px system-ui, sans-serif";
    this.chosen.forEach((number, index) => {
      const [x, y] = [16 + (index % perRow) * 220, 10 + Math.floor(index / perRow) * lineHeight];
      context.strokeStyle = this.plot.colour(index);
      context.lineWidth = 2;
      context.setLineDash(this.plot.dash(index));
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x + 26, y);
      context.stroke();
      context.fillStyle = colours.ink;
      context.fillText(this.all[number].label, x + 32, y + 4);
    });
    picture.toBlob((blob) => blob && save("etherpen-signals.png", blob), "image/png");
  }
}
