// The robot from the side and from above, where its joints are measured, with its pen, the sheet and the work area.
// The console sends the machine's parts as lines and rings; the page knows no kind of machine.

import { $, Canvas } from "./dom.js";

const PEN_MM = 60;
const STYLES = { base: [5, "metal"], link: [6, "ink"], rod: [1.8, "soft"], joint: [5, "metal"], platform: [4, "accent"] };

export function robot(link) {
  let dirty = true;
  const side = { flat: ([x, , z]) => [x, -z], depth: ([, y]) => -y, fades: true, box: ([x, , z]) => [x[0], -z[1], x[1], -z[0]] };
  const top = { flat: ([x, y]) => [x, -y], depth: ([, , z]) => z, fades: false, box: ([x, y]) => [x[0], -y[1], x[1], -y[0]] };
  const views = [[side, "side"], [top, "top"]].map(([view, id]) => ({ ...view, screen: new Canvas($(id), () => (dirty = true)) }));

  const draw = () => {
    requestAnimationFrame(draw);
    const { robot: constants, pose } = link.state;
    if (!dirty || !constants) return;
    dirty = false;
    for (const view of views) paint(view, constants, pose);
  };

  const paint = ({ screen, flat, depth, fades, box }, constants, pose) => {
    const { context, colours } = screen;
    screen.clear();
    const [left, top, right, bottom] = box(constants.bounds_mm);
    const scale = Math.min(screen.width / (right - left), screen.height / (bottom - top));
    const at = (point) => {
      const [x, y] = flat(point);
      return [screen.width / 2 + (x - (left + right) / 2) * scale, screen.height / 2 + (y - (top + bottom) / 2) * scale];
    };
    const line = (points, width, colour) => {
      context.beginPath();
      points.forEach((point, index) => (index ? context.lineTo(...at(point)) : context.moveTo(...at(point))));
      context.lineWidth = width;
      context.strokeStyle = colour;
      context.stroke();
    };
    const dot = (point, radius, colour) => {
      context.beginPath();
      context.arc(...at(point), radius, 0, 7);
      context.fillStyle = colour;
      context.fill();
    };
    const part = ({ style, points_mm: points, ring_mm: radius }) => {
      const [width, colour] = STYLES[style];
      const far = fades && Math.min(...points.map(depth)) < middle - 10 && (style === "link" || style === "rod");
      context.globalAlpha = far ? 0.55 : 1;
      if (radius) line(ring(points[0], radius), width, colours[colour]);
      else if (points.length === 1) dot(points[0], width, colours[colour]);
      else line(points, width, colours[colour]);
      context.globalAlpha = 1;
    };
    context.lineCap = context.lineJoin = "round";
    workspace(constants, line, at, context, colours);
    const known = link.state.status?.referenced !== false;
    const parts = (known && pose?.parts) || [];
    const tool = known ? pose?.measured_mm : undefined;
    const middle = tool ? depth(tool) : 0;
    constants.parts.forEach(part);
    const near = (of) => Math.max(...of.points_mm.map(depth));
    [...parts].sort((a, b) => near(a) - near(b)).forEach(part);
    if (!parts.length) return;
    const tip = [tool[0], tool[1], tool[2] - PEN_MM];
    line([tool, tip], 3, colours.accent);
    dot(tip, 2.5, colours.accent);
  };

  // The sheet and the work area.
  const workspace = ({ paper, work_area: area }, line, at, context, colours) => {
    const [width, height] = paper.size_mm.map((size) => size / 2);
    const [x, y] = paper.centre_mm;
    const [alongX, alongY] = paper.slope;
    const corner = (right, back) => [x + right, y + back, paper.pen_down_z_mm - PEN_MM + alongX * right + alongY * back];
    const corners = [corner(-width, -height), corner(width, -height), corner(width, height), corner(-width, height)];
    context.beginPath();
    corners.forEach((corner, index) => (index ? context.lineTo(...at(corner)) : context.moveTo(...at(corner))));
    context.closePath();
    context.fillStyle = colours.sheet;
    context.fill();
    line([...corners, corners[0]], 1.5, colours["sheet-edge"]);
    context.setLineDash([3, 5]);
    for (const level of [area.z_low_mm, area.z_high_mm]) for (const outline of outlines(area, level)) line(outline, 1, colours.faint);
    context.setLineDash([]);
  };

  link.on("pose", () => (dirty = true));
  link.on("robot", () => (dirty = true));
  requestAnimationFrame(draw);
}

const ring = ([x, y, z], radius) => Array.from({ length: 49 }, (_, index) => [x + radius * Math.cos((index * Math.PI) / 24), y + radius * Math.sin((index * Math.PI) / 24), z]);

// The borders of the work area at a height: a rectangle where x and y are limited, else a circle, and the hole of a ring.
function outlines({ x_mm: [left, right], y_mm: [front, back], radius_mm: radius, inner_radius_mm: hole }, z) {
  const boxed = Math.max(-left, right, -front, back) < radius;
  const rectangle = [[left, front, z], [right, front, z], [right, back, z], [left, back, z], [left, front, z]];
  const outer = boxed ? rectangle : ring([0, 0, z], radius);
  return hole > 0 ? [outer, ring([0, 0, z], hole)] : [outer];
}
