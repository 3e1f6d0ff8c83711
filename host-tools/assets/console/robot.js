// The robot from the side and from above, where its joints are measured, with its pen, the sheet and the work area.

import { $, Canvas } from "./dom.js";
import { drawMechanism } from "./robot_delta.js";

const PEN_MM = 60;

export function robot(link) {
  let dirty = true;
  const views = [
    { screen: new Canvas($("side"), () => (dirty = true)), flat: ([x, , z]) => [x, -z], depth: ([, y]) => -y, fades: true, box: [-600, -110, 600, 1010] },
    { screen: new Canvas($("top"), () => (dirty = true)), flat: ([x, y]) => [x, -y], depth: ([, , z]) => z, fades: false, box: [-620, -620, 620, 620] },
  ];

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
    const [left, top, right, bottom] = box;
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
    context.lineCap = context.lineJoin = "round";
    workspace(constants, line, at, context, colours);
    const measured = pose && Number.isFinite(pose.measured_mm[2]) ? pose : null;
    drawMechanism(constants.geometry, measured, { context, colours, line, dot, depth, fades });
    if (!measured) return;
    const platform = measured.measured_mm;
    const tip = [platform[0], platform[1], platform[2] - PEN_MM];
    line([platform, tip], 3, colours.accent);
    dot(tip, 2.5, colours.accent);
  };

  // The sheet and the work area.
  const workspace = ({ paper, work_area: area }, line, at, context, colours) => {
    const [width, height] = paper.size_mm.map((size) => size / 2);
    const [x, y] = paper.centre_mm;
    const z = paper.pen_down_z_mm - PEN_MM;
    const corners = [[x - width, y - height, z], [x + width, y - height, z], [x + width, y + height, z], [x - width, y + height, z]];
    context.beginPath();
    corners.forEach((corner, index) => (index ? context.lineTo(...at(corner)) : context.moveTo(...at(corner))));
    context.closePath();
    context.fillStyle = colours.sheet;
    context.fill();
    line([...corners, corners[0]], 1.5, colours["sheet-edge"]);
    context.setLineDash([3, 5]);
    const circle = (height) => Array.from({ length: 61 }, (_, index) => [area.radius_mm * Math.cos((index * Math.PI) / 30), area.radius_mm * Math.sin((index * Math.PI) / 30), height]);
    line(circle(area.z_low_mm), 1, colours.faint);
    line(circle(area.z_high_mm), 1, colours.faint);
    context.setLineDash([]);
  };

  link.on("pose", () => (dirty = true));
  link.on("robot", () => (dirty = true));
  requestAnimationFrame(draw);
}
