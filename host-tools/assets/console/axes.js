// The check of the axes: while a button is pressed one axis moves alone, then the operator says which one moved.

import { choice } from "./choice.js";
import { $, element, keyed, set, text } from "./dom.js";

const UNSEEN = "";
const seenOf = (value, axis) => {
  if (value === UNSEEN) return null;
  const other = Number(value);
  if (!other) return value;
  return other === axis ? "as_told" : { other };
};

// The advice numbers axes.
const called = ({ axis, name }) => (name.endsWith(` ${axis}`) ? name : `${axis} ${name}`);

// `hold(button, wanted)` moves while the button is pressed.
export function axes(link, hold) {
  const may = () => link.controls && link.allows("jog");
  const row = ({ axis, name }) => {
    const { axes: checked, others: further } = link.state.axes;
    const others = [...checked, ...further].filter((other) => other.axis !== axis);
    const answers = (way) => [[UNSEEN, "not checked"], ["as_told", way ? `right: ${way}` : "right"], ["reversed", "reversed"], ...others.map((other) => [other.axis, called(other)]), ["unclear", "cannot tell"]];
    const answer = choice(`What moved when axis ${axis}, ${name}, was told to go forwards`, answers(""));
    answer.addEventListener("change", () => link.send({ type: "saw", axis, seen: seenOf(answer.value, axis) }));
    const ways = [["−", false], ["+", true]].map(([sign, forward]) => {
      const button = element("button", { type: "button", ariaLabel: `Move axis ${axis}, ${name}, ${forward ? "forwards" : "back"}` }, sign);
      hold(button, { axis, forward });
      return button;
    });
    let told = null;
    let heard = null;
    // An answer that was refused is taken back.
    link.on("refused", () => (answer.value = heard ?? UNSEEN));
    const shown = element("div", { className: "axis", role: "group", ariaLabel: `Axis ${axis}, ${name}` }, element("span", {}, called({ axis, name })), ...ways, answer);
    return [shown, ({ seen, moved, way }) => {
      for (const button of ways) set(button, { disabled: !may() });
      // An open list stays as it is, and an answer as it was given.
      if (told !== way && answer.list.hidden && seen === null) {
        answer.options = answers(way);
        told = way;
      }
      const value = seen === null ? UNSEEN : typeof seen === "string" ? seen : String(seen.other);
      if (heard !== value) answer.value = value;
      heard = value;
      set(answer, { disabled: !link.controls || !moved });
    }];
  };
  const show = () => {
    const check = link.state.axes;
    $("axes").hidden = !check;
    if (!check) return;
    keyed($("axes-list"), check.axes, ({ axis }) => axis, row);
    const answered = check.axes.filter(({ seen }) => seen !== null).length;
    text($("axes-summary"), check.confirmed ? "all as configured" : answered ? `${answered} of ${check.axes.length} checked` : "not checked");
    keyed($("axes-advice"), check.advice, (line) => line, (line) => [element("p", {}, line), () => {}]);
  };
  for (const name of ["axes", "status", "control", "open", "closed"]) link.on(name, show);
  show();
}
