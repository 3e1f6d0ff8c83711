// A plot of many signals over one time axis: one lane per unit, each column from its smallest to its largest value.

import { Canvas } from "./dom.js";

const LEFT = 62;
const RIGHT = 12;
const TOP = 8;
const BOTTOM = 24;
const GAP = 10;
// Maximum number of letters of a tick's text beside the plot.
const TICK_LETTERS = 9;
const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];

// A bounded number of columns in the order of time.
export class Columns {
  constructor(capacity, signals) {
    this.capacity = capacity;
    this.signals = signals;
    this.bucketMs = 1;
    this.clear();
  }

  clear() {
    this.numbers = new Float64Array(this.capacity);
    this.spans = new Float32Array(this.capacity * this.signals * 2);
    this.head = 0;
    this.count = 0;
  }

  add(numbers, spans) {
    const width = this.signals * 2;
    for (let column = 0; column < numbers.length; column += 1) {
      const place = (this.head + this.count) % this.capacity;
      this.numbers[place] = numbers[column];
      this.spans.set(spans.subarray(column * width, (column + 1) * width), place * width);
      if (this.count < this.capacity) this.count += 1;
      else this.head = (this.head + 1) % this.capacity;
    }
  }

  place(column) {
    return (this.head + column) % this.capacity;
  }

  timeMs(column) {
    return this.numbers[this.place(column)] * this.bucketMs;
  }

  low(column, signal) {
    return this.spans[(this.place(column) * this.signals + signal) * 2];
  }

  high(column, signal) {
    return this.spans[(this.place(column) * this.signals + signal) * 2 + 1];
  }

  // The first column at or after a time.
  find(timeMs) {
    let [low, high] = [0, this.count];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.timeMs(middle) < timeMs) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}

// Round numbers between two values, about `wanted` of them.
export function ticks(low, high, wanted) {
  const rough = (high - low) / Math.max(wanted, 1);
  if (!(rough > 0) || !Number.isFinite(rough)) return [];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((factor) => factor * power >= rough) * power;
  const first = Math.ceil(low / step);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, index) => (first + index) * step);
}

// Texts of ticks at a given distance: no two alike, none wider than the margin. If the values differ in their last
// digits only, the texts are the differences from a base, which is shown once.
export function tickTexts(marks, step) {
  const written = (value, digits) => value.toFixed(digits).replace("-", "−");
  const largest = Math.max(...marks.map(Math.abs), step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const whole = Math.max(1, Math.floor(Math.log10(largest) + 1e-9) + 1);
  if (digits <= 6 && whole + digits <= TICK_LETTERS - 2) return { base: "", texts: marks.map((value) => written(value, digits)) };
  const power = 10 ** Math.floor(Math.log10(step) + 1e-9);
  const count = (value) => Math.round(value / power);
  const units = `e${Math.round(Math.log10(power))}`.replace("-", "−");
  const small = marks.every((value) => Math.abs(count(value)) < 1000);
  const base = small ? 0 : marks[0];
  const texts = marks.map((value) => (count(value - base) === 0 ? "0" : `${small ? "" : "+"}${String(count(value - base)).replace("-", "−")}${units}`));
  return { base: small ? "" : String(Number(base.toPrecision(9))).replace("-", "−"), texts };
}

export class Plot {
  constructor(canvas) {
    this.screen = new Canvas(canvas, () => (this.dirty = true));
    this.signals = [];
    this.columns = new Columns(1, 0);
    this.fromMs = 0;
    this.toMs = 1;
    this.marks = [];
    this.cursorMs = null;
    this.selection = null;
    this.ranges = new Map();
    this.dirty = true;
  }

  show(signals) {
    this.signals = signals;
    const lanes = new Map();
    signals.forEach((signal, index) => {
      const key = signal.name.startsWith("e") ? `${signal.unit} error` : signal.unit;
      if (!lanes.has(key)) lanes.set(key, { key, unit: signal.unit, error: key !== signal.unit, members: [] });
      lanes.get(key).members.push(index);
    });
    this.lanes = [...lanes.values()];
    this.ranges.clear();
    this.dirty = true;
  }

  colour(index) {
    return this.screen.colours.series[index % 8];
  }

  dash(index) {
    return DASHES[Math.floor(index / 8) % DASHES.length];
  }

  x(timeMs) {
    return LEFT + ((timeMs - this.fromMs) / (this.toMs - this.fromMs)) * (this.screen.width - LEFT - RIGHT);
  }

  timeAt(x) {
    return this.fromMs + ((x - LEFT) / (this.screen.width - LEFT - RIGHT)) * (this.toMs - this.fromMs);
  }

  // Smallest and largest visible value of a lane; the range grows at once and shrinks slowly.
  range(lane, from, to) {
    let [low, high] = [Infinity, -Infinity];
    for (let column = from; column < to; column += 1) {
      for (const signal of lane.members) {
        const [least, most] = [this.columns.low(column, signal), this.columns.high(column, signal)];
        if (least < low) low = least;
        if (most > high) high = most;
      }
    }
    if (low > high) [low, high] = [-1, 1];
    // A constant value gets a scale of its own magnitude; single precision resolves no more than this.
    const flat = high - low <= Math.abs(high) * 1e-6;
    const room = flat ? Math.max(Math.abs(high) * 0.06, 1.3e-3) : (high - low) * 0.08;
    [low, high] = [low - room, high + room];
    const before = this.ranges.get(lane.key);
    if (before) {
      low = Math.min(low, before[0] + (low - before[0]) * 0.05);
      high = Math.max(high, before[1] + (high - before[1]) * 0.05);
    }
    this.ranges.set(lane.key, [low, high]);
    return [low, high];
  }

  draw() {
    const { context, colours, width, height } = this.screen;
    this.screen.clear();
    if (width < 40 || !this.lanes?.length) return;
    const from = Math.max(0, this.columns.find(this.fromMs) - 1);
    const to = Math.min(this.columns.count, this.columns.find(this.toMs) + 1);
    const laneHeight = (height - TOP - BOTTOM - GAP * (this.lanes.length - 1)) / this.lanes.length;
    context.font = "11px system-ui, sans-serif";
    this.drawTimes(context, colours, height);
    this.lanes.forEach((lane, index) => {
      const top = TOP + index * (laneHeight + GAP);
      const [low, high] = this.range(lane, from, to);
      const y = (value) => top + laneHeight - ((value - low) / (high - low)) * laneHeight;
      this.drawLane(context, colours, lane, top, laneHeight, low, high, y);
      context.save();
      context.beginPath();
      context.rect(LEFT, top, width - LEFT - RIGHT, laneHeight);
      context.clip();
      for (const signal of lane.members) this.drawSignal(context, signal, from, to, y);
      context.restore();
    });
    this.drawMarks(context, colours, height);
  }

  drawTimes(context, colours, height) {
    context.textAlign = "center";
    context.textBaseline = "alphabetic";
    const wanted = Math.max(2, Math.floor(this.screen.width / 110));
    for (const seconds of ticks(this.fromMs / 1000, this.toMs / 1000, wanted)) {
      const x = Math.round(this.x(seconds * 1000)) + 0.5;
      context.strokeStyle = colours.line;
      context.beginPath();
      context.moveTo(x, TOP);
      context.lineTo(x, height - BOTTOM);
      context.stroke();
      context.fillStyle = colours.soft;
      context.fillText(`${Number(seconds.toFixed(4))} s`, x, height - 8);
    }
  }

  drawLane(context, colours, lane, top, laneHeight, low, high, y) {
    const right = this.screen.width - RIGHT;
    context.strokeStyle = colours.line;
    context.strokeRect(LEFT + 0.5, Math.round(top) + 0.5, right - LEFT, Math.round(laneHeight));
    context.textAlign = "right";
    context.textBaseline = "middle";
    const marks = ticks(low, high, Math.max(2, laneHeight / 34));
    const step = marks.length > 1 ? marks[1] - marks[0] : high - low;
    const { base, texts } = tickTexts(marks, step);
    marks.forEach((value, index) => {
      context.strokeStyle = colours.line;
      context.beginPath();
      context.moveTo(LEFT, Math.round(y(value)) + 0.5);
      context.lineTo(right, Math.round(y(value)) + 0.5);
      context.stroke();
      context.fillStyle = colours.soft;
      context.fillText(texts[index], LEFT - 6, y(value));
    });
    context.save();
    context.translate(10, top + laneHeight / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillStyle = colours.ink;
    context.fillText(lane.error ? `error, ${lane.unit}` : lane.unit, 0, 0);
    context.restore();
    if (!base) return;
    context.textAlign = "left";
    context.fillText(`${base} + …`, LEFT + 6, top + 10);
  }

  drawSignal(context, signal, from, to, y) {
    context.strokeStyle = this.colour(signal);
    context.setLineDash(this.dash(signal));
    context.lineWidth = 1.4;
    context.lineJoin = "round";
    context.beginPath();
    let [pen, before] = [false, 0];
    for (let column = from; column < to; column += 1) {
      const [low, high] = [this.columns.low(column, signal), this.columns.high(column, signal)];
      const time = this.columns.timeMs(column);
      if (!(low <= high)) {
        pen = false;
        continue;
      }
      const x = this.x(time);
      // A gap in the telemetry stays a gap.
      if (pen && time - before > 3 * this.columns.bucketMs) pen = false;
      if (pen) context.lineTo(x, y(low));
      else context.moveTo(x, y(low));
      if (high > low) context.lineTo(x, y(high));
      [pen, before] = [true, time];
    }
    context.stroke();
    context.setLineDash([]);
  }

  drawMarks(context, colours, height) {
    const vertical = (timeMs, colour, dash) => {
      if (timeMs < this.fromMs || timeMs > this.toMs) return;
      const x = Math.round(this.x(timeMs)) + 0.5;
      context.setLineDash(dash);
      context.strokeStyle = colour;
      context.beginPath();
      context.moveTo(x, TOP);
      context.lineTo(x, height - BOTTOM);
      context.stroke();
      context.setLineDash([]);
    };
    for (const { timeMs, tone } of this.marks) vertical(timeMs, colours[tone] ?? colours.soft, [2, 4]);
    if (this.cursorMs !== null) vertical(this.cursorMs, colours.ink, []);
    if (this.selection) {
      const [a, b] = this.selection.map((timeMs) => this.x(timeMs));
      context.globalAlpha = 0.14;
      context.fillStyle = colours.accent;
      context.fillRect(Math.min(a, b), TOP, Math.abs(b - a), height - TOP - BOTTOM);
      context.globalAlpha = 1;
    }
  }

  // Smallest and largest value of each signal at a time; null if there is none.
  readout(timeMs) {
    const column = this.columns.find(timeMs);
    const near = column < this.columns.count ? column : this.columns.count - 1;
    // In a gap there is no value; after the newest column it is the newest value.
    const inHole = column > 0 && column < this.columns.count && this.columns.timeMs(near) - timeMs > 3 * this.columns.bucketMs;
    if (near < 0 || inHole) return this.signals.map(() => null);
    return this.signals.map((_, signal) => {
      const [low, high] = [this.columns.low(near, signal), this.columns.high(near, signal)];
      return low <= high ? [low, high] : null;
    });
  }
}
