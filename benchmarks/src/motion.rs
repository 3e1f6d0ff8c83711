//! Loads for the planner: paths and commands that make a period's work large.
//!
//! The trajectory stage is fed as the firmware feeds it. A load that does not come to rest at its end fails, so no figure
//! comes from work that was not done.

use etherpen::config::{Config, Orientation};
use etherpen::motion::{MotionCommand, MotionState, Pen, Trajectory, Vertex};
use etherpen::robots::{JointAngles, Kinematics, Position};

/// Vertices of a load at most.
pub const VERTICES_MAX: usize = 4096;
/// Periods that a load may take.
const PERIODS_MAX: u32 = 20_000;
/// Height of the pen on the paper, and above it, mm.
const DOWN_MM: f64 = -850.0;
const UP_MM: f64 = -847.0;

/// Paths of the samples, in the robot's frame.
const SQUARE: &str = include_str!("../../samples/motion/square.csv");
const CIRCLE: &str = include_str!("../../samples/motion/circle.csv");
const TEXT: &str = include_str!("../../samples/motion/text.csv");

/// A path with room for the longest.
pub struct Path {
    vertices: [Vertex; VERTICES_MAX],
    length: usize,
}

/// What is measured.
#[derive(Clone, Copy)]
pub struct Load {
    /// Its name.
    pub name: &'static str,
    /// Writes its path.
    pub path: fn(&mut Path),
    /// Changes the default configuration.
    pub limits: fn(&mut Config),
    /// Command of a period, by its number.
    pub command: fn(u32) -> Option<MotionCommand>,
}

/// What a load cost.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Counts of the costliest period.
    pub worst: u32,
    /// Counts of all periods.
    pub sum: u64,
    /// Periods.
    pub periods: u32,
}

impl Default for Path {
    fn default() -> Self {
        Self::new()
    }
}

impl Path {
    /// An empty path.
    pub const fn new() -> Self {
        let vertex = Vertex {
            position: Position {
                x_mm: 0.0,
                y_mm: 0.0,
                z_mm: 0.0,
            },
            pen: Pen::Up,
            stroke: 0,
        };
        Self {
            vertices: [vertex; VERTICES_MAX],
            length: 0,
        }
    }

    fn push(&mut self, [x_mm, y_mm, z_mm]: [f64; 3], pen: Pen) {
        if let Some(vertex) = self.vertices.get_mut(self.length) {
            vertex.position = Position { x_mm, y_mm, z_mm };
            vertex.pen = pen;
            self.length += 1;
        }
    }

    fn draw(&mut self, x_mm: f64, y_mm: f64) {
        self.push([x_mm, y_mm, DOWN_MM], Pen::Down);
    }

    fn as_slice(&self) -> &[Vertex] {
        self.vertices.get(..self.length).unwrap_or(&[])
    }
}

const fn load(name: &'static str, path: fn(&mut Path)) -> Load {
    Load {
        name,
        path,
        limits: |_| (),
        command: |_| None,
    }
}

/// Joints alone limit the speed.
fn joints_only(config: &mut Config) {
    config.motion.speed_mm_s = 1.0e5;
    config.motion.travel_speed_mm_s = 1.0e5;
    config.motion.acceleration_mm_s2 = 1.0e7;
    config.motion.jerk_window_ms = 0;
}

/// The speed changes every few periods, to the largest and the smallest.
fn overrides(period: u32) -> Option<MotionCommand> {
    let percent = [200, 10, 150, 40, 100];
    period
        .is_multiple_of(5)
        .then(|| MotionCommand::Override(percent[(period / 5) as usize % percent.len()]))
}

/// Holds, and goes on a third of a second later.
fn holds(period: u32) -> Option<MotionCommand> {
    match period % 45 {
        15 => Some(MotionCommand::Hold),
        44 => Some(MotionCommand::Resume),
        _ => None,
    }
}

/// All loads.
pub const LOADS: [Load; 17] = [
    load("square", |path| read(path, SQUARE)),
    load("circle", |path| read(path, CIRCLE)),
    load("text", |path| read(path, TEXT)),
    Load {
        limits: joints_only,
        ..load("text/joints", |path| read(path, TEXT))
    },
    Load {
        limits: joints_only,
        ..load("circle/joints", |path| read(path, CIRCLE))
    },
    load("portrait", portrait),
    Load {
        limits: |config| config.motion.orientation = Orientation::Path,
        ..load("portrait/orientation", portrait)
    },
    Load {
        command: holds,
        ..load("portrait/holds", portrait)
    },
    Load {
        command: overrides,
        ..load("portrait/overrides", portrait)
    },
    load("zigzag/fine", |path| zigzag(path, 0.002)),
    load("zigzag/medium", |path| zigzag(path, 0.1)),
    Load {
        limits: joints_only,
        ..load("zigzag/coarse", |path| zigzag(path, 2.0))
    },
    load("dense", dense),
    Load {
        command: overrides,
        ..load("dense/overrides", dense)
    },
    Load {
        command: overrides,
        limits: joints_only,
        ..load("line/overrides", line)
    },
    load("random", |path| random(path, 3)),
    Load {
        limits: joints_only,
        command: overrides,
        ..load("random/overrides", |path| random(path, 4))
    },
];

/// Reads `x,y,z,pen` lines below a heading.
fn read(path: &mut Path, text: &str) {
    for line in text.lines().skip(1) {
        let mut values = line.split(',').map(|value| value.trim().parse::<f64>());
        if let (Some(Ok(x)), Some(Ok(y)), Some(Ok(z)), Some(Ok(pen))) =
            (values.next(), values.next(), values.next(), values.next())
        {
            path.push([x, y, z], if pen > 0.5 { Pen::Down } else { Pen::Up });
        }
    }
}

/// Strokes of short legs with lifts between them.
fn portrait(path: &mut Path) {
    let mut number = numbers(7);
    let (mut x, mut y) = (0.0, 0.0);
    for _ in 0..24 {
        x = (x + 8.0 * (number() - 0.5)).clamp(-80.0, 80.0);
        y = (y + 8.0 * (number() - 0.5)).clamp(-80.0, 80.0);
        path.push([x, y, UP_MM], Pen::Up);
        path.push([x, y, DOWN_MM], Pen::Up);
        let (mut dx, mut dy) = (1.0, 0.0);
        for _ in 0..40 {
            let turn = 0.5 * (number() - 0.5);
            (dx, dy) = (dx - turn * dy, dy + turn * dx);
            let step = 0.3 + 1.2 * number();
            x += step * dx;
            y += step * dy;
            if x.abs() > 90.0 || y.abs() > 90.0 {
                (dx, dy) = (-dx, -dy);
            }
            path.draw(x.clamp(-95.0, 95.0), y.clamp(-95.0, 95.0));
        }
        path.push([x.clamp(-95.0, 95.0), y.clamp(-95.0, 95.0), UP_MM], Pen::Up);
    }
}

fn zigzag(path: &mut Path, step_mm: f64) {
    for index in 0..1_500u32 {
        let along = step_mm * f64::from(index);
        path.draw(
            along % 100.0,
            step_mm * f64::from(index % 2) + (along / 100.0) as u32 as f64,
        );
    }
}

/// A gentle curve of legs of 20 micrometres: as many vertices in a period as the queue takes.
fn dense(path: &mut Path) {
    for index in 0..4_000u32 {
        let along = 0.02 * f64::from(index);
        path.draw(along, 0.002 * along * along);
    }
}

fn line(path: &mut Path) {
    for index in 0..8u32 {
        path.draw(-400.0 + 800.0 * f64::from(index % 2), 2.0 * f64::from(index));
    }
}

/// Legs of any length and direction.
fn random(path: &mut Path, seed: u64) {
    let mut number = numbers(seed);
    for _ in 0..400 {
        let scale = if number() < 0.5 { 1.0 } else { 60.0 };
        path.draw(scale * (number() - 0.5), scale * (number() - 0.5));
    }
}

/// Seeded numbers from 0 to 1.
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Runs a load; `now` is a clock that counts instructions.
///
/// # Panics
/// The planner does not finish the path.
pub fn run(trajectory: &mut Trajectory, path: &mut Path, load: &Load, now: fn() -> u32) -> Cost {
    let mut config = Config::default();
    (load.limits)(&mut config);
    path.length = 0;
    (load.path)(path);
    let vertices = path.as_slice();
    place(trajectory, &config, vertices);
    let (mut cost, mut pushed) = (Cost::default(), 0);
    while cost.periods < PERIODS_MAX {
        let command = (load.command)(cost.periods);
        let start = now();
        while trajectory.free() > 0 && pushed < vertices.len() {
            let taken = trajectory.push(vertices[pushed]);
            assert!(taken.is_ok(), "{}: vertex {pushed} is refused: {taken:?}", load.name);
            pushed += 1;
        }
        if pushed == vertices.len() {
            trajectory.finish();
        }
        if cost.periods == 0 {
            assert_eq!(trajectory.command(MotionCommand::Start), Ok(()), "{}", load.name);
        }
        if let Some(command) = command {
            // A command may meet a state that does not take it.
            let _ = trajectory.command(command);
        }
        let references = trajectory.step();
        let counts = now().wrapping_sub(start);
        core::hint::black_box(references);
        cost.worst = cost.worst.max(counts);
        cost.sum += u64::from(counts);
        cost.periods += 1;
        if trajectory.state() == MotionState::Idle && trajectory.executed() as usize == vertices.len() {
            return cost;
        }
    }
    panic!(
        "{}: {} of {} executed",
        load.name,
        trajectory.executed(),
        vertices.len()
    );
}

fn place(trajectory: &mut Trajectory, config: &Config, vertices: &[Vertex]) {
    let first = vertices.first().map(|vertex| vertex.position).unwrap_or_default();
    let kinematics = Kinematics::new(&config.geometry).expect("the default robot");
    let [a, b, c] = kinematics.inverse(&first).expect("a place that can be reached");
    trajectory
        .reconfigure(&config.motion_settings())
        .expect("the default robot");
    assert!(trajectory.place(JointAngles([a, b, c, 0.0])));
}
