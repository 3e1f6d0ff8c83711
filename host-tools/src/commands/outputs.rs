//! The output files of a drawing, and its printed summary.

use super::prepare::Prepared;
use super::{CommandError, code, counted, in_colour};
use crate::cell::{Cell, CellOptions, InkStroke};
use crate::drawing::{Stroke, render_png, render_rgb, tone_correlation, write_svg};
use crate::emulator;
use crate::link::job::JobReport;
use crate::output_file::{OutputFile, is_same_file};
use crate::recording::{About, Recorder};
use crate::report::{Drives, Evidence, Report, Timing, rows, write_intended, write_telemetry, write_tracking};
use etherpen::config::Config;
use etherpen::link::protocol::{Counters, Status};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Width of the pen's line in the pictures, mm.
const PEN_WIDTH_MM: f64 = 0.5;
/// Largest distance from the intended line reported as good, mm.
const DEVIATION_GOOD_MM: f64 = 0.1;
/// Resolution of `drawn.png`, pixels a millimetre.
const PIXELS_PER_MM: f64 = 8.0;

/// Everything a run leaves behind.
pub(super) struct Outcome<'a> {
    /// The configuration that was in force.
    pub(super) config: &'a Config,
    /// What was to be drawn.
    pub(super) prepared: &'a Prepared,
    /// What the job collected.
    pub(super) job: &'a JobReport,
    /// The virtual cell and what it is made of, unless a real machine drew.
    pub(super) cell: Option<(&'a Cell, &'a CellOptions)>,
    /// Name or hash of what ran.
    pub(super) image: String,
    /// Planner's duration, s; not a number where the path cannot be planned.
    pub(super) planned_s: f64,
    /// Whether the job ended as it should.
    pub(super) completed: bool,
}

impl Outcome<'_> {
    /// The figures.
    pub(super) fn report(&self) -> Report {
        let ink = self.cell.map(|(cell, _)| ink_in_robot_frame(self.config, cell.ink()));
        let drives = self.cell.map(|(_, options)| Drives {
            bandwidth_hz: options.drive_bandwidth_hz,
            input_delay_cycles: options.input_delay_cycles,
            output_delay_cycles: options.output_delay_cycles,
        });
        let mut report = Report::new(&Evidence {
            config: self.config,
            path: &self.prepared.path,
            samples: &self.job.samples,
            ink_mm: ink.as_deref(),
            verdict: &self.job.verification.verdict(),
            counters: self.counters(),
            completed: self.completed,
            planned_s: self.planned_s,
            image: self.image.clone(),
            drives,
        });
        report.held_s = self.job.held_s;
        if self.cell.is_none() {
            // Telemetry has gaps where the line was broken.
            report.drawn_s = self.job.drawn_s;
        }
        if !self.completed {
            report.pen_down_mm = self.job.progress.pen_down_mm;
        }
        if let Some(readings) = &self.job.measurements {
            report.timing = Timing::new(readings, self.ns_per_instruction());
        }
        if let (Some((picture, place_mm)), Some((cell, _))) = (&self.prepared.photograph, self.cell) {
            let sheet_mm = self.config.paper.size_mm;
            let drawn = render_rgb(&strokes(cell.ink()), sheet_mm, PEN_WIDTH_MM, PIXELS_PER_MM);
            let [left, top, width, height] = place_mm.map(|mm| (mm * PIXELS_PER_MM).round() as u32);
            let drawn = image::imageops::crop_imm(&drawn, left, top, width, height).to_image();
            report.tone_correlation = Some(tone_correlation(picture, &drawn));
        }
        report
    }

    /// What the firmware counted: on a real machine since the drawing began, which may have run for days before.
    fn counters(&self) -> Counters {
        let counters = |status: &Option<Status>| status.as_ref().map(|status| status.counters).unwrap_or_default();
        let last = counters(&self.job.status);
        if self.cell.is_some() {
            return last;
        }
        let before = counters(&self.job.status_before);
        let since = |last: u32, before: u32| last.wrapping_sub(before);
        Counters {
            cycles: since(last.cycles, before.cycles),
            cycles_late: since(last.cycles_late, before.cycles_late),
            frames_lost: since(last.frames_lost, before.frames_lost),
            working_counter_errors: since(last.working_counter_errors, before.working_counter_errors),
            frames_ignored: since(last.frames_ignored, before.frames_ignored),
            reference_underruns: since(last.reference_underruns, before.reference_underruns),
            path_starvations: since(last.path_starvations, before.path_starvations),
            trajectory_overruns: since(last.trajectory_overruns, before.trajectory_overruns),
            telemetry_dropped: since(last.telemetry_dropped, before.telemetry_dropped),
            link_errors: since(last.link_errors, before.link_errors),
            ethernet_errors: since(last.ethernet_errors, before.ethernet_errors),
        }
    }

    /// Virtual time of an instruction, ns, where instructions are counted: in the emulator in lockstep with the cell.
    fn ns_per_instruction(&self) -> Option<f64> {
        let emulated = self
            .job
            .welcome
            .as_ref()
            .is_some_and(|welcome| welcome.board == "emulated");
        let shift = emulator::Options::default().instruction_shift;
        (emulated && self.cell.is_some()).then(|| f64::from(1_u32 << shift))
    }

    /// Writes the telemetry as a recording; its time axis is the device's.
    fn write_recording(&self, out: &OutputFile) -> io::Result<()> {
        let about = About {
            config: self.config,
            source: &self.image,
            begin_ns: 0,
        };
        let mut recorder = Recorder::new(BufWriter::new(out.stream()?), &about)?;
        recorder.samples(0, &self.job.samples)?;
        if let Some(status) = &self.job.status {
            recorder.status(status)?;
        }
        recorder.finish().map(|_| ())
    }

    /// Writes pictures, tables and figures into a folder. Every file is complete before the first one takes its name:
    /// a disk that is full leaves the results of the last run.
    ///
    /// # Errors
    /// The file that could not be written.
    pub(super) fn write(&self, dir: &Path, report: &Report) -> Result<(), CommandError> {
        let mut complete = Vec::new();
        let mut save = |name: &'static str, write: &mut dyn FnMut(&mut OutputFile) -> io::Result<()>| {
            let mut out = create(dir, name)?;
            let written = write(&mut out).and_then(|()| out.flush());
            written.map_err(|cause| unwritable(&dir.join(name), &cause))?;
            complete.push((name, out));
            Ok::<(), CommandError>(())
        };
        if let Some((cell, _)) = self.cell {
            let (ink, sheet) = (strokes(cell.ink()), self.config.paper.size_mm);
            let png = render_png(&ink, sheet, PEN_WIDTH_MM, PIXELS_PER_MM)
                .map_err(|cause| CommandError::failed("the picture cannot be made", cause))?;
            save("drawn.png", &mut |out| out.write_all(&png))?;
            save("drawn.svg", &mut |out| {
                out.write_all(write_svg(&ink, sheet, PEN_WIDTH_MM).as_bytes())
            })?;
        }
        save("intended.csv", &mut |out| write_intended(&self.prepared.path, out))?;
        save("telemetry.csv", &mut |out| {
            write_telemetry(&rows(self.config, &self.job.samples), out)
        })?;
        save("telemetry.mcap", &mut |out| self.write_recording(out))?;
        save("tracking.svg", &mut |out| {
            write_tracking(self.config, &self.job.samples, out)
        })?;
        save("report.json", &mut |out| {
            serde_json::to_writer_pretty(&mut *out, report)?;
            writeln!(out)
        })?;
        for (name, out) in complete {
            out.commit().map_err(|cause| unwritable(&dir.join(name), &cause))?;
        }
        Ok(())
    }
}

/// All possible output files of a drawing.
const IN_FOLDER: [&str; 9] = [
    "drawn.png",
    "drawn.svg",
    "intended.csv",
    "telemetry.csv",
    "telemetry.mcap",
    "tracking.svg",
    "report.json",
    "bus.pcapng",
    "firmware.log",
];

/// Refuses an output that is one of the files that the command reads, whatever names both have.
///
/// # Errors
/// Both names, and what to try.
pub(super) fn refuse_input(output: &Path, inputs: &[PathBuf]) -> Result<(), CommandError> {
    match inputs.iter().find(|input| is_same_file(output, input)) {
        None => Ok(()),
        Some(input) => {
            let (output, input) = (output.display(), input.display());
            let text = format!("{output} is the input file {input}, which would be lost; choose another output");
            Err(CommandError::new(code::USAGE, text))
        }
    }
}

/// Refuses a folder for results in which one of the results is a file that the command reads.
///
/// # Errors
/// As for [`refuse_input`].
pub(super) fn refuse_inputs_in(dir: &Path, inputs: &[PathBuf]) -> Result<(), CommandError> {
    IN_FOLDER
        .iter()
        .try_for_each(|name| refuse_input(&dir.join(name), inputs))
}

/// Writes a text to a file, or to standard output for `-`.
///
/// # Errors
/// The file cannot be written.
pub(super) fn write_text(path: &Path, text: &str) -> Result<(), CommandError> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes to a file, or to standard output for `-`.
///
/// # Errors
/// The file cannot be written.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), CommandError> {
    let written = OutputFile::create_or_stdout(path).and_then(|mut out| {
        out.write_all(bytes)?;
        out.commit()
    });
    written.map_err(|cause| unwritable(path, &cause))
}

/// An output that could not be written.
pub(super) fn unwritable(path: &Path, cause: &io::Error) -> CommandError {
    CommandError::failed(format!("{} cannot be written", path.display()), cause)
}

/// Makes the output folder.
///
/// # Errors
/// The folder cannot be made.
pub(super) fn make_folder(dir: &Path) -> Result<(), CommandError> {
    std::fs::create_dir_all(dir)
        .map_err(|cause| CommandError::failed(format!("the folder {} cannot be made", dir.display()), cause))
}

/// Begins a file of the output folder.
///
/// # Errors
/// The file cannot be made.
pub(super) fn create(dir: &Path, name: &str) -> Result<OutputFile, CommandError> {
    let path = dir.join(name);
    OutputFile::create(&path).map_err(|cause| unwritable(&path, &cause))
}

fn strokes(ink: &[InkStroke]) -> Vec<Stroke> {
    ink.iter()
        .map(|stroke| Stroke {
            points: stroke.points_mm.clone(),
        })
        .collect()
}

fn ink_in_robot_frame(config: &Config, ink: &[InkStroke]) -> Vec<Vec<[f64; 2]>> {
    let paper = &config.paper;
    let place = |[x, y]: &[f64; 2]| {
        [
            paper.centre_mm[0] + x - 0.5 * paper.size_mm[0],
            paper.centre_mm[1] - y + 0.5 * paper.size_mm[1],
        ]
    };
    let line = |stroke: &InkStroke| stroke.points_mm.iter().map(place).collect();
    ink.iter().map(line).collect()
}

/// Prints the result of the drawing.
pub(super) fn summarise(report: &Report, dir: Option<&Path>) {
    let good = |ok: bool, text: String| in_colour(&text, if ok { "32" } else { "1;31" });
    let clean = report.cycles_late == 0
        && report.frames_lost == 0
        && report.working_counter_errors == 0
        && report.reference_underruns == 0;
    eprintln!();
    eprintln!(
        "Drew {}, {:.2} m of line, in {:.1} s (planned {:.1} s).",
        counted(report.strokes, "stroke"),
        report.pen_down_mm / 1_000.0,
        report.drawn_s,
        report.planned_s
    );
    eprintln!(
        "The pen stayed within {} of the intended lines ({:.3} mm rms).",
        good(
            report.path_deviation_max_mm <= DEVIATION_GOOD_MM,
            format!("{:.3} mm", report.path_deviation_max_mm)
        ),
        report.path_deviation_rms_mm
    );
    eprintln!(
        "Of that the shaping takes {:.3} of its {:.3} mm; the axes follow the shaped path within {:.3} mm ({:.3} mm rms).",
        report.shaping_deviation_max_mm,
        report.shaping_tolerance_mm,
        report.tracking_error_max_mm,
        report.tracking_error_rms_mm
    );
    if report.drives.is_some() {
        eprintln!(
            "The ink lies within {} of the lines ({:.3} mm rms); missing: {}.",
            good(
                report.ink_deviation_max_mm <= DEVIATION_GOOD_MM,
                format!("{:.3} mm", report.ink_deviation_max_mm)
            ),
            report.ink_deviation_rms_mm,
            good(report.ink_missing_mm == 0.0, format!("{:.1} mm", report.ink_missing_mm))
        );
    }
    if report.not_verified_mm > 0.0 {
        eprintln!(
            "Not verified: {:.1} of {:.1} mm, for which telemetry was lost on the line.",
            report.not_verified_mm,
            report.followed_mm + report.not_followed_mm + report.not_verified_mm
        );
    }
    let shares = report
        .limits
        .map(|axis| axis.acceleration_rad_s2 / axis.acceleration_limit_rad_s2);
    let share = shares.iter().fold(0.0_f64, |most, share| most.max(*share));
    eprintln!(
        "Joints used at most {:.0} % of their acceleration limit.",
        100.0 * share
    );
    eprintln!(
        "{}{}: {}.",
        counted(report.cycles, "millisecond"),
        if report.drives.is_some() {
            ""
        } else {
            " since the drawing began"
        },
        good(
            clean,
            format!(
                "{} late, {} lost, {}, {}",
                report.cycles_late,
                counted(report.frames_lost, "frame"),
                counted(report.working_counter_errors, "working counter error"),
                counted(report.reference_underruns, "reference underrun")
            )
        )
    );
    if let (Some(ratio), Some(processor_s)) = (report.virtual_to_processor_ratio, report.processor_s) {
        eprintln!("Virtual time ran {ratio:.0} times as fast as this process' processor time ({processor_s:.2} s).");
    }
    if let Some(correlation) = report.tone_correlation {
        eprintln!("Seen from afar, the drawing correlates with the photograph by {correlation:.2}.");
    }
    if let Some(dir) = dir {
        let pictures = if report.drives.is_some() {
            "drawn.png, drawn.svg, bus.pcapng, "
        } else {
            ""
        };
        eprintln!(
            "Written to {}: {pictures}report.json, telemetry.csv, telemetry.mcap, tracking.svg, intended.csv",
            dir.display()
        );
    }
}
