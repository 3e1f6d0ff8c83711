//! What `demo` and `simulate` share: a prepared file, a run, its outputs.

use super::outputs::{Outcome, create};
use super::prepare::{Prepared, planned_s, to_wire};
use super::{CommandError, code, job_error};
use crate::cell::CellOptions;
use crate::emulator::EmulatorError;
use crate::report::Report;
use crate::run::{Drawn, RunError, Sink, Task};
use etherpen::config::Config;
use std::path::Path;

/// A task for a prepared file in the default cell.
pub fn task(config: &Config, prepared: &Prepared) -> Task {
    let path = prepared.path.iter().map(to_wire).collect();
    Task {
        config: config.clone(),
        path,
        cell: CellOptions::default(),
    }
}

/// The capture's file in the output folder.
///
/// # Errors
/// It cannot be made.
pub fn capture(dir: &Path) -> Result<Sink, CommandError> {
    Ok(Box::new(create(dir, "bus.pcapng")?))
}

/// Writes the results of a run, also of one that failed, and gives its report.
///
/// # Errors
/// The results cannot be written, or the job failed.
pub fn conclude(
    task: &Task,
    prepared: &Prepared,
    drawn: &Drawn,
    image: String,
    dir: Option<&Path>,
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
    if let Some(dir) = dir {
        outcome.write(dir, &report)?;
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
