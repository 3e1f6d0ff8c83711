// Options for converting a file into strokes; empty ones take their defaults. Every change plans the file again.

import { choice } from "./choice.js";
import { $, element, set, toast } from "./dom.js";

// Pause in typing before a file is planned, ms.
const TYPING_MS = 400;
// The value of a list whose text is in a field of its own.
const OWN = "own";
const PARTS = [["", "automatic"], ["head", "head"], ["subject", "subject"], ["none", "everything"], [OWN, "own frame"]];
const FACES = [["", "found"], [OWN, "own circle"]];
const GROUNDS = { keep: "all of it", fade: "faded", none: "none" };
const OPTIONS = ["style", "size", "max_time", "crop", "background", "focus"];

const same = (a, b) => Boolean(a && b) && OPTIONS.every((name) => a[name] === b[name]);

// A list with a field for a value that is not in it; the field is there only while it is used.
class Owned {
  constructor(list, label) {
    this.list = list;
    this.field = element("input", { type: "text", hidden: true, ariaLabel: label });
    // What the field begins with when a person chooses to set it.
    this.begins = () => "";
    list.addEventListener("change", () => {
      if (this.isOwn && !this.field.value) this.field.value = this.begins();
      this.show();
    });
  }

  get isOwn() {
    return this.list.value === OWN;
  }

  get value() {
    return this.isOwn ? this.field.value.trim() : this.list.value;
  }

  set value(value) {
    const listed = this.list.options.some(([known]) => known === value && known !== OWN);
    set(this.list, { value: listed ? value : OWN });
    set(this.field, { value: listed ? "" : value });
    this.show();
  }

  contains(node) {
    return this.list.contains(node) || this.field.contains(node);
  }

  show() {
    set(this.field, { hidden: !this.isOwn });
  }
}

// The fields by the names of their options, in a row each; and what shows the rows for photographs.
function rows(link) {
  const style = choice("Style", [["", "default"]]);
  const size = element("input", { type: "text", placeholder: "fits the sheet", ariaLabel: "Size, with its unit" });
  const time = element("input", { type: "text", placeholder: "about 110s", ariaLabel: "Longest drawing time, for instance 3m" });
  const crop = new Owned(choice("Part of the photograph that is drawn", PARTS), "Left, top, width and height of the part, pixels");
  const ground = choice("Background of the photograph", [["", "default"]]);
  const focus = new Owned(choice("Face, which is drawn finest", FACES), "Centre and radius of the face, pixels");
  const row = (name, ...inputs) => element("div", { className: "field", hidden: true }, name, ...inputs);
  const styles = row("style", style);
  const photographs = [row("part", crop.list, crop.field), row("background", ground), row("face", focus.list, focus.field)];
  $("options").append(styles, element("label", {}, "size", size), element("label", {}, "at most", time), ...photographs);
  const fill = (list, known, words) => {
    if (list.options.length === 1) list.options = [["", "default"], ...known.map((name) => [name, words[name] ?? name])];
  };
  link.on("robot", (constants) => {
    const known = constants?.styles ?? [];
    styles.hidden = known.length === 0;
    fill(style, known, {});
    fill(ground, constants?.backgrounds ?? [], GROUNDS);
  });
  const photograph = (shown) => photographs.forEach((field) => set(field, { hidden: !shown }));
  return [{ style, size, max_time: time, crop, background: ground, focus }, photograph];
}

export function optionFields(link) {
  const [fields, photograph] = rows(link);
  const { crop, focus } = fields;
  const wishes = () => Object.fromEntries(OPTIONS.map((name) => [name, fields[name].value.trim()]));
  const fill = (values, kept = () => false) => {
    for (const name of OPTIONS) {
      const value = name === "crop" && values.crop === "auto" ? "" : values[name];
      if (!kept(fields[name])) set(fields[name], { value });
    }
  };

  let asked = null;
  let timer = 0;
  const replan = () => {
    clearTimeout(timer);
    const { studio: made } = link.state;
    const wanted = wishes();
    if (!made || made.state === "idle" || same(wanted, asked ?? made.wishes)) return;
    if (!link.controls) {
      toast("Take control to plan it again");
      return;
    }
    asked = wanted;
    link.send({ type: "replan", wishes: wanted });
  };
  const soon = () => {
    clearTimeout(timer);
    timer = setTimeout(replan, TYPING_MS);
  };
  const readers = [];
  for (const field of Object.values(fields).flatMap((field) => (field instanceof Owned ? [field.list, field.field] : [field]))) {
    for (const [event, plan] of [["change", replan], ["input", soon]]) {
      field.addEventListener(event, () => {
        plan();
        readers.forEach((reader) => reader());
      });
    }
  }
  // Options chosen by another viewer, or by this page before a reload; a field being edited is never overwritten.
  let seen = null;
  link.on("studio", (made) => {
    asked = null;
    if (!made || made.state === "idle" || (seen && link.controls) || same(made.wishes, seen)) return;
    fill(made.wishes, (field) => field.contains(document.activeElement));
    seen = made.wishes;
  });
  link.on("control", () => link.controls && replan());
  return {
    wishes,
    same,
    crop,
    focus,
    // Shows or hides the options of photographs.
    photograph,
    // Plans the file again, at once or after a pause.
    replan,
    soon,
    // Calls back when a person has changed a field.
    on: (reader) => readers.push(reader),
    // Sets all options, and plans the file again.
    choose: (values) => {
      fill(values);
      replan();
    },
    // A place in one photograph means nothing in the next.
    forget: () => [crop, focus].forEach((owned) => owned.isOwn && (owned.value = "")),
  };
}
