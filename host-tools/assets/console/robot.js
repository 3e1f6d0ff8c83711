// The delta robot from the side and from above: arms, forearms and platform where the joints are measured.

import { $, Canvas } from "./dom.js";

const ROD_MM = 34;
const PEN_MM = 60;

// Shoulders, elbows and the platform's joints of a pose; z up, mm.
function skeleton(geometry, joints, platform) {
  return geometry.arm_azimuths_deg.map((degrees, arm) => {
    const azimuth = (degrees * Math.PI) / 180;
    const [cos, sin] = [Math.cos(azimuth), Math.sin(azimuth)];
    const radial = (radius, z) => [radius * cos, radius * sin, z];
    const angle = joints[arm];
    const elbow = radial(geometry.base_radius_mm + geometry.upper_arm_mm * Math.cos(angle), -geometry.upper_arm_mm * Math.sin(angle));
    const joint = radial(geometry.platform_radius_mm, 0).map((part, axis) => part + platform[axis]);
    return { shoulder: radial(geometry.base_radius_mm, 0), elbow, joint, across: [-sin * ROD_MM, cos * ROD_MM, 0] };
  });
}

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
    const { geometry } = constants;
    const ring = (radius, z, centre = [0, 0]) => Array.from({ length: 49 }, (_, index) => [centre[0] + radius * Math.cos((index * Math.PI) / 24), centre[1] + radius * Math.sin((index * Math.PI) / 24), z]);
    line(ring(geometry.base_radius_mm, 0), 5, colours.metal);
    if (!pose || !Number.isFinite(pose.measured_mm[2])) return;
    const platform = pose.measured_mm;
    const arms = skeleton(geometry, pose.joints_rad, platform).map((arm) => ({ ...arm, near: depth(arm.elbow) }));
    arms.sort((a, b) => a.near - b.near);
    for (const { shoulder, elbow, joint, across, near } of arms) {
      context.globalAlpha = fades && near < -10 ? 0.55 : 1;
      line([shoulder, elbow], 6, colours.ink);
      for (const side of [-1, 1]) {
        const shift = (point) => point.map((part, axis) => part + side * across[axis]);
        line([shift(elbow), shift(joint)], 1.8, colours.soft);
      }
      line([-1, 1].map((side) => elbow.map((part, axis) => part + side * across[axis])), 3, colours.ink);
      dot(shoulder, 5, colours.metal);
      context.globalAlpha = 1;
    }
    line(ring(geometry.platform_radius_mm, platform[2], platform), 4, colours.accent);
    const tip = [platform[0], platform[1], platform[2] - PEN_MM];
    line([platform, tip], 3, colours.accent);
    dot(tip, 2.5, colours.accent);
  };

  // Sheet and the space that may be used.
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
