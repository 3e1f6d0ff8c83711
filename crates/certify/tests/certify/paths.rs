//! Random settings and paths of all characters. A seed gives one path for ever.

use crate::planning::vertex;
use etherpen_motion::robots::{AXES, Geometry, Kind, Position, ScaraGeometry};
use etherpen_motion::settings::Orientation;
use etherpen_motion::{Pen, Settings, Vertex};
use std::f64::consts::{PI, TAU};

/// Random numbers: xorshift with 64 bits of state (Marsaglia, 2003).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    /// A number from 0 (included) to 1 (excluded).
    pub(crate) fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    /// An integer below `end`.
    pub(crate) fn below(&mut self, end: usize) -> usize {
        ((self.next() * end as f64) as usize).min(end - 1)
    }
}

/// Random limits, tolerances and options of a usual machine of a kind.
pub(crate) fn settings(random: &mut Random, kind: Kind) -> Settings {
    let geometry = match kind.geometry() {
        // A path that follows its direction winds the fourth axis up.
        Geometry::Scara(geometry) => Geometry::Scara(ScaraGeometry {
            turn_range_rad: [-6_283.0, 6_283.0],
            ..geometry
        }),
        other => other,
    };
    let mut settings = Settings::usual(geometry);
    let motion = &mut settings.motion;
    motion.speed_mm_s = random.between(50.0, 2_000.0);
    motion.travel_speed_mm_s = motion.speed_mm_s * random.between(1.0, 3.0);
    motion.acceleration_mm_s2 = 10.0_f64.powf(random.between(3.0, 5.0));
    for axis in 0..AXES {
        // Of the default machine: 1 to 30 rad/s, 32 to 1,000 rad/s2.
        motion.joint_speed_rad_s[axis] *= random.between(0.04, 1.2);
        motion.joint_acceleration_rad_s2[axis] *= 10.0_f64.powf(random.between(-0.9, 0.6));
    }
    motion.tolerance_mm = random.between(0.01, 0.3);
    motion.travel_tolerance_mm = motion.tolerance_mm * random.between(1.0, 10.0);
    motion.jerk_window_ms = [0, 1, 2, 4, 4, 8, 32][random.below(7)];
    motion.pen_dwell_ms = [0, 0, 0, 15][random.below(4)];
    if random.below(4) == 0 {
        motion.pen_speed_mm_s = random.between(20.0, 300.0);
        motion.pen_acceleration_mm_s2 = random.between(500.0, 10_000.0);
    }
    if random.below(2) == 0 {
        motion.orientation = Orientation::Path;
    }
    settings.paper.pen_lift_mm = random.between(0.5, 10.0);
    assert_eq!(settings.check(), Ok(()));
    settings
}

/// A path of the default machine where another machine's sheet lies: in the size at which a square of ±150 mm around the
/// middle of the sheet lies inside the work area, in the default size at most.
pub(crate) fn fitted(path: &[Vertex], settings: &Settings) -> Vec<Vertex> {
    let (paper, default) = (&settings.paper, Settings::default().paper);
    let scale = match settings.geometry.kind() {
        Kind::Delta | Kind::Gantry | Kind::CoreXy => 1.0,
        Kind::Scara => 0.5,
        Kind::LinearDelta => 0.4,
    };
    let [x_mm, y_mm] = paper.centre_mm;
    let moved = |at: &Vertex| Vertex {
        position: Position {
            x_mm: x_mm + scale * at.position.x_mm,
            y_mm: y_mm + scale * at.position.y_mm,
            z_mm: paper.pen_down_z_mm + at.position.z_mm - default.pen_down_z_mm,
        },
        ..*at
    };
    path.iter().map(moved).collect()
}

/// One stroke of a random character, lowered and lifted straight or on a slant.
pub(crate) fn stroke(random: &mut Random, settings: &Settings) -> Vec<Vertex> {
    let down = Settings::default().paper.pen_down_z_mm;
    let up = down + settings.paper.pen_lift_mm;
    let slant = [0.0, random.between(-2.0, 2.0)][random.below(2)];
    let mut point = [random.between(-90.0, 90.0), random.between(-90.0, 90.0), down];
    let mut path = vec![
        vertex([point[0] - slant, point[1], up], Pen::Up),
        vertex(point, Pen::Up),
    ];
    let kind = random.below(7);
    let (bend, step) = (random.between(-0.3, 0.3), random.between(0.1, 2.0));
    let mut heading = random.between(0.0, TAU);
    for number in 0..1 + random.below(10) {
        let (turn, leg) = match kind {
            0 => (random.between(-1.2, 1.2), random.between(0.3, 3.0)),
            1 => (if number % 2 == 0 { 2.6 } else { -2.6 }, random.between(0.5, 5.0)),
            2 => (random.between(-PI, PI), random.between(20.0, 150.0)),
            3 => (bend, step),
            4 => ([0.0, PI / 2.0, PI, -2.0][random.below(4)], random.between(0.01, 20.0)),
            5 => (random.between(-PI, PI), random.between(0.001, 0.05)),
            _ => (random.between(-2.0, 2.0), random.between(0.5, 10.0)),
        };
        heading += turn;
        point[0] = (point[0] + leg * heading.cos()).clamp(-150.0, 150.0);
        point[1] = (point[1] + leg * heading.sin()).clamp(-150.0, 150.0);
        if kind == 6 {
            point[2] = random.between(down, up);
        }
        path.push(vertex(point, Pen::Down));
    }
    path.push(vertex([point[0] + slant, point[1], up], Pen::Up));
    path
}

/// Paths whose limits lie between the points of the planner's grid: corners of every turn between long and short legs,
/// and a circle; with a small acceleration limit, at which a millisecond smooths nothing.
pub(crate) fn hidden(seed: u64) -> Vec<Vec<Vertex>> {
    let mut random = Random::new(seed);
    let down = |x: f64, y: f64| vertex([x, y, -850.0], Pen::Down);
    let corner = |turn: f64, leg: f64| {
        let end = [leg * turn.cos(), leg * turn.sin()];
        [[-leg, 0.0], [0.0, 0.0], end].map(|[x, y]| down(x, y)).to_vec()
    };
    let mut paths: Vec<Vec<Vertex>> = (0..8)
        .map(|_| corner(random.between(0.1, 2.88), 10.0_f64.powf(random.between(-2.0, 1.3))))
        .collect();
    // Just below the turn beyond which the path stops: the sharpest peak.
    paths.push(corner(2.879, 10.0));
    let (radius, step) = (10.0_f64.powf(random.between(-1.5, 1.0)), random.between(0.05, 0.6));
    let round = |k: u32| step * f64::from(k);
    paths.push(
        (0..40)
            .map(|k| down(radius * round(k).cos(), radius * round(k).sin()))
            .collect(),
    );
    paths
}
