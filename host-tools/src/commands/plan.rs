//! `etherpen plan`: runs a path through the firmware's planner and shows duration, peaks, violations and references.

use super::{ConfigArguments, print_json};
use crate::axes::{AxisView, Motion, Quantity, axes, motions};
use crate::drawing::preparation::compose::unusable;
use crate::drawing::preparation::listed::read_path;
use crate::drawing::preparation::source::SourceArguments;
use crate::error::{ProgramError, code};
use crate::output_file::OutputFile;
use crate::output_file::{refuse_input, unwritable};
use crate::planning::{CertificateReport, Findings, Table, analyse, certify};
use crate::terminal::counted;
use etherpen::config::{Config, InputShaper, MotionLimits, Orientation};
use etherpen::motion::{RESONANCE_HZ, effective_jerk_window_ms, resonance_min_hz};
use etherpen::robots::AXES;
use serde::Serialize;
use serde_json::Value;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Longest moving average, ms.
const JERK_WINDOW_MAX_MS: u16 = 32;
/// The excess that the planner's own tests allow, [`crate::planning::EXCESS`], as text.
const EXCESS_TEXT: &str = "0.001";
/// Largest value of a limit: its square is still a number.
const LIMIT_MAX: f64 = 1.0e12;

/// Options of `etherpen plan`.
///
/// A CSV with the heading `x_mm,y_mm,z_mm,pen` is in the robot's frame and planned exactly as listed: from rest at its
/// first vertex to rest at its last, without an approach or added pen motion; vertices less than 0.0005 mm apart are
/// merged, and those of legs shorter than four tolerances where a fifth of the tolerance allows it. Without z_mm, and for a photograph, the path is what `draw` would draw: ordered, on the paper, with the
/// pen's lifts.
///
/// The deviation is measured on every 1 ms reference, as its distance from the path near the vertex being passed, and
/// on every vertex, as its distance from the line through the references (less what a straight line between two of them
/// leaves out). Both have to be within the tolerance. Speeds, accelerations and jerks are differences of the
/// references; a value that exceeds its limit by more than a thousandth is a violation.
///
/// `--certify` also proves the limits at every moment between the references, with interval arithmetic and kinematics
/// of its own: angles, speeds and accelerations before the moving average, the distance from the path before and after
/// it. Every limit that is not proved is listed with a witness.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// CSV of coordinates, a photograph (PNG, JPEG, WebP) or vectors (SVG, G-code, HPGL).
    file: PathBuf,
    /// Print the findings as JSON on stdout.
    #[arg(long)]
    json: bool,
    /// Write one row a millisecond: time, position, joint angles, joint speeds, pen.
    #[arg(long, value_name = "OUT.csv")]
    samples: Option<PathBuf>,
    /// Prove the limits in continuous time. EXCESS is the part of a limit by which it may be exceeded.
    #[arg(long, value_name = "EXCESS", num_args = 0..=1, require_equals = true, default_missing_value = EXCESS_TEXT,
          value_parser = excess)]
    certify: Option<f64>,
    #[command(flatten)]
    config: ConfigArguments,
    #[command(flatten)]
    limits: LimitArguments,
    #[command(flatten)]
    source: SourceArguments,
}

/// Limits given by hand; they override the configuration, and its bounds too: nothing moves.
#[derive(clap::Args, Debug, Default)]
struct LimitArguments {
    /// Speed limit of every axis, in its own unit: rad/s, or mm/s of a linear axis.
    #[arg(long, value_name = "RAD_S|MM_S", value_parser = limit)]
    joint_speed: Option<f64>,
    /// Acceleration limit of every axis, in its own unit: rad/s2, or mm/s2 of a linear axis.
    #[arg(long, value_name = "RAD_S2|MM_S2", value_parser = limit)]
    joint_acceleration: Option<f64>,
    /// Speed limit of the tool, pen down and up.
    #[arg(long, value_name = "MM_S", value_parser = limit)]
    speed: Option<f64>,
    /// Acceleration limit of the tool.
    #[arg(long, value_name = "MM_S2", value_parser = limit)]
    acceleration: Option<f64>,
    /// Largest distance of the setpoints from the path, pen down and up.
    #[arg(long, value_name = "MM", value_parser = limit)]
    tolerance: Option<f64>,
    /// Moving average of the setpoints, which limits jerk, whole milliseconds; 0 switches it off. Refused if it would take
    /// more than half of the tolerance.
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u16).range(0..=i64::from(JERK_WINDOW_MAX_MS)))]
    jerk_window: Option<u16>,
    /// Axis 4: follow the direction of the path, or keep its angle.
    #[arg(long, value_name = "WHAT", value_parser = ["path", "constant"])]
    orientation: Option<String>,
}

fn excess(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=1.0).contains(&value) => Ok(value),
        _ => Err("a number from 0 to 1 is needed".into()),
    }
}

fn limit(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= LIMIT_MAX => Ok(value),
        _ => Err(format!("a number above 0 and up to {LIMIT_MAX:.0e} is needed")),
    }
}

impl LimitArguments {
    fn apply(&self, config: &mut Config) {
        let motions = motions(config.geometry.kind());
        let motion = &mut config.motion;
        let set = |value: &mut f64, given: Option<f64>| *value = given.unwrap_or(*value);
        let speeds = motion.joint_speed_rad_s.iter_mut();
        let limits = speeds.zip(&mut motion.joint_acceleration_rad_s2).zip(motions);
        for ((speed_rad_s, acceleration_rad_s2), axis) in limits {
            let in_rad = |given: Option<f64>| given.map(|value| value / axis.factor());
            set(speed_rad_s, in_rad(self.joint_speed));
            set(acceleration_rad_s2, in_rad(self.joint_acceleration));
        }
        set(&mut motion.speed_mm_s, self.speed);
        set(&mut motion.travel_speed_mm_s, self.speed);
        set(&mut motion.acceleration_mm_s2, self.acceleration);
        set(&mut motion.tolerance_mm, self.tolerance);
        set(&mut motion.travel_tolerance_mm, self.tolerance);
        motion.orientation = match self.orientation.as_deref() {
            Some("path") => Orientation::Path,
            Some(_) => Orientation::Constant,
            None => motion.orientation,
        };
    }

    /// Applies the moving average, after all other limits: they bound its length.
    fn apply_jerk_window(&self, config: &mut Config) -> Result<(), ProgramError> {
        let Some(asked_ms) = self.jerk_window else {
            return Ok(());
        };
        config.motion.jerk_window_ms = asked_ms;
        let longest_ms = effective_jerk_window_ms(&config.motion_settings());
        if longest_ms == asked_ms {
            return Ok(());
        }
        let MotionLimits {
            tolerance_mm,
            acceleration_mm_s2,
            ..
        } = config.motion;
        Err(ProgramError::new(
            code::USAGE,
            format!(
                "--jerk-window {asked_ms}: at {acceleration_mm_s2} mm/s2 an average over more than {longest_ms} ms takes \
                 more than half of the tolerance of {tolerance_mm} mm; give a window of at most {longest_ms} ms, a larger \
                 --tolerance or a lower --acceleration"
            ),
        ))
    }
}

/// Whether the input shaper keeps the tolerance with the limits given by hand, and a certificate can be asked for.
fn check_shaper(config: &Config, arguments: &Arguments) -> Result<(), ProgramError> {
    let motion = &config.motion;
    let usage = |text| Err(ProgramError::new(code::USAGE, text));
    if motion.input_shaper == InputShaper::None {
        return Ok(());
    }
    if arguments.certify.is_some() {
        return usage(
            "--certify: nothing is proved of setpoints that an input shaper sums; give a configuration with motion.input_shaper = \
             \"none\""
                .to_string(),
        );
    }
    let lowest_hz = resonance_min_hz(motion);
    if motion.resonance_hz >= lowest_hz {
        return Ok(());
    }
    if lowest_hz > RESONANCE_HZ[1] {
        return usage(format!(
            "at {} mm/s2 and a tolerance of {} mm the input shaper keeps no resonance quiet; give a larger --tolerance or a lower \
             --acceleration",
            motion.acceleration_mm_s2, motion.tolerance_mm
        ));
    }
    usage(format!(
        "at {} mm/s2 and a tolerance of {} mm the input shaper keeps no resonance below {lowest_hz:.1} Hz quiet; motion.resonance_hz \
         is {}: give a larger --tolerance or a lower --acceleration",
        motion.acceleration_mm_s2, motion.tolerance_mm, motion.resonance_hz
    ))
}

/// What the command prints.
#[derive(Debug, Serialize)]
struct Answer {
    /// Vertices of the path.
    vertices: usize,
    /// Vertices merged with the vertex before them.
    vertices_merged: usize,
    #[serde(flatten)]
    findings: Findings,
    /// What is proved in continuous time.
    #[serde(skip_serializing_if = "Option::is_none")]
    certificate: Option<CertificateReport>,
}

/// Runs the command.
///
/// # Errors
/// The file or the configuration cannot be used, or a vertex is refused: its index, its line and why.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    if let Some(table) = &arguments.samples {
        refuse_input(
            table,
            &arguments.source.inputs(&arguments.file, arguments.config.path()),
        )?;
    }
    let mut config = arguments.config.load()?;
    arguments.limits.apply(&mut config);
    arguments.limits.apply_jerk_window(&mut config)?;
    check_shaper(&config, arguments)?;
    let (path, vertices_merged) = read_path(&arguments.file, &config, &arguments.source)?;
    let mut table = arguments
        .samples
        .as_deref()
        .map(|file| begin(&config, file))
        .transpose()?;
    let mut failed = None;
    let observe = |sample: &_| {
        if let Some(Err(cause)) = table.as_mut().map(|table| table.step(sample)) {
            failed.get_or_insert(cause);
        }
    };
    let (findings, certificate) = match arguments.certify {
        Some(excess) => {
            certify(&config, &path, excess, observe).map(|(findings, certificate)| (findings, Some(certificate)))
        }
        None => analyse(&config, &path, observe).map(|findings| (findings, None)),
    }
    .map_err(|cause| unusable(&arguments.file, &cause))?;
    if let (Some(cause), Some(file)) = (
        failed.or_else(|| table.and_then(|table| table.finish().commit().err())),
        &arguments.samples,
    ) {
        return Err(unwritable(file, &cause));
    }
    let answer = Answer {
        vertices: path.len() + vertices_merged,
        vertices_merged,
        findings,
        certificate,
    };
    if arguments.json {
        let value = serde_json::to_value(&answer).map_err(|cause| ProgramError::failed("the findings", cause))?;
        return print_json(&in_units(value, &axes(&config)));
    }
    io::stdout()
        .write_all(shown(&answer, &axes(&config)).as_bytes())
        .or_else(ProgramError::of_stdout)
}

/// Starts the table of references.
fn begin(config: &Config, file: &Path) -> Result<Table<OutputFile>, ProgramError> {
    OutputFile::create(file)
        .and_then(|out| Table::new(config, out))
        .map_err(|cause| unwritable(file, &cause))
}

/// Quantities of the joints in the findings, by their names without a unit.
const OF_JOINTS: [(&str, Quantity); 3] = [
    ("joint_speed", Quantity::Speed),
    ("joint_acceleration", Quantity::Acceleration),
    ("joint_jerk", Quantity::Jerk),
];

/// The findings with the values of the joints in the units of the machine's axes, and without axes that it lacks. Where
/// the units are mixed, a list becomes an object with the axes' names.
fn in_units(mut answer: Value, axes: &[AxisView]) -> Value {
    for table in ["peaks", "limits"] {
        let Some(values) = answer.get_mut(table).and_then(Value::as_object_mut) else {
            continue;
        };
        for (name, quantity) in OF_JOINTS {
            let rotary = format!("{name}_{}", Motion::Rotary.suffix(quantity));
            let Some(Value::Array(list)) = values.get(&rotary) else {
                continue;
            };
            let value = |axis: &AxisView| {
                let value = list.get(axis.index).and_then(Value::as_f64);
                value.map_or(Value::Null, |value| (value * axis.motion.factor()).into())
            };
            let first = axes.first().map_or(Motion::Rotary, |axis| axis.motion);
            let (key, converted) = if axes.iter().all(|axis| axis.motion == first) {
                let key = format!("{name}_{}", first.suffix(quantity));
                (key, axes.iter().map(value).collect())
            } else {
                let named = |axis: &AxisView| (format!("{}_{}", axis.name, axis.motion.suffix(quantity)), value(axis));
                (name.to_owned(), Value::Object(axes.iter().map(named).collect()))
            };
            values.remove(&rotary);
            values.insert(key, converted);
        }
    }
    let violations = answer.get_mut("violations").and_then(Value::as_array_mut);
    for violation in violations.into_iter().flatten() {
        let number = violation.get("axis").and_then(Value::as_u64);
        let axis = axes.iter().find(|axis| Some(axis.index as u64 + 1) == number);
        if let Some(axis) = axis.filter(|axis| axis.motion == Motion::Linear) {
            violation_in_millimetres(violation, axis);
        }
    }
    answer
}

fn violation_in_millimetres(violation: &mut Value, axis: &AxisView) {
    let limited = violation.get("limit_of").and_then(Value::as_str).unwrap_or_default();
    let name = limited.replace("_rad", "_mm");
    let scaled = |value: Option<&Value>| value.and_then(Value::as_f64).map(|value| value * axis.motion.factor());
    let [value, limit] = ["value", "limit"].map(|key| scaled(violation.get(key)));
    if let Some(violation) = violation.as_object_mut() {
        violation.insert("limit_of".into(), name.into());
        violation.insert("value".into(), value.into());
        violation.insert("limit".into(), limit.into());
    }
}

/// The findings as text.
fn shown(answer: &Answer, axes: &[AxisView]) -> String {
    let findings = &answer.findings;
    let (peaks, limits) = (&findings.peaks, &findings.limits);
    let mut text = format!(
        "{:.3} s for {:.1} mm, {} vertices\n\n{:<22} {:>12} {:>12}\n",
        findings.duration_s, findings.length_mm, answer.vertices, "", "peak", "limit"
    );
    let mut line = |name: &str, unit: &str, peak: f64, limit: Option<f64>| {
        let limit = limit.map_or("-".into(), figure);
        text.push_str(&format!("{name:<22} {:>12} {limit:>12} {unit}\n", figure(peak)));
    };
    for axis in axes {
        let unit = |quantity| axis.motion.unit(quantity);
        let name = format!("{}: speed", axis.label);
        let of = |values: &[f64; AXES]| axis.of(values);
        let limit = Some(of(&limits.joint_speed_rad_s));
        line(&name, unit(Quantity::Speed), of(&peaks.joint_speed_rad_s), limit);
        let (peak, limit) = (
            of(&peaks.joint_acceleration_rad_s2),
            of(&limits.joint_acceleration_rad_s2),
        );
        line("        acceleration", unit(Quantity::Acceleration), peak, Some(limit));
        let jerk = limits.joint_jerk_rad_s3.as_ref().map(of);
        line("        jerk", unit(Quantity::Jerk), of(&peaks.joint_jerk_rad_s3), jerk);
    }
    line("drawing speed", "mm/s", peaks.speed_mm_s, Some(limits.speed_mm_s));
    line(
        "travel speed",
        "mm/s",
        peaks.travel_speed_mm_s,
        Some(limits.travel_speed_mm_s),
    );
    line(
        "acceleration",
        "mm/s2",
        peaks.acceleration_mm_s2,
        Some(limits.acceleration_mm_s2),
    );
    line("jerk", "mm/s3", peaks.jerk_mm_s3, None);
    line(
        "deviation, pen down",
        "mm",
        findings.deviation_drawn_max_mm,
        Some(limits.tolerance_mm + limits.shaper_deviation_mm),
    );
    line(
        "deviation, all",
        "mm",
        findings.deviation_max_mm,
        Some(limits.travel_tolerance_mm + limits.shaper_deviation_mm),
    );
    text + &violations(findings) + &answer.certificate.as_ref().map_or(String::new(), proved)
}

/// The certificate as text.
fn proved(certificate: &CertificateReport) -> String {
    let axis = |axis: Option<u8>| axis.map_or(String::new(), |axis| format!(" of axis {axis}"));
    let mut text = format!(
        "\n{} in continuous time ({} of a limit over it allowed): {} stretches, {}, {} undecided\n",
        if certificate.proved { "proved" } else { "not proved" },
        figure(certificate.excess),
        certificate.stretches,
        counted(certificate.violations as u64, "violation"),
        certificate.undecided
    );
    for used in &certificate.used {
        let name = format!("{}{}", used.limit_of, axis(used.axis));
        text.push_str(&format!(
            "  {name:<30} uses {:.5} to {:.5} of its limit\n",
            used.least, used.most
        ));
    }
    for refused in certificate.refusals.iter().take(20) {
        let [low, high] = refused.value.map(figure);
        text.push_str(&format!(
            "  {}: {}{} at {:.6} s, stretch {}, vertex {}: {low} to {high} {} over {}\n",
            refused.kind,
            refused.limit_of,
            axis(refused.axis),
            refused.t_s,
            refused.stretch,
            refused.vertex,
            refused.unit,
            figure(refused.limit)
        ));
    }
    text
}

/// The violations of limits as text.
fn violations(findings: &Findings) -> String {
    let mut text = format!("\n{} of limits\n", counted(findings.violation_count, "violation"));
    for violation in findings.violations.iter().take(20) {
        let axis = violation.axis.map_or(String::new(), |axis| format!(" axis {axis}"));
        let at = match (violation.t_ms, violation.vertex) {
            (Some(t_ms), _) => format!("at {t_ms} ms"),
            (None, Some(vertex)) => format!("at vertex {vertex}"),
            (None, None) => String::new(),
        };
        text.push_str(&format!(
            "  {}{axis} {at}: {} over {}\n",
            violation.limit_of,
            figure(violation.value),
            figure(violation.limit)
        ));
    }
    text
}

/// A number with four significant digits.
fn figure(value: f64) -> String {
    let places = if value == 0.0 || !value.is_finite() {
        0
    } else {
        (3.0 - value.abs().log10().floor()).clamp(0.0, 6.0) as usize
    };
    format!("{value:.places$}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::motion::{Pen, Vertex};

    #[test]
    fn the_findings_name_each_axis_by_its_label() {
        for (machine, labels) in [
            (0, "axis 1, axis 2, axis 3, axis 4"),
            (1, "x, y, z"),
            (3, "shoulder, elbow, height, turn"),
            (4, "axis 1, axis 2, axis 3"),
        ] {
            let config = crate::settings::machines::MACHINES[machine].load().unwrap();
            let [x_mm, y_mm] = config.paper.centre_mm;
            let vertex = |along_mm: f64| Vertex {
                position: [x_mm + along_mm, y_mm, config.paper.pen_down_z_mm].into(),
                pen: Pen::Down,
                stroke: 0,
            };
            let path = [vertex(0.0), vertex(5.0)];
            let answer = Answer {
                vertices: path.len(),
                vertices_merged: 0,
                findings: analyse(&config, &path, |_| {}).unwrap(),
                certificate: None,
            };
            let text = shown(&answer, &axes(&config));
            let told: Vec<&str> = text
                .lines()
                .filter_map(|line| Some(line.split_once(": speed")?.0))
                .collect();
            assert_eq!(told.join(", "), labels);
        }
    }

    #[test]
    fn findings_are_told_in_the_units_of_the_axes() {
        let answer = serde_json::json!({
            "peaks": {"joint_speed_rad_s": [1.0, 2.0, 3.0, 4.0], "speed_mm_s": 5.0},
            "violations": [{"limit_of": "joint_speed_rad_s", "axis": 3, "value": 3.0, "limit": 2.0}],
        });
        let told = |machine: usize| {
            let config = crate::settings::machines::MACHINES[machine].load().unwrap();
            in_units(answer.clone(), &axes(&config))
        };
        assert_eq!(told(0), answer);
        let gantry = told(1);
        assert_eq!(
            gantry["peaks"]["joint_speed_mm_s"],
            serde_json::json!([100.0, 200.0, 300.0])
        );
        let violation = &gantry["violations"][0];
        assert_eq!(
            (&violation["limit_of"], &violation["limit"]),
            (&"joint_speed_mm_s".into(), &200.0.into())
        );
        let scara = told(3);
        assert_eq!(scara["peaks"]["joint_speed"]["height_mm_s"], 300.0);
        assert_eq!(scara["peaks"]["joint_speed"]["turn_rad_s"], 4.0);
    }
}
