//! Supervision of the axes: the faults that the critical tasks detect and answer with a quick stop.
//!
//! One [`Supervision`] is stepped every millisecond in the critical task, with bounded work and without a lock. It
//! latches the first cause until a slower task clears it; later causes do not replace the first.

use crate::application::Fault;
use crate::board::Interlock;
use crate::config::{Axis, Bus};
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
}

/// AL state OP without the error flag.
const AL_OPERATIONAL: u8 = 8;

/// Latches the first cause of a quick stop.
#[derive(Debug)]
pub struct Supervision {
    fault: Option<Fault>,
    blind_ms: [u16; AXES],
    clamped: [u8; AXES],
    window_ms: u16,
    late: u16,
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
            blind_ms: [0; AXES],
            clamped: [0; AXES],
            window_ms: 0,
            late: 0,
        }
    }

    /// The latched cause.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Clears the latched cause.
    pub fn clear(&mut self) {
        *self = Self::new();
    }

    /// Latches `fault` unless a cause is latched already.
    #[cold]
    pub fn latch(&mut self, fault: Fault) {
        self.fault.get_or_insert(fault);
    }

    /// Advances by one millisecond; returns the latched cause, if there is one.
    #[inline]
    pub fn step(&mut self, axes: &[Axis; AXES], bus: &Bus, seen: &Observation) -> Option<Fault> {
        if let Some(interlock) = seen.interlock {
            self.latch(interlock.fault());
        }
        self.count_late(bus, seen.late, seen.following);
        if seen.valid == [true; AXES] {
            self.blind_ms = [0; AXES];
        } else {
            self.count_blind(&seen.valid);
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
    fn count_blind(&mut self, valid: &[bool; AXES]) {
        for (ms, valid) in self.blind_ms.iter_mut().zip(valid) {
            *ms = if *valid { 0 } else { ms.saturating_add(1) };
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
            self.look_for_blind(bus.blind_max_ms);
        } else if let Some(al_state) = seen.al_status
            && al_state != AL_OPERATIONAL
        {
            // The supervisor determines which slave it is; until then 255 means any slave.
            self.latch(Fault::SlaveState {
                slave: u8::MAX,
                al_state,
                al_code: 0,
            });
        }
        if let Some(fault) = seen.clock {
            self.latch(fault);
        }
        if seen.underrun {
            self.latch(Fault::SetpointUnderrun);
        }
    }

    #[cold]
    fn look_for_blind(&mut self, limit_ms: u16) {
        let blind = self.blind_ms.map(|ms| ms > limit_ms);
        if blind.iter().all(|b| *b) {
            self.latch(Fault::Blind {
                blind_ms: self.blind_ms[0],
                limit_ms,
            });
        } else if let Some(axis) = blind.iter().position(|b| *b) {
            self.latch(Fault::SlaveLost { slave: axis as u8 });
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
mod tests {
    use super::*;

    fn well() -> Observation {
        Observation {
            valid: [true; AXES],
            following_error_rad: [0.0; AXES],
            output_rad_s: [0.0; AXES],
            status_word: [0x0637; AXES],
            drive_fault: [false; AXES],
            home_lost: [false; AXES],
            al_status: Some(AL_OPERATIONAL),
            clock: None,
            power: true,
            following: true,
            underrun: false,
            late: 0,
            interlock: None,
        }
    }

    fn run(cycles: usize, seen: &Observation) -> Option<Fault> {
        let mut supervision = Supervision::new();
        let (axes, bus) = ([Axis::default(); AXES], Bus::default());
        (0..cycles).find_map(|_| supervision.step(&axes, &bus, seen))
    }

    #[test]
    fn a_healthy_bus_never_faults() {
        assert_eq!(run(10_000, &well()), None);
    }

    #[test]
    fn blind_motion_lasts_for_the_configured_limit_and_no_longer() {
        let blind = Observation {
            valid: [false; AXES],
            al_status: None,
            ..well()
        };
        let limit_ms = Bus::default().blind_max_ms;
        assert_eq!(run(usize::from(limit_ms), &blind), None);
        assert_eq!(
            run(usize::from(limit_ms) + 1, &blind),
            Some(Fault::Blind {
                blind_ms: limit_ms + 1,
                limit_ms
            })
        );
    }

    #[test]
    fn a_lost_clock_stops_drives_that_have_power_and_no_others() {
        let fault = Fault::ClockLost {
            missing_cycles: 10,
            limit_cycles: 10,
        };
        let lost = Observation {
            clock: Some(fault),
            ..well()
        };
        assert_eq!(run(1, &lost), Some(fault));
        let off = Observation { power: false, ..lost };
        assert_eq!(run(100, &off), None);
    }

    #[test]
    fn an_interlock_is_latched_with_or_without_power_and_again_after_it_was_cleared() {
        for power in [true, false] {
            let open = Observation {
                interlock: Some(Interlock::EmergencyStop),
                power,
                following: power,
                ..well()
            };
            let expected = Some(Interlock::EmergencyStop.fault());
            let mut supervision = Supervision::new();
            let (axes, bus) = ([Axis::default(); AXES], Bus::default());
            for _ in 0..3 {
                assert_eq!(supervision.step(&axes, &bus, &open), expected);
                supervision.clear();
            }
            assert_eq!(supervision.step(&axes, &bus, &well()), None);
        }
    }

    #[test]
    fn one_silent_slave_is_named() {
        let lost = Observation {
            valid: [true, true, false, true],
            ..well()
        };
        assert_eq!(run(100, &lost), Some(Fault::SlaveLost { slave: 2 }));
    }

    #[test]
    fn a_following_error_above_its_limit_names_axis_value_and_limit() {
        let far = Observation {
            following_error_rad: [0.0, -0.06, 0.0, 0.0],
            ..well()
        };
        let expected = Fault::FollowingError {
            axis: 1,
            error_rad: 0.06,
            limit_rad: 0.05,
        };
        assert_eq!(run(1, &far), Some(expected));
    }

    #[test]
    fn a_position_that_is_not_a_number_stops_the_drives() {
        let broken = Observation {
            following_error_rad: [f64::NAN, 0.0, 0.0, 0.0],
            ..well()
        };
        assert!(matches!(run(1, &broken), Some(Fault::FollowingError { axis: 0, .. })));
    }

    #[test]
    fn an_output_at_the_clamp_faults_after_a_few_cycles_only() {
        let high = Observation {
            output_rad_s: [0.0, 0.0, 0.0, 30.0],
            ..well()
        };
        assert_eq!(run(usize::from(CLAMPED_CYCLES_MAX) - 1, &high), None);
        assert!(matches!(
            run(usize::from(CLAMPED_CYCLES_MAX), &high),
            Some(Fault::OutputLimit { axis: 3, .. })
        ));
    }

    #[test]
    fn more_late_cycles_than_configured_within_a_second_fault_when_something_moves() {
        let late = Observation { late: 1, ..well() };
        assert_eq!(run(10, &late), None);
        assert_eq!(run(11, &late), Some(Fault::CyclesLate { late: 11, limit: 10 }));
        assert_eq!(
            run(
                500,
                &Observation {
                    following: false,
                    ..late
                }
            ),
            None
        );
    }

    #[test]
    fn the_first_cause_stays_until_it_is_cleared() {
        let mut supervision = Supervision::new();
        supervision.latch(Fault::SetpointUnderrun);
        supervision.latch(Fault::ReferenceLost { axis: 0 });
        assert_eq!(supervision.fault(), Some(Fault::SetpointUnderrun));
        supervision.clear();
        assert_eq!(supervision.fault(), None);
    }

    #[test]
    fn nothing_that_moves_nothing_is_a_fault() {
        let idle = Observation {
            power: false,
            following: false,
            valid: [false; AXES],
            drive_fault: [true; AXES],
            ..well()
        };
        assert_eq!(run(100, &idle), None);
    }
}
