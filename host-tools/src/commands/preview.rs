//! `etherpen preview`: shows how a file would be drawn, as a picture and in figures.

use super::{ConfigArguments, print_json};
use crate::drawing::preparation::compose::{in_sequence, unusable};
use crate::drawing::preparation::prepare::{compose, refused};
use crate::drawing::preparation::preview::Preview;
use crate::drawing::preparation::source::SourceArguments;
use crate::drawing::preparation::stages::stages;
use crate::drawing::{DrawingError, Input, PreviewScene, from_path, load};
use crate::error::{ProgramError, code};
use crate::output_file::{refuse_input, write_bytes, write_text};
use crate::terminal::counted;
use etherpen::config::Config;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Options of `etherpen preview`.
///
/// The picture shows the sheet and the work area's border, the strokes coloured in the order of drawing (first blue,
/// last red), travel moves as thin grey lines, and refused strokes in thick red. The time is what the firmware's
/// planner computes for the path that `draw` would send, from above the first stroke's start. With --debug the picture
/// shows the stages from a photograph to its lines instead.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Photograph (PNG, JPEG, WebP), vectors (SVG, G-code, HPGL) or CSV; - reads it from standard input.
    file: PathBuf,
    /// Picture to write; the file name selects SVG or PNG.
    #[arg(short, long, value_name = "OUT.svg|png")]
    out: PathBuf,
    /// Show what is found in a photograph instead of its strokes: exposure and contrast evened, faces and landmarks, weights
    /// of focus and background, edges, tone, directions; OUT is a PNG.
    #[arg(long)]
    debug: bool,
    /// Print strokes, lengths, lifts, time and refusals as JSON on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
    #[command(flatten)]
    source: SourceArguments,
}

/// Resolution of a PNG, pixels a millimetre.
const PX_PER_MM: f64 = 6.0;

/// Runs the command.
///
/// # Errors
/// The file or the configuration cannot be used, the picture cannot be written, or strokes are refused; in the last
/// case the picture is written and shows them.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let is_png = match arguments.out.extension().and_then(|extension| extension.to_str()) {
        Some(extension) if extension.eq_ignore_ascii_case("png") => true,
        Some(extension) if extension.eq_ignore_ascii_case("svg") => false,
        _ if arguments.out.as_os_str() == "-" => false,
        _ => {
            let shown = arguments.out.display();
            return Err(ProgramError::new(
                code::USAGE,
                format!("{shown}: the picture's name ends in .svg or .png"),
            ));
        }
    };
    if arguments.debug && !is_png {
        let shown = arguments.out.display();
        let text = format!("{shown}: --debug makes a PNG; give it a name that ends in .png");
        return Err(ProgramError::new(code::USAGE, text));
    }
    if arguments.debug && arguments.file.as_os_str() == "-" {
        let text = "--debug reads the photograph twice: standard input cannot be read again; name a file";
        return Err(ProgramError::new(code::USAGE, text));
    }
    refuse_input(
        &arguments.out,
        &arguments.source.inputs(&arguments.file, arguments.config.path()),
    )?;
    let config = arguments.config.load()?;
    let composed = compose(&arguments.file, &config, &arguments.source)?;
    let drawing = if composed.parts.is_empty() {
        from_path(&composed.path, &config.paper)
    } else {
        in_sequence(&composed.parts)
    };
    let refused = refused(&composed, &config)?;
    let numbers: BTreeSet<u32> = refused.iter().map(|refused| refused.stroke).collect();
    let centre = config.paper.centre_mm;
    let scene = PreviewScene {
        drawing: &drawing,
        refused: &numbers,
        pen_width_mm: arguments.source.pen_width_mm(),
        work_area: (
            [
                0.5 * drawing.sheet_mm[0] - centre[0],
                0.5 * drawing.sheet_mm[1] + centre[1],
            ],
            config.work_area.radius_mm,
        ),
    };
    if arguments.debug {
        write_bytes(&arguments.out, &stages_of(arguments, &config)?)?;
    } else if is_png {
        let png = scene
            .png(PX_PER_MM)
            .map_err(|cause| ProgramError::failed("the picture cannot be made", cause))?;
        write_bytes(&arguments.out, &png)?;
    } else {
        write_text(&arguments.out, &scene.svg())?;
    }
    let answer = Preview::new(&composed, &drawing, &refused, &config);
    if arguments.json {
        print_json(&answer)?;
    } else {
        show(&answer, &arguments.out);
    }
    match answer.refused {
        0 => Ok(()),
        refused => {
            let strokes = counted(answer.strokes, "stroke");
            let text = format!("{refused} of {strokes} would be refused; nothing of this file would be drawn");
            Err(unusable(&arguments.file, &text))
        }
    }
}

/// The stages of the photograph, a PNG.
fn stages_of(arguments: &Arguments, config: &Config) -> Result<Vec<u8>, ProgramError> {
    let refused = |cause: DrawingError| unusable(&arguments.file, &cause);
    let Input::Photograph(picture) = load(&arguments.file).map_err(refused)? else {
        return Err(refused(DrawingError::NoPhotograph));
    };
    stages(picture, config, &arguments.source).map_err(refused)
}

fn show(answer: &Preview, out: &Path) {
    let time = answer
        .estimated_s
        .map_or("no time".to_owned(), |seconds| format!("{seconds:.1} s"));
    eprintln!(
        "etherpen: {}, {:.2} m drawn, {:.2} m with the pen up, {}, {time}; shown in {}",
        counted(answer.strokes, "stroke"),
        answer.pen_down_mm / 1_000.0,
        answer.pen_up_mm / 1_000.0,
        counted(answer.lifts, "lift"),
        out.display()
    );
    for refusal in answer.refusals.iter().take(5) {
        eprintln!("etherpen: refused: stroke {}: {}", refusal.stroke, refusal.reason);
    }
}
