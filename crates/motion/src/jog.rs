//! Jogging: follows a velocity while the command is repeated, and never leaves the work area.
//!
//! The velocity approaches the wanted one with a bounded acceleration. Before each millisecond the point at which the
//! motion would come to rest is checked. If that point lies outside the work area the motion slows down instead, unless
//! the robot is outside already and moves inwards. When the command is not repeated within the dead-man time, the
//! wanted velocity becomes zero. A jog whose direction is blocked is refused at the start.

use super::delay_line::PathSample;
use super::limits::Limits;
use super::scan::Row;
use super::shaping::Label;
use super::work_area::{Outside, WorkArea};
use crate::robots::vector::{Vector, add_scaled, length, scale, subtract};
use crate::settings::TICK_S;

/// Fastest jog, mm/s.
const SPEED_MAX_MM_S: f64 = 250.0;
/// Part of the limits that a jog uses; the rest is for the curvature of the joints' motion.
const LIMIT_PART: f64 = 0.25;
/// Largest acceleration of a jog, mm/s2.
const ACCELERATION_MAX_MM_S2: f64 = 2_000.0;
/// Margin kept beyond the point of rest, in braking distances.
const BRAKING_ROOM: f64 = 1.25;
/// Margin kept beyond the point of rest, mm.
const ROOM_MM: f64 = 0.5;
/// Distance that has to be free for a jog to begin, mm: more than the margin that a jog keeps from a border.
const START_MM: f64 = 0.75;
/// Speed below which the direction of a jog is not checked, mm/s.
const SPEED_MIN_MM_S: f64 = 1.0e-3;

/// Checks that a jog with a velocity from a point is not blocked.
///
/// # Errors
/// The limit that blocks the jog.
pub(crate) fn check(area: &WorkArea, point: &Vector, velocity_mm_s: &Vector) -> Result<(), Outside> {
    let speed = length(velocity_mm_s);
    if speed < SPEED_MIN_MM_S {
        return Ok(());
    }
    let ahead = add_scaled(point, velocity_mm_s, START_MM / speed);
    area.check_step(&(*point).into(), &ahead.into())
}

/// A jog in progress.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Jog {
    point: Vector,
    velocity: Vector,
    wanted: Vector,
    silent_ms: u16,
    heading: f64,
    label: Label,
}

impl Jog {
    pub(crate) fn new(at: &PathSample) -> Self {
        Self {
            point: at.point,
            velocity: [0.0; 3],
            wanted: [0.0; 3],
            silent_ms: 0,
            heading: at.heading,
            label: at.label,
        }
    }

    /// Takes a repeated command, mm/s.
    pub(crate) fn want(&mut self, velocity_mm_s: &Vector) {
        self.wanted = *velocity_mm_s;
        self.silent_ms = 0;
    }

    /// Advances by one millisecond; returns the position and whether the jog is at rest.
    pub(crate) fn next_millisecond(
        &mut self,
        area: &WorkArea,
        limits: &Limits,
        dead_man_ms: u16,
    ) -> (PathSample, bool) {
        self.silent_ms = self.silent_ms.saturating_add(1);
        if self.silent_ms > dead_man_ms {
            self.wanted = [0.0; 3];
        }
        let (speed_max, acceleration) = self.bounds(area, limits);
        let wanted_speed = length(&self.wanted);
        let wanted = if wanted_speed > speed_max {
            scale(&self.wanted, speed_max / wanted_speed)
        } else {
            self.wanted
        };
        let next = approach(&self.velocity, &wanted, acceleration * TICK_S);
        let stays_inside = |velocity: &Vector| {
            let speed = length(velocity);
            let room = BRAKING_ROOM * speed * speed / (2.0 * acceleration) + ROOM_MM;
            let rest = if speed > 0.0 {
                add_scaled(&self.point, velocity, TICK_S + room / speed)
            } else {
                self.point
            };
            area.check_step(&self.point.into(), &rest.into()).is_ok()
        };
        self.velocity = if stays_inside(&next) {
            next
        } else {
            approach(&self.velocity, &[0.0; 3], acceleration * TICK_S)
        };
        self.point = add_scaled(&self.point, &self.velocity, TICK_S);
        let sample = PathSample {
            point: self.point,
            heading: self.heading,
            label: self.label,
        };
        (sample, self.velocity == [0.0; 3] && self.wanted == [0.0; 3])
    }

    /// Speed and acceleration that the joints allow at this position in every direction.
    fn bounds(&self, area: &WorkArea, limits: &Limits) -> (f64, f64) {
        let mut speed = SPEED_MAX_MM_S * SPEED_MAX_MM_S;
        let mut acceleration = ACCELERATION_MAX_MM_S2.min(LIMIT_PART * limits.acceleration);
        speed = speed.min(limits.path_speed_squared(false));
        if limits.pen_limited {
            speed = speed.min(limits.pen_speed_squared);
            acceleration = acceleration.min(limits.pen_acceleration);
        }
        for axis in 0..3 {
            let mut direction = [0.0; 3];
            direction[axis] = 1.0;
            let rows = area.kinematics().rows(&self.point, &direction, &[0.0; 3]);
            let row = Row {
                joints: rows,
                ..Row::NONE
            };
            speed = speed.min(LIMIT_PART * limits.cap(&row));
            let joints = rows.slope.iter().zip(&rows.bend).zip(&limits.joint_acceleration);
            for ((slope, bend), limit) in joints {
                if slope.abs() * acceleration > LIMIT_PART * limit {
                    acceleration = LIMIT_PART * limit / slope.abs();
                }
                if bend.abs() * speed > LIMIT_PART * limit {
                    speed = LIMIT_PART * limit / bend.abs();
                }
            }
        }
        (crate::robots::vector::root(speed), acceleration)
    }
}

fn approach(from: &Vector, to: &Vector, step: f64) -> Vector {
    let way = subtract(to, from);
    let distance = length(&way);
    if distance <= step {
        *to
    } else {
        add_scaled(from, &way, step / distance)
    }
}
