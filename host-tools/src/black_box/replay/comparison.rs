//! Compares the replay with the recording, millisecond by millisecond.

use super::super::contents::SampleEntry;
use super::SETTLED_MS;
use super::events::{EVENT_MS, Events, FAULT_EVENT_MS};
use etherpen::application::{Fault, StopSource};
use etherpen::config::{AxisMode, Config};
use etherpen::control::sampler::{CycleReport, STANDSTILL_MS};
use etherpen::robots::AXES;
use std::f64::consts::TAU;
use std::fmt::Debug;

/// For an axis that has not had a position yet.
const NEVER: u16 = u16::MAX;
/// Positions that make a speed.
const SPEED_POSITIONS: u16 = 2;
/// A value up to this share of its limit exceeds it by what rounding may decide.
const LIMIT_SHARE: f32 = 1.01;
/// Relative rounding of a number in single precision.
const ROUNDING: f64 = 1.2e-7;

/// What a millisecond has shown.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Finding {
    /// Recording and replay agree. A fault may have latched in both: the recorded one, or `None` if its event is missing
    /// or is that of another task.
    Agreed { latched: Option<Option<Fault>> },
    /// A fault whose cause the samples do not hold, or not all of it; `None` if its event has been overwritten.
    NotRecorded(Option<Fault>),
    /// What differs, in words.
    Differs(String),
}

/// The comparison so far.
pub(super) struct Comparison<'a> {
    config: &'a Config,
    events: Events<'a>,
    /// Whether the drives had no power when the replay began.
    begins_without_power: bool,
    /// Whether no fault of before the recording can be latched.
    knows_fault: bool,
    was_latched: bool,
    /// Whether all axes were homed in the last sample.
    was_homed: bool,
    /// Whether a search for the home switches has begun since: it counts from turns that no sample tells.
    has_searched: bool,
    /// By how much the replay's angles are greater, rad: whole turns of motors that are not homed.
    turns_rad: [f64; AXES],
    /// Milliseconds since each axis's last position, or [`NEVER`].
    blind_ms: [u16; AXES],
    /// Milliseconds since each axis has a speed.
    seen_ms: [u16; AXES],
    /// Positions that each axis has shown.
    positions: [u16; AXES],
}

impl<'a> Comparison<'a> {
    pub(super) fn new(
        config: &'a Config,
        events: Events<'a>,
        begins_without_power: bool,
        begins_without_fault: bool,
    ) -> Self {
        Self {
            config,
            events,
            begins_without_power,
            knows_fault: begins_without_fault,
            was_latched: false,
            was_homed: false,
            has_searched: false,
            turns_rad: [0.0; AXES],
            blind_ms: [NEVER; AXES],
            seen_ms: [0; AXES],
            positions: [0; AXES],
        }
    }

    /// By how much the replay's angles are greater than the recorded ones, rad.
    pub(super) fn turns_rad(&self) -> &[f64; AXES] {
        &self.turns_rad
    }

    /// Whether the recording is known to have no fault, and the replay has one.
    pub(super) fn has_only_replayed(&self, now: &SampleEntry, report: &CycleReport) -> bool {
        self.knows_fault && !now.fault && report.fault.is_some()
    }

    /// Compares a millisecond, the `index`th of the replay. Until the controllers have forgotten what was before, only
    /// their state is followed.
    pub(super) fn step(&mut self, index: usize, now: &SampleEntry, report: &CycleReport) -> Finding {
        for (axis, valid) in now.valid.into_iter().enumerate() {
            let (blind_ms, positions) = (&mut self.blind_ms[axis], &mut self.positions[axis]);
            *blind_ms = if valid { 0 } else { blind_ms.saturating_add(1) };
            *positions = positions.saturating_add(valid.into());
            if *positions >= SPEED_POSITIONS {
                self.seen_ms[axis] = self.seen_ms[axis].saturating_add(1);
            }
        }
        let searches = self.config.has_home_switches() && now.following && now.homed != [true; AXES];
        self.has_searched |= self.was_homed && searches;
        let is_new = self.knows_fault && !self.was_latched;
        let not_recorded = self.not_recorded(now, report);
        let differs = self.difference(index, now, report, is_new && now.fault);
        self.was_latched = report.fault.is_some();
        self.was_homed = now.homed == [true; AXES];
        self.knows_fault |= !now.fault;
        // It latched before the controllers had forgotten what was before, perhaps by what is not in the samples.
        if index + 1 == SETTLED_MS && now.fault && report.fault.is_none() {
            self.knows_fault = false;
        }
        match (not_recorded, differs) {
            _ if index < SETTLED_MS => Finding::Agreed { latched: None },
            (Some(fault), _) => Finding::NotRecorded(fault),
            (None, Some(what)) => Finding::Differs(what),
            (None, None) => Finding::Agreed {
                latched: (is_new && self.was_latched).then(|| self.told(now, report)),
            },
        }
    }

    /// The recorded fault, if it is the replayed one.
    fn told(&self, now: &SampleEntry, report: &CycleReport) -> Option<Fault> {
        let recorded = self.events.fault_at(now)?;
        report
            .fault
            .filter(|replayed| is_alike(&recorded, replayed))
            .and(Some(recorded))
    }

    /// A fault of the recording or of the replay whose cause is not in the samples, or not all of it.
    fn not_recorded(&self, now: &SampleEntry, report: &CycleReport) -> Option<Option<Fault>> {
        let fault = report.fault.or_else(|| self.events.fault_at(now));
        // An axis loses its home to an implausible feedback, which is compared with the commands, even while another
        // axis has the fault; what the drives were commanded after a fault is not recorded.
        let is_latched = now.fault || report.fault.is_some();
        // The event of an order or a fault comes after the sample that shows its effect.
        let is_unwritten = |within_ms: u32| now.before_end_s * 1e3 < f64::from(within_ms);
        let differs = |axis: usize| now.homed[axis] != report.homed[axis];
        if (0..AXES)
            .any(|axis| differs(axis) && (is_latched || is_unwritten(EVENT_MS) || self.compares_since_before(axis)))
        {
            return Some(fault);
        }
        if self.has_searched {
            return Some(None);
        }
        if !self.knows_fault || now.fault == report.fault.is_some() {
            return None;
        }
        let is_outside = match fault {
            // A stop by command is not replayed, and so is not what ends it early.
            Some(Fault::PathStopLeft(_)) if now.fault => true,
            Some(fault) => !is_replayed(&fault) || self.reaches_back(&fault),
            // Overwritten, or not written yet.
            None => self.events.begin_after(now) || is_unwritten(FAULT_EVENT_MS),
        };
        is_outside.then_some(fault)
    }

    /// Whether a fault may depend on what was before the recording, or is not in it: commanded and measured motion are
    /// compared since the drives got power, in torque mode in the digits of a kind of drive that is not recorded; late
    /// telegrams are counted in seconds whose beginning is not recorded; a value just above its limit depends on rounding.
    fn reaches_back(&self, fault: &Fault) -> bool {
        // Setpoints are recorded rounded.
        let is_at_limit = |value: f32, limit: f32| value.abs() < LIMIT_SHARE * limit;
        match *fault {
            Fault::CyclesLate { .. } => true,
            Fault::FollowingError {
                error_rad, limit_rad, ..
            } => is_at_limit(error_rad, limit_rad),
            Fault::OutputLimit {
                output_rad_s,
                limit_rad_s,
                ..
            } => is_at_limit(output_rad_s, limit_rad_s),
            Fault::FeedbackDeviation {
                deviation_rad,
                limit_rad,
                ..
            } if is_at_limit(deviation_rad, limit_rad) => true,
            Fault::FeedbackDeviation { axis, .. } | Fault::FeedbackNoise { axis, .. } => {
                self.compares_since_before(usize::from(axis))
            }
            _ => false,
        }
    }

    /// Whether an axis's commanded and measured motion are compared since before the recording, or in digits that are
    /// not recorded.
    fn compares_since_before(&self, axis: usize) -> bool {
        let settings = self.config.axes.get(axis);
        !self.begins_without_power || settings.is_some_and(|axis| axis.mode != AxisMode::Velocity)
    }

    /// What differs between a sample and the replay.
    fn difference(
        &mut self,
        index: usize,
        now: &SampleEntry,
        report: &CycleReport,
        is_new_fault: bool,
    ) -> Option<String> {
        let words = |what: &str, recorded: &dyn Debug, replayed: &dyn Debug| {
            Some(format!("{what}: recorded {recorded:?}, replayed {replayed:?}"))
        };
        if report.valid != now.valid {
            return words("axes with a position", &now.valid, &report.valid);
        }
        if report.homed != now.homed {
            return words("axes homed", &now.homed, &report.homed);
        }
        // An axis without a drive shows its setpoint.
        for axis in 0..AXES.min(self.config.bus.drives.into()) {
            let (recorded, replayed) = (f64::from(now.measured_rad[axis]), report.measured_rad[axis]);
            // Where the turns of a motor that is not homed were counted from is not recorded.
            let turn_rad = TAU / self.config.axes[axis].gear.abs();
            let turns = if now.homed[axis] {
                0.0
            } else {
                ((replayed - recorded) / turn_rad).round()
            };
            self.turns_rad[axis] = turns * turn_rad;
            let is_close = (replayed - self.turns_rad[axis] - recorded).abs() <= self.rounding_rad(axis, replayed);
            // Not a number is a difference, too.
            if !is_close {
                return words(&format!("angle of axis {}, rad", axis + 1), &recorded, &replayed);
            }
        }
        if report.following != now.following {
            return words("following", &now.following, &report.following);
        }
        // By how much an axis moved before its first positions is not recorded.
        let is_known = self.seen_ms.iter().all(|ms| *ms == 0 || *ms > STANDSTILL_MS);
        // The last speed of an axis that was silent all the time is not recorded either: it may have been no standstill.
        let drives = usize::from(self.config.bus.drives);
        let is_known = is_known && (now.standstill || self.seen_ms.iter().take(drives).all(|ms| *ms > 0));
        if report.standstill != now.standstill && is_known && index > SETTLED_MS + usize::from(STANDSTILL_MS) {
            return words("standstill", &now.standstill, &report.standstill);
        }
        if self.knows_fault && report.fault.is_some() != now.fault {
            return match (now.fault, self.events.fault_at(now)) {
                (true, None) => words("fault", &"one whose event is missing", &report.fault),
                (_, recorded) => words("fault", &recorded, &report.fault),
            };
        }
        let recorded = self.events.fault_at(now);
        let recorded = recorded.filter(|fault| is_new_fault && is_the_samplers(fault) && !self.reaches_back(fault));
        match (recorded, report.fault) {
            (Some(recorded), Some(replayed)) if !is_alike(&recorded, &replayed) => words("fault", &recorded, &replayed),
            _ => None,
        }
    }

    /// By how much a replayed angle may differ from the recorded one, rad: the recording is rounded, and a position that
    /// is predicted goes on from a rounded speed.
    fn rounding_rad(&self, axis: usize, angle_rad: f64) -> f64 {
        // The speed before the first position, at which a prediction goes on, is not recorded.
        let has_no_speed = self.blind_ms[axis] > 0 && self.positions[axis] < SPEED_POSITIONS;
        if self.blind_ms[axis] == NEVER || has_no_speed {
            return f64::INFINITY;
        }
        let settings = &self.config.axes[axis];
        let increment_rad = TAU / (settings.gear.abs() * f64::from(settings.increments_per_revolution.max(1)));
        let increments = 3.0 * (f64::from(self.blind_ms[axis]) + 1.0);
        increments * (increment_rad + ROUNDING * angle_rad.abs()) + ROUNDING
    }
}

/// Whether the sampler comes to a fault by what is in the samples. Any other one hides the sampler's.
fn is_replayed(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::Drive { .. } | Fault::SlaveLost { .. } | Fault::ReferenceLost { .. }
    ) || is_the_samplers(fault)
}

/// Whether no other task comes to a fault.
fn is_the_samplers(fault: &Fault) -> bool {
    matches!(
        fault,
        Fault::EmergencyStop(StopSource::Input)
            | Fault::ClockFailure
            | Fault::Blind { .. }
            | Fault::FollowingError { .. }
            | Fault::OutputLimit { .. }
            | Fault::CyclesLate { .. }
            | Fault::SetpointUnderrun
            | Fault::FeedbackDeviation { .. }
            | Fault::FeedbackNoise { .. }
            | Fault::PathStopLeft(_)
    )
}

/// Whether two faults are of one kind and concern the same axis.
fn is_alike(one: &Fault, other: &Fault) -> bool {
    let axis = |fault: &Fault| {
        let value = serde_json::to_value(fault).unwrap_or_default();
        let content = value.as_object().and_then(|object| object.values().next().cloned());
        content.and_then(|content| content.get("axis").or(content.get("slave")).cloned())
    };
    std::mem::discriminant(one) == std::mem::discriminant(other) && axis(one) == axis(other)
}
