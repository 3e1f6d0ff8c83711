//! Common part of `demo` and `simulate`: a prepared file, a run, its outputs.

use super::outputs::{Outcome, create, unwritable};
use super::prepare::{Prepared, planned_s, to_wire};
use super::{CommandError, code, job_error};
use crate::cell::CellOptions;
use crate::emulator::EmulatorError;
use crate::output_file::OutputFile;
use crate::report::Report;
use crate::run::{Drawn, RunError, Sink, Task};
use etherpen::config::Config;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// A task for a prepared file in the default cell.
pub fn task(config: &Config, prepared: &Prepared) -> Task {
    let path = prepared.path.iter().map(to_wire).collect();
    Task {
        config: config.clone(),
        path,
        cell: CellOptions::default(),
    }
}

/// A file of the output folder that is written while a drawing runs, and takes its name when the results do.
pub struct Growing {
    path: PathBuf,
    out: OutputFile,
}

impl Growing {
    /// Begins the file; what is written into the sink goes into it.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn create(dir: &Path, name: &str) -> Result<(Self, Sink), CommandError> {
        let (path, out) = (dir.join(name), create(dir, name)?);
        let stream = out.stream().map_err(|cause| unwritable(&path, &cause))?;
        Ok((Self { path, out }, Box::new(BufWriter::new(stream))))
    }

    /// Completes the file; the sink has been flushed.
    ///
    /// # Errors
    /// It is not on the disk; the last good file stays.
    pub fn commit(self) -> Result<(), CommandError> {
        self.out.commit().map_err(|cause| unwritable(&self.path, &cause))
    }
}

/// The capture's file in the output folder.
///
/// # Errors
/// The file cannot be made.
pub fn capture(dir: &Path) -> Result<(Growing, Sink), CommandError> {
    Growing::create(dir, "bus.pcapng")
}

/// Writes the results of a run, also of one that failed, and gives its report. `results` are the folder and the files that
/// have grown in it.
///
/// # Errors
/// The results cannot be written, or the job failed.
pub fn conclude(
    task: &Task,
    prepared: &Prepared,
    drawn: &Drawn,
    image: String,
    results: Option<(&Path, Vec<Growing>)>,
) -> Result<Report, CommandError> {
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
    if let Some((dir, growing)) = results {
        outcome.write(dir, &report)?;
        growing.into_iter().try_for_each(Growing::commit)?;
    }
    match &drawn.outcome {
        Some(Ok(())) => Ok(report),
        Some(Err(error)) => Err(job_error(error)),
        None => Err(CommandError::new(code::FAILED, "the run ended before the drawing did")),
    }
}

/// An emulator's error with its exit code.
pub fn emulator_error(error: &EmulatorError) -> CommandError {
    let code = match error {
        EmulatorError::QemuMissing { .. } => code::TOOL,
        _ => code::CONNECTION,
    };
    CommandError::new(code, error)
}

/// A run's error with its exit code.
pub fn run_error(error: &RunError) -> CommandError {
    match error {
        RunError::Emulator(error) => emulator_error(error),
        RunError::Capture(_) => CommandError::new(code::FAILED, error),
    }
}

/// Hash of a firmware image: FNV-1a, 64 bits, over the file.
///
/// # Errors
/// The image cannot be read.
pub fn image_hash(image: &Path) -> Result<String, CommandError> {
    let bytes = std::fs::read(image)
        .map_err(|cause| CommandError::failed(format!("the image {} cannot be read", image.display()), cause))?;
    let hash = bytes.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3)
    });
    Ok(format!("fnv1a64:{hash:016x}"))
}
