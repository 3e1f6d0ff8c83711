// Drawings: drop a file, see what it will be and how long it takes, let it wait, start it; what was drawn before.

import { $, duration, element, number, toast } from "./dom.js";

export function jobs(link) {
  const options = optionFields(link);
  const upload = async (file) => {
    if (!file) return;
    if (!link.controls) {
      toast("Take control first, then drop the file");
      return;
    }
    const answer = await link.upload(file, options()).catch(() => null);
    if (!answer?.ok) toast((await answer?.text()) || "The console cannot be reached");
  };
  const drop = $("drop");
  $("file").addEventListener("change", () => {
    upload($("file").files[0]);
    $("file").value = "";
  });
  for (const name of ["dragenter", "dragover"]) {
    addEventListener(name, (event) => {
      event.preventDefault();
      drop.classList.add("over");
    });
  }
  for (const name of ["dragleave", "drop"]) addEventListener(name, () => drop.classList.remove("over"));
  addEventListener("drop", (event) => {
    event.preventDefault();
    upload(event.dataTransfer.files[0]);
  });
  studio(link);
  lists(link);
}

// How a photograph becomes strokes; what is left empty is left to the program.
function optionFields(link) {
  const style = element("select", { ariaLabel: "Style" }, element("option", { value: "" }, "usual style"));
  const size = element("input", { type: "text", placeholder: "fits the sheet", ariaLabel: "Size, with its unit" });
  const time = element("input", { type: "text", placeholder: "about 110s", ariaLabel: "Longest drawing time, for instance 3m" });
  const styles = element("label", { hidden: true }, "style", style);
  $("options").append(styles, element("label", {}, "size", size), element("label", {}, "at most", time));
  link.on("robot", (constants) => {
    const known = constants?.styles ?? [];
    styles.hidden = known.length === 0;
    if (style.childElementCount === 1) style.append(...known.map((value) => element("option", { value }, value)));
  });
  return () => JSON.stringify({ style: style.value, size: size.value.trim(), max_time: time.value.trim() });
}

function studio(link) {
  const show = () => {
    const { studio: made } = link.state;
    const box = $("studio");
    box.dataset.state = made?.state ?? "idle";
    if (made?.state === "working") {
      box.replaceChildren(element("p", { className: "busy" }, `${made.name}: finding its strokes and planning them`));
    } else if (made?.state === "failed") {
      box.replaceChildren(element("p", { className: "wrong" }, made.error));
    } else if (made?.state === "ready") {
      const facts = `${made.strokes} strokes, ${number(made.pen_down_mm / 1000, 2)} m of line, about ${duration(made.planned_s)}`;
      const draw = element("button", { type: "button", className: "primary", id: "enqueue", on: { click: () => link.send({ type: "enqueue", preparation: made.number }) } }, "Add to queue");
      box.replaceChildren(element("p", {}, element("b", {}, made.name), element("br"), facts), draw);
    } else {
      box.replaceChildren();
    }
    const button = $("enqueue");
    if (button) button.disabled = !link.controls;
  };
  for (const name of ["studio", "control", "you"]) link.on(name, show);
}

function lists(link) {
  const show = () => {
    const { jobs: all, status } = link.state;
    if (!all) return;
    const ready = link.controls && !all.active && ["DrivesOff", "Unreferenced", "Idle"].includes(status?.mode);
    const waiting = all.waiting.map((job) => {
      const start = element("button", { type: "button", className: "primary", disabled: !ready, title: "Is there fresh paper?", on: { click: () => link.send({ type: "start", job: job.number }) } }, "Draw");
      const discard = element("button", { type: "button", className: "quiet round", disabled: !link.controls, ariaLabel: `Take ${job.name} out of the queue`, on: { click: () => link.send({ type: "discard", job: job.number }) } }, "×");
      return element("li", {}, element("span", {}, element("b", {}, job.name), ` ${job.strokes} strokes, ${duration(job.planned_s)}`), start, discard);
    });
    if (all.active) waiting.unshift(element("li", { className: "active" }, element("span", {}, element("b", {}, all.active.name), ` ${all.phase}`)));
    $("queue").replaceChildren(...(waiting.length ? waiting : [element("li", { className: "empty" }, "nothing waits")]));
    const past = all.past.slice(0, 8).map((job) => element("li", { data: { done: String(job.done) } }, element("span", {}, element("b", {}, job.name), ` ${job.done ? "drawn in" : "ended after"} ${duration(job.drawn_s)}`, job.done ? null : element("small", {}, ` ${job.text}`))));
    $("past").replaceChildren(...(past.length ? past : [element("li", { className: "empty" }, "nothing yet")]));
  };
  for (const name of ["jobs", "control", "you", "status"]) link.on(name, show);
}
