//! Texts about modes, faults, refusals and the bus, with what to try.
//!
//! Axes and slaves are counted from 1 here, as on the machine's labels; the protocol counts from 0.

pub mod bus;
mod faults;

use crate::axes::{self, Motion, Quantity};
use etherpen::application::{Fault, IoRefusal, Mode, Refusal};
use etherpen::board::{PreviousRun, RunEnd};
use etherpen::config::{ConfigError, IO_NAME_MAX, IoError, IoRole};
use etherpen::messages::{Command, ConfigRefusal, Status};
use etherpen::motion::{Outside, RESONANCE_HZ, RefusalReason};
use etherpen::robots::{Kinematics, KinematicsError, Words};
pub use faults::fault;
use std::borrow::Cow;

/// An operating mode in a few words.
pub fn mode(mode: Mode) -> &'static str {
    match mode {
        Mode::Startup => "waiting for a configuration",
        Mode::BusConfiguring => "bringing up the bus",
        Mode::DrivesOff => "ready, the drives are without power",
        Mode::Unreferenced => "the drives hold, the robot is not homed",
        Mode::Idle => "enabled and at rest",
        Mode::Moving => "moving",
        Mode::Drawing => "drawing",
        Mode::Holding => "the drawing is held",
        Mode::Stopping => "coming to a standstill",
        Mode::Fault => "stopped by a fault",
        Mode::Homing => "going to the home switches",
    }
}

/// Whether the bring-up or the repair of the bus waits for a slave that is still starting up. The firmware ends this wait.
pub fn waits_for_slave(status: &Status) -> bool {
    status.waiting_for.is_some() && (status.recovering || status.mode == Mode::BusConfiguring)
}

/// The latched fault of a status and what to try; behind a lost slave or cable, the inputs and outputs that are missing
/// with it.
pub fn fault_of(status: &Status) -> Option<String> {
    let latched = status.fault.as_ref()?;
    let told = fault(latched);
    let takes_others = matches!(
        latched,
        Fault::SlaveLost { .. }
            | Fault::SlaveState { .. }
            | Fault::NoLink { .. }
            | Fault::OutputsLost { axis: None, .. }
    );
    let missing = (1..).zip(&status.io).filter(|(_, state)| takes_others && !state.valid);
    let missing: Vec<String> = missing.map(|(io, _): (usize, _)| io.to_string()).collect();
    Some(match missing.as_slice() {
        [] => told,
        [io] => format!("{told}; with it io {io} is missing"),
        [others @ .., last] => format!("{told}; with it io {} and {last} are missing", others.join(", ")),
    })
}

/// The state of the firmware in a few words: its mode, and whether it is recovering from a fault.
pub fn doing(status: &Status) -> Cow<'static, str> {
    let waits = waits_for_slave(status);
    match (status.waiting_for.filter(|_| waits), status.recovering) {
        (Some(slave), _) => format!("waiting for slave {}, which is still starting up", one(slave)).into(),
        (None, true) => "the fault was acknowledged: bringing back the bus and the drives".into(),
        (None, false) => mode(status.mode).into(),
    }
}

/// A command as a noun.
pub fn command(command: &Command) -> &'static str {
    match command {
        Command::Home | Command::HomeAt { .. } => "homing",
        Command::Enable => "enabling the drives",
        Command::Disable => "disabling the drives",
        Command::Jog { .. } => "jogging",
        Command::Move { .. } => "moving",
        Command::Draw { .. } => "starting a drawing",
        Command::Hold => "holding",
        Command::Resume => "resuming",
        Command::Cancel => "cancelling",
        Command::Override { .. } => "the speed override",
        Command::Pen { .. } => "moving the pen",
        Command::Stop => "stopping",
        Command::Acknowledge => "acknowledging the fault",
        Command::SetOutput { .. } => "setting the output",
    }
}

/// Why a command was refused and what to try.
pub fn refusal(refusal: &Refusal) -> String {
    match refusal {
        Refusal::NotInMode(now) => format!("not possible now: {}; wait, or end that first", mode(*now)),
        Refusal::NotConfigured => "there is no configuration yet; connect with one (etherpen.toml)".into(),
        Refusal::NotReferenced => "the robot is not homed; home it first".into(),
        Refusal::Target(target) => vertex(target),
        Refusal::OverrideRange(percent) => format!("an override of {percent} % is outside 10 to 200 %"),
        Refusal::CauseRemains(cause) => format!("its cause is still present: {}", fault(cause)),
        Refusal::Moving => {
            "the robot is still moving, homing or switching its power; try again when it is at rest".into()
        }
        Refusal::Busy => "too many commands at once; wait a moment".into(),
        Refusal::Recovering => {
            "the fault was acknowledged already, and the bus and the drives are recovering; wait".into()
        }
        Refusal::Io { io, reason } => io_refusal(*io, *reason),
        Refusal::NeedsPower => "homing by switches moves the axes: enable the drives first (etherpen enable)".into(),
        Refusal::OtherSide {
            axis,
            angle_rad,
            planned_rad,
        } => format!(
            "axis {} stands at {:.1} degrees, where the robot only works with {:.1}: no motion leads from one side to the \
             other; switch the drives off, push the axis to the other side by hand, then enable again",
            axis + 1,
            angle_rad.to_degrees(),
            planned_rad.to_degrees()
        ),
        Refusal::NotFinite => "a value is not a finite number; check the input".into(),
        Refusal::NoPosition { axis } => format!("no position arrives from axis {}; check its drive", axis + 1),
        Refusal::PoseResolver { axis, difference_rad } => format!(
            "axis {}: the encoder shows an angle {:.2} degrees away from the pose; measure the pose again, or correct the \
             axis' synchronisation values",
            axis + 1,
            difference_rad.to_degrees()
        ),
        Refusal::PosePosition {
            axis,
            difference_rad,
            distance_mm,
        } => format!(
            "axis {}: the pose is {:.1} degrees away from the pose at the measured position, forward kinematics {distance_mm:.0} mm; \
             a multiple of 30 degrees is a wrong motor turn",
            axis + 1,
            difference_rad.to_degrees()
        ),
    }
}

/// Why a vertex was refused and what to try; vertices are counted from 0, as in the path's file.
pub fn vertex(refusal: &etherpen::motion::Refusal) -> String {
    let (why, hint) = match refusal.reason {
        RefusalReason::NotFinite => ("a coordinate is not a finite number".into(), "check the input file"),
        RefusalReason::Repeated { distance_mm } => (
            format!("it lies only {distance_mm:.4} mm from the one before"),
            "remove repeated points from the path",
        ),
        RefusalReason::Outside(why) => (outside(&why), MOVE_OR_SCALE),
        RefusalReason::Leg { at, outside: why } => (
            format!(
                "the straight line to it leaves the work area at x {:.1}, y {:.1}, z {:.1} mm: {}",
                at.x_mm,
                at.y_mm,
                at.z_mm,
                outside(&why)
            ),
            MOVE_OR_SCALE,
        ),
        RefusalReason::Wound {
            angle_rad,
            low_rad,
            high_rad,
        } => (
            format!(
                "the path has wound axis 4 up: it would turn to {angle_rad:.1} rad (allowed {low_rad:.1} to {high_rad:.1} rad)"
            ),
            "draw it in parts and home before each, or set motion.orientation = \"constant\"",
        ),
    };
    format!("vertex {} of the path was refused: {why}; {hint}", refusal.index)
}

const MOVE_OR_SCALE: &str = "move or scale the drawing so that it lies within the work area";

/// Why a position is outside the work area.
pub fn outside(outside: &Outside) -> String {
    let machine = axes::machine().geometry();
    let words = Kinematics::new(&machine).map_or_else(|_| Words::default(), |kinematics| kinematics.words());
    let joint_name = |joint: u8| axes::name(&machine, joint.into());
    match *outside {
        Outside::Radius { radius_mm, limit_mm } => {
            format!("it is {radius_mm:.1} mm from the robot's axis (limit {limit_mm:.1} mm)")
        }
        Outside::Height { z_mm, low_mm, high_mm } => {
            format!("its height is {z_mm:.1} mm (allowed {low_mm:.1} to {high_mm:.1} mm)")
        }
        Outside::Kinematics(KinematicsError::Apart) => format!("the {} do not meet there", words.last_links),
        Outside::Kinematics(KinematicsError::NotFinite) => "a coordinate is not a finite number".into(),
        Outside::Kinematics(KinematicsError::Unreachable { joint, .. }) => {
            format!("{} does not reach it", joint_name(joint))
        }
        Outside::Kinematics(KinematicsError::Singular { joint, .. }) | Outside::Stretched { joint, .. } => {
            format!(
                "{} would come too close to a singularity ({})",
                joint_name(joint),
                words.singular
            )
        }
        Outside::Kinematics(KinematicsError::Range {
            joint,
            angle_rad,
            low_rad,
            high_rad,
        })
        | Outside::Margin {
            joint,
            angle_rad,
            low_rad,
            high_rad,
        } => {
            let motion = axes::motion(machine.kind(), joint.into());
            let (unit, factor) = (motion.unit(Quantity::Position), motion.factor());
            let [angle, low, high] = [angle_rad, low_rad, high_rad].map(|value| value * factor);
            format!(
                "{} would be at {angle:.3} {unit} (allowed {low:.3} to {high:.3} {unit})",
                joint_name(joint)
            )
        }
        Outside::InnerRadius { radius_mm, limit_mm } => {
            format!("it is only {radius_mm:.1} mm from the robot's axis (at least {limit_mm:.1} mm)")
        }
        Outside::X { x_mm, low_mm, high_mm } => {
            format!("its x is {x_mm:.1} mm (allowed {low_mm:.1} to {high_mm:.1} mm)")
        }
        Outside::Y { y_mm, low_mm, high_mm } => {
            format!("its y is {y_mm:.1} mm (allowed {low_mm:.1} to {high_mm:.1} mm)")
        }
        Outside::Flat { .. } => format!("the {} would lie in a plane", words.last_links),
        Outside::Paper { z_mm, low_mm } => {
            format!("at {z_mm:.1} mm the pen would press too deep into the paper (allowed down to {low_mm:.1} mm)")
        }
    }
}

/// Why a configuration was refused and what to try.
pub fn config_refusal(refusal: &ConfigRefusal) -> String {
    match refusal {
        ConfigRefusal::Bounds(error) => config_error(error),
        ConfigRefusal::Geometry(cause) => {
            format!(
                "the configured dimensions do not form a valid robot ({cause}); correct [geometry] in etherpen.toml"
            )
        }
        ConfigRefusal::Io(error) => format!("{}; correct {} in etherpen.toml", io_error(error), io_table(error)),
        ConfigRefusal::NotInMode(now) => format!(
            "the configuration cannot be changed now: {}; disable the drives first",
            mode(*now)
        ),
    }
}

/// Why a named input or output was refused, and what to try.
fn io_refusal(io: u8, reason: IoRefusal) -> String {
    let io = one(io);
    match reason {
        IoRefusal::Unknown => format!("the firmware's configuration has no io {io}; connect with the one that has it"),
        IoRefusal::IsInput => format!("io {io} is an input; only outputs can be set"),
        IoRefusal::IsOwn => format!("io {io} is the lamp's or the pen's; the controller sets it"),
        IoRefusal::Range { expected, actual } => {
            format!("the value {actual:#x} does not fit the {expected} bits of io {io}")
        }
        IoRefusal::Missing => {
            format!(
                "the terminal of io {io} is not in operation; check its supply and cable, then: etherpen acknowledge"
            )
        }
        IoRefusal::Holds => format!("the hold input (io {io}) is open; close it first"),
    }
}

/// The table of the configuration in which an error is.
const fn io_table(error: &IoError) -> &'static str {
    match error {
        IoError::TerminalSlave { .. }
        | IoError::SameTerminal { .. }
        | IoError::SameDevice { .. }
        | IoError::DeviceOfAxis { .. } => "[[terminals]]",
        _ => "[[io]]",
    }
}

/// Why a named input or output of the configuration, or a terminal, cannot be used.
pub fn io_error(error: &IoError) -> String {
    match *error {
        IoError::Name { io } => format!(
            "the name of io {} has to be of 1 to {IO_NAME_MAX} letters, digits, '_' and '-'",
            one(io)
        ),
        IoError::SameName { first, second } => format!("io {} and io {} have one name", one(first), one(second)),
        IoError::Slave { io, expected, actual } => {
            format!("io {}: slave is {actual}, allowed is 0 to {expected}", one(io))
        }
        IoError::HomeSwitch { axis } => format!(
            "axis {}: its home switch is not an input with role = \"home\" in [[io]]",
            one(axis)
        ),
        IoError::SameHomeSwitch { first, second } => format!(
            "axis {} and axis {} have one home switch; each axis needs its own",
            one(first),
            one(second)
        ),
        IoError::CoupledAxis { axis } => format!(
            "axis {}: it moves together with an axis that has a home switch, and one switch does not tell the places of both; \
             give it one too, or home both by encoders",
            one(axis)
        ),
        IoError::PenWithoutHeight => {
            "an output cannot lower the pen of this kind of machine, whose third axis is not the \
                                      height; write kind = \"axis\" in [pen]"
                .into()
        }
        IoError::PenPositions { io } => format!(
            "io {}: the output that lowers the pen is a bit (type = \"bool\") with kind = \"output\" in [pen], and a word with \
             kind = \"servo\", whose type holds both up and down, two different values; without the controller an output is 0, \
             which must not press the pen down: down is neither 0 nor between 0 and up; all pens have the same type",
            one(io)
        ),
        IoError::ToolWithoutOutput => {
            "the tool follows the path, and no output does; write an [[io]] with direction = \"out\" and \
                                       role = \"tool\", or take [tool] out"
                .into()
        }
        IoError::ToolFollowsNothing { io } => format!(
            "io {}: an output with role = \"tool\" needs what it follows; write follows = \"speed\", nominal_mm_s and maximum \
             in [tool], or follows = \"distance\" and pitch_um",
            one(io)
        ),
        IoError::ToolRange { io, most } => format!(
            "io {}: maximum in [tool] has to be 1 to {most}, which its type holds, and minimum not above maximum",
            one(io)
        ),
        IoError::ToolPitch { io, least_um } => format!(
            "io {}: at motion.speed_mm_s its pulses come faster than it shows them; write pitch_um = {least_um} or more in \
             [tool], a lower motion.speed_mm_s, or a word (type = \"u16\") instead of a bit",
            one(io)
        ),
        IoError::LimitAxis { io, axes } => format!(
            "io {}: the role limit needs axis = 0 to {}, the axis of the limit switch, and no other role has an axis",
            one(io),
            axes.saturating_sub(1)
        ),
        IoError::Place { io } => format!("io {}: give either bit or object", one(io)),
        IoError::Bit { io, expected, actual } => {
            format!(
                "io {}: bit is {actual}, allowed for its type is 0 to {expected}",
                one(io)
            )
        }
        IoError::Role {
            io,
            role: role @ (IoRole::Lamp | IoRole::Pen),
        } => format!("io {}: a {} is an output of type bool", one(io), role.name()),
        IoError::Role { io, role: IoRole::Tool } => format!(
            "io {}: the role tool is for an output that is off at a fault; write direction = \"out\", and no on_fault",
            one(io)
        ),
        IoError::Role { io, role } => {
            format!("io {}: the role {} is for an input of type bool", one(io), role.name())
        }
        IoError::SameOutput { first, second } => {
            format!("io {} and io {} set the same output", one(first), one(second))
        }
        IoError::TerminalSlave {
            terminal,
            expected,
            actual,
        } => {
            format!(
                "terminal {}: slave is {actual}, allowed is 0 to {expected}",
                one(terminal)
            )
        }
        IoError::SameTerminal { first, second } => {
            format!("terminal {} and terminal {} are at one place", one(first), one(second))
        }
        IoError::SameDevice { first, second } => {
            format!(
                "terminal {} and terminal {} expect the same device",
                one(first),
                one(second)
            )
        }
        IoError::DeviceOfAxis { terminal, axis } => {
            format!(
                "terminal {} and axis {} expect the same device",
                one(terminal),
                one(axis)
            )
        }
    }
}

/// Which value of the configuration was refused.
pub fn config_error(error: &ConfigError) -> String {
    let axis = error
        .field
        .axis
        .map_or(String::new(), |axis| format!(" of axis {}", one(axis)));
    let why = match error.field.name() {
        "axes.quick_stop_rad_s2" if error.value > error.high => {
            "the drive is told increments per second squared in 32 bits: a smaller gear or fewer increments allow more; "
        }
        "axes.quick_stop_rad_s2" => "the axis must stop from its highest speed before its brake closes; ",
        "axes.alias" | "axes.switch" | "axes.serial" => "another axis expects the same drive; ",
        "motion.resonance_hz" if error.low > error.high => {
            return "motion.resonance_hz: at this acceleration_mm_s2 the input shaper can keep no frequency quiet within tolerance_mm; a \
                    larger tolerance_mm or a lower acceleration_mm_s2 allows it; correct it in etherpen.toml"
                .to_string();
        }
        "motion.resonance_hz" if error.value < error.low && error.low > RESONANCE_HZ[0] => {
            "the input shaper leads the tool farther from its line at a lower frequency: a larger tolerance_mm or a lower \
             acceleration_mm_s2 allows it; "
        }
        "axes.gear" if is_linear(error) => "it is gear times 628.3 mm / pitch_mm; ",
        _ => "",
    };
    let (name, factor) = written(error);
    // Without the remainder of the conversion.
    let shown = |value: f64| (value * factor * 1.0e6).round() / 1.0e6;
    let [value, low, high] = match factor == 1.0 {
        true => [error.value, error.low, error.high],
        false => [error.value, error.low, error.high].map(shown),
    };
    format!("{name}{axis} is {value}, allowed is {low} to {high}; {why}correct it in etherpen.toml")
}

/// Whether the refused value belongs to a linear axis.
fn is_linear(error: &ConfigError) -> bool {
    let of_axis = |axis: u8| axes::motion(error.field.kind, axis.into()) == Motion::Linear;
    error.field.axis.is_some_and(of_axis)
}

/// The refused value's name in a configuration file, and the factor from the controller's value to the written one.
fn written(error: &ConfigError) -> (Cow<'static, str>, f64) {
    let name = error.field.name();
    let as_written = |axis: u8| axes::as_written(error.field.kind, axis.into(), name.strip_prefix("axes.")?);
    if let Some((name, factor)) = error.field.axis.and_then(as_written) {
        return (format!("axes.{name}").into(), factor);
    }
    // A list with a value for each axis in the axis's own unit; where all main axes are linear, it is millimetres.
    let motions = axes::motions(error.field.kind);
    let in_own_units = motions.contains(&Motion::Linear);
    let factor = match motions {
        [first, second, third, _] if first == second && second == third => first.factor(),
        _ => 1.0,
    };
    match name {
        "motion.joint_speed_rad_s" if in_own_units => ("motion.joint_speed".into(), factor),
        "motion.joint_acceleration_rad_s2" if in_own_units => ("motion.joint_acceleration".into(), factor),
        _ => (name.into(), 1.0),
    }
}

/// How the previous run ended, if that is worth reporting.
pub fn previous_run(previous: &PreviousRun) -> Option<String> {
    let end = match &previous.end {
        RunEnd::PowerOff | RunEnd::Reset if previous.fault.is_none() => return None,
        RunEnd::PowerOff => "the firmware was switched off".into(),
        RunEnd::Reset => "the firmware was reset".into(),
        RunEnd::Watchdog => "the watchdog ended the firmware's last run: a task did not run".into(),
        RunEnd::Panic(cause) => format!("the firmware's last run ended by itself: {cause}; please report it"),
    };
    let last = previous.fault.as_ref();
    let last = last.map_or_else(String::new, |last| format!("; its last fault was: {}", fault(last)));
    let recorded = match previous.end {
        RunEnd::Watchdog | RunEnd::Panic(_) => "; its last two seconds may be kept: etherpen blackbox",
        RunEnd::PowerOff | RunEnd::Reset => "",
    };
    Some(end + &last + recorded)
}

fn one(index: u8) -> u16 {
    u16::from(index) + 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::application::Fault;
    use etherpen::config::Config;
    use etherpen::robots::Position;

    #[test]
    fn a_refused_value_is_named_with_its_axis_and_bounds() {
        let mut config = Config::default();
        config.axes[1].gear = 0.0;
        let text = config_error(&config.check().unwrap_err());
        assert_eq!(
            text,
            "axes.gear of axis 2 is 0, allowed is 0.1 to 1000; correct it in etherpen.toml"
        );
    }

    #[test]
    fn a_quick_stop_that_is_too_weak_is_refused_with_the_value_it_needs() {
        let mut config = Config::default();
        config.axes[2].quick_stop_rad_s2 = 1.0;
        let text = config_error(&config.check().unwrap_err());
        assert!(
            text.starts_with("axes.quick_stop_rad_s2 of axis 3 is 1, allowed is 28.73 to 2000; the axis must stop"),
            "{text}"
        );
    }

    #[test]
    fn an_earlier_end_is_told_only_when_there_is_something_to_tell() {
        assert_eq!(previous_run(&PreviousRun::default()), None);
        let previous = PreviousRun {
            end: PreviousRun::panicked("src/a.rs:7: no"),
            fault: Some(Fault::ReferenceLost { axis: 2 }),
        };
        let text = previous_run(&previous).unwrap();
        assert!(text.contains("src/a.rs:7: no") && text.contains("axis 3"), "{text}");
        let reset = PreviousRun {
            end: RunEnd::Watchdog,
            fault: None,
        };
        assert!(previous_run(&reset).unwrap().contains("watchdog"));
    }

    #[test]
    fn a_refused_vertex_is_told_with_its_place_and_the_limit() {
        let radius = Outside::Radius {
            radius_mm: 571.25,
            limit_mm: 565.0,
        };
        let reason = RefusalReason::Leg {
            at: Position::default(),
            outside: radius,
        };
        let text = vertex(&etherpen::motion::Refusal { index: 17, reason });
        assert!(
            text.starts_with("vertex 17 of the path was refused: the straight line"),
            "{text}"
        );
        assert!(text.contains("(limit 565.0 mm); move or scale"), "{text}");
        let margin = Outside::Margin {
            joint: 0,
            angle_rad: -0.7,
            low_rad: -0.6,
            high_rad: 1.7,
        };
        assert!(outside(&margin).contains("arm 1 would be at -0.700 rad"));
        let stretched = Outside::Stretched {
            joint: 1,
            ratio: 0.05,
            limit: 0.1,
        };
        assert_eq!(
            outside(&stretched),
            "arm 2 would come too close to a singularity (upper arm and forearm in line)"
        );
    }
}
