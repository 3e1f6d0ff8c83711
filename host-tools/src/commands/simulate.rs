//! `etherpen simulate`: draws with the firmware's tasks and the virtual cell in virtual time, in this process.

use super::display::Display;
use super::{CellArguments, DrawingArguments};
use crate::drawing::preparation::prepare::prepare_with;
use crate::error::ProgramError;
use crate::output_file::make_folder;
use crate::report::output::refuse_inputs_in;
use crate::report::output::{capture, conclude};
use crate::report::summary::summarise;
use crate::run;
use crate::run::task;
use std::path::PathBuf;

/// Options of `etherpen simulate`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Photograph (PNG, JPEG, WebP), vectors (SVG, G-code, HPGL) or CSV to draw; - reads it from standard input.
    file: PathBuf,
    #[command(flatten)]
    drawing: DrawingArguments,
    #[command(flatten)]
    cell: CellArguments,
}

/// Runs the command.
///
/// # Errors
/// The file, the configuration or the drawing failed.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.drawing.config.load()?;
    let physics = arguments.cell.load()?;
    let drawing = &arguments.drawing;
    let dir = drawing.out.as_deref();
    if let Some(dir) = dir {
        let mut inputs = drawing.source.inputs(&arguments.file, drawing.config.path());
        inputs.extend(arguments.cell.file());
        refuse_inputs_in(dir, &inputs)?;
    }
    let prepared = prepare_with(&arguments.file, &config, &drawing.source)?;
    if let Some(dir) = dir {
        make_folder(dir)?;
    }
    let task = task(&config, &prepared).in_cell(physics);
    let (capture_file, sink) = dir.map(capture).transpose()?.unzip();
    let mut display = Display::new();
    let drawn =
        run::simulate(&task, sink, &mut |job| display.update(job)).map_err(|error| ProgramError::from(&error))?;
    display.finish();
    let results = dir.map(|dir| (dir, capture_file.into_iter().collect()));
    let report = conclude(&task, &prepared, &drawn, "simulation".to_owned(), results)?;
    summarise(&report, dir);
    if arguments.drawing.json {
        super::print_json(&report)?;
    }
    Ok(())
}
