//! `cargo demo`: the main job with no hardware.

use super::display::Display;
use super::{CellArguments, DrawingArguments};
use crate::drawing::preparation::prepare::prepare_with;
use crate::emulator::LogLine;
use crate::error::ProgramError;
use crate::firmware_image::image_hash;
use crate::output_file::make_folder;
use crate::report::output::refuse_inputs_in;
use crate::report::output::{PendingOutput, capture, conclude};
use crate::report::summary::summarise;
use crate::run::task;
use crate::{run, setup};
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Options of `etherpen demo`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// File to draw: photograph (PNG, JPEG, WebP), vectors (SVG, G-code, HPGL) or CSV. Default: the bundled portrait. Results
    /// go to target/demo, or to --out.
    #[arg(long, value_name = "FILE")]
    photo: Option<PathBuf>,
    #[command(flatten)]
    drawing: DrawingArguments,
    #[command(flatten)]
    cell: CellArguments,
}

/// Runs the command.
///
/// # Errors
/// A tool is missing, the photograph cannot be used, the emulator cannot be reached or the drawing failed.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    setup::ensure_sources()?;
    let config = arguments.drawing.config.load()?;
    let physics = arguments.cell.load()?;
    let photo = arguments
        .photo
        .clone()
        .unwrap_or_else(|| setup::workspace().join("samples/astronaut.png"));
    let dir = arguments
        .drawing
        .out
        .clone()
        .unwrap_or_else(|| setup::workspace().join("target/demo"));
    let drawing = &arguments.drawing;
    let mut inputs = drawing.source.inputs(&photo, drawing.config.path());
    inputs.extend(arguments.cell.file());
    refuse_inputs_in(&dir, &inputs)?;
    eprintln!("Vectorising {}", photo.display());
    let prepared = prepare_with(&photo, &config, &arguments.drawing.source)?;
    setup::ensure_qemu()?;
    make_folder(&dir)?;
    eprintln!("Building the firmware for the emulated board");
    let image = setup::build_firmware("emulated")?;
    eprintln!("Starting the firmware in QEMU (mps2-an500, Cortex-M7)");
    let task = task(&config, &prepared).in_cell(physics);
    let (log_file, mut log) = PendingOutput::create(&dir, "firmware.log")?;
    let (capture_file, capture) = capture(&dir)?;
    let log_is_whole = Arc::new(AtomicBool::new(true));
    let is_whole = log_is_whole.clone();
    let write_log = move |line: &LogLine| {
        // A log that cannot be written must not end a drawing.
        let written = writeln!(log, "{line}").and_then(|()| log.flush());
        is_whole.fetch_and(written.is_ok(), Ordering::Relaxed);
    };
    let mut display = Display::new();
    let drawn = run::emulate(&task, &image, Some(capture), &mut |job| display.update(job), write_log)
        .map_err(|error| ProgramError::from(&error))?;
    display.finish();
    let log_file = Some(log_file).filter(|_| log_is_whole.load(Ordering::Relaxed));
    let results = Some((dir.as_path(), std::iter::once(capture_file).chain(log_file).collect()));
    let report = conclude(&task, &prepared, &drawn, image_hash(&image)?, results)?;
    summarise(&report, Some(&dir));
    if arguments.drawing.json {
        super::print_json(&report)?;
    }
    Ok(())
}
