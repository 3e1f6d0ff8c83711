// Drawings: drop a file, preview it with its duration, queue it, start it; past drawings.

import { crop } from "./crop.js";
import { $, duration, element, keyed, number, set, text } from "./dom.js";
import { optionFields } from "./options.js";
import { variants } from "./variants.js";

// A layer that waits for its pen.
export const layerText = ({ layer, number, layers }) => `layer ${layer || "without a name"} (${number} of ${layers})`;
const strokes = (count) => `${count} stroke${count === 1 ? "" : "s"}`;

export function jobs(link) {
  const fields = optionFields(link);
  dropped(link, fields);
  studio(link);
  crop(link, fields);
  variants(link, fields);
  lists(link);
}

// A dropped file stays here until the console has accepted it: without control, without a connection, or after a
// refusal.
function dropped(link, fields) {
  let kept = null;
  let refused = "";
  let sending = false;
  const note = element("p");
  const button = element("button", { type: "button" }, "Try again");
  $("kept").append(note, button);

  const waitsFor = () => {
    const { control, you } = link.state;
    if (!link.open) return ["It will be planned when the console is reachable."];
    if (you && !you.may_command) return ["This page can only watch. Open the address with the token that the console printed."];
    if (refused) return [refused, "Try again", offer];
    if (link.controls) return ["Sending it."];
    if (control?.holder) return [`Viewer ${control.holder} has control. Take over to plan it.`, "Take over", () => link.send({ type: "take", force: true })];
    return ["Take control to plan it.", "Take control", () => link.send({ type: "take" })];
  };
  const show = () => {
    $("kept").hidden = !kept;
    if (!kept) return;
    const [words, name, press] = waitsFor();
    text(note, `${kept.name} is kept. ${words}`);
    if (name) text(button, name);
    set(button, { hidden: !name, onclick: press ?? null });
  };
  const offer = async () => {
    if (!kept || sending || !link.controls) return;
    const file = kept;
    [sending, refused] = [true, ""];
    // While the file waited, another viewer's frame may have come into the fields.
    fields.forget();
    show();
    const answer = await link.upload(file, JSON.stringify(fields.wishes())).catch(() => null);
    sending = false;
    if (kept !== file) return offer();
    if (answer?.ok) kept = null;
    else if (link.controls && link.open) refused = (await answer?.text()) || "The console did not answer.";
    show();
  };
  const take = (file) => {
    if (!file) return;
    [kept, refused] = [file, ""];
    fields.forget();
    const { control, you } = link.state;
    if (you?.may_command && control?.holder === null) link.send({ type: "take" });
    show();
    offer();
  };
  for (const name of ["control", "you", "open", "closed"]) {
    link.on(name, () => {
      show();
      if (!refused) offer();
    });
  }

  $("file").addEventListener("change", () => {
    take($("file").files[0]);
    $("file").value = "";
  });
  for (const name of ["dragenter", "dragover"]) {
    addEventListener(name, (event) => {
      event.preventDefault();
      $("drop").classList.add("over");
    });
  }
  for (const name of ["dragleave", "drop"]) addEventListener(name, () => $("drop").classList.remove("over"));
  addEventListener("drop", (event) => {
    event.preventDefault();
    take(event.dataTransfer.files[0]);
  });
}

function studio(link) {
  const busy = element("p", { className: "busy" });
  const wrong = element("p", { className: "wrong" });
  const name = element("b");
  const facts = element("span");
  const ready = element("p", {}, name, element("br"), facts);
  const pauses = element("input", { type: "checkbox", id: "pauses", checked: true });
  const layers = element("span");
  const pause = element("label", {}, pauses, layers);
  const draw = element("button", { type: "button", className: "primary", id: "enqueue", on: { click: () => link.send({ type: "enqueue", preparation: link.state.studio.number, pauses: pauses.checked && !pause.hidden }) } }, "Add to queue");
  $("studio").append(busy, wrong, ready, pause, draw);
  const show = () => {
    const { studio: made } = link.state;
    const state = made?.state ?? "idle";
    const box = $("studio");
    box.dataset.state = state;
    box.hidden = state === "idle";
    busy.hidden = state !== "working";
    wrong.hidden = state !== "failed";
    ready.hidden = draw.hidden = state !== "ready";
    pause.hidden = state !== "ready" || made.layers.length < 2;
    set(draw, { disabled: !link.controls });
    if (state === "working") text(busy, `${made.name}: tracing and planning`);
    if (state === "failed") text(wrong, `${made.name}: ${made.error}`);
    if (state !== "ready") return;
    text(name, made.name);
    text(layers, ` change the pen between ${made.layers.length} layers`);
    text(facts, `${strokes(made.strokes)}, ${number(made.pen_down_mm / 1000, 2)} m of line, about ${duration(made.planned_s)}`);
  };
  for (const event of ["studio", "control", "you", "closed"]) link.on(event, show);
  show();
}

// What an unfinished drawing needs before it can continue, and the buttons for it.
function continueControls(link, drawing) {
  const words = element("small");
  const button = element("button", { type: "button", className: "continue", on: { click: () => link.send({ type: "continue", job: drawing }) } }, "Continue");
  const here = element("button", { type: "button", className: "reference-here", title: "Only if nobody has moved the joints since then", on: { click: () => link.command({ do: "reference_here" }) } }, "The robot has not moved");
  const wants = (status, all) => {
    if (all.active || !status) return "";
    if (!link.controls) return ": take control first";
    if (status.mode === "Fault") return ": acknowledge the fault first";
    if (!["DrivesOff", "Unreferenced", "Idle"].includes(status.mode)) return ": wait until the robot is at rest";
    if (status.referenced) return "";
    const marks = ": the controller does not know the robot's pose. Press Home, with its joints at their marks unless their encoders or switches know better";
    if (!status.seen_mm) return marks;
    const [x, y] = status.seen_mm.map((mm) => number(mm, 0));
    return `${marks}, or, if nobody has moved them (pen at x ${x}, y ${y} mm):`;
  };
  const show = (job) => {
    const { jobs: all, status } = link.state;
    const ready = link.controls && !all.active && Boolean(status?.referenced) && ["DrivesOff", "Idle"].includes(status.mode);
    text(words, `stroke ${job.stroke} of ${job.strokes}${wants(status, all)}`);
    set(button, { hidden: !job.unfinished, disabled: !ready, title: `Continues at stroke ${job.stroke}. Is the same paper still in place?` });
    set(words, { hidden: !job.unfinished });
    set(here, { hidden: !job.unfinished || !link.controls || !status?.seen_mm || !["DrivesOff", "Unreferenced", "Idle"].includes(status.mode) });
  };
  return [[words, button, here], show];
}

function lists(link) {
  const waiting = (job) => {
    const [name, facts] = [element("b"), element("span")];
    const start = element("button", { type: "button", className: "primary", title: "Is there a fresh sheet of paper?", on: { click: () => link.send({ type: "start", job: job.number }) } }, "Draw");
    const discard = element("button", { type: "button", className: "quiet round", ariaLabel: `Remove ${job.name} from the queue`, on: { click: () => link.send({ type: "discard", job: job.number }) } }, "×");
    const show = () => {
      const { jobs: all, status } = link.state;
      text(name, job.name);
      text(facts, ` ${strokes(job.strokes)}, ${duration(job.planned_s)}`);
      set(start, { disabled: !(link.controls && !all.active && ["DrivesOff", "Unreferenced", "Idle"].includes(status?.mode)) });
      set(discard, { disabled: !link.controls });
    };
    return [element("li", {}, element("span", {}, name, facts), start, discard), show];
  };
  const active = () => {
    const [name, phase] = [element("b"), element("span")];
    const go = element("button", { type: "button", className: "primary", id: "pen-is-in", on: { click: () => link.send({ type: "pen_is_in", job: link.state.jobs.pause?.job }) } }, "The pen is in");
    const show = (job) => {
      const { jobs: all, status } = link.state;
      text(name, job.name);
      text(phase, all.pause ? ` change the pen for ${layerText(all.pause)}` : ` ${all.phase}`);
      set(go, { hidden: !all.pause, disabled: !(link.controls && status?.referenced && ["DrivesOff", "Idle"].includes(status.mode)), title: `Draws ${all.pause ? layerText(all.pause) : ""}` });
    };
    return [element("li", { className: "active" }, element("span", {}, name, phase), go), show];
  };
  const ended = (job) => {
    const [how, why] = [element("span"), element("small")];
    const [buttons, showButtons] = continueControls(link, job.number);
    const node = element("li", {}, element("span", {}, element("b", {}, job.name), how, why), ...buttons);
    const show = (now) => {
      if (!now) return;
      set(node.dataset, { done: String(now.done), unfinished: String(now.unfinished) });
      text(how, ` ${now.done ? "drawn in" : "ended after"} ${duration(now.drawn_s)}`);
      text(why, now.done ? "" : ` ${now.text}`);
      showButtons(now);
    };
    return [node, show];
  };
  const empty = (words) => [element("li", { className: "empty" }, words)];
  const show = () => {
    const { jobs: all } = link.state;
    if (!all) return;
    const queue = [...(all.active ? [{ ...all.active, active: true }] : []), ...all.waiting];
    keyed($("queue"), queue.length ? queue : [null], (job) => (job ? `${job.number}${job.active ? " active" : ""}` : "empty"), (job) => (job ? (job.active ? active() : waiting(job)) : empty("nothing waits")));
    const past = all.past.slice(0, 8);
    keyed($("past"), past.length ? past : [null], (job) => job?.number ?? "empty", (job) => (job ? ended(job) : empty("nothing yet")));
  };
  for (const name of ["jobs", "control", "you", "status"]) link.on(name, show);
  link.on("closed", () => [...$("queue").querySelectorAll("button"), ...$("past").querySelectorAll("button")].forEach((button) => set(button, { disabled: true })));
}
