//! A straight move from rest to rest that does not belong to a path: lifting and lowering the pen, and moves to a
//! position.
//!
//! One speed and one acceleration apply to the whole line. They are chosen so that half of each joint's acceleration
//! limit covers the acceleration along the line and the other half its curvature in joint space, at every checked
//! point. That is slower than the plan's scan, but needs no look-ahead and can be stopped at any time.

use super::delay_line::PathSample;
use super::limits::Limits;
use super::scan::Row;
use super::shaping::Label;
use crate::Pen;
use crate::robots::Kinematics;
use crate::robots::vector::{Vector, add_scaled, length, root, scale, subtract};
use crate::settings::TICK_S;

/// Points of the line at which the limits are evaluated.
const CHECKS: u32 = 33;
/// Part of a joint's acceleration limit for the acceleration along the line; the rest is for the curvature.
const SHARE: f64 = 0.5;
/// Moves shorter than this are ignored, mm.
const LENGTH_MIN_MM: f64 = 1.0e-6;

/// A straight move in progress.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Straight {
    from: Vector,
    direction: Vector,
    heading: f64,
    length_mm: f64,
    speed: f64,
    acceleration: f64,
    elapsed_s: f64,
    /// Position at which braking began, the speed there, and the time since then.
    braking: Option<(f64, f64, f64)>,
    /// Label during the move.
    pub(crate) label: Label,
}

impl Straight {
    /// A move from the present position to `to`; the fourth axis keeps its angle.
    pub(crate) fn new(kinematics: &Kinematics, limits: &Limits, here: &PathSample, to: &Vector, label: Label) -> Self {
        let from = &here.point;
        let line = subtract(to, from);
        let length_mm = length(&line);
        let direction = scale(
            &line,
            if length_mm > LENGTH_MIN_MM {
                1.0 / length_mm
            } else {
                0.0
            },
        );
        let mut row = Row {
            rise: direction[2],
            ..Row::NONE
        };
        let mut speed_squared = limits.path_speed_squared(false);
        let mut acceleration = limits.acceleration;
        if limits.pen_limited {
            speed_squared = limits.cap_pen(speed_squared, &row);
            if row.rise.abs() * acceleration > limits.pen_acceleration {
                acceleration = limits.pen_acceleration / row.rise.abs();
            }
        }
        for check in 0..CHECKS {
            let place = length_mm * f64::from(check) / f64::from(CHECKS - 1);
            let rows = kinematics.rows(&add_scaled(from, &direction, place), &direction, &[0.0; 3]);
            row.joints = rows;
            speed_squared = speed_squared.min(limits.cap(&row));
            let joints = rows.slope.iter().zip(&rows.bend).zip(&limits.joint_acceleration);
            for ((slope, bend), limit) in joints {
                if slope.abs() * acceleration > SHARE * limit {
                    acceleration = SHARE * limit / slope.abs();
                }
                if bend.abs() * speed_squared > (1.0 - SHARE) * limit {
                    speed_squared = (1.0 - SHARE) * limit / bend.abs();
                }
            }
        }
        let speed = root(speed_squared.min(acceleration * length_mm));
        Self {
            from: *from,
            direction,
            heading: here.heading,
            length_mm: if length_mm > LENGTH_MIN_MM { length_mm } else { 0.0 },
            speed,
            acceleration,
            elapsed_s: 0.0,
            braking: None,
            label,
        }
    }

    /// Where the move began.
    pub(crate) fn from(&self) -> &Vector {
        &self.from
    }

    fn duration_s(&self) -> f64 {
        if self.speed > 0.0 {
            self.length_mm / self.speed + self.speed / self.acceleration
        } else {
            0.0
        }
    }

    /// Position and speed at a time of the undisturbed move.
    fn state(&self, time_s: f64) -> (f64, f64) {
        let ramp_s = if self.speed > 0.0 {
            self.speed / self.acceleration
        } else {
            0.0
        };
        let left_s = self.duration_s() - time_s;
        if left_s <= 0.0 {
            (self.length_mm, 0.0)
        } else if time_s < ramp_s.min(left_s) {
            (0.5 * self.acceleration * time_s * time_s, self.acceleration * time_s)
        } else if left_s < ramp_s {
            (
                self.length_mm - 0.5 * self.acceleration * left_s * left_s,
                self.acceleration * left_s,
            )
        } else {
            (self.speed * (time_s - 0.5 * ramp_s), self.speed)
        }
    }

    /// Ends the move as soon as its acceleration limit allows. A pen that does not get down any more is up.
    pub(crate) fn brake(&mut self) {
        if self.braking.is_none() {
            let (place, speed) = self.state(self.elapsed_s);
            self.braking = Some((place, speed, 0.0));
            let gets_there = self.length_mm - place <= 0.5 * speed * speed / self.acceleration + LENGTH_MIN_MM;
            if !gets_there {
                self.label.pen = Pen::Up;
            }
        }
    }

    /// Advances by one millisecond; returns the position and whether the move has ended.
    pub(crate) fn next_millisecond(&mut self) -> (PathSample, bool) {
        let (place, done) = match self.braking.as_mut() {
            None => {
                self.elapsed_s += TICK_S;
                (self.state(self.elapsed_s).0, self.elapsed_s >= self.duration_s())
            }
            Some((start, speed, time_s)) => {
                *time_s += TICK_S;
                let stop_s = *speed / self.acceleration;
                let time_s = time_s.min(stop_s);
                (
                    (*start + time_s * (*speed - 0.5 * self.acceleration * time_s)).min(self.length_mm),
                    time_s >= stop_s,
                )
            }
        };
        let sample = PathSample {
            point: add_scaled(&self.from, &self.direction, place),
            heading: self.heading,
            label: self.label,
        };
        (sample, done)
    }
}
