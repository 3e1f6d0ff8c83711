//! Hands the planner's motion to the certifier, and its certificate to reports.

use super::PlanningError;
use super::dimensions::robot;
use crate::axes::{self, Motion};
use etherpen::config::Config;
use etherpen::motion::{Observer, Passage, Trajectory, Vertex};
use etherpen::robots;
use etherpen_certify::{Certificate, Certifier, Kind, Limits, Quantity, Stretch};
use serde::Serialize;

/// Part of a limit by which a motion may exceed it: the planner's own tests allow as much.
pub const EXCESS: f64 = 1.0e-3;
/// Allowed jump of the velocity between two stretches, as a part of the acceleration limit over a millisecond.
const JUMP_PART: f64 = 1.0e-3;
/// One millisecond, s.
const TICK_S: f64 = 1.0e-3;

/// What is proved of a motion in continuous time, as reports show it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CertificateReport {
    /// Whether every limit is proved.
    pub proved: bool,
    /// Part of a limit by which it may be exceeded.
    pub excess: f64,
    /// Stretches of constant acceleration.
    pub stretches: usize,
    /// Boxes for which bounds were computed.
    pub boxes: usize,
    /// Largest bound of what the moving average adds to the distance from the path, mm.
    pub average_mm: f64,
    /// Largest used part of each limit.
    pub used: Vec<UsedPart>,
    /// Limits that the motion violates.
    pub violations: usize,
    /// Limits that could not be decided.
    pub undecided: usize,
    /// Witnesses of both, the first ones.
    pub refusals: Vec<Refused>,
}

/// Largest part of a limit that a motion uses, 1 for all of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UsedPart {
    /// The limited quantity.
    pub limit_of: &'static str,
    /// The axis, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<u8>,
    /// The motion reaches this part.
    pub least: f64,
    /// The motion stays below this part.
    pub most: f64,
}

/// A limit that is not proved, with its witness.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refused {
    /// `violated` if the value at the witness is over the limit, `undecided` if the bounds are not tight enough.
    pub kind: &'static str,
    /// The limited quantity.
    pub limit_of: &'static str,
    /// Its unit, that of the axis.
    pub unit: &'static str,
    /// The axis, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<u8>,
    /// Number of the stretch, from 0.
    pub stretch: usize,
    /// Vertices executed where the piece of the path begins.
    pub vertex: u32,
    /// Time since the path began, s.
    pub t_s: f64,
    /// Parameter of the curve, from 0 to 1.
    pub parameter: f64,
    /// Lower and upper bound of the value.
    pub value: [f64; 2],
    /// The configured limit.
    pub limit: f64,
}

/// Observes the planner and feeds the certifier.
pub(super) struct Witness {
    certifier: Certifier,
    kind: robots::Kind,
    excess: f64,
    ticks: u64,
}

impl Witness {
    pub(super) fn new(config: &Config, path: &[Vertex], excess: f64) -> Result<Self, PlanningError> {
        let trajectory = Box::new(Trajectory::new(&config.motion_settings()).map_err(PlanningError::Geometry)?);
        let points = path.iter().map(|vertex| vertex.position.into());
        let limits = limits(config, trajectory.jerk_window_ms(), excess);
        Ok(Self {
            certifier: Certifier::new(robot(config), limits, points.collect()),
            kind: config.geometry.kind(),
            excess,
            ticks: 0,
        })
    }

    pub(super) fn finish(self) -> CertificateReport {
        report(&self.certifier.finish(), self.kind, self.excess)
    }
}

impl Observer for Witness {
    fn millisecond(&mut self) {
        self.ticks += 1;
    }

    fn moved(&mut self, passage: &Passage) {
        self.certifier.take(&Stretch {
            coefficients: passage.coefficients,
            parameter: passage.parameter,
            start_mm: passage.start_mm,
            speed_mm_s: passage.speed_mm_s,
            acceleration_mm_s2: passage.acceleration_mm_s2,
            time_s: passage.time_s,
            ends_s: self.ticks as f64 * TICK_S - passage.left_s,
            heading_rad: passage.heading_rad,
            turn_rad_mm: passage.turn_rad_mm,
            turn_change_rad_mm2: passage.turn_change_rad_mm2,
            drawn: passage.drawn,
            lifts: passage.lifts,
            vertex: passage.vertex,
        });
    }
}

fn limits(config: &Config, window_ms: u16, excess: f64) -> Limits {
    let (motion, geometry) = (&config.motion, &config.geometry);
    let [a, b, c] = geometry.ranges_rad();
    Limits {
        range_rad: [a, b, c, geometry.turn_range_rad()],
        joint_speed_rad_s: motion.joint_speed_rad_s,
        joint_acceleration_rad_s2: motion.joint_acceleration_rad_s2,
        speed_mm_s: motion.speed_mm_s,
        travel_speed_mm_s: motion.travel_speed_mm_s,
        acceleration_mm_s2: motion.acceleration_mm_s2,
        pen_speed_mm_s: motion.pen_speed_mm_s,
        pen_acceleration_mm_s2: motion.pen_acceleration_mm_s2,
        tolerance_mm: motion.tolerance_mm,
        travel_tolerance_mm: motion.travel_tolerance_mm,
        window_ms,
        excess,
        jump_part: JUMP_PART,
    }
}

/// Name and unit of a quantity as the axis has it, and the factor from the certifier's value.
fn shown(quantity: &Quantity, kind: robots::Kind) -> (&'static str, &'static str, f64) {
    let (name, unit) = quantity.name_and_unit();
    let axis = quantity.axis().map(|axis| usize::from(axis).saturating_sub(1));
    let motion = axis.map_or(Motion::Rotary, |axis| axes::motion(kind, axis));
    let of_axis = match quantity {
        Quantity::Angle(_) => axes::Quantity::Position,
        Quantity::JointSpeed(_) => axes::Quantity::Speed,
        Quantity::JointAcceleration(_) | Quantity::JointJump(_) => axes::Quantity::Acceleration,
        _ => return (name, unit, 1.0),
    };
    let name = match (quantity, motion) {
        (Quantity::Angle(_), Motion::Linear) => "position",
        _ => name,
    };
    (name, motion.unit(of_axis), motion.factor())
}

fn report(certificate: &Certificate, kind: robots::Kind, excess: f64) -> CertificateReport {
    let used = certificate.uses.iter().map(|(quantity, used)| UsedPart {
        limit_of: shown(quantity, kind).0,
        axis: quantity.axis(),
        least: used.least,
        most: used.most,
    });
    let refusals = certificate.refusals.iter().map(|refusal| {
        let (limit_of, unit, factor) = shown(&refusal.quantity, kind);
        Refused {
            kind: match refusal.kind {
                Kind::Violated => "violated",
                Kind::NotProved => "undecided",
            },
            limit_of,
            unit,
            axis: refusal.quantity.axis(),
            stretch: refusal.stretch,
            vertex: refusal.vertex,
            t_s: refusal.time_s,
            parameter: refusal.parameter,
            value: refusal.value.map(|value| value * factor),
            limit: refusal.limit * factor,
        }
    });
    CertificateReport {
        proved: certificate.is_proved(),
        excess,
        stretches: certificate.stretches,
        boxes: certificate.boxes,
        average_mm: certificate.average_mm,
        used: used.collect(),
        violations: certificate.violations,
        undecided: certificate.undecided,
        refusals: refusals.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::vertices;
    use super::super::{certify, plan, plan_observed};
    use super::*;

    #[test]
    fn a_certificate_changes_nothing_and_a_lower_limit_refuses_it_with_a_witness() {
        let config = Config::default();
        let path = vertices(&[[0.0, 0.0, -800.0], [30.0, 0.0, -800.0], [30.0, 5.0, -800.0]]);
        let mut seen = Vec::new();
        let run = plan(&config, &path, |sample, _| seen.push(sample.setpoint)).unwrap();
        let mut again = Vec::new();
        let (findings, report) = certify(&config, &path, 0.01, |sample| again.push(sample.setpoint)).unwrap();
        assert_eq!(seen, again);
        assert_eq!(findings.duration_s, run.duration_ms as f64 * TICK_S);
        assert!(report.proved && report.refusals.is_empty(), "{report:?}");
        let speed = report.used.iter().find(|used| used.limit_of == "speed").unwrap();
        assert!(speed.least > 0.99 && speed.most < 1.01);

        let mut tighter = config.clone();
        tighter.motion.speed_mm_s = 396.0;
        let mut witness = Witness::new(&tighter, &path, 0.0).unwrap();
        plan_observed(&config, &path, &mut witness, |_, _| ()).unwrap();
        let report = witness.finish();
        let found = report
            .refusals
            .iter()
            .find(|refusal| refusal.limit_of == "speed")
            .unwrap();
        assert_eq!((found.kind, found.limit), ("violated", 396.0));
        assert!(found.value[0] > 396.0 && found.t_s > 0.0 && found.unit == "mm/s");
    }

    #[test]
    fn a_linear_axis_is_proved_and_refused_in_millimetres() {
        let mut config = crate::settings::machines::MACHINES[1].load().unwrap();
        let path = vertices(&[[300.0, 200.0, -20.0], [400.0, 200.0, -20.0], [400.0, 260.0, -20.0]]);
        let fast = config.clone();
        config.motion.joint_speed_rad_s[0] = 1.0;
        let mut witness = Witness::new(&config, &path, 0.0).unwrap();
        plan_observed(&fast, &path, &mut witness, |_, _| ()).unwrap();
        let report = witness.finish();
        let found = report
            .refusals
            .iter()
            .find(|refusal| refusal.limit_of == "joint_speed")
            .unwrap();
        assert_eq!((found.axis, found.unit, found.limit), (Some(1), "mm/s", 100.0));
        // The pen goes along x with its configured speed.
        assert!(
            found.value[0] > 100.0 && found.value[1] < 1.01 * fast.motion.speed_mm_s,
            "{found:?}"
        );
        assert!(report.used.iter().any(|used| used.limit_of == "position"), "{report:?}");
        assert!(
            report
                .used
                .iter()
                .all(|used| used.axis != Some(1) || used.limit_of != "angle")
        );
        // A rotary axis keeps its radians.
        let mixed = robots::Kind::Scara;
        assert_eq!(shown(&Quantity::Angle(1), mixed), ("angle", "rad", 1.0));
        assert_eq!(shown(&Quantity::JointJump(3), mixed), ("joint_jump", "mm/s2", 100.0));
    }
}
