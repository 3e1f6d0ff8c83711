//! The sampler while it brakes on the path: the setpoints of [`PathStop`](crate::control::path_stop) take the place of the
//! ring's.
//!
//! Invariant: when a stop on the path ends by itself or by a fault, the drives' quick stop begins in the same millisecond; a stop
//! that has left its envelope is latched as [`Fault::PathStopLeft`] and counted. An order ends it too; while the robot stops, the
//! operating modes give none but the quick stop.

use super::Sampler;
use crate::application::{Fault, PathStopFailure, Power};
use crate::config::AxisMode;
use crate::control::path_stop::Progress;
use crate::control::position::PositionController;
use crate::drives::io::{IoGroup, IoTrigger};
use crate::robots::AXES;

impl<G: IoTrigger + IoGroup> Sampler<'_, G> {
    /// Begins a stop on the path; without a path, with drives or feedback in doubt, or if the quick stop itself takes too
    /// long, the drives' quick stop.
    #[cold]
    pub(super) fn stop_on_path(&mut self) {
        if self.path_stop.is_active() {
            return;
        }
        let may_keep = self.power == Power::On
            && self.epoch.is_some()
            && !self.supervision.stops_at_once()
            && self.robot.is_in_operation();
        let kept = self.setpoints_sent();
        let axes = self.axes.get(..self.used).unwrap_or_default();
        if !may_keep || !self.path_stop.begin(&mut self.window, kept, axes) {
            self.stop_at_once();
        }
    }

    /// Number of setpoints, from that of the last command on, that the last command has used: its feed-forward lies between
    /// the last two of them, or, for a torque, is the difference of the last two.
    fn setpoints_sent(&self) -> usize {
        let controllers = self.controllers.iter().zip(&self.velocity_controllers);
        let leads = self.axes.iter().zip(controllers).take(self.used);
        let leads = leads.map(|(axis, (controller, velocity_controller))| match axis.mode {
            AxisMode::Velocity => controller.lead().whole,
            AxisMode::Position => controller.lead().whole.max(controller.position_lead().whole),
            AxisMode::Torque => 1 + velocity_controller.lead().whole,
        });
        2 + leads.max().unwrap_or(0)
    }

    /// Orders the drives' quick stop.
    #[cold]
    pub(super) fn stop_at_once(&mut self) {
        self.power = Power::QuickStop;
        self.epoch = None;
        self.path_stop.end();
        self.end_search();
    }

    /// This millisecond's setpoint of a stop on the path. Returns what [`Self::next_setpoint`] does.
    #[cold]
    pub(super) fn stop_setpoint(&mut self) -> (bool, bool) {
        let axes = self.axes.get(..self.used).unwrap_or_default();
        let next = self
            .epoch
            .and_then(|epoch| self.path_stop.step(&mut self.setpoints, epoch, axes));
        let Some(next) = next else {
            self.leave_path(PathStopFailure::Dry);
            self.window.clear();
            return (false, true);
        };
        self.window.advance();
        self.window.push(&next);
        if let Some(setpoint) = self.window.first() {
            self.now.setpoint = *setpoint;
        }
        (true, false)
    }

    /// Watches a stop on the path, or begins one for a fault that has just been latched.
    #[cold]
    pub(super) fn watch_stop(&mut self) {
        let stops_at_once = self.supervision.stops_at_once();
        if !self.path_stop.is_active() {
            if self.power == Power::On && !stops_at_once {
                self.stop_on_path();
            }
            return;
        }
        if stops_at_once || !self.robot.is_in_operation() {
            return match self.farthest_from_path() {
                Some(failure) => self.leave_path(failure),
                None => self.stop_at_once(),
            };
        }
        let planned_rad_s = self.controllers.each_ref().map(PositionController::velocity_at_age);
        let measured_rad_s = self.now.measured_rad_s.get(..self.used).unwrap_or_default();
        match self.path_stop.watch(measured_rad_s, &planned_rad_s, self.still_ms) {
            Progress::Brakes => {}
            Progress::Stands => self.stop_at_once(),
            Progress::Left(failure) => self.leave_path(failure),
        }
    }

    /// Ends a stop on the path that has left its envelope by the drives' quick stop; latches and counts it. What was only
    /// predicted is no reason to name a joint: the bus is.
    #[cold]
    fn leave_path(&mut self, failure: PathStopFailure) {
        if failure == PathStopFailure::Dry || self.now.valid == [true; AXES] {
            let fault = Fault::PathStopLeft(failure);
            self.supervision.latch(fault);
            // Another fault of this millisecond explains more.
            if self.supervision.fault() == Some(fault) {
                self.counters.path_stops_left = self.counters.path_stops_left.wrapping_add(1);
            }
        }
        self.stop_at_once();
    }

    /// A joint that is farther from the path than its following error may be.
    #[cold]
    fn farthest_from_path(&self) -> Option<PathStopFailure> {
        let joints = self.axes.iter().zip(&self.controllers).zip(&self.now.measured_rad);
        let mut joints = (0..).zip(joints).take(self.used);
        joints.find_map(|(axis, ((config, controller), measured_rad))| {
            let error_rad = (controller.setpoint_at_age() - measured_rad).abs();
            let limit_rad = config.following_error_max_rad;
            let is_near = error_rad <= limit_rad;
            (!is_near).then_some(PathStopFailure::Distance {
                axis,
                error_rad: error_rad as f32,
                limit_rad: limit_rad as f32,
            })
        })
    }
}
