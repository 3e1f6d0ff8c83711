// Drives and bus, faults of a virtual segment, counters, log and the firmware's own measurements.

import { $, duration, element, keyed, set, text, toast } from "./dom.js";

const FAULTS = [["fault", "drive fault"], ["retreat", "SAFEOP"], ["power", "power dip"], ["stuck", "frozen resolver"]];
const WIRE = [["lose", "Lose a frame"], ["stall", "Stall 50 ms"], ["restart", "Restart the firmware"]];

export function drives(link) {
  slaves(link);
  log(link);
  timing(link);
}

// Damaged frames and lost links as counted by the slave's controller; all counts in the tooltip.
function lineErrors(line) {
  if (!line) return "–";
  const counts = [[line.invalid_frames, "CRC"], [line.receive_errors, "RX"], [line.lost_links, "lost links"], [line.watchdog, "watchdog"]];
  const told = counts.filter(([count]) => count > 0).map(([count, name]) => `${count} ${name}`);
  return told.join(", ") || "none";
}

function slaves(link) {
  const inject = (what, slave) => link.send({ type: "inject", fault: slave === undefined ? { what } : { what, slave } });
  const injector = (what, name, slave) => element("button", { type: "button", className: "quiet", data: { inject: slave === undefined ? what : `${what}-${slave}` }, on: { click: () => inject(what, slave) } }, name);

  const row = ({ number }) => {
    const names = ["state", "drive", "mono", "mono", "error", "line"];
    const cells = names.map((className) => element("td", { className }));
    const [state, drive, word, product, error, line] = cells;
    line.dataset.lineErrors = String(number);
    const plugs = [injector("remove", "unplug", number), injector("insert", "plug in", number)];
    const buttons = [...plugs, ...FAULTS.map(([what, name]) => injector(what, name, number))];
    const made = element("tr", {}, element("th", { scope: "row" }, String(number)), ...cells, element("td", { className: "virtual" }, ...buttons));
    const show = ({ slave, removed, counted }) => {
      const silent = !slave || slave.silent_s !== null;
      made.classList.toggle("old", silent);
      made.dataset.tone = slave?.operational && !slave.fault ? "good" : "bad";
      const since = slave?.silent_s ? ` since ${duration(slave.silent_s)}` : "";
      text(state, slave ? `${slave.state}${silent ? since : ""}` : "unplugged");
      text(drive, slave ? `${slave.drive}${slave.voltage ? "" : ", no supply"}${slave.warning ? ", warning" : ""}` : "–");
      text(word, slave?.status_word ?? "–");
      text(product, slave?.product ?? "–");
      text(error, slave ? slave.error || "none" : "–");
      set(error, { title: slave?.hint ?? "" });
      text(line, lineErrors(counted));
      set(line, { title: counted?.text ?? "" });
      for (const cell of [drive, word, error, line]) set(cell, { ariaLabel: silent ? `last known: ${cell.textContent}` : null });
      set(plugs[0], { hidden: removed });
      set(plugs[1], { hidden: !removed });
      for (const button of buttons) set(button, { disabled: !link.controls });
    };
    return [made, show];
  };
  const none = () => [element("tr", {}, element("td", { colSpan: 8, className: "empty" }, "no slaves known"))];

  const kind = element("span");
  const wire = WIRE.map(([what, name]) => injector(what, name));
  $("segment").append(kind, ...wire);

  const back = $("bring-back");
  back.addEventListener("click", () => link.command({ do: "acknowledge" }));
  const show = () => {
    const { status, segment, line_errors: counts } = link.state;
    document.body.classList.toggle("is-virtual", Boolean(segment?.kind));
    text(kind, `${segment?.kind ?? ""} segment, no hardware:`);
    for (const button of wire) set(button, { disabled: !link.controls });
    const removed = segment?.removed ?? [];
    const seen = status?.slaves ?? [];
    const numbers = [...new Set([...seen.map((slave) => slave.number), ...removed])].sort((a, b) => a - b);
    const rows = numbers.map((number) => ({ number, removed: removed.includes(number), slave: seen.find((slave) => slave.number === number), counted: counts?.find((line) => line.number === number) }));
    keyed($("slaves"), rows.length ? rows : [null], (item) => item?.number ?? "none", (item) => (item ? row(item) : none()));
    keyed($("counters"), status?.counters ?? [], ([name]) => name, ([name]) => {
      const value = element("dd");
      return [element("div", {}, element("dt", {}, name), value), ([, count]) => text(value, String(count))];
    });
    keyed($("io"), status?.io ?? [], ({ name }) => name, ({ name, is_output, role }) => {
      const value = element("dd");
      const label = `${name} (${is_output ? "output" : "input"}${role === "none" ? "" : `, ${role.replace("_", " ")}`})`;
      return [element("div", {}, element("dt", {}, label), value), (point) => text(value, point.value === null ? "missing" : String(point.value))];
    });
    // Without a fault; the acknowledgement of a fault brings them back too.
    set(back, { hidden: !link.allows("acknowledge") || Boolean(status?.fault), disabled: !link.controls });
  };
  for (const name of ["status", "segment", "control", "you", "line_errors", "closed"]) link.on(name, show);
  show();
}

function log(link) {
  const box = $("log");
  let last = null;
  link.on("log", (lines) => {
    if (!lines) return;
    const below = box.scrollHeight - box.scrollTop - box.clientHeight < 30;
    const marks = { info: "·", warning: "▲", error: "■" };
    for (const line of lines) {
      box.append(element("li", { data: { level: line.level } }, element("time", {}, `${(line.time_ms / 1000).toFixed(3)} s`), element("span", { className: "mark", ariaHidden: "true" }, marks[line.level]), element("span", {}, line.text)));
      // Faults have a place of their own; messages from before this page was opened are not news.
      if (line.level === "warning" && last !== null) tell(line.text);
    }
    while (box.childElementCount > 500) box.firstElementChild.remove();
    if (below) box.scrollTop = box.scrollHeight;
    last = lines.at(-1)?.number ?? last ?? -1;
  });
  link.on("open", () => {
    box.replaceChildren();
    last = null;
  });
  const tell = (words) => {
    toast(words);
    if ($("fault").hidden) return;
    text($("fault-note"), words);
    $("fault-note").hidden = false;
  };
  link.on("refused", (why) => why && tell(why));
  link.on("status", (status) => {
    if (!status?.fault) $("fault-note").hidden = true;
  });
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

// Bars over a logarithmic count axis: the rare values matter.
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
