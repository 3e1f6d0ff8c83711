//! `etherpen kinematics`: positions to arm angles and back, for the robot or for another geometry.
//!
//! Only reach and singularity are checked; `plan` and `draw` check the work area. The range of the arms is checked if
//! the geometry's file gives one.

use super::print_json;
use crate::error::{ProgramError, code};
use etherpen::config::Geometry;
use etherpen::robot::{
    ARMS, Conditioning, Delta, GeometryError, JointAngles, KinematicsError, Position, RATIO_SINGULAR,
};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::io::Write;
use std::path::PathBuf;

/// Absolute determinant of the forearms' directions below which a pose is singular.
const DETERMINANT_SINGULAR: f64 = 1.0e-9;

/// Options of `etherpen kinematics`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    direction: Direction,
}

#[derive(clap::Subcommand, Debug)]
enum Direction {
    /// Arm angles for a position of the platform.
    Inverse {
        /// Position in the robot's frame, mm; the shoulder plane is z = 0, the platform works at z < 0.
        #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = three_numbers)]
        position: Three,
        #[command(flatten)]
        options: Options,
    },
    /// Position of the platform for arm angles.
    Forward {
        /// Arm angles, rad; positive turns the upper arm below the horizontal.
        #[arg(long, value_name = "Q1,Q2,Q3", allow_hyphen_values = true, value_parser = three_numbers)]
        joints: Three,
        #[command(flatten)]
        options: Options,
    },
}

/// Options of both directions.
#[derive(clap::Args, Debug)]
struct Options {
    /// TOML file with base_radius_mm, upper_arm_mm, forearm_mm, platform_radius_mm and arm_azimuths_deg, or with
    /// base_side_mm and platform_side_mm of equilateral triangles instead of the radii; arm_range_rad = [low, high] if
    /// the arms' range is to be checked. Without it the IRB 340, its range not checked.
    #[arg(long, value_name = "FILE")]
    geometry: Option<PathBuf>,
    /// Print the answer as JSON on stdout.
    #[arg(long)]
    json: bool,
}

/// Three numbers with commas between them.
#[derive(Clone, Copy, Debug)]
struct Three([f64; 3]);

fn three_numbers(text: &str) -> Result<Three, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse::<f64>()).collect();
    match numbers.ok().and_then(|numbers| numbers.try_into().ok()) {
        Some(numbers) => Ok(Three(numbers)),
        None => Err("three numbers with commas between them are needed, like -10,0,-800".into()),
    }
}

/// A geometry as its file gives it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GeometryFile {
    base_radius_mm: Option<f64>,
    base_side_mm: Option<f64>,
    upper_arm_mm: f64,
    forearm_mm: f64,
    platform_radius_mm: Option<f64>,
    platform_side_mm: Option<f64>,
    arm_azimuths_deg: Option<[f64; ARMS]>,
    arm_range_rad: Option<[f64; 2]>,
}

/// The answer of either direction.
#[derive(Debug, Serialize)]
struct Answer {
    joints_rad: [f64; ARMS],
    position_mm: [f64; 3],
}

/// The robot asked for.
struct Robot {
    delta: Delta,
    /// Range of the arms where the geometry gives one, rad.
    range_rad: Option<[f64; 2]>,
}

/// Runs the command.
///
/// # Errors
/// The geometry's file cannot be used, or there is no solution: which arm and why.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let (answer, options) = match &arguments.direction {
        Direction::Inverse { position, options } => (robot(options)?.inverse(position.0)?, options),
        Direction::Forward { joints, options } => (robot(options)?.forward(joints.0)?, options),
    };
    if options.json {
        return print_json(&answer);
    }
    let [x, y, z] = answer.position_mm;
    let mut shown = format!("position  {x} {y} {z} mm\n");
    for (arm, angle) in (1..).zip(answer.joints_rad) {
        shown.push_str(&format!("arm {arm}     {angle} rad ({:.4} deg)\n", angle.to_degrees()));
    }
    std::io::stdout()
        .write_all(shown.as_bytes())
        .map_err(|cause| ProgramError::failed("stdout", cause))
}

fn robot(options: &Options) -> Result<Robot, ProgramError> {
    match &options.geometry {
        None => Robot::new(Geometry::default(), None),
        Some(path) => std::fs::read_to_string(path)
            .map_err(|cause| format!("it cannot be read: {cause}"))
            .and_then(|text| parse_geometry(&text))
            .and_then(|(geometry, range_rad)| Robot::new(geometry, range_rad)),
    }
    .map_err(|cause| match &options.geometry {
        Some(path) => ProgramError::new(code::INPUT, format!("the geometry {}: {cause}", path.display())),
        None => ProgramError::new(code::FAILED, cause),
    })
}

/// Geometry of a file, and the arms' range if it has one.
fn parse_geometry(text: &str) -> Result<(Geometry, Option<[f64; 2]>), String> {
    let file: GeometryFile = toml::from_str(text).map_err(|cause| cause.to_string())?;
    let radius = |name: &str, radius_mm: Option<f64>, side_mm: Option<f64>, part: f64| match (radius_mm, side_mm) {
        (Some(_), Some(_)) => Err(format!(
            "{name}_radius_mm and {name}_side_mm say the same; leave one of them out"
        )),
        (None, None) => Err(format!("{name}_radius_mm or {name}_side_mm is missing")),
        (Some(radius_mm), None) => Ok(radius_mm),
        (None, Some(side_mm)) => Ok(side_mm * part),
    };
    let root = 3.0_f64.sqrt();
    // From the centre of the base's triangle to a side, of the platform's to a corner.
    let base_radius_mm = radius("base", file.base_radius_mm, file.base_side_mm, root / 6.0)?;
    let platform_radius_mm = radius("platform", file.platform_radius_mm, file.platform_side_mm, root / 3.0)?;
    for (name, value) in [("base", base_radius_mm), ("platform", platform_radius_mm)] {
        if value < 0.0 {
            return Err(format!("the {name} has a negative size"));
        }
    }
    let defaults = Geometry::default();
    let geometry = Geometry {
        base_radius_mm,
        platform_radius_mm,
        upper_arm_mm: file.upper_arm_mm,
        forearm_mm: file.forearm_mm,
        arm_azimuths_deg: file.arm_azimuths_deg.unwrap_or(defaults.arm_azimuths_deg),
        ..defaults
    };
    Ok((geometry, file.arm_range_rad))
}

fn no_delta(cause: GeometryError) -> String {
    let why = match cause {
        GeometryError::NotFinite => "a value is no finite number".into(),
        GeometryError::Lengths {
            upper_arm_mm,
            forearm_mm,
        } => format!(
            "upper arms of {upper_arm_mm} mm and forearms of {forearm_mm} mm; both have to be longer than 0, and the \
             forearm the longer one"
        ),
        GeometryError::Azimuths { first_deg, second_deg } => {
            format!("arms at {first_deg} and {second_deg} degrees move in the same plane")
        }
        GeometryError::Range { low_rad, high_rad } => {
            format!("the range of the arms from {low_rad} to {high_rad} rad is empty")
        }
    };
    format!("it is no delta robot: {why}")
}

impl Robot {
    fn new(geometry: Geometry, range_rad: Option<[f64; 2]>) -> Result<Self, String> {
        let geometry = Geometry {
            // Every angle that there is.
            arm_range_rad: range_rad.unwrap_or([-PI, PI]),
            ..geometry
        };
        let delta = Delta::new(&geometry).map_err(no_delta)?;
        Ok(Self { delta, range_rad })
    }

    fn inverse(&self, position_mm: [f64; 3]) -> Result<Answer, ProgramError> {
        if let Some((name, value)) = ["x", "y", "z"]
            .iter()
            .zip(position_mm)
            .find(|(_, value)| !value.is_finite())
        {
            return Err(ProgramError::new(
                code::USAGE,
                format!("{name} is {value}, which is no finite number: no arm has an angle for it"),
            ));
        }
        let position = Position::from(position_mm);
        let joints_rad = self.delta.inverse(&position).map_err(|cause| no_answer(&cause))?;
        self.check_regular(&position)?;
        Ok(Answer {
            joints_rad,
            position_mm,
        })
    }

    fn forward(&self, joints_rad: [f64; ARMS]) -> Result<Answer, ProgramError> {
        for (arm, angle_rad) in (0u8..).zip(joints_rad) {
            if !angle_rad.is_finite() {
                let message = format!("arm {} is {angle_rad}, which is no finite number", arm + 1);
                return Err(ProgramError::new(code::USAGE, message));
            }
            if let Some([low_rad, high_rad]) = self.range_rad
                && !(angle_rad >= low_rad && angle_rad <= high_rad)
            {
                return Err(no_answer(&KinematicsError::Range {
                    arm,
                    angle_rad,
                    low_rad,
                    high_rad,
                }));
            }
        }
        let [first, second, third] = joints_rad;
        let pose = JointAngles([first, second, third, 0.0]);
        let position = self.delta.forward(&pose).map_err(|cause| no_answer(&cause))?;
        self.check_regular(&position)?;
        Ok(Answer {
            joints_rad,
            position_mm: position.into(),
        })
    }

    /// Refuses poses in which the arms do not hold the platform.
    fn check_regular(&self, position: &Position) -> Result<(), ProgramError> {
        let Conditioning { ratio, determinant, .. } = self.delta.conditioning(position);
        let (arm, ratio) = ratio;
        if ratio.is_nan() || ratio < RATIO_SINGULAR {
            return Err(no_answer(&KinematicsError::Singular { arm, ratio }));
        }
        if determinant.is_nan() || determinant < DETERMINANT_SINGULAR {
            return Err(ProgramError::new(
                code::FAILED,
                "singular: the forearms of arms 1, 2 and 3 lie in one plane and do not hold the platform across it",
            ));
        }
        Ok(())
    }
}

fn no_answer(cause: &KinematicsError) -> ProgramError {
    let why = match *cause {
        KinematicsError::NotFinite => "a value is no finite number".into(),
        KinematicsError::Unreachable { arm, .. } => format!("unreachable: arm {} does not reach it", arm + 1),
        KinematicsError::Singular { arm, ratio } => format!(
            "singular: upper arm and forearm of arm {} are in line (D/A = {ratio:.1e})",
            arm + 1
        ),
        KinematicsError::Range {
            arm,
            angle_rad,
            low_rad,
            high_rad,
        } => format!(
            "out of range: arm {} at {angle_rad} rad, the geometry gives it {low_rad} to {high_rad} rad",
            arm + 1
        ),
        KinematicsError::Apart => {
            "unreachable: with these angles the forearms of arms 1, 2 and 3 do not meet in one platform".into()
        }
    };
    ProgramError::new(code::FAILED, why)
}

#[cfg(test)]
mod tests {
    use super::*;

    const IRB: &str = "base_radius_mm = 200\nupper_arm_mm = 350.0\nforearm_mm = 800.0\nplatform_radius_mm = 45.0\n\
        arm_azimuths_deg = [0.0, 120.0, 240.0]\n";

    fn robot_of(text: &str) -> Result<Robot, String> {
        let (geometry, range_rad) = parse_geometry(text)?;
        Robot::new(geometry, range_rad)
    }

    #[test]
    fn positions_come_back_through_the_angles() {
        let robot = Robot::new(Geometry::default(), None).unwrap();
        for position_mm in [[-10.0, 0.0, -800.0], [300.5, -200.25, -850.125], [0.0, 0.0, -750.0]] {
            let joints = robot.inverse(position_mm).unwrap().joints_rad;
            let back = robot.forward(joints).unwrap().position_mm;
            for (value, expected) in back.iter().zip(position_mm) {
                assert!((value - expected).abs() < 1.0e-9);
            }
        }
    }

    #[test]
    fn triangles_give_the_radii() {
        let text = "base_side_mm = 692.8203230275509\nplatform_side_mm = 77.94228634059948\n\
            upper_arm_mm = 350\nforearm_mm = 800\n";
        let (geometry, range_rad) = parse_geometry(text).unwrap();
        assert!((geometry.base_radius_mm - 200.0).abs() < 1.0e-9);
        assert!((geometry.platform_radius_mm - 45.0).abs() < 1.0e-9);
        assert_eq!((geometry.arm_azimuths_deg, range_rad), ([0.0, 120.0, 240.0], None));
    }

    #[test]
    fn only_a_range_that_the_file_gives_is_checked() {
        let high = [0.0, 0.0, -470.0];
        assert!(robot_of(IRB).unwrap().inverse(high).is_ok());
        let limited = robot_of(&format!("{IRB}arm_range_rad = [-0.5, 1.7]\n")).unwrap();
        let error = limited.inverse(high).unwrap_err();
        assert!(error.message.starts_with("out of range: arm 1"), "{}", error.message);
        let error = limited.forward([0.1, 1.8, 0.1]).unwrap_err();
        assert!(error.message.starts_with("out of range: arm 2"), "{}", error.message);
    }

    #[test]
    fn a_position_without_an_answer_names_the_arm_and_the_reason() {
        let robot = Robot::new(Geometry::default(), None).unwrap();
        let message = |position_mm| robot.inverse(position_mm).unwrap_err().message;
        assert_eq!(message([-1500.0, 0.0, -800.0]), "unreachable: arm 1 does not reach it");
        assert!(message([0.0, f64::NAN, -800.0]).starts_with("y is NaN"));
        // Straight down from shoulders that stand over the platform's joints.
        let straight = robot_of(&IRB.replace("45.0", "200.0")).unwrap();
        let error = straight.inverse([0.0, 0.0, -1150.0]).unwrap_err();
        assert!(
            error.message.starts_with("singular: upper arm and forearm of arm 1"),
            "{}",
            error.message
        );
        let message = |joints| robot.forward(joints).unwrap_err().message;
        assert!(message([0.1, f64::INFINITY, 0.1]).starts_with("arm 2 is inf"));
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
            (&IRB.replace("800.0", "300.0"), "no delta robot"),
            (&IRB.replace("800.0", "nan"), "no finite number"),
            (&IRB.replace("45.0", "-45.0"), "negative"),
            (&format!("{IRB}arms = 4\n"), "unknown field"),
        ] {
            let error = robot_of(text).map(|_| ()).unwrap_err();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
