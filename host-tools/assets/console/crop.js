// The photograph, with a frame around the part that is drawn and a circle around the face. Both follow the pointer and
// the keys; what they are set to stands in the fields of the options.

import { $, element, set, text } from "./dom.js";

// Share of the photograph's longer side by which a key moves.
const STEP = 0.01;
// Least radius of a face, pixels of the photograph.
const RADIUS_MIN = 4;
// Least way of the pointer that moves something, px on the page.
const DRAG_MIN_PX = 4;
// Largest height of the photograph on the page, px.
const TALL_PX = 340;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
// Whether a corner moves the left or right, and the upper or lower side.
const CORNERS = [[0, 0], [1, 0], [0, 1], [1, 1]];

const clamp = (value, low, high) => Math.min(Math.max(value, low), Math.max(low, high));
const numbers = (words, count) => {
  const read = words.split(",").map((part) => (part.trim() ? Number(part) : NaN));
  return read.length === count && read.every((value) => Number.isFinite(value) && value >= 0) ? read : null;
};

export function crop(link, fields) {
  const picture = element("img", { alt: "", draggable: false });
  const dim = element("i", { className: "dim" });
  const corners = CORNERS.map(([x, y]) => element("i", { className: "grip corner", data: { x, y } }));
  const frame = element("div", { className: "frame", role: "application", ariaRoleDescription: "frame" }, ...corners);
  const [middle, edge] = [element("i", { className: "grip middle" }), element("i", { className: "grip edge" })];
  const ring = element("div", { className: "ring", role: "application", ariaRoleDescription: "circle" }, middle, edge);
  const facts = element("p", { className: "note", ariaLive: "polite" });
  const box = element("div", { className: "photograph" }, element("div", { className: "under" }, picture, dim), ring, frame);
  $("photograph").append(box, facts);

  const pictures = new Map();
  let photo = null;
  let part = null;
  let face = null;
  let held = null;

  // What the fields say, or else what was last drawn.
  const read = () => {
    if (!photo || held) return;
    const { state, wishes } = link.state.studio;
    const typed = fields.crop.isOwn && numbers(fields.crop.value, 4);
    const pointed = fields.focus.isOwn && numbers(fields.focus.value, 3);
    const [width, height] = photo.size_px;
    const isDrawn = state === "ready" && fields.same(fields.wishes(), wishes);
    part = typed && !isDrawn ? limited(typed) : photo.window_px;
    // A circle near a face that was found becomes that face.
    face = pointed && !isDrawn ? [clamp(pointed[0], 0, width), clamp(pointed[1], 0, height), clamp(pointed[2], RADIUS_MIN, Math.hypot(width, height))] : photo.face_px;
    show();
  };
  const limited = ([left, top, width, height]) => {
    const [across, down] = photo.size_px;
    const [x, y] = [clamp(left, 0, across - photo.side_min_px), clamp(top, 0, down - photo.side_min_px)];
    return [x, y, clamp(width, photo.side_min_px, across - x), clamp(height, photo.side_min_px, down - y)];
  };

  const share = (node, [left, top, width, height]) => {
    const [across, down] = photo.size_px;
    const sides = { left: left / across, top: top / down, width: width / across, height: height / down };
    for (const [side, value] of Object.entries(sides)) node.style[side] = `${(100 * value).toFixed(3)}%`;
  };
  const show = () => {
    const [left, top, width, height] = part.map(Math.round);
    const [across, down] = photo.size_px;
    share(frame, part);
    share(dim, part);
    const whole = width >= across && height >= down;
    frame.classList.toggle("whole", whole);
    const words = whole ? `all ${across} × ${down} pixels` : `${width} × ${height} of ${across} × ${down} pixels`;
    text(facts, fields.crop.value === "" ? `${words}, automatic` : words);
    set(frame, { ariaLabel: `Part that is drawn: ${words}, from ${left}, ${top}. Arrow keys move it, Shift and arrow keys change its size`, tabIndex: link.controls ? 0 : -1, ariaDisabled: String(!link.controls) });
    ring.hidden = !face;
    if (!face) return;
    const [x, y, radius] = face;
    share(ring, [x - radius, y - radius, 2 * radius, 2 * radius]);
    const own = link.controls && fields.focus.isOwn;
    ring.classList.toggle("own", own);
    set(ring, { ariaHidden: String(!own), ariaLabel: `Face: radius ${Math.round(radius)} pixels at ${Math.round(x)}, ${Math.round(y)}. Arrow keys move it, Shift and arrow keys change its size`, tabIndex: own ? 0 : -1 });
  };

  // A side or the whole frame, moved by so many pixels of the photograph from where it was.
  const moved = ([left, top, width, height], [x, y], corner) => {
    const [across, down] = photo.size_px;
    const least = photo.side_min_px;
    if (!corner) return [clamp(left + x, 0, across - width), clamp(top + y, 0, down - height), width, height];
    const side = (start, length, by, far, most) => {
      if (far) return [start, clamp(length + by, least, most - start)];
      const next = clamp(start + by, 0, start + length - least);
      return [next, start + length - next];
    };
    const [newLeft, newWidth] = side(left, width, x, corner[0], across);
    const [newTop, newHeight] = side(top, height, y, corner[1], down);
    return [newLeft, newTop, newWidth, newHeight];
  };
  const turned = ([x, y, radius], [dx, dy], grows) => {
    const [width, height] = photo.size_px;
    if (grows) return [x, y, clamp(radius + dx, RADIUS_MIN, Math.hypot(width, height))];
    return [clamp(x + dx, 0, width), clamp(y + dy, 0, height), radius];
  };
  const write = (circle) => {
    const [field, values] = circle ? [fields.focus, face] : [fields.crop, part];
    field.value = values.map(Math.round).join(",");
    show();
  };

  const press = (event) => {
    const grip = event.target.closest(".grip");
    const circle = ring.contains(event.target);
    if (!photo || !link.controls || event.button !== 0 || (circle && !grip)) return;
    const corner = grip && !circle ? [Number(grip.dataset.x), Number(grip.dataset.y)] : null;
    held = { circle, corner, grows: grip === edge, from: [event.clientX, event.clientY], values: circle ? face : part, changed: false };
    event.currentTarget.setPointerCapture(event.pointerId);
    event.currentTarget.focus({ preventScroll: true });
    event.preventDefault();
  };
  const drag = (event) => {
    if (!held) return;
    const scale = photo.size_px[0] / box.clientWidth;
    const by = [event.clientX - held.from[0], event.clientY - held.from[1]].map((side) => side * scale);
    // A hand that presses a button moves a little.
    if (!held.changed && Math.hypot(...by) < DRAG_MIN_PX * scale) return;
    if (held.circle) face = turned(held.values, by, held.grows);
    else part = moved(held.values, by, held.corner);
    held.changed = true;
    write(held.circle);
  };
  const release = () => {
    const changed = held?.changed;
    held = null;
    if (changed) fields.replan();
  };
  const key = (event) => {
    const arrow = ARROWS[event.key];
    if (!arrow || !photo || !link.controls || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = Math.max(1, Math.round(STEP * Math.max(...photo.size_px)));
    const by = arrow.map((side) => side * step);
    const circle = event.currentTarget === ring;
    // Down and right are larger.
    if (circle) face = turned(face, event.shiftKey ? [by[0] + by[1], 0] : by, event.shiftKey);
    else part = moved(part, by, event.shiftKey ? [1, 1] : null);
    write(circle);
    fields.soon();
    event.preventDefault();
    event.stopPropagation();
  };
  for (const node of [frame, ring]) {
    node.addEventListener("pointerdown", press);
    node.addEventListener("pointermove", drag);
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) node.addEventListener(name, release);
    node.addEventListener("keydown", key);
  }

  // The fields as they are typed, and where they begin when a person chooses to set them.
  fields.on(read);
  fields.crop.begins = () => part?.map(Math.round).join(",") ?? "";
  fields.focus.begins = () => {
    if (!photo) return "";
    const [left, top, width, height] = part;
    return (face ?? [left + width / 2, top + height / 2, Math.min(width, height) / 6]).map(Math.round).join(",");
  };

  link.on("picture", ({ use, number, file }) => {
    if (use !== 1) return;
    for (const [old, address] of pictures) {
      URL.revokeObjectURL(address);
      pictures.delete(old);
    }
    pictures.set(number, URL.createObjectURL(file));
    look();
  });
  const look = () => {
    photo = link.state.studio?.photograph ?? null;
    const address = photo && pictures.get(photo.number);
    $("photograph").hidden = !address;
    fields.photograph(Boolean(photo));
    if (!address) return;
    const [width, height] = photo.size_px;
    set(picture, { src: address, width, height });
    box.style.width = `min(100%, ${Math.round((TALL_PX * width) / height)}px)`;
    read();
  };
  for (const name of ["studio", "control", "you", "closed"]) link.on(name, look);
  look();
}
