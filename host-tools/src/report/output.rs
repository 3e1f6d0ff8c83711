//! The output files of a drawing.

use super::{Drives, Evidence, Report, Timing, rows, write_intended, write_telemetry, write_tracking};
use crate::cell::{Cell, CellOptions, InkStroke};
use crate::drawing::preparation::prepare::Prepared;
use crate::drawing::{Stroke, render_png, render_rgb, tone_correlation, write_svg};
use crate::emulator;
use crate::error::{ProgramError, code};
use crate::job::JobReport;
use crate::output_file::{OutputFile, create, refuse_input, unwritable};
use crate::planning::planned_s;
use crate::recording::{About, Recorder};
use crate::run::{Drawn, RunTask, Sink};
use etherpen::config::Config;
use etherpen::messages::{Counters, Status};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Line width of the pen in the pictures, mm.
const PEN_WIDTH_MM: f64 = 0.5;
/// Resolution of `drawn.png`, pixels a millimetre.
const PIXELS_PER_MM: f64 = 8.0;

/// Everything that a run produces.
pub struct Outcome<'a> {
    /// The configuration that was in effect.
    pub config: &'a Config,
    /// What was to be drawn.
    pub prepared: &'a Prepared,
    /// Data collected by the job.
    pub job: &'a JobReport,
    /// The virtual cell and its options, unless a real machine drew.
    pub cell: Option<(&'a Cell, &'a CellOptions)>,
    /// Name or hash of the firmware.
    pub image: String,
    /// Planned duration, s; NaN if the path cannot be planned.
    pub planned_s: f64,
    /// Whether the job was completed.
    pub completed: bool,
}

impl<'a> Outcome<'a> {
    /// The outcome of a drawing on a machine.
    pub fn of_machine(config: &'a Config, prepared: &'a Prepared, job: &'a JobReport, completed: bool) -> Self {
        let image = job
            .welcome
            .as_ref()
            .map_or_else(String::new, |welcome| format!("{} {}", welcome.board, welcome.firmware));
        Self {
            config,
            prepared,
            job,
            cell: None,
            image,
            planned_s: planned_s(config, &prepared.path),
            completed,
        }
    }

    /// The figures.
    pub fn report(&self) -> Report {
        let ink = self.cell.map(|(cell, _)| ink_in_robot_frame(self.config, cell.ink()));
        let drives = self.cell.map(|(_, options)| Drives {
            bandwidth_hz: options.physics.velocity_loop.bandwidth_hz,
            input_delay_cycles: options.physics.dead_time.position_cycles as usize,
            output_delay_cycles: options.physics.dead_time.command_cycles as usize,
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

    /// The firmware's counters: on a real machine since the drawing began, because the firmware may have run for days.
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
            setpoint_underruns: since(last.setpoint_underruns, before.setpoint_underruns),
            path_starvations: since(last.path_starvations, before.path_starvations),
            trajectory_overruns: since(last.trajectory_overruns, before.trajectory_overruns),
            telemetry_dropped: since(last.telemetry_dropped, before.telemetry_dropped),
            link_errors: since(last.link_errors, before.link_errors),
            ethernet_errors: since(last.ethernet_errors, before.ethernet_errors),
            path_stops_left: since(last.path_stops_left, before.path_stops_left),
        }
    }

    /// Virtual time of an instruction, ns, if instructions are counted: in the emulator in lockstep with the cell.
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

    /// Writes pictures, tables and figures into a folder. Every file is complete before the first one takes its name: a
    /// full disk leaves the results of the last run.
    ///
    /// # Errors
    /// The file that could not be written.
    pub fn write(&self, dir: &Path, report: &Report) -> Result<(), ProgramError> {
        let mut complete = Vec::new();
        let mut save = |name: &'static str, write: &mut dyn FnMut(&mut OutputFile) -> io::Result<()>| {
            let mut out = create(dir, name)?;
            let written = write(&mut out).and_then(|()| out.flush());
            written.map_err(|cause| unwritable(&dir.join(name), &cause))?;
            complete.push((name, out));
            Ok::<(), ProgramError>(())
        };
        if let Some((cell, _)) = self.cell {
            let (ink, sheet) = (strokes(cell.ink()), self.config.paper.size_mm);
            let png = render_png(&ink, sheet, PEN_WIDTH_MM, PIXELS_PER_MM)
                .map_err(|cause| ProgramError::failed("the picture cannot be made", cause))?;
            save("drawn.png", &mut |out| out.write_all(&png))?;
            save("drawn.svg", &mut |out| {
                out.write_all(write_svg(&ink, sheet, PEN_WIDTH_MM).as_bytes())
            })?;
        }
        save("intended.csv", &mut |out| write_intended(&self.prepared.path, out))?;
        save("telemetry.csv", &mut |out| {
            write_telemetry(self.config, &rows(self.config, &self.job.samples), out)
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

/// A file in the output folder that is written during a drawing, and takes its name together with the results.
pub struct PendingOutput {
    path: PathBuf,
    out: OutputFile,
}

impl PendingOutput {
    /// Creates the file; the sink writes into it.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn create(dir: &Path, name: &str) -> Result<(Self, Sink), ProgramError> {
        let (path, out) = (dir.join(name), create(dir, name)?);
        let stream = out.stream().map_err(|cause| unwritable(&path, &cause))?;
        Ok((Self { path, out }, Box::new(BufWriter::new(stream))))
    }

    /// Completes the file; the sink has been flushed.
    ///
    /// # Errors
    /// The content is not on the disk; the last good file stays.
    pub fn commit(self) -> Result<(), ProgramError> {
        self.out.commit().map_err(|cause| unwritable(&self.path, &cause))
    }
}

/// The capture's file in the output folder.
///
/// # Errors
/// The file cannot be created.
pub fn capture(dir: &Path) -> Result<(PendingOutput, Sink), ProgramError> {
    PendingOutput::create(dir, "bus.pcapng")
}

/// Writes the results of a run, even a failed one, and returns its report. `results` are the folder and the files that
/// have grown in it.
///
/// # Errors
/// The results cannot be written, or the job failed.
pub fn conclude(
    task: &RunTask,
    prepared: &Prepared,
    drawn: &Drawn,
    image: String,
    results: Option<(&Path, Vec<PendingOutput>)>,
) -> Result<Report, ProgramError> {
    let outcome = Outcome {
        config: &task.config,
        prepared,
        job: &drawn.job,
        cell: Some((&drawn.cell, &task.cell)),
        image,
        planned_s: planned_s(&task.config, &prepared.path),
        completed: matches!(drawn.outcome, Some(Ok(()))),
    };
    let mut report = outcome.report();
    report.processor_s = drawn.cost.map(|cost| cost.processor_s);
    report.virtual_to_processor_ratio = drawn.cost.map(|cost| cost.virtual_s / cost.processor_s);
    if let Some((dir, outputs)) = results {
        outcome.write(dir, &report)?;
        outputs.into_iter().try_for_each(PendingOutput::commit)?;
    }
    match &drawn.outcome {
        Some(Ok(())) => Ok(report),
        Some(Err(error)) => Err(error.into()),
        None => Err(ProgramError::new(code::FAILED, "the run ended before the drawing did")),
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

/// Refuses a folder for results in which one of the results is a file that the command reads.
///
/// # Errors
/// As for [`refuse_input`].
pub fn refuse_inputs_in(dir: &Path, inputs: &[PathBuf]) -> Result<(), ProgramError> {
    IN_FOLDER
        .iter()
        .try_for_each(|name| refuse_input(&dir.join(name), inputs))
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
