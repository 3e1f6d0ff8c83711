// A delta robot's mechanism: base, arms, forearms and platform.

const ROD_MM = 34;

// Shoulders, elbows and platform joints of a pose; z up, mm.
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

// Draws the mechanism at the joints measured in `pose`; without a pose, only the base. The view provides `line` and
// `dot` for points in mm, a point's `depth`, and whether distant parts are drawn fainter (`fades`).
export function drawMechanism(geometry, pose, { context, colours, line, dot, depth, fades }) {
  const ring = (radius, z, centre = [0, 0]) => Array.from({ length: 49 }, (_, index) => [centre[0] + radius * Math.cos((index * Math.PI) / 24), centre[1] + radius * Math.sin((index * Math.PI) / 24), z]);
  line(ring(geometry.base_radius_mm, 0), 5, colours.metal);
  if (!pose) return;
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
}
