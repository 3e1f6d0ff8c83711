//! The parts of a machine as lines and rings, for drawings from any side.
//!
//! The page draws parts without knowing the kind of machine. Points are millimetres in the robot's frame, z up.
//!
//! Invariant: a part has finite points only.

use etherpen::config::{Config, WorkVolume};
use etherpen::robots::{AXES, Geometry, LINEAR_MM_PER_RAD, MAIN_AXES};
use serde::Serialize;

/// Half the distance between the two rods of a pair, mm.
const ROD_MM: f64 = 34.0;
/// Height of beams and links above the highest tool, mm.
const ABOVE_MM: f64 = 30.0;
/// Radius of the platform of a machine whose dimensions do not tell it, mm.
const PLATFORM_MM: f64 = 24.0;
/// Length of the pen below the tool's position, mm.
const PEN_MM: f64 = 60.0;

type Point = [f64; 3];

/// What a part is, which decides how it is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Style {
    /// Stands still: base, column, rail.
    Base,
    /// Moves: link, beam, column of the tool.
    Link,
    /// One of the thin rods to the platform.
    Rod,
    /// A joint, as a dot.
    Joint,
    /// Carries the tool.
    Platform,
}

/// A part: a line through points, a dot, or a horizontal ring around its only point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Part {
    /// What it is.
    pub style: Style,
    /// Its points, mm.
    pub points_mm: Vec<Point>,
    /// Radius of a ring, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ring_mm: Option<f64>,
}

fn line(style: Style, points_mm: impl Into<Vec<Point>>) -> Part {
    Part {
        style,
        points_mm: points_mm.into(),
        ring_mm: None,
    }
}

fn ring(style: Style, centre: Point, radius_mm: f64) -> Part {
    Part {
        style,
        points_mm: vec![centre],
        ring_mm: Some(radius_mm),
    }
}

fn plus(a: Point, b: Point) -> Point {
    let [x, y, z] = a;
    let [dx, dy, dz] = b;
    [x + dx, y + dy, z + dz]
}

/// A direction in the horizontal plane.
#[derive(Clone, Copy)]
struct Azimuth {
    cos: f64,
    sin: f64,
}

impl Azimuth {
    fn new(angle_rad: f64) -> Self {
        let (sin, cos) = angle_rad.sin_cos();
        Self { cos, sin }
    }

    fn out(self, radius_mm: f64, z_mm: f64) -> Point {
        [radius_mm * self.cos, radius_mm * self.sin, z_mm]
    }

    fn across(self, mm: f64) -> Point {
        [-mm * self.sin, mm * self.cos, 0.0]
    }
}

/// The parts that stand still.
#[must_use]
pub fn fixed(geometry: &Geometry) -> Vec<Part> {
    let parts = match geometry {
        Geometry::Delta(of) => vec![ring(Style::Base, [0.0; 3], of.base_radius_mm)],
        Geometry::Gantry(of) => frame(of.x_range_mm, of.y_range_mm, above(of.z_range_mm)),
        Geometry::CoreXy(of) => frame(of.x_range_mm, of.y_range_mm, above(of.z_range_mm)),
        Geometry::Scara(of) => {
            let [low, _] = of.z_range_mm;
            vec![line(
                Style::Base,
                [[0.0, 0.0, low - PEN_MM], [0.0, 0.0, above(of.z_range_mm)]],
            )]
        }
        Geometry::LinearDelta(of) => {
            let [low, high] = of.carriage_range_mm;
            let foot = low.min(0.0) - PEN_MM;
            let towers = of.tower_azimuths_deg.map(|degrees| Azimuth::new(degrees.to_radians()));
            let at = |z_mm: f64| towers.map(|tower| tower.out(of.radius_mm + PLATFORM_MM, z_mm));
            let mut parts: Vec<Part> = at(foot)
                .into_iter()
                .zip(at(high))
                .map(|(low, high)| line(Style::Base, [low, high]))
                .collect();
            for corners in [at(foot), at(high)] {
                let [first, ..] = corners;
                parts.push(line(
                    Style::Base,
                    corners.into_iter().chain([first]).collect::<Vec<_>>(),
                ));
            }
            parts
        }
    };
    finite(parts)
}

/// Height of beams and links over a tool with this range, mm.
fn above([_, high]: [f64; 2]) -> f64 {
    high + ABOVE_MM
}

/// The rails of a machine with a beam, and the bars that join them.
fn frame([left, right]: [f64; 2], [front, back]: [f64; 2], z: f64) -> Vec<Part> {
    let corners = [
        [left, front, z],
        [right, front, z],
        [right, back, z],
        [left, back, z],
        [left, front, z],
    ];
    vec![line(Style::Base, corners)]
}

/// The parts that move, for joint angles and the position of the tool that belongs to them.
#[must_use]
pub fn moving(geometry: &Geometry, joints_rad: &[f64; AXES], tool_mm: Point) -> Vec<Part> {
    let [x, y, z] = tool_mm;
    let [first, second, third, _] = *joints_rad;
    let main: [f64; MAIN_AXES] = [first, second, third];
    if !main.iter().chain(&tool_mm).all(|value| value.is_finite()) {
        return Vec::new();
    }
    let parts = match geometry {
        Geometry::Delta(of) => {
            let mut parts = Vec::new();
            for (angle_rad, degrees) in main.into_iter().zip(of.arm_azimuths_deg) {
                let (azimuth, (sin, cos)) = (Azimuth::new(degrees.to_radians()), angle_rad.sin_cos());
                let shoulder = azimuth.out(of.base_radius_mm, 0.0);
                let elbow = azimuth.out(of.base_radius_mm + of.upper_arm_mm * cos, -of.upper_arm_mm * sin);
                parts.push(line(Style::Link, [shoulder, elbow]));
                let joint = plus(azimuth.out(of.platform_radius_mm, 0.0), tool_mm);
                parts.extend(rods(elbow, joint, azimuth));
                parts.push(line(Style::Joint, [shoulder]));
            }
            parts.push(ring(Style::Platform, tool_mm, of.platform_radius_mm));
            parts
        }
        Geometry::Gantry(of) => beam(of.x_range_mm, above(of.z_range_mm), tool_mm),
        Geometry::CoreXy(of) => beam(of.x_range_mm, above(of.z_range_mm), tool_mm),
        Geometry::Scara(of) => {
            let height = above(of.z_range_mm);
            let elbow = Azimuth::new(first).out(of.inner_link_mm, height);
            vec![
                line(Style::Link, [[0.0, 0.0, height], elbow]),
                line(Style::Link, [elbow, [x, y, height]]),
                line(Style::Rod, [[x, y, height + ABOVE_MM], tool_mm]),
                line(Style::Joint, [[0.0, 0.0, height]]),
                line(Style::Joint, [elbow]),
                line(Style::Platform, [[x, y, height], [x, y, z]]),
            ]
        }
        Geometry::LinearDelta(of) => {
            let mut parts = Vec::new();
            for (angle_rad, degrees) in main.into_iter().zip(of.tower_azimuths_deg) {
                let azimuth = Azimuth::new(degrees.to_radians());
                let carriage = azimuth.out(of.radius_mm + PLATFORM_MM, angle_rad * LINEAR_MM_PER_RAD);
                let joint = plus(azimuth.out(PLATFORM_MM, 0.0), tool_mm);
                parts.extend(rods(carriage, joint, azimuth));
                parts.push(line(Style::Joint, [carriage]));
            }
            parts.push(ring(Style::Platform, tool_mm, PLATFORM_MM));
            parts
        }
    };
    finite(parts)
}

/// A beam along x at the tool's y, the carriage on it, and the column down to the tool.
fn beam([left, right]: [f64; 2], height: f64, [x, y, z]: Point) -> Vec<Part> {
    vec![
        line(Style::Link, [[left, y, height], [right, y, height]]),
        line(Style::Joint, [[left, y, height]]),
        line(Style::Joint, [[right, y, height]]),
        line(Style::Platform, [[x, y, height], [x, y, z]]),
        line(Style::Joint, [[x, y, height]]),
    ]
}

/// A pair of rods from an upper to a lower joint, and the bar that holds them.
fn rods(upper: Point, lower: Point, azimuth: Azimuth) -> Vec<Part> {
    let sides = [azimuth.across(-ROD_MM), azimuth.across(ROD_MM)];
    let rod = |side: Point| line(Style::Rod, [plus(upper, side), plus(lower, side)]);
    let bar = line(Style::Link, sides.map(|side| plus(upper, side)));
    sides.into_iter().map(rod).chain([bar]).collect()
}

fn finite(parts: Vec<Part>) -> Vec<Part> {
    let is_finite = |part: &Part| part.points_mm.iter().flatten().all(|value| value.is_finite());
    parts.into_iter().filter(is_finite).collect()
}

/// The box of everything that is drawn: lowest and highest x, y and z, mm.
#[must_use]
pub fn bounds_mm(config: &Config) -> [[f64; 2]; 3] {
    let WorkVolume {
        radius_mm,
        x_mm,
        y_mm,
        z_low_mm,
        z_high_mm,
        ..
    } = config.work_area;
    let within = |[low, high]: [f64; 2]| [low.max(-radius_mm), high.min(radius_mm)];
    let mut all = [within(x_mm), within(y_mm), [z_low_mm - PEN_MM, z_high_mm]];
    let mut include = |point: Point| {
        for ([low, high], value) in all.iter_mut().zip(point) {
            (*low, *high) = (low.min(value), high.max(value));
        }
    };
    for part in fixed(&config.geometry) {
        let radius = part.ring_mm.unwrap_or(0.0);
        for point in part.points_mm {
            include(plus(point, [radius, radius, 0.0]));
            include(plus(point, [-radius, -radius, 0.0]));
        }
    }
    // A margin, and room for what moves above and beside.
    let widest = all.iter().map(|[low, high]| high - low).fold(0.0, f64::max);
    let margin = 0.05 * widest;
    all.map(|[low, high]| [low - margin, high + margin])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::machines::MACHINES;
    use etherpen::robots::{JointAngles, Kinematics, Position};

    #[test]
    fn every_bundled_machine_is_drawn_within_its_box_with_its_links_as_long_as_they_are() {
        for machine in MACHINES {
            let config = machine.load().unwrap();
            let kinematics = Kinematics::new(&config.geometry).unwrap();
            let [x_mm, y_mm] = config.paper.centre_mm;
            let position = Position {
                x_mm,
                y_mm,
                z_mm: config.paper.pen_down_z_mm,
            };
            let [first, second, third] = kinematics.inverse(&position).unwrap();
            let joints = [first, second, third, 0.0];
            let tool = Point::from(kinematics.forward(&JointAngles(joints)).unwrap());
            let parts = moving(&config.geometry, &joints, tool);
            let bounds = bounds_mm(&config);
            let all = parts
                .iter()
                .chain(&fixed(&config.geometry))
                .cloned()
                .collect::<Vec<_>>();
            assert!(all.iter().any(|part| part.style == Style::Base), "{}", machine.name);
            assert!(all.iter().any(|part| part.style == Style::Platform), "{}", machine.name);
            for point in all.iter().flat_map(|part| &part.points_mm) {
                for (value, [low, high]) in point.iter().zip(bounds) {
                    assert!(
                        *value >= low && *value <= high,
                        "{}: {point:?} {bounds:?}",
                        machine.name
                    );
                }
            }
            // Second opinion on the kinematics: rods and links have the lengths of the configuration.
            let length = |part: &Part| match part.points_mm[..] {
                [[x, y, z], [u, v, w]] => (x - u).hypot(y - v).hypot(z - w),
                _ => 0.0,
            };
            let of = |style| parts.iter().filter(move |part| part.style == style).map(length);
            let expected: &[f64] = match &config.geometry {
                Geometry::Delta(of) => &[of.forearm_mm; 6],
                Geometry::LinearDelta(of) => &[of.rod_mm; 6],
                Geometry::Scara(of) => &[of.inner_link_mm, of.outer_link_mm],
                _ => &[],
            };
            let style = match &config.geometry {
                Geometry::Scara(_) => Style::Link,
                _ => Style::Rod,
            };
            for (length, expected) in of(style).zip(expected) {
                assert!((length - expected).abs() < 1.0e-6, "{}: {length}", machine.name);
            }
        }
    }

    #[test]
    fn a_position_that_is_not_known_has_no_parts() {
        for machine in MACHINES {
            let config = machine.load().unwrap();
            let parts = moving(&config.geometry, &[f64::NAN; AXES], [f64::NAN; 3]);
            assert_eq!(parts, [], "{}", machine.name);
        }
    }
}
