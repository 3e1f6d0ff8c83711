// The page: one link, and the panels that listen to it.

import "./choice.js";
import { $, age, element, text } from "./dom.js";
import { Link } from "./link.js";
import { operate } from "./operate.js";
import { paper } from "./paper.js";
import { robot } from "./robot.js";
import { Scope } from "./scope.js";
import { jobs } from "./jobs.js";
import { drives } from "./drives.js";

const THEMES = ["auto", "light", "dark"];

function theme() {
  const set = (name) => {
    document.documentElement.dataset.theme = name;
    localStorage.setItem("theme", name);
    document.dispatchEvent(new Event("themechange"));
  };
  set(localStorage.getItem("theme") ?? "auto");
  $("theme").addEventListener("click", () => {
    const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark") ? matchMedia("(prefers-color-scheme: dark)").matches : false;
    const present = document.documentElement.dataset.theme;
    set(present === "auto" ? (dark ? "light" : "dark") : THEMES[3 - THEMES.indexOf(present)]);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => document.dispatchEvent(new Event("themechange")));
}

function figures(link, scope) {
  let [bytes, frames] = [0, 0];
  setInterval(() => {
    const now = { frames_per_s: scope.frames - frames, bytes_per_s: link.bytes - bytes, signals: scope.chosen.length };
    [bytes, frames] = [link.bytes, scope.frames];
    const skipped = link.state.you?.skipped ? ` · ${link.state.you.skipped} pictures skipped` : "";
    text($("figures"), `${now.signals} signals · ${now.frames_per_s} frames/s · ${(now.bytes_per_s / 1000).toFixed(0)} kB/s${skipped}`);
    globalThis.etherpenFigures = now;
  }, 1000);
  link.on("robot", (constants) => constants && text($("about"), `etherpen ${constants.version} · ${constants.port} · no safety function: use the drives' STO`));
}

// Not modal: under a modal dialog nothing else can be pressed, and STOP must always work.
function shortcuts() {
  const dialog = $("shortcuts");
  const open = (opened) => {
    dialog.open = opened;
    $("help").ariaExpanded = String(opened);
    (opened ? dialog : $("help")).focus();
  };
  $("help").addEventListener("click", () => open(!dialog.open));
  dialog.querySelector("button").addEventListener("click", () => open(false));
  addEventListener("keydown", (event) => event.key === "Escape" && dialog.open && open(false));
  document.addEventListener("pointerdown", (event) => {
    if (dialog.open && !dialog.contains(event.target) && !$("help").contains(event.target)) open(false);
  });
}

// Measured values are dimmed, with their age, when no new ones arrive.
function ages(link) {
  const show = () => {
    const seconds = link.silentSeconds();
    const old = seconds >= 1;
    const words = old && link.heard.time_ms !== null ? `measured ${age(seconds)}` : "";
    document.body.classList.toggle("silent", old);
    for (const label of document.querySelectorAll(".age")) text(label, words);
    document.body.classList.toggle("offline", !link.open);
  };
  setInterval(show, 250);
  for (const name of ["open", "closed"]) link.on(name, show);
}

theme();
const link = new Link();
operate(link);
paper(link);
robot(link);
const scope = new Scope(link);
jobs(link);
drives(link);
figures(link, scope);
shortcuts();
ages(link);
document.addEventListener("themechange", () => scope.all && scope.legend());
addEventListener("error", (event) => document.body.append(element("p", { className: "wrong", hidden: true }, `script: ${event.message}`)));
globalThis.etherpen = { link, scope };
