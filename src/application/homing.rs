//! Homing: the joint angles that encoders show, and the check of a pose before it is taken.
//!
//! A resolver is absolute within one motor turn; at a gear of 1:12 the same resolver angle repeats every 30 degrees of
//! the joint. A pose read from marks or measured selects the turn. Two things can be checked: within its turn the
//! resolver has to show the pose's angle, and if the platform's position was measured too, forward kinematics of the
//! pose has to give that position. A pose that is wrong by whole turns passes the first check and fails the second. A
//! multi-turn encoder knows the turn, and fails it in the first; an incremental one knows nothing.
//!
//! Invariant: a refused pose names the axis that disagrees most and changes nothing.

use super::Refusal;
use crate::config::{Axis, Config, Encoder};
use crate::control::robot_axes::encoder_angle_rad;
use crate::robots::{AXES, JointAngles, Kind, Kinematics, MAIN_AXES, Position};

/// Largest difference between a pose and the resolver angles, rad: a tenth of the joint angle after which the resolver
/// angle repeats.
pub const POSE_DIFFERENCE_MAX_RAD: f64 = 0.05;
/// Largest distance between a measured position and forward kinematics of the pose, mm; a motor turn of a joint moves
/// the platform by more than 50 mm.
pub const POSITION_DIFFERENCE_MAX_MM: f64 = 20.0;

/// Checks that a position of every axis arrives.
///
/// # Errors
/// The first axis without a position.
pub fn positions_arrive(increments: &[Option<i64>; AXES]) -> Result<(), Refusal> {
    match (0u8..).zip(increments).find(|(_, increments)| increments.is_none()) {
        Some((axis, _)) => Err(Refusal::NoPosition { axis }),
        None => Ok(()),
    }
}

/// Limits and geometry against which a pose is checked.
#[derive(Clone, Copy, Debug)]
pub struct HomingCheck {
    axes: [Axis; AXES],
    /// Number of axes that have drives: the first ones.
    used: usize,
    kinematics: Option<Kinematics>,
}

impl HomingCheck {
    /// Makes the check for a configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            axes: config.axes,
            used: config.bus.drives.into(),
            kinematics: Kinematics::new(&config.geometry).ok(),
        }
    }

    /// Kind of the robot.
    pub fn kind(&self) -> Kind {
        self.kinematics.as_ref().map_or_else(Kind::default, Kinematics::kind)
    }

    /// Positions as the encoders know them, increments: of a single-turn encoder within its motor turn, from 0, of others all
    /// 32 bits of the drive's position.
    pub fn known(&self, increments: &[Option<i64>; AXES]) -> [Option<i32>; AXES] {
        let mut known = [None; AXES];
        for ((known, axis), increments) in known.iter_mut().zip(&self.axes).zip(increments) {
            let revolution = i64::from(axis.increments_per_revolution.max(1));
            *known = increments.map(|increments| match axis.encoder {
                Encoder::SingleTurn => increments.rem_euclid(revolution) as i32,
                Encoder::MultiTurn | Encoder::Incremental => increments as i32,
            });
        }
        known
    }

    /// Checks whether the robot may be homed at a pose: `increments` are the resolver positions, `position` is the
    /// measured position of the platform.
    ///
    /// # Errors
    /// The disagreement, with its axis.
    pub fn check(
        &self,
        increments: &[Option<i64>; AXES],
        pose: &JointAngles,
        position: Option<&Position>,
    ) -> Result<(), Refusal> {
        if pose.0.iter().any(|angle| !angle.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        positions_arrive(increments)?;
        let axes = self.axes.iter().zip(increments).zip(pose.0).take(self.used);
        for (number, ((axis, increments), wanted_rad)) in (0u8..).zip(axes) {
            let Some(increments) = increments else { continue };
            let difference_rad = encoder_angle_rad(axis, *increments, Some(wanted_rad)) - wanted_rad;
            if difference_rad.abs() > POSE_DIFFERENCE_MAX_RAD {
                return Err(Refusal::PoseResolver {
                    axis: number,
                    difference_rad: difference_rad as f32,
                });
            }
        }
        match (&self.kinematics, position) {
            (Some(kinematics), Some(position)) => check_position(kinematics, pose, position),
            _ => Ok(()),
        }
    }
}

fn check_position(kinematics: &Kinematics, pose: &JointAngles, position: &Position) -> Result<(), Refusal> {
    let distance_mm = kinematics.forward(pose).map_or(f64::INFINITY, |there| {
        let (x, y, z) = (
            there.x_mm - position.x_mm,
            there.y_mm - position.y_mm,
            there.z_mm - position.z_mm,
        );
        libm::sqrt(x * x + y * y + z * z)
    });
    if distance_mm <= POSITION_DIFFERENCE_MAX_MM {
        return Ok(());
    }
    // The joint whose angle is farthest from the angle that the position requires.
    let wanted = kinematics.inverse(position).unwrap_or([f64::NAN; MAIN_AXES]);
    let differences = (0u8..).zip(pose.0.iter().zip(wanted).map(|(angle, wanted)| angle - wanted));
    let worst = differences.max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
    let (axis, difference_rad) = worst.unwrap_or_default();
    Err(Refusal::PosePosition {
        axis,
        difference_rad: difference_rad as f32,
        distance_mm: distance_mm as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TURN_RAD: f64 = core::f64::consts::TAU / 12.0;

    fn shown(pose: &JointAngles, config: &Config) -> [Option<i64>; AXES] {
        core::array::from_fn(|k| {
            let axis = &config.axes[k];
            let turns = (pose.0[k] - axis.sync_angle_rad) / TURN_RAD;
            let revolution = f64::from(axis.increments_per_revolution);
            Some(libm::round((turns - libm::floor(turns)) * revolution) as i64 + i64::from(axis.sync_increments))
        })
    }

    fn calibrated() -> Config {
        let mut config = Config::default();
        for (axis, increments) in config.axes.iter_mut().zip([123_456, 700_000, 5, 999_999]) {
            axis.sync_increments = increments;
        }
        config
    }

    #[test]
    fn the_pose_tells_the_turn_and_the_resolver_the_angle_on_it() {
        let config = calibrated();
        for turns in -2..=2 {
            let pose = JointAngles([0.31, 0.62, 0.1, 4.0].map(|angle| angle + TURN_RAD * f64::from(turns)));
            for ((axis, increments), angle) in config.axes.iter().zip(shown(&pose, &config)).zip(pose.0) {
                let found = encoder_angle_rad(axis, increments.unwrap(), Some(angle + 0.2));
                assert!((found - angle).abs() < 1e-5, "{found} for {angle}");
            }
        }
    }

    #[test]
    fn a_pose_that_the_resolvers_do_not_show_is_refused_with_its_axis() {
        let config = calibrated();
        let pose = JointAngles([0.31, 0.62, 0.1, 4.0]);
        let check = HomingCheck::new(&config);
        let increments = shown(&pose, &config);
        assert_eq!(check.check(&increments, &pose, None), Ok(()));
        let mut wrong = pose;
        wrong.0[2] += 0.08;
        assert!(matches!(
            check.check(&increments, &wrong, None),
            Err(Refusal::PoseResolver { axis: 2, difference_rad }) if (difference_rad + 0.08).abs() < 1e-4
        ));
        let mut turned = config.clone();
        turned
            .axes
            .iter_mut()
            .for_each(|axis| axis.encoder = Encoder::MultiTurn);
        let on_its_turn = |k: usize| {
            let axis = &turned.axes[k];
            let revolution = f64::from(axis.increments_per_revolution);
            let turns = (pose.0[k] - axis.sync_angle_rad) / TURN_RAD;
            Some(libm::round(turns * revolution) as i64 + i64::from(axis.sync_increments))
        };
        let check_turned = HomingCheck::new(&turned);
        let known = core::array::from_fn(on_its_turn);
        assert_eq!(check_turned.check(&known, &pose, None), Ok(()));
        let mut a_turn_off = pose;
        a_turn_off.0[1] -= TURN_RAD;
        let refused = check_turned.check(&known, &a_turn_off, None);
        assert!(
            matches!(refused, Err(Refusal::PoseResolver { axis: 1, .. })),
            "{refused:?}"
        );
        let mut silent = increments;
        silent[1] = None;
        assert_eq!(check.check(&silent, &pose, None), Err(Refusal::NoPosition { axis: 1 }));
        assert_eq!(positions_arrive(&silent), Err(Refusal::NoPosition { axis: 1 }));
        wrong.0[0] = f64::NAN;
        assert_eq!(check.check(&increments, &wrong, None), Err(Refusal::NotFinite));
    }

    #[test]
    fn increments_within_a_turn_are_from_0_and_below_a_revolution() {
        let check = HomingCheck::new(&Config::default());
        let revolution = i64::from(Config::default().axes[0].increments_per_revolution);
        let within = check.known(&[Some(-1), Some(3 * revolution + 7), Some(5), None]);
        assert_eq!(within, [Some(revolution as i32 - 1), Some(7), Some(5), None]);
        let mut config = Config::default();
        config.axes[0].encoder = Encoder::MultiTurn;
        config.axes[1].encoder = Encoder::Incremental;
        let lap = 1_i64 << 32;
        let known = HomingCheck::new(&config).known(&[Some(-1), Some(lap + 3 * revolution), None, None]);
        assert_eq!(known, [Some(-1), Some(3 * revolution as i32), None, None]);
    }

    #[test]
    fn an_axis_without_a_resolution_has_no_increments_within_its_turn() {
        let mut config = Config::default();
        config.axes[1].increments_per_revolution = 0;
        let within = HomingCheck::new(&config).known(&[Some(7), Some(-7), None, None]);
        assert_eq!(within, [Some(7), Some(0), None, None]);
    }

    #[test]
    fn a_wrong_multiple_of_30_degrees_disagrees_with_the_measured_position() {
        let config = calibrated();
        let check = HomingCheck::new(&config);
        let kinematics = Kinematics::new(&config.geometry).unwrap();
        let pose = JointAngles([0.31, 0.42, 0.36, 0.0]);
        let mut position = kinematics.forward(&pose).unwrap();
        position.x_mm += 5.0;
        let increments = shown(&pose, &config);
        assert_eq!(check.check(&increments, &pose, Some(&position)), Ok(()));
        for joint in 0..MAIN_AXES {
            for turns in [-1.0, 1.0, 2.0] {
                let mut wrong = pose;
                wrong.0[joint] += turns * TURN_RAD;
                assert_eq!(
                    check.check(&increments, &wrong, None),
                    Ok(()),
                    "the resolver alone cannot tell"
                );
                let refusal = check.check(&increments, &wrong, Some(&position));
                assert!(
                    matches!(refusal, Err(Refusal::PosePosition { axis, distance_mm, .. })
                        if usize::from(axis) == joint && distance_mm > 50.0),
                    "joint {joint}, {turns} turns: {refusal:?}"
                );
            }
        }
    }
}
