//! Requirements on the whole trajectory stage, checked on every 1 ms setpoint.
//!
//! This file holds the harness: a run of the stage over a path, and the checks of its setpoints. The requirements are
//! in the other files of this folder.

mod bad_input;
mod commands;
mod drawing_speed;
mod executed;
mod merging;
mod noise;
mod orientation;
mod paths;
mod pen;
mod promptness;
mod properties;
mod slow;
mod tolerance;
mod vibration;

extern crate std;

use super::*;
use crate::random::Random;
use crate::robots::vector::{Vector, add_scaled, dot, length, subtract};
use crate::robots::{JointAngles, Kind, Kinematics};
use crate::settings::Settings;
use crate::settings::TICK_S;
use core::f64::consts::{PI, TAU};
use std::vec::Vec;
use std::{format, println};

/// Relative excess over a limit that is tolerated.
const EXCESS: f64 = 1.0e-3;
/// Kinds of limits: joint speed and acceleration, Cartesian speed and acceleration, jerk.
const KINDS: usize = 5;
/// Periods after which a run counts as stuck.
const PERIODS_MAX: usize = 60_000;

fn vertex(point: Vector, pen: Pen, stroke: u32) -> Vertex {
    Vertex {
        position: point.into(),
        pen,
        stroke,
    }
}

/// Another kind's machine on which the tests' paths are drawn as on the default one.
struct Bench {
    settings: Settings,
    /// Size of a path against the default machine's: that at which a square of ±150 mm around the middle of the sheet lies
    /// inside the work area, 1 at most.
    scale: f64,
}

impl Bench {
    /// The usual machine of a kind.
    fn new(kind: Kind) -> Self {
        let settings = Settings::usual(kind.geometry());
        let scale = match kind {
            Kind::Delta | Kind::Gantry | Kind::CoreXy => 1.0,
            Kind::Scara => 0.5,
            Kind::LinearDelta => 0.4,
        };
        assert_eq!(settings.check(), Ok(()), "{kind:?}");
        Self { settings, scale }
    }

    /// A path of the default machine where this machine's sheet lies.
    fn fitted(&self, path: &[Vertex]) -> Vec<Vertex> {
        let (paper, default) = (&self.settings.paper, Settings::default().paper);
        let [x, y] = paper.centre_mm;
        let moved = |at: &Vertex| {
            let point = Vector::from(at.position);
            let height = point[2] - default.pen_down_z_mm;
            let place = [
                x + self.scale * point[0],
                y + self.scale * point[1],
                paper.pen_down_z_mm + height,
            ];
            vertex(place, at.pen, at.stroke)
        };
        path.iter().map(moved).collect()
    }
}

fn placed(settings: &Settings, point: Vector) -> Trajectory {
    let mut trajectory = Trajectory::new(settings).unwrap();
    let [a, b, c] = Kinematics::new(&settings.geometry)
        .unwrap()
        .inverse(&point.into())
        .unwrap();
    assert!(trajectory.place(JointAngles([a, b, c, 0.0])));
    trajectory
}

/// A run: the stage, the vertices still to be pushed, and all setpoints so far.
struct Run {
    settings: Settings,
    trajectory: Trajectory,
    path: Vec<Vertex>,
    pushed: usize,
    setpoints: Vec<Setpoint>,
    work_max: u32,
    work_sum: u64,
}

impl Run {
    /// At rest at the path's first vertex.
    fn new(settings: &Settings, path: &[Vertex]) -> Self {
        let mut run = Self {
            settings: settings.clone(),
            trajectory: placed(settings, path[0].position.into()),
            path: path.to_vec(),
            pushed: 0,
            setpoints: Vec::new(),
            work_max: 0,
            work_sum: 0,
        };
        run.step();
        run
    }

    fn feed(&mut self, at_most: usize) {
        let mut left = at_most;
        while left > 0 && self.pushed < self.path.len() && self.trajectory.free() > 0 {
            self.trajectory.push(self.path[self.pushed]).unwrap();
            self.pushed += 1;
            left -= 1;
        }
        if self.pushed == self.path.len() {
            self.trajectory.finish();
        }
    }

    fn step(&mut self) {
        self.setpoints.extend(self.trajectory.step());
        self.work_max = self.work_max.max(self.trajectory.work());
        self.work_sum += u64::from(self.trajectory.work());
    }

    fn command(&mut self, command: MotionCommand) {
        self.trajectory.command(command).unwrap();
    }

    fn until(&mut self, state: MotionState) {
        for _ in 0..PERIODS_MAX {
            self.feed(usize::MAX);
            self.step();
            if self.trajectory.state() == state {
                return;
            }
        }
        panic!(
            "{:?} instead of {state:?}, {} of {} executed",
            self.trajectory.state(),
            self.trajectory.executed(),
            self.path.len()
        );
    }

    fn whole(mut self) -> Self {
        self.feed(usize::MAX);
        self.command(MotionCommand::Start);
        self.until(MotionState::Idle);
        self
    }

    fn duration_s(&self) -> f64 {
        let last = self.setpoints.last().unwrap().position_rad;
        let still = self
            .setpoints
            .iter()
            .take_while(|r| r.velocity_rad_s == [0.0; AXES])
            .count();
        let moving = self.setpoints.iter().rposition(|r| r.position_rad != last);
        moving.map_or(0.0, |index| (index + 2).saturating_sub(still) as f64 * TICK_S)
    }

    /// Checks speeds and accelerations of every sample, and rest at the end. Returns the largest values as parts of the
    /// limits.
    fn check_limits(&self, name: &str) -> [f64; KINDS] {
        let motion = &self.settings.motion;
        let kinematics = Kinematics::new(&self.settings.geometry).unwrap();
        let point = |r: &Setpoint| Vector::from(kinematics.forward(&JointAngles(r.position_rad)).unwrap());
        let mut worst = [0.0_f64; KINDS];
        let mut note = |kind: usize, value: f64, limit: f64, at: usize| {
            worst[kind] = worst[kind].max(value / limit);
            assert!(
                value <= limit * (1.0 + EXCESS),
                "{name}: kind {kind} {value} over {limit} at {at} ms"
            );
        };
        let window_ms = crate::settings::averaging::averaging(&self.settings.motion).0;
        let jerk_s = f64::from(window_ms) * TICK_S;
        let mut accelerations = [0.0; AXES];
        let mut before: Option<(Vector, Vector, Setpoint)> = None;
        for (at, setpoint) in self.setpoints.iter().enumerate() {
            let here = point(setpoint);
            let Some((last, last_velocity, last_setpoint)) = before else {
                before = Some((here, [0.0; 3], *setpoint));
                continue;
            };
            for (axis, acceleration_before) in accelerations.iter_mut().enumerate() {
                let velocity = setpoint.velocity_rad_s[axis];
                let difference = (setpoint.position_rad[axis] - last_setpoint.position_rad[axis]) / TICK_S;
                assert!((velocity - difference).abs() < 1.0e-8, "{name}: axis {axis} at {at} ms");
                note(0, velocity.abs(), motion.joint_speed_rad_s[axis], at);
                let acceleration = (velocity - last_setpoint.velocity_rad_s[axis]) / TICK_S;
                let limit = motion.joint_acceleration_rad_s2[axis];
                note(1, acceleration.abs(), limit, at);
                let jerk = (acceleration - *acceleration_before).abs() / TICK_S;
                if window_ms > 1 {
                    // Differences of positions that count in 2^-40 rad are exact to 1 rad/s3.
                    note(4, jerk, 2.0 * limit / jerk_s + 1.0, at);
                }
                *acceleration_before = acceleration;
            }
            let velocity = subtract(&here, &last).map(|d| d / TICK_S);
            let drawn = setpoint.pen == Pen::Down && last_setpoint.pen == Pen::Down;
            let speed_max = if drawn {
                motion.speed_mm_s
            } else {
                motion.travel_speed_mm_s
            };
            note(2, length(&velocity), speed_max, at);
            let acceleration = length(&subtract(&velocity, &last_velocity)) / TICK_S;
            note(3, acceleration, motion.acceleration_mm_s2 + 0.1, at);
            before = Some((here, velocity, *setpoint));
        }
        let last = self.setpoints.last().unwrap();
        assert_eq!(last.velocity_rad_s, [0.0; AXES], "{name}: not at rest");
        worst
    }

    /// For each setpoint the vertex reported two reports earlier, and that three reports later: a leg may replace those
    /// between two reports.
    fn reported(&self) -> Vec<[usize; 2]> {
        let vertices = || self.setpoints.iter().map(|setpoint| setpoint.vertex as usize);
        let mut reports: Vec<usize> = vertices().collect();
        reports.sort_unstable();
        reports.dedup();
        let around = |vertex| {
            let at = reports.partition_point(|report| *report < vertex);
            let later = reports.get(at + 3).copied().unwrap_or(self.path.len());
            [reports[at.saturating_sub(2)], later]
        };
        vertices().map(around).collect()
    }

    /// Largest distance of the setpoints from the path, near the vertices that they report.
    fn deviation(&self) -> (f64, f64) {
        let kinematics = Kinematics::new(&self.settings.geometry).unwrap();
        let mut worst = (0.0_f64, 0.0_f64);
        for (setpoint, reported) in self.setpoints.iter().zip(self.reported()) {
            let at = Vector::from(kinematics.forward(&JointAngles(setpoint.position_rad)).unwrap());
            let near = setpoint.vertex as usize;
            let from = near.saturating_sub(8).min(reported[0]);
            let to = (near + 9).max(reported[1] + 1).min(self.path.len());
            let distance = self.path[from..to]
                .windows(2)
                .map(|leg| distance(&at, &leg[0].position.into(), &leg[1].position.into()))
                .fold(f64::INFINITY, f64::min);
            if setpoint.pen == Pen::Down {
                worst.0 = worst.0.max(distance);
            } else {
                worst.1 = worst.1.max(distance);
            }
        }
        worst
    }

    /// Checks the deviation with the pen down only: a hold has lifted the pen off the path.
    fn check_drawn(&self, name: &str) {
        let (drawn, limit) = (self.deviation().0, self.settings.motion.tolerance_mm);
        assert!(drawn <= limit * (1.0 + EXCESS), "{name}: {drawn} mm off");
    }

    fn check_deviation(&self, name: &str) {
        let (drawn, travelled) = self.deviation();
        let motion = &self.settings.motion;
        assert!(drawn <= motion.tolerance_mm * (1.0 + EXCESS), "{name}: {drawn} mm off");
        assert!(
            travelled <= motion.travel_tolerance_mm * (1.0 + EXCESS),
            "{name}: {travelled} mm off with the pen up"
        );
    }

    fn end(&self) -> Vector {
        let kinematics = Kinematics::new(&self.settings.geometry).unwrap();
        kinematics
            .forward(&JointAngles(self.setpoints.last().unwrap().position_rad))
            .unwrap()
            .into()
    }
}

fn distance(point: &Vector, from: &Vector, to: &Vector) -> f64 {
    let leg = subtract(to, from);
    let along = dot(&subtract(point, from), &leg) / dot(&leg, &leg).max(f64::MIN_POSITIVE);
    length(&subtract(point, &add_scaled(from, &leg, along.clamp(0.0, 1.0))))
}

/// Strokes of a random character with lifts between them.
fn random_path(random: &mut Random, strokes: usize) -> Vec<Vertex> {
    let (down, up) = (-850.0, -847.0);
    let mut path: Vec<Vertex> = Vec::new();
    for stroke in 0..strokes as u32 {
        let mut point = [random.between(-90.0, 90.0), random.between(-90.0, 90.0), up];
        path.push(vertex(point, Pen::Up, stroke));
        point[2] = down;
        path.push(vertex(point, Pen::Up, stroke));
        let kind = random.below(5);
        let mut heading = random.between(0.0, TAU);
        for _ in 0..2 + random.below(30) {
            let (turn, leg) = match kind {
                0 => (random.between(-0.3, 0.3), random.between(0.3, 2.0)),
                1 => (random.between(-PI, PI), random.between(0.3, 20.0)),
                2 => (random.between(-0.1, 0.1), random.between(0.05, 0.4)),
                3 => (random.between(-PI, PI), random.between(0.001, 0.05)),
                _ => {
                    let turns = [0.0, 1.57, PI, -2.0];
                    (turns[random.below(4)], random.between(0.01, 8.0))
                }
            };
            heading += turn;
            point[0] = (point[0] + leg * libm::cos(heading)).clamp(-110.0, 110.0);
            point[1] = (point[1] + leg * libm::sin(heading)).clamp(-110.0, 110.0);
            path.push(vertex(point, Pen::Down, stroke));
        }
        point[2] = up;
        path.push(vertex(point, Pen::Up, stroke));
    }
    path
}

/// A portrait's load: strokes of short segments, lifts of 3 mm.
fn portrait(random: &mut Random, strokes: u32) -> (Vec<Vertex>, f64) {
    let (mut path, mut drawn_mm) = (Vec::new(), 0.0);
    for stroke in 0..strokes {
        let start = [random.between(-60.0, 60.0), random.between(-60.0, 60.0), -847.0];
        let mut point = path.last().map_or(start, |last: &Vertex| {
            let last = Vector::from(last.position);
            [
                last[0] + random.between(-4.0, 4.0),
                last[1] + random.between(-4.0, 4.0),
                -847.0,
            ]
        });
        path.push(vertex(point, Pen::Up, stroke));
        point[2] = -850.0;
        path.push(vertex(point, Pen::Up, stroke));
        let mut heading = random.between(0.0, TAU);
        for _ in 0..30 {
            heading += random.between(-0.25, 0.25);
            let leg = random.between(0.3, 2.0);
            drawn_mm += leg;
            point[0] += leg * libm::cos(heading);
            point[1] += leg * libm::sin(heading);
            path.push(vertex(point, Pen::Down, stroke));
        }
        point[2] = -847.0;
        path.push(vertex(point, Pen::Up, stroke));
    }
    (path, drawn_mm)
}
