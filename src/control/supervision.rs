//! Supervision of the axes: the faults that the critical tasks detect and answer with a stop.
//!
//! One [`Supervision`] is stepped every millisecond in the critical task, with bounded work and without a lock. It
//! latches the first cause until a slower task clears it; later causes do not replace the first, except that a stop on the
//! path that fails replaces what ordered it.

use crate::application::Fault;
use crate::board::Interlock;
use crate::config::{Axis, Bus};
use crate::control::io::IoStop;
use crate::robots::AXES;

/// Consecutive cycles with a clamped output that cause a fault.
pub const CLAMPED_CYCLES_MAX: u8 = 5;
/// Length of the window in which late cycles are counted, ms.
pub const LATE_WINDOW_MS: u16 = 1_000;

/// Inputs of the supervision for one millisecond.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    /// Whether each axis delivered a valid position in this cycle.
    pub valid: [bool; AXES],
    /// Axes whose drive has not confirmed the outputs of the cycle before, one bit each.
    pub unconfirmed: u32,
    /// Following error of each axis, rad.
    pub following_error_rad: [f64; AXES],
    /// Velocity command before the clamp, rad/s.
    pub output_rad_s: [f64; AXES],
    /// Status word of each axis's drive.
    pub status_word: [u16; AXES],
    /// Whether each drive reports a fault or has lost its power while it should have power.
    pub drive_fault: [bool; AXES],
    /// Whether each axis's position has been missing too long for the motor turn to be known.
    pub home_lost: [bool; AXES],
    /// AL states of all slaves OR-ed, with the error flag; `None` if the broadcast did not return.
    pub al_status: Option<u8>,
    /// Fault of the bus clock, if any.
    pub clock: Option<Fault>,
    /// Whether the drives should have power.
    pub power: bool,
    /// Whether the drives follow setpoints.
    pub following: bool,
    /// Whether the ring of setpoints was empty.
    pub underrun: bool,
    /// Number of output telegrams since the last cycle that were late or not sent at all.
    pub late: u16,
    /// Board input that keeps the drives in quick stop.
    pub interlock: Option<Interlock>,
    /// Input of a terminal that stops the drives.
    pub io_stop: Option<IoStop>,
    /// Whether the bus has terminals whose failure is no fault.
    pub spares_terminals: bool,
}

/// Longest wait for the supervisor to find out that an unexpected AL state belongs to a terminal whose failure is no
/// fault, ms. A drive that leaves OP stops by itself, and the supervisor names it meanwhile.
pub const AL_UNEXPLAINED_MAX_MS: u8 = 60;

/// AL state OP without the error flag.
const AL_OPERATIONAL: u8 = 8;

/// Latches the first cause of a stop.
#[derive(Debug)]
pub struct Supervision {
    fault: Option<Fault>,
    /// Whether a cause has come, the latched one or a later one, that forbids braking on the path.
    stops_at_once: bool,
    blind_ms: [u16; AXES],
    /// How long each axis's drive has confirmed no outputs.
    unconfirmed_ms: [u16; AXES],
    clamped: [u8; AXES],
    window_ms: u16,
    late: u16,
    al_unexplained_ms: u8,
}

impl Default for Supervision {
    fn default() -> Self {
        Self::new()
    }
}

impl Supervision {
    /// A supervision with nothing latched.
    pub const fn new() -> Self {
        Self {
            fault: None,
            stops_at_once: false,
            blind_ms: [0; AXES],
            unconfirmed_ms: [0; AXES],
            clamped: [0; AXES],
            window_ms: 0,
            late: 0,
            al_unexplained_ms: 0,
        }
    }

    /// The latched cause.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Whether a cause has come that forbids braking on the path ([`Fault::keeps_path`]), be it the latched one or not.
    pub fn stops_at_once(&self) -> bool {
        self.stops_at_once
    }

    /// Clears the latched cause.
    pub fn clear(&mut self) {
        *self = Self::new();
    }

    /// Latches `fault` unless a cause is latched already. The failure of a stop replaces what ordered the stop.
    #[cold]
    pub fn latch(&mut self, fault: Fault) {
        let known = *self.fault.get_or_insert(fault);
        if fault.ends_stop_for(&known) {
            self.fault = Some(fault);
        }
        self.stops_at_once |= !fault.keeps_path();
    }

    /// Advances by one millisecond; returns the latched cause, if there is one.
    #[inline]
    pub fn step(&mut self, axes: &[Axis; AXES], bus: &Bus, seen: &Observation) -> Option<Fault> {
        if let Some(interlock) = seen.interlock {
            self.latch(interlock.fault());
        }
        if let Some(stop) = seen.io_stop {
            self.check_input(stop, seen.power);
        }
        self.count_late(bus, seen.late, seen.following);
        if seen.valid == [true; AXES] && seen.unconfirmed == 0 {
            (self.blind_ms, self.unconfirmed_ms) = ([0; AXES], [0; AXES]);
        } else {
            self.count_blind(&seen.valid, seen.unconfirmed);
        }
        if seen.home_lost != [false; AXES] && seen.following {
            self.check_homes(&seen.home_lost);
        }
        if seen.power {
            self.look_at_bus(bus, seen);
            if seen.drive_fault != [false; AXES] {
                self.check_drives(seen);
            }
        }
        if seen.following {
            self.check_axes(axes, seen);
        } else {
            self.clamped = [0; AXES];
        }
        self.fault
    }

    #[inline]
    fn count_late(&mut self, bus: &Bus, late: u16, following: bool) {
        self.late = self.late.saturating_add(late);
        if following && self.late > bus.late_max_per_s {
            self.latch(Fault::CyclesLate {
                late: self.late,
                limit: bus.late_max_per_s,
            });
        }
        self.window_ms += 1;
        if self.window_ms >= LATE_WINDOW_MS {
            (self.window_ms, self.late) = (0, 0);
        }
    }

    #[cold]
    fn count_blind(&mut self, valid: &[bool; AXES], unconfirmed: u32) {
        let next = |ms: u16, is_missing: bool| if is_missing { ms.saturating_add(1) } else { 0 };
        for (ms, valid) in self.blind_ms.iter_mut().zip(valid) {
            *ms = next(*ms, !valid);
        }
        for (axis, ms) in self.unconfirmed_ms.iter_mut().enumerate() {
            *ms = next(*ms, unconfirmed >> axis & 1 != 0);
        }
    }

    #[cold]
    fn check_homes(&mut self, lost: &[bool; AXES]) {
        for axis in (0u8..).zip(lost).filter_map(|(axis, lost)| lost.then_some(axis)) {
            self.latch(Fault::ReferenceLost { axis });
        }
    }

    #[inline]
    fn look_at_bus(&mut self, bus: &Bus, seen: &Observation) {
        if seen.valid != [true; AXES] {
            self.look_for_blind(bus);
        } else if let Some(al_state) = seen.al_status
            && al_state != AL_OPERATIONAL
        {
            self.question_state(al_state, seen.spares_terminals);
        } else {
            self.al_unexplained_ms = 0;
        }
        if seen.unconfirmed != 0 {
            self.look_for_lost_outputs(bus);
        }
        if let Some(fault) = seen.clock {
            self.latch(fault);
        }
        if seen.underrun {
            self.latch(Fault::SetpointUnderrun);
        }
    }

    /// Latches an input that stops the drives: without power only an open emergency stop.
    #[cold]
    fn check_input(&mut self, stop: IoStop, power: bool) {
        if power || stop.is_interlock() {
            self.latch(stop.fault());
        }
    }

    #[cold]
    fn question_state(&mut self, al_state: u8, spares_terminals: bool) {
        self.al_unexplained_ms = self.al_unexplained_ms.saturating_add(1);
        if !spares_terminals || self.al_unexplained_ms > AL_UNEXPLAINED_MAX_MS {
            // The supervisor determines which slave it is; until then 255 means any slave.
            self.latch(Fault::SlaveState {
                slave: u8::MAX,
                al_state,
                al_code: 0,
            });
        }
    }

    #[cold]
    fn look_for_blind(&mut self, bus: &Bus) {
        let limit_ms = bus.blind_max_ms;
        let blind = self.blind_ms.map(|ms| ms > limit_ms);
        // A missing axis is never blind.
        if blind.iter().take(bus.drives.into()).all(|b| *b) {
            self.latch(Fault::Blind {
                blind_ms: self.blind_ms[0],
                limit_ms,
            });
        } else if let Some(axis) = blind.iter().position(|b| *b) {
            self.latch(Fault::SlaveLost { slave: axis as u8 });
        }
    }

    /// The outputs of this cycle are the next ones that may be lost, so the limit is reached a cycle before it is
    /// exceeded. One lost telegram is never a fault.
    #[cold]
    fn look_for_lost_outputs(&mut self, bus: &Bus) {
        let limit_ms = bus.blind_max_ms;
        let lost = self.unconfirmed_ms.map(|ms| ms >= limit_ms.max(2));
        if let Some(axis) = lost.iter().position(|lost| *lost) {
            let all = lost.iter().take(bus.drives.into()).all(|lost| *lost);
            self.latch(Fault::OutputsLost {
                axis: (!all).then_some(axis as u8),
                lost_ms: self.unconfirmed_ms[axis],
                limit_ms,
            });
        }
    }

    #[cold]
    fn check_drives(&mut self, seen: &Observation) {
        for (axis, number) in (0..AXES).zip(0u8..) {
            if seen.drive_fault[axis] {
                self.latch(Fault::Drive {
                    axis: number,
                    status_word: seen.status_word[axis],
                });
            }
        }
    }

    #[inline]
    fn check_axes(&mut self, axes: &[Axis; AXES], seen: &Observation) {
        let (mut near, mut below) = (true, true);
        for (axis, limits) in axes.iter().enumerate() {
            // A NaN counts as neither near nor below its limit.
            near &= seen.following_error_rad[axis].abs() <= limits.following_error_max_rad;
            below &= seen.output_rad_s[axis].abs() <= limits.output_max_rad_s;
        }
        if !near {
            self.name_following_errors(axes, seen);
        }
        if below {
            self.clamped = [0; AXES];
        } else {
            self.count_clamped(axes, seen);
        }
    }

    #[cold]
    fn name_following_errors(&mut self, axes: &[Axis; AXES], seen: &Observation) {
        for (axis, number) in (0..AXES).zip(0u8..) {
            let (error, limit) = (seen.following_error_rad[axis].abs(), axes[axis].following_error_max_rad);
            if error.is_nan() || error > limit {
                self.latch(Fault::FollowingError {
                    axis: number,
                    error_rad: error as f32,
                    limit_rad: limit as f32,
                });
            }
        }
    }

    #[cold]
    fn count_clamped(&mut self, axes: &[Axis; AXES], seen: &Observation) {
        for (axis, number) in (0..AXES).zip(0u8..) {
            let (output, limit) = (seen.output_rad_s[axis].abs(), axes[axis].output_max_rad_s);
            self.clamped[axis] = if output <= limit {
                0
            } else {
                self.clamped[axis].saturating_add(1)
            };
            if self.clamped[axis] >= CLAMPED_CYCLES_MAX {
                let (output_rad_s, limit_rad_s) = (seen.output_rad_s[axis] as f32, limit as f32);
                self.latch(Fault::OutputLimit {
                    axis: number,
                    output_rad_s,
                    limit_rad_s,
                });
            }
        }
    }
}

#[cfg(test)]
mod tests;
