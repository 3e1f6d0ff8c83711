//! Positions to joint angles and back, for the robot or for another geometry, with the reason if there is no solution.
//!
//! Only reach and singularity are checked; `plan` and `draw` check the work area. The joints' range is checked if the
//! geometry's file gives one.

use crate::axes::{AxisView, Motion, PerAxis, Quantity, first_axes};
use crate::error::{ProgramError, code};
use etherpen::robots::{
    Conditioning, Geometry, JointAngles, Kinematics, KinematicsError, MAIN_AXES, Measured, Position, RATIO_SINGULAR,
};
use serde::Serialize;

/// Determinant of [`Conditioning`] below which a pose is singular.
const DETERMINANT_SINGULAR: f64 = 1.0e-9;

/// The solution in either direction.
#[derive(Debug, Serialize)]
pub struct Answer {
    /// The main axes, each in its own unit.
    #[serde(flatten)]
    pub joints: PerAxis,
    /// Angles of the main axes, rad; of a linear axis the controller's.
    #[serde(skip)]
    pub joints_rad: [f64; MAIN_AXES],
    /// Position of the tool, mm.
    pub position_mm: [f64; 3],
}

/// A robot whose kinematics can be solved.
#[derive(Debug)]
pub struct Robot {
    kinematics: Kinematics,
    axes: Vec<AxisView>,
    /// Range of the joints, rad, if the geometry's file gives one.
    range_rad: Option<[f64; 2]>,
}

impl Robot {
    /// The robot of a file's text, see [`Measured::KEYS`].
    ///
    /// # Errors
    /// Why the text does not describe a robot.
    pub fn parse(text: &str) -> Result<Self, String> {
        let measured: Measured = toml::from_str(text).map_err(|cause| cause.to_string())?;
        let geometry = measured.geometry().map_err(|cause| cause.to_string())?.into();
        Self::of(&geometry, measured.range_rad())
    }

    /// A robot with a geometry; its ranges of the joints are not checked.
    ///
    /// # Errors
    /// Why the dimensions do not form a valid robot.
    pub fn new(geometry: Geometry) -> Result<Self, String> {
        Self::of(&geometry.without_ranges(), None)
    }

    fn of(geometry: &Geometry, range_rad: Option<[f64; 2]>) -> Result<Self, String> {
        let kinematics =
            Kinematics::new(geometry).map_err(|cause| format!("the dimensions do not form a valid robot: {cause}"))?;
        let axes = first_axes(geometry, MAIN_AXES);
        Ok(Self {
            kinematics,
            axes,
            range_rad,
        })
    }

    /// Noun for a main axis of the robot.
    #[must_use]
    pub fn joint(&self) -> &'static str {
        self.kinematics.words().joint
    }

    /// Joint angles for a position, mm.
    ///
    /// # Errors
    /// The position is not finite, or has no pose: which joint and why.
    pub fn inverse(&self, position_mm: [f64; 3]) -> Result<Answer, ProgramError> {
        if let Some((name, value)) = ["x", "y", "z"]
            .iter()
            .zip(position_mm)
            .find(|(_, value)| !value.is_finite())
        {
            return Err(ProgramError::new(
                code::USAGE,
                format!(
                    "{name} is {value}, which is no finite number: no {} has an angle for it",
                    self.joint()
                ),
            ));
        }
        let position = Position::from(position_mm);
        let joints_rad = self
            .kinematics
            .inverse(&position)
            .map_err(|cause| self.no_answer(&cause))?;
        self.check_regular(&position)?;
        Ok(self.answer(joints_rad, position_mm))
    }

    fn answer(&self, joints_rad: [f64; MAIN_AXES], position_mm: [f64; 3]) -> Answer {
        let [first, second, third] = joints_rad;
        let all_rad = [first, second, third, 0.0];
        Answer {
            joints: PerAxis::new("joints", self.axes.clone(), Some(&all_rad)),
            joints_rad,
            position_mm,
        }
    }

    /// Position for the main axes, each in its own unit: rad or mm.
    ///
    /// # Errors
    /// As [`forward`](Self::forward).
    pub fn forward_in_units(&self, joints: [f64; MAIN_AXES]) -> Result<Answer, ProgramError> {
        let mut joints_rad = joints;
        for (joint, axis) in joints_rad.iter_mut().zip(&self.axes) {
            *joint /= axis.motion.factor();
        }
        self.forward(joints_rad)
    }

    /// Position for joint angles, rad.
    ///
    /// # Errors
    /// An angle is not finite or outside the given range, or the angles have no position: why.
    pub fn forward(&self, joints_rad: [f64; MAIN_AXES]) -> Result<Answer, ProgramError> {
        for (joint, angle_rad) in (0u8..).zip(joints_rad) {
            if !angle_rad.is_finite() {
                let message = format!(
                    "{} {} is {angle_rad}, which is no finite number",
                    self.joint(),
                    joint + 1
                );
                return Err(ProgramError::new(code::USAGE, message));
            }
            if let Some([low_rad, high_rad]) = self.range_rad
                && !(angle_rad >= low_rad && angle_rad <= high_rad)
            {
                return Err(self.no_answer(&KinematicsError::Range {
                    joint,
                    angle_rad,
                    low_rad,
                    high_rad,
                }));
            }
        }
        let [first, second, third] = joints_rad;
        let pose = JointAngles([first, second, third, 0.0]);
        let position = self.kinematics.forward(&pose).map_err(|cause| self.no_answer(&cause))?;
        self.check_regular(&position)?;
        Ok(self.answer(joints_rad, position.into()))
    }

    /// Refuses poses in which the joints do not hold the tool firmly.
    fn check_regular(&self, position: &Position) -> Result<(), ProgramError> {
        let Conditioning { ratio, determinant, .. } = self.kinematics.conditioning(position);
        let (joint, ratio) = ratio;
        if ratio.is_nan() || ratio < RATIO_SINGULAR {
            return Err(self.no_answer(&KinematicsError::Singular { joint, ratio }));
        }
        if determinant.is_nan() || determinant < DETERMINANT_SINGULAR {
            let words = self.kinematics.words();
            return Err(ProgramError::new(
                code::FAILED,
                format!(
                    "singular: the {} of {}s 1, 2 and 3 lie in one plane and do not hold the platform across it",
                    words.last_links, words.joint
                ),
            ));
        }
        Ok(())
    }

    fn no_answer(&self, cause: &KinematicsError) -> ProgramError {
        let words = self.kinematics.words();
        let noun = words.joint;
        let of_range = |joint: u8| {
            self.axes
                .get(usize::from(joint))
                .map_or(Motion::Rotary, |axis| axis.motion)
        };
        let why = match *cause {
            KinematicsError::NotFinite => "a value is no finite number".into(),
            KinematicsError::Unreachable { joint, .. } => {
                format!("unreachable: {noun} {} does not reach it", joint + 1)
            }
            KinematicsError::Singular { joint, ratio } => format!(
                "singular: {} at {noun} {} (ratio {ratio:.1e})",
                words.singular,
                joint + 1
            ),
            KinematicsError::Range {
                joint,
                angle_rad,
                low_rad,
                high_rad,
            } => {
                let motion = of_range(joint);
                let (unit, factor) = (motion.unit(Quantity::Position), motion.factor());
                format!(
                    "out of range: {} at {} {unit}, the geometry gives it {} to {} {unit}",
                    self.axes
                        .get(usize::from(joint))
                        .map_or("an axis", |axis| axis.name.as_str()),
                    angle_rad * factor,
                    low_rad * factor,
                    high_rad * factor
                )
            }
            KinematicsError::Apart => format!(
                "unreachable: with these angles the {} of {noun}s 1, 2 and 3 do not meet in one platform",
                words.last_links
            ),
        };
        ProgramError::new(code::FAILED, why)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IRB: &str = "base_radius_mm = 200\nupper_arm_mm = 350.0\nforearm_mm = 800.0\nplatform_radius_mm = 45.0\n\
        arm_azimuths_deg = [0.0, 120.0, 240.0]\n";

    #[test]
    fn positions_come_back_through_the_angles() {
        let robot = Robot::new(Geometry::default()).unwrap();
        for position_mm in [[-10.0, 0.0, -800.0], [300.5, -200.25, -850.125], [0.0, 0.0, -750.0]] {
            let joints = robot.inverse(position_mm).unwrap().joints_rad;
            let back = robot.forward(joints).unwrap().position_mm;
            for (value, expected) in back.iter().zip(position_mm) {
                assert!((value - expected).abs() < 1.0e-9);
            }
        }
    }

    #[test]
    fn only_a_range_that_the_file_gives_is_checked() {
        let high = [0.0, 0.0, -470.0];
        assert!(Robot::parse(IRB).unwrap().inverse(high).is_ok());
        let limited = Robot::parse(&format!("{IRB}arm_range_rad = [-0.5, 1.7]\n")).unwrap();
        let error = limited.inverse(high).unwrap_err();
        assert!(error.message.starts_with("out of range: arm 1"), "{}", error.message);
        let error = limited.forward([0.1, 1.8, 0.1]).unwrap_err();
        assert!(error.message.starts_with("out of range: arm 2"), "{}", error.message);
    }

    #[test]
    fn a_position_without_an_answer_names_the_joint_and_the_reason() {
        let robot = Robot::new(Geometry::default()).unwrap();
        let message = |position_mm| robot.inverse(position_mm).unwrap_err().message;
        assert_eq!(message([-1500.0, 0.0, -800.0]), "unreachable: arm 1 does not reach it");
        assert!(message([0.0, f64::NAN, -800.0]).starts_with("y is NaN"));
        // Straight down from shoulders directly above the platform's joints.
        let straight = Robot::parse(&IRB.replace("45.0", "200.0")).unwrap();
        let error = straight.inverse([0.0, 0.0, -1150.0]).unwrap_err();
        assert!(
            error
                .message
                .starts_with("singular: upper arm and forearm in line at arm 1"),
            "{}",
            error.message
        );
        let links = Robot::new(etherpen::robots::Kind::Scara.geometry()).unwrap();
        let error = links.inverse([400.0, 0.0, -20.0]).unwrap_err();
        assert!(
            error
                .message
                .starts_with("singular: inner and outer link in line at joint "),
            "{}",
            error.message
        );
        let message = |joints| robot.forward(joints).unwrap_err().message;
        assert!(message([0.1, f64::INFINITY, 0.1]).starts_with("arm 2 is inf"));
    }

    #[test]
    fn linear_axes_are_told_and_taken_in_millimetres() {
        let robot = Robot::new(etherpen::robots::Kind::Gantry.geometry()).unwrap();
        let answer = robot.inverse([120.0, 30.5, -20.0]).unwrap();
        let json = serde_json::to_value(&answer).unwrap();
        let joints: Vec<f64> = serde_json::from_value(json["joints_mm"].clone()).unwrap();
        let back = robot.forward_in_units([joints[0], joints[1], joints[2]]).unwrap();
        assert_eq!(joints.len(), 3);
        for (value, expected) in back.position_mm.iter().zip([120.0, 30.5, -20.0]) {
            assert!((value - expected).abs() < 1.0e-9, "{value}");
        }
    }

    #[test]
    fn a_file_that_is_no_geometry_is_refused_with_the_reason() {
        for (text, reason) in [
            ("", "missing field"),
            ("base_radius_mm = \"wide\"", "invalid type"),
            ("this is no TOML", "TOML"),
            (
                &IRB.replace("base_radius_mm = 200\n", ""),
                "base_radius_mm or base_side_mm is missing",
            ),
            (&format!("{IRB}base_side_mm = 1.0\n"), "say the same"),
            (&IRB.replace("800.0", "300.0"), "do not form a valid robot"),
            (&IRB.replace("800.0", "nan"), "no finite number"),
            (&IRB.replace("45.0", "-45.0"), "negative"),
            (&format!("{IRB}arms = 4\n"), "unknown field"),
        ] {
            let error = Robot::parse(text).map(|_| ()).unwrap_err();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
