// Banner, stop, buttons, jog and positions: the operator's controls.
//
// The firmware's mode determines what may be pressed; its state shows what happened.

import { axes } from "./axes.js";
import { $, duration, element, number, set, text } from "./dom.js";
import { layerText } from "./jobs.js";

const JOG_MS = 40;
const TONES = { Idle: "good", Drawing: "good", Homing: "good", Moving: "good", Holding: "warn", Unreferenced: "warn", DrivesOff: "plain", Stopping: "warn", Fault: "bad", Startup: "wait", BusConfiguring: "wait" };
const NAMES = { BusConfiguring: "Bus", DrivesOff: "Drives off" };

export function operate(link) {
  banner(link);
  stop(link);
  control(link);
  buttons(link);
  override(link);
  axes(link, jog(link));
  sheet(link);
  positions(link);
}

function banner(link) {
  const show = () => {
    const { status, link: connection } = link.state;
    let [tone, mode, words] = ["wait", "No connection", "trying to reach the console again"];
    if (link.open && connection && connection.state !== "connected") {
      [tone, mode, words] = [connection.state === "lost" ? "bad" : "wait", "No firmware", connection.text];
    } else if (link.open && status) {
      [tone, mode, words] = [TONES[status.mode] ?? "wait", NAMES[status.mode] ?? status.mode, about(link, status)];
    } else if (link.open) {
      [mode, words] = ["Connecting", "waiting for the firmware's state"];
    }
    $("banner").dataset.tone = tone;
    text($("mode"), mode);
    text($("mode-text"), words);
    document.title = `${mode} · etherpen`;
    const lost = connection?.samples_missing ? `, ${connection.samples_missing} samples lost` : "";
    chip("chip-link", link.open && connection?.state === "connected" ? "good" : "bad", connection ? `${connection.firmware || "no firmware"}${lost}` : "no console");
    chip("chip-bus", status?.bus.good ? "good" : status ? "warn" : "wait", status?.bus.text ?? "bus unknown");
    $("fault").hidden = !status?.fault;
    text($("fault-text"), status?.fault ?? "");
  };
  for (const name of ["open", "closed", "link", "status", "progress", "jobs"]) link.on(name, show);
  show();
}

// The mode in words; for a drawing, its name and remaining time, or the layer that waits for its pen.
function about(link, status) {
  const { jobs, progress } = link.state;
  if (jobs?.pause && ["DrivesOff", "Idle"].includes(status.mode)) return `${status.text}; change the pen for ${layerText(jobs.pause)}`;
  if (!["Drawing", "Holding"].includes(status.mode) || !jobs?.active) return status.text;
  const left = progress?.job === jobs.active.number ? `, ${duration(progress.left_s)} left` : "";
  return `${jobs.active.name}${left}`;
}

function chip(id, tone, words) {
  $(id).dataset.tone = tone;
  text($(id).lastElementChild, words);
}

// The effect of STOP; `stop.js` handles the press itself before anything else.
function stop(link) {
  const show = () => {
    const { status } = link.state;
    const { asked, taken, refused } = link.stopping;
    let words = matchMedia("(max-width: 860px), (pointer: coarse)").matches ? "stops at once" : "Esc";
    if (refused) words = refused;
    else if (asked && status?.mode === "Stopping") words = "the firmware is stopping";
    else if (asked) words = taken || link.open ? "sent, not confirmed" : "will be sent first";
    else if (status?.stopped) words = "confirmed by the firmware";
    text($("stop-text"), words);
    $("stop").dataset.state = asked ? "asked" : status?.stopped ? "stopped" : "ready";
  };
  for (const name of ["stopping", "status", "open", "closed"]) link.on(name, show);
  show();
}

function control(link) {
  const show = () => {
    const { control: held, you } = link.state;
    const viewers = held?.viewers ?? 0;
    const who = link.controls ? "you have control" : held?.holder ? `viewer ${held.holder} has control` : "control is free";
    text($("chip-view").lastElementChild, link.open ? `${who} · ${viewers} viewer${viewers === 1 ? "" : "s"}` : "not connected");
    $("chip-view").dataset.tone = link.controls ? "good" : "plain";
    text($("control"), link.controls ? "Release" : held?.holder ? "Take over" : "Take control");
    $("control").disabled = !link.open || !you?.may_command;
    $("control").title = you && !you.may_command ? "open the address that the console has printed, with its token" : "";
    document.body.classList.toggle("commanding", link.controls);
  };
  $("control").addEventListener("click", () => link.send(link.controls ? { type: "release" } : { type: "take", force: Boolean(link.state.control?.holder) }));
  for (const name of ["control", "you", "open", "closed"]) link.on(name, show);
  show();
}

function buttons(link) {
  const press = (id, action) => $(id).addEventListener("click", () => link.command(typeof action === "function" ? action() : action));
  press("enable", () => ({ do: link.allows("disable") ? "disable" : "enable" }));
  press("reference", { do: "reference" });
  press("hold", { do: "hold" });
  press("resume", { do: "resume" });
  press("cancel", { do: "cancel" });
  press("pen-up", { do: "pen", down: false });
  press("pen-down", { do: "pen", down: true });
  press("acknowledge", { do: "acknowledge" });
  const show = () => {
    const may = (name) => link.controls && link.allows(name);
    const drawing = Boolean(link.state.jobs?.active);
    const active = drawing && !link.state.jobs.pause;
    $("enable").disabled = !may("enable") && !may("disable");
    text($("enable"), link.allows("disable") ? "Disable" : "Enable");
    $("enable").classList.toggle("primary", !link.allows("disable"));
    $("reference").disabled = !may("reference") || active;
    $("reference").classList.toggle("primary", link.state.status?.referenced === false);
    const encoders = link.state.status?.encoders ?? [];
    const shown = ({ axis, increments }) => `${axis}: ${increments === null ? "no position" : increments.toLocaleString("en").replace("-", "−")}`.replaceAll(" ", "\u00a0");
    set($("encoders"), { hidden: !encoders.length, textContent: `Not homed. Encoders, increments: ${encoders.map(shown).join(" · ")}` });
    $("hold").disabled = !may("hold");
    $("resume").disabled = !may("resume");
    $("cancel").disabled = !(link.controls && (link.allows("cancel") || drawing));
    $("pen-up").disabled = $("pen-down").disabled = !may("pen") || active;
    $("acknowledge").disabled = !may("acknowledge");
    $("override").disabled = !may("override");
    for (const button of $("jog").querySelectorAll("[data-jog]")) button.disabled = !may("jog");
  };
  for (const name of ["status", "control", "you", "jobs", "open", "closed"]) link.on(name, show);
  show();
  const keys = { h: () => $(link.allows("resume") ? "resume" : "hold"), e: () => $("enable"), r: () => $("reference"), u: () => $("pen-up"), d: () => $("pen-down"), j: () => $("jog-keys"), p: () => $("scope-pause"), t: () => $("control"), "?": () => $("help") };
  addEventListener("keydown", (event) => {
    const typing = event.target.matches?.("input:not([type=range]), textarea, choice-list *");
    if (typing || event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    keys[event.key.toLowerCase()]?.()?.click();
  });
}

function override(link) {
  let timer = 0;
  $("override").addEventListener("input", () => {
    text($("override-value"), `${$("override").value} %`);
    clearTimeout(timer);
    timer = setTimeout(() => {
      timer = 0;
      link.command({ do: "override", percent: Number($("override").value) });
    }, 120);
  });
  link.on("status", (status) => {
    if (!status || timer || document.activeElement === $("override") && link.controls && $("override").matches(":active")) return;
    $("override").value = status.override_percent;
    text($("override-value"), `${status.override_percent} %`);
  });
}

// The robot moves only while something is pressed: the message is repeated, and every way of releasing ends it. After a stop,
// and after everything else that forbids jogs, a key has to be pressed anew. A key is known by its place on the keyboard: which
// letter it is changes with Shift and NumLock while it is held. Returns what makes a button move an axis alone while it is
// pressed.
function jog(link) {
  const pressed = new Map();
  let timer = 0;
  let presses = 0;
  const velocity = () => {
    const speed = Number($("jog-speed").value);
    const sum = [0, 0, 0];
    for (const direction of pressed.values()) direction.forEach((part, axis) => (sum[axis] += part * speed));
    return sum;
  };
  const send = () => {
    const alone = [...pressed.values()].find((wanted) => !Array.isArray(wanted));
    link.send(alone ? { type: "jog_axis", ...alone } : { type: "jog", velocity_mm_s: velocity() });
  };
  const press = (key, wanted) => {
    if (!link.controls || !link.allows("jog") || link.stopping.asked) return;
    // One axis moves alone: what else is held has to be pressed anew.
    const isAlone = (held) => !Array.isArray(held);
    for (const [other, held] of pressed) if (isAlone(held) || isAlone(wanted)) pressed.delete(other);
    presses += 1;
    pressed.set(key, isAlone(wanted) ? { ...wanted, press: presses } : wanted);
    send();
    timer ||= setInterval(send, JOG_MS);
  };
  const release = (key) => {
    if (!pressed.delete(key) || pressed.size > 0) return;
    clearInterval(timer);
    timer = 0;
    send();
  };
  const releaseAll = () => [...pressed.keys()].forEach(release);
  const hold = (button, wanted) => {
    button.addEventListener("pointerdown", (event) => {
      button.setPointerCapture(event.pointerId);
      press(button, wanted);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture", "contextmenu"]) button.addEventListener(name, () => release(button));
    button.addEventListener("keydown", (event) => {
      if (!event.repeat && (event.key === " " || event.key === "Enter")) press(button, wanted);
    });
    for (const name of ["keyup", "blur"]) button.addEventListener(name, () => release(button));
  };
  for (const button of $("jog").querySelectorAll("[data-jog]")) hold(button, button.dataset.jog.split(",").map(Number));
  const arrows = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };
  const toggle = $("jog-keys");
  toggle.addEventListener("click", () => {
    toggle.setAttribute("aria-pressed", String(toggle.getAttribute("aria-pressed") !== "true"));
    releaseAll();
  });
  addEventListener("keydown", (event) => {
    const typing = event.target.matches?.("input:not([type=range]), textarea");
    // Some systems tell nothing of a key that is released while one of these is held.
    if (event.ctrlKey || event.altKey || event.metaKey) return releaseAll();
    if (typing || toggle.getAttribute("aria-pressed") !== "true" || !arrows[event.key]) return;
    event.preventDefault();
    if (!event.repeat) press(event.code, arrows[event.key]);
  });
  addEventListener("keyup", (event) => release(event.code));
  addEventListener("blur", releaseAll);
  document.addEventListener("visibilitychange", releaseAll);
  for (const name of ["closed", "control", "status", "stopping"]) {
    link.on(name, () => (link.controls && link.allows("jog") && !link.stopping.asked) || releaseAll());
  }
  return hold;
}

// Where the sheet lies, from places where the pen touched it.
function sheet(link) {
  const actions = { touch: "add", "touch-undo": "undo", "touch-store": "store" };
  for (const [id, action] of Object.entries(actions)) $(id).addEventListener("click", () => link.send({ type: "touch", action }));
  const show = () => {
    const { sheet: found, status } = link.state;
    $("sheet").hidden = !found?.follows;
    text($("sheet-text"), found?.text ?? "");
    text($("sheet-summary"), found?.touches ? `${found.touches} touch${found.touches === 1 ? "" : "es"}` : "find its tilt");
    $("touch").disabled = !link.controls || !status?.referenced || !["Idle", "DrivesOff", "Fault"].includes(status.mode);
    $("touch-undo").disabled = !link.controls || !found?.touches;
    $("touch-store").disabled = !link.controls || !found?.is_found;
  };
  for (const name of ["sheet", "status", "control", "open", "closed"]) link.on(name, show);
  show();
}

function positions(link) {
  const actual = [];
  const cells = ["x", "y", "z"].map((name) => {
    const [commanded, measured] = [element("td"), element("td")];
    $("positions").append(element("tr", {}, element("th", { scope: "row" }, name), commanded, measured));
    actual.push(measured);
    return [commanded, measured];
  });
  let bars = [];
  let peaks = [];
  link.on("robot", (robot) => {
    if (!robot || bars.length) return;
    peaks = robot.axes.map(() => 0);
    bars = robot.axes.map(({ name, error_unit: unit }) => {
      const [bar, value] = [element("meter", { min: 0, max: 100, value: 0, ariaLabel: `following error of ${name}` }), element("output")];
      $("errors").append(element("span", {}, name), bar, value);
      return [bar, value, unit];
    });
  });
  // For a drive that does not answer, the firmware reports expected values, not actual ones.
  link.on("status", (status) => {
    const silent = bars.map((_, axis) => (status?.slaves[axis]?.silent_s ?? null) !== null);
    bars.forEach(([bar, value], axis) => [bar, value].forEach((node) => node.classList.toggle("old", silent[axis])));
    actual.forEach((cell) => cell.classList.toggle("old", silent.slice(0, 3).includes(true)));
  });
  let shown = 0;
  link.on("pose", (pose) => {
    if (!pose) return;
    pose.errors.forEach((error, axis) => (peaks[axis] = Math.max((peaks[axis] ?? 0) * 0.97, Math.abs(error ?? 0))));
    const now = performance.now();
    if (now - shown < 90) return;
    shown = now;
    cells.forEach(([commanded, measured], axis) => {
      // Without a home, positions count from the encoders' zeros.
      const known = (mm) => (link.state.status?.referenced === false ? NaN : mm);
      text(commanded, number(known(pose.commanded_mm[axis]), 2));
      text(measured, number(known(pose.measured_mm[axis]), 2));
    });
    bars.forEach(([bar, value, unit], axis) => {
      bar.value = Math.min(100, (Math.log10(1 + peaks[axis]) / 4) * 100);
      text(value, `${number(peaks[axis], 0)} ${unit}`);
    });
    $("pen-down").setAttribute("aria-pressed", String(pose.pen_down));
    $("pen-up").setAttribute("aria-pressed", String(!pose.pen_down));
  });
}
