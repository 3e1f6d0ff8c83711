//! A drawing layer by layer, with a pause before each but the first, for another pen.
//!
//! The robot stands without power in a pause, at the place for changing the pen or over the last stroke. A layer that
//! cannot begin, because of a fault, a stop or a broken connection, waits until the operator has removed the cause; one
//! that has begun ends the program. The log of jobs has an entry for each layer: `--pause --resume` goes on with the first
//! that is not drawn to its end, after asking for its pen.

use super::{Arguments, EarlyEnd, Part, draw};
use crate::commands::operator::{Key, Operator};
use crate::drawing::preparation::prepare::{compose, prepare_with};
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::preparation::wire::to_wire;
use crate::error::{ProgramError, code};
use crate::job::history::hash_text;
use crate::job::path_hash;
use crate::job::resume::{self, LastPart, Resumption};
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use std::path::Path;

/// Draws the layers of a file, or those that are left with `--resume`.
pub(super) fn draw_layers(
    arguments: &Arguments,
    config: &Config,
    file: &Path,
    source: &SourceArguments,
    operator: &mut Operator,
) -> Result<(), ProgramError> {
    let place = arguments.pen_change.place(config)?;
    let layers = names(file, config, source)?;
    let mut resumed = arguments.resume.is_some().then(|| Resumption::Last(file.to_owned()));
    let first = match &resumed {
        Some(_) => first_left(file, config, source, &layers)?,
        None => LastPart::default(),
    };
    resumed = resumed.filter(|_| !first.is_next);
    for (number, layer) in layers.iter().enumerate().skip(first.index) {
        let shown = if layer.is_empty() { "without a name" } else { layer };
        let name = format!("{}, layer {shown} ({} of {})", file.display(), number + 1, layers.len());
        eprintln!("etherpen: {name}");
        let part = Part {
            source: source.only(layer),
            out: (arguments.drawing.out.as_ref()).map(|dir| dir.join(format!("layer-{}", number + 1))),
            then_to: place.filter(|_| number + 1 < layers.len()),
            file,
            name,
        };
        let mut pause = Pause {
            layer: shown,
            // Whoever resumes may have taken the pen out.
            is_answered: number == 0 && resumed.is_none(),
        };
        pause.wait(operator)?;
        while let Err(EarlyEnd { error, begun }) = draw(arguments, config, &part, resumed.as_ref(), operator) {
            // What was never drawn needs no pause, and what has begun goes on only by --resume.
            if begun || error.code == code::INTERRUPTED || (number == 0 && resumed.is_none()) {
                return Err(resumable(error));
            }
            pause.again(operator, error)?;
        }
        resumed = None;
    }
    Ok(())
}

/// The wait before a layer, with the machine at rest and without power.
struct Pause<'a> {
    layer: &'a str,
    is_answered: bool,
}

impl Pause<'_> {
    /// Waits until the pen is changed.
    fn wait(&mut self, operator: &mut Operator) -> Result<(), ProgramError> {
        if self.is_answered {
            return Ok(());
        }
        let layer = self.layer;
        eprintln!("etherpen: change the pen for layer {layer}; Enter draws it, Ctrl-C ends");
        self.is_answered = true;
        match operator.wait_fresh() {
            Some(Key::Enter) => Ok(()),
            Some(Key::Interrupt | Key::Terminate) | None => Err(ProgramError::new(
                code::INTERRUPTED,
                format!(
                    "ended before layer {layer}; --pause --resume draws it and the layers after it, --layer draws it alone"
                ),
            )),
        }
    }

    /// Waits until the cause is removed for which the layer could not begin.
    fn again(&self, operator: &mut Operator, error: ProgramError) -> Result<(), ProgramError> {
        let layer = self.layer;
        eprintln!("etherpen: layer {layer} did not begin: {}", error.message);
        eprintln!("etherpen: remove the cause; Enter goes on with layer {layer}, Ctrl-C ends");
        operator.held = false;
        match operator.wait_fresh() {
            Some(Key::Enter) => Ok(()),
            Some(Key::Interrupt | Key::Terminate) | None => Err(resumable(error)),
        }
    }
}

/// The error, with the way back.
fn resumable(error: ProgramError) -> ProgramError {
    ProgramError {
        message: format!(
            "{}; --pause --resume goes on with the layers that are left",
            error.message
        ),
        ..error
    }
}

/// Names of a file's layers, in the order of drawing.
fn names(file: &Path, config: &Config, source: &SourceArguments) -> Result<Vec<String>, ProgramError> {
    if file.as_os_str() == "-" {
        let text = "--pause reads the file once for each layer: standard input cannot be read again";
        return Err(ProgramError::new(code::USAGE, text));
    }
    let composed = compose(file, config, source)?;
    Ok(composed.parts.into_iter().map(|(layer, _)| layer.name).collect())
}

/// The first layer that was not drawn to its end, from the log of jobs.
fn first_left(
    file: &Path,
    config: &Config,
    source: &SourceArguments,
    layers: &[String],
) -> Result<LastPart, ProgramError> {
    let hash = |layer: &String| -> Result<String, ProgramError> {
        let prepared = prepare_with(file, config, &source.only(layer))?;
        let path: Vec<PathVertex> = prepared.path.iter().map(to_wire).collect();
        Ok(hash_text(path_hash(&path)))
    };
    let hashes: Vec<String> = layers.iter().map(hash).collect::<Result<_, _>>()?;
    resume::last_part(&hashes, file)
}
