// The photograph drawn in several ways: pictures to choose from. A press makes one the drawing that can be queued.

import { $, duration, element, keyed, set, text } from "./dom.js";

const PARTS = { none: "everything", head: "head", subject: "subject" };
const GROUNDS = { keep: "with the background", none: "without the background" };

// What distinguishes a variant; an automatic part and a faded background are not worth a word.
function words({ style, crop, background }) {
  const part = crop === "auto" ? null : (PARTS[crop] ?? "own frame");
  return [style, part, GROUNDS[background]].filter(Boolean);
}

export function variants(link, fields) {
  const pictures = new Map();
  // Number of the last variant that was shown.
  let last = 0;
  const ask = element("button", { type: "button", id: "vary", on: { click: () => press() } }, "Show variants");
  $("studio").append(ask);

  let asked = false;
  const press = () => {
    asked = link.send({ type: "vary" });
  };
  const tile = () => {
    const [picture, name, rest] = [element("img", { alt: "" }), element("b"), element("span")];
    const button = element("button", { type: "button" }, picture, name, rest);
    const show = ({ number, wishes, strokes, planned_s: planned }) => {
      const [style, ...more] = words(wishes);
      const chosen = fields.same(wishes, link.state.studio?.explicit);
      const address = pictures.get(number);
      if (address) set(picture, { src: address });
      text(name, style);
      text(rest, [...more, duration(planned)].join(", "));
      set(button, { disabled: !link.controls, ariaPressed: String(chosen), title: `${strokes} strokes`, onclick: () => fields.choose(wishes) });
    };
    return [button, show];
  };
  const empty = () => [element("div", { className: "empty", ariaHidden: "true" }), () => {}];
  const show = () => {
    const { studio, variants: all } = link.state;
    const state = all?.state ?? "idle";
    const working = state === "working";
    set(ask, { hidden: studio?.state !== "ready" || !studio.photograph, disabled: working || !link.controls });
    $("strip").hidden = state === "idle";
    if (state === "idle") return;
    if (asked && working) {
      asked = false;
      $("strip").scrollIntoView({ block: "nearest" });
    }
    const made = all.items.length;
    text($("strip-text"), working ? `${made} of ${all.wanted}` : state === "failed" ? all.error : "press the one to draw");
    $("strip-text").classList.toggle("busy", working);
    const waiting = working ? Array.from({ length: Math.max(0, all.wanted - made) }, (_, index) => ({ waits: made + index })) : [];
    keyed($("variants"), [...all.items, ...waiting], (item) => item.number ?? `waits ${item.waits}`, (item) => (item.number ? tile() : empty()));
  };
  link.on("picture", ({ use, number, file }) => {
    if (use !== 2) return;
    if (pictures.has(number)) URL.revokeObjectURL(pictures.get(number));
    pictures.set(number, URL.createObjectURL(file));
    show();
  });
  link.on("variants", (all) => {
    const kept = new Set(all?.items.map((item) => item.number));
    last = Math.max(last, ...kept);
    for (const [number, address] of pictures) {
      // A picture may arrive before the variant that it shows.
      if (kept.has(number) || number > last) continue;
      URL.revokeObjectURL(address);
      pictures.delete(number);
    }
    show();
  });
  for (const name of ["studio", "control", "you", "closed"]) link.on(name, show);
  show();
}
