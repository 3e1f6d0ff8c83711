// Drives and bus, faults of a virtual segment, counters, log and what the firmware measures of itself.

import { $, element, text, toast } from "./dom.js";

const FAULTS = [["fault", "drive fault"], ["retreat", "SAFEOP"], ["power", "power dip"], ["stuck", "frozen resolver"]];
const WIRE = [["lose", "Lose a frame"], ["stall", "Stall 50 ms"], ["restart", "Restart the firmware"]];

export function drives(link) {
  slaves(link);
  log(link);
  timing(link);
}

// Damaged frames and lost links as the slave's controller counts them; all counts in the tip.
function lineErrors(line) {
  if (!line) return element("td", { className: "empty" }, "–");
  const counts = [[line.invalid_frames, "CRC"], [line.receive_errors, "RX"], [line.lost_links, "lost links"], [line.watchdog, "watchdog"]];
  const told = counts.filter(([count]) => count > 0).map(([count, name]) => `${count} ${name}`);
  return element("td", { title: line.text, data: { lineErrors: line.number } }, told.join(", ") || "none");
}

function slaves(link) {
  const inject = (what, slave) => link.send({ type: "inject", fault: slave === undefined ? { what } : { what, slave } });
  const injectors = (number, removed) => {
    const plug = removed ? ["insert", "plug in"] : ["remove", "unplug"];
    return [plug, ...FAULTS].map(([what, name]) => element("button", { type: "button", className: "quiet", disabled: !link.controls, data: { inject: `${what}-${number}` }, on: { click: () => inject(what, number) } }, name));
  };
  let before = "";
  const show = () => {
    const { status, segment, control, you, line_errors: counted } = link.state;
    const key = JSON.stringify([status?.slaves, segment, counted, control?.holder, you?.id, link.open]);
    if (key === before) return;
    before = key;
    document.body.classList.toggle("is-virtual", Boolean(segment?.kind));
    const removed = segment?.removed ?? [];
    const seen = status?.slaves ?? [];
    const rows = seen.map((slave) => {
      const tone = slave.operational && !slave.fault ? "good" : "bad";
      const drive = `${slave.drive}${slave.voltage ? "" : ", no supply"}${slave.warning ? ", warning" : ""}`;
      return element("tr", { data: { tone } }, element("th", { scope: "row" }, String(slave.number)), element("td", { className: "state" }, slave.state), element("td", {}, drive), element("td", { className: "mono" }, slave.status_word), element("td", { className: "mono" }, slave.product), element("td", { title: slave.hint }, slave.error || "none"), lineErrors(counted?.find((line) => line.number === slave.number)), element("td", { className: "virtual" }, ...injectors(slave.number, removed.includes(slave.number))));
    });
    for (const number of removed.filter((number) => !seen.some((slave) => slave.number === number))) {
      rows.push(element("tr", { data: { tone: "bad" } }, element("th", { scope: "row" }, String(number)), element("td", { colSpan: 6 }, "unplugged"), element("td", { className: "virtual" }, ...injectors(number, true))));
    }
    $("slaves").replaceChildren(...(rows.length ? rows : [element("tr", {}, element("td", { colSpan: 8, className: "empty" }, "no slaves known"))]));
    $("segment").replaceChildren(element("span", {}, `${segment?.kind ?? ""} segment, no hardware:`), ...WIRE.map(([what, name]) => element("button", { type: "button", className: "quiet", disabled: !link.controls, data: { inject: what }, on: { click: () => inject(what) } }, name)));
  };
  for (const name of ["status", "segment", "control", "you", "line_errors", "closed"]) link.on(name, show);
  link.on("status", (status) => {
    const entries = status?.counters ?? [];
    if ($("counters").childElementCount !== entries.length) $("counters").replaceChildren(...entries.map(([name]) => element("div", {}, element("dt", {}, name), element("dd"))));
    [...$("counters").querySelectorAll("dd")].forEach((cell, index) => text(cell, String(entries[index][1])));
  });
}

function log(link) {
  const box = $("log");
  link.on("log", (lines) => {
    if (!lines) return;
    const below = box.scrollHeight - box.scrollTop - box.clientHeight < 30;
    const marks = { info: "·", warning: "▲", error: "■" };
    for (const line of lines) {
      box.append(element("li", { data: { level: line.level } }, element("time", {}, `${(line.time_ms / 1000).toFixed(3)} s`), element("span", { className: "mark", ariaHidden: "true" }, marks[line.level]), element("span", {}, line.text)));
      // Faults have a place of their own.
      if (line.level === "warning" && line.number > (log.last ?? Infinity)) toast(line.text);
      log.last = line.number;
    }
    while (box.childElementCount > 500) box.firstElementChild.remove();
    if (below) box.scrollTop = box.scrollHeight;
    log.last ??= -1;
  });
  link.on("open", () => {
    box.replaceChildren();
    log.last = undefined;
  });
  link.on("refused", (why) => why && toast(why));
}

function timing(link) {
  $("measure").addEventListener("click", () => link.send({ type: "measure" }));
  $("measure-reset").addEventListener("click", () => link.send({ type: "measure", reset: true }));
  for (const name of ["control", "you", "open", "closed"]) link.on(name, () => ($("measure").disabled = $("measure-reset").disabled = !link.controls));
  link.on("measured", (measured) => {
    if (!measured) return;
    if (!measured.quantities.length) {
      $("timing").replaceChildren(element("p", { className: "empty" }, measured.text));
      return;
    }
    const charts = measured.quantities.map(histogram);
    if (measured.cpu_load !== null) charts.unshift(element("p", { className: "load" }, `The core is awake ${(measured.cpu_load * 100).toFixed(1)} % of the time.`));
    $("timing").replaceChildren(...charts);
  });
}

const SVG = "http://www.w3.org/2000/svg";

// Bars over a logarithmic count axis: rare values are what matters.
function histogram({ name, bins, p50_us: median, p999_us: rare, max_us: most, count }) {
  const [width, height] = [240, 64];
  const [low, high] = [bins[0].from_us, bins[bins.length - 1].to_us];
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `${name}: median ${median.toFixed(2)}, largest ${most.toFixed(2)} microseconds`);
  const tallest = Math.log10(1 + Math.max(...bins.map((bin) => bin.count)));
  const x = (us) => ((us - low) / Math.max(high - low, 1e-9)) * width;
  for (const bin of bins) {
    const bar = document.createElementNS(SVG, "rect");
    const tall = (Math.log10(1 + bin.count) / tallest) * (height - 4);
    const place = { x: x(bin.from_us), y: height - tall, width: Math.max(1.5, x(bin.to_us) - x(bin.from_us) - 0.5), height: tall, rx: 1 };
    for (const [key, value] of Object.entries(place)) bar.setAttribute(key, value.toFixed(2));
    svg.append(bar);
  }
  const us = (value) => (value < 10 ? value.toFixed(2) : value.toFixed(1));
  return element("figure", { className: "histogram" }, element("figcaption", {}, element("b", {}, name), ` ${count} values`), svg, element("div", { className: "ends" }, element("span", {}, us(low)), element("span", {}, `median ${us(median)} · 99.9 % ${us(rare)} · max ${us(most)} µs`), element("span", {}, us(high))));
}
