//! `etherpen plan`: runs a path through the firmware's planner and shows duration, peaks, violations and references.

use super::{ConfigArguments, print_json};
use crate::drawing::preparation::compose::unusable;
use crate::drawing::preparation::listed::read_path;
use crate::drawing::preparation::source::SourceArguments;
use crate::error::ProgramError;
use crate::output_file::OutputFile;
use crate::output_file::{refuse_input, unwritable};
use crate::planning::{CertificateReport, Findings, Table, analyse, certify};
use crate::terminal::counted;
use etherpen::config::{Config, Orientation};
use etherpen::robots::AXES;
use serde::Serialize;
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
/// merged. Without z_mm, and for a photograph, the path is what `draw` would draw: ordered, on the paper, with the
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
    /// Speed limit of every axis.
    #[arg(long, value_name = "RAD_S", value_parser = limit)]
    joint_speed: Option<f64>,
    /// Acceleration limit of every axis.
    #[arg(long, value_name = "RAD_S2", value_parser = limit)]
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
    /// Moving average of the setpoints, which limits jerk, whole milliseconds; 0 switches it off.
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
        let motion = &mut config.motion;
        let set = |value: &mut f64, given: Option<f64>| *value = given.unwrap_or(*value);
        for axis in 0..AXES {
            set(&mut motion.joint_speed_rad_s[axis], self.joint_speed);
            set(&mut motion.joint_acceleration_rad_s2[axis], self.joint_acceleration);
        }
        set(&mut motion.speed_mm_s, self.speed);
        set(&mut motion.travel_speed_mm_s, self.speed);
        set(&mut motion.acceleration_mm_s2, self.acceleration);
        set(&mut motion.tolerance_mm, self.tolerance);
        set(&mut motion.travel_tolerance_mm, self.tolerance);
        motion.jerk_window_ms = self.jerk_window.unwrap_or(motion.jerk_window_ms);
        motion.orientation = match self.orientation.as_deref() {
            Some("path") => Orientation::Path,
            Some(_) => Orientation::Constant,
            None => motion.orientation,
        };
    }
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
    let (path, vertices_merged) = read_path(&arguments.file, &config, &arguments.source)?;
    let mut table = arguments.samples.as_deref().map(begin).transpose()?;
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
        return print_json(&answer);
    }
    io::stdout()
        .write_all(shown(&answer).as_bytes())
        .map_err(|cause| ProgramError::failed("stdout", cause))
}

/// Starts the table of references.
fn begin(file: &Path) -> Result<Table<OutputFile>, ProgramError> {
    OutputFile::create(file)
        .and_then(Table::new)
        .map_err(|cause| unwritable(file, &cause))
}

/// The findings as text.
fn shown(answer: &Answer) -> String {
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
    for axis in 0..AXES {
        let jerk = limits.joint_jerk_rad_s3.map(|jerk| jerk[axis]);
        let number = axis + 1;
        let (speed, acceleration) = (peaks.joint_speed_rad_s[axis], peaks.joint_acceleration_rad_s2[axis]);
        line(
            &format!("axis {number}: speed"),
            "rad/s",
            speed,
            Some(limits.joint_speed_rad_s[axis]),
        );
        let limit = Some(limits.joint_acceleration_rad_s2[axis]);
        line("        acceleration", "rad/s2", acceleration, limit);
        line("        jerk", "rad/s3", peaks.joint_jerk_rad_s3[axis], jerk);
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
        Some(limits.tolerance_mm),
    );
    line(
        "deviation, all",
        "mm",
        findings.deviation_max_mm,
        Some(limits.travel_tolerance_mm),
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
