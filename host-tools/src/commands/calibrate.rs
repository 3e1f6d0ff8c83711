//! `etherpen calibrate`: the dimensions of a machine from marks that it drew.

use super::{ConfigArguments, print_json};
use crate::axes::{self, Motion, Quantity};
use crate::calibration::marks::{self, Table};
use crate::calibration::parameters::{Parameter, What, value};
use crate::calibration::{Distance, Found, calibrate, expected_mm};
use crate::error::{ProgramError, code};
use crate::settings::dimensions::store_dimensions;
use crate::terminal::counted;
use crate::touches::Touch;
use etherpen::config::Config;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What is left of the marks, in parts of what measuring explains, that is worth a word.
const LEFT_OVER: f64 = 2.0;
/// Largest table, bytes.
const TABLE_BYTES_MAX: u64 = 1 << 20;

/// How the command is used.
const STEPS: &str = "\
1. etherpen calibrate --pattern marks.svg: a drawing of crosses, and marks.csv beside it with their places.
2. etherpen draw marks.svg: on a sheet that does not move, without --fit and --size.
3. Measure where the crosses are, from any corner, x to the right and y up, and write it into marks.csv. A cross that is not
   measured stays empty.
4. etherpen calibrate marks.csv --store, and home again before the next drawing.";

/// Options of `etherpen calibrate`.
#[derive(clap::Args, Debug)]
#[command(after_long_help = STEPS)]
pub struct Arguments {
    /// Table of the marks: x_mm,y_mm from the middle of the sheet, and measured_x_mm,measured_y_mm.
    #[arg(value_name = "MARKS")]
    marks: Option<PathBuf>,
    /// Write the drawing, an SVG, and its table beside it.
    #[arg(long, value_name = "FILE", conflicts_with = "marks")]
    pattern: Option<PathBuf>,
    /// With --pattern: marks in a row and in a column of the drawing, 3 to 21.
    #[arg(long, value_name = "NUMBER", default_value_t = 5, value_parser = clap::value_parser!(u8).range(3..=21))]
    side: u8,
    /// A place where the pen touched the sheet, as `etherpen paper --touch` takes it. Touches tell little about dimensions; without
    /// marks the command says how little. A negative x needs =: --touch=-80,70,-849.6.
    #[arg(long, value_name = "X,Y,Z", value_parser = touch, conflicts_with = "pattern")]
    touch: Vec<Touch>,
    /// Standard error of measuring a mark, in x and in y, mm.
    #[arg(long, value_name = "MM", default_value_t = 0.05, value_parser = error)]
    error: f64,
    /// Store what was found in the configuration file in use; the rest of the file is unchanged.
    #[arg(long, requires = "marks")]
    store: bool,
    /// Print the result as JSON on stdout.
    #[arg(long, conflicts_with = "pattern")]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

fn touch(text: &str) -> Result<Touch, String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|number| number.trim().parse().ok().filter(|number: &f64| number.is_finite()))
        .collect();
    let touch = numbers.and_then(|numbers| numbers.try_into().ok());
    touch.ok_or_else(|| "three finite numbers with commas between them are needed".into())
}

fn error(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(mm) if (0.001..=5.0).contains(&mm) => Ok(mm),
        _ => Err("a number of millimetres from 0.001 to 5 is needed".into()),
    }
}

/// A value of the configuration that is found.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Value {
    /// Where it stands in the file.
    name: String,
    unit: &'static str,
    before: f64,
    after: f64,
    /// Standard error of what was found.
    error: f64,
}

/// What the command prints.
#[derive(Clone, Debug, Serialize)]
struct Answer {
    marks: usize,
    /// Distance of the marks from their places, the sheet placed best.
    shape_before: Distance,
    /// Distance of the marks from their places with what was found, the sheet placed best.
    shape_after: Distance,
    /// Distance of each mark from where all others predict it.
    predicted: Distance,
    /// Error of shape over the sheet that is usual before and expected with these marks, rms.
    expected_before_mm: f64,
    expected_after_mm: f64,
    /// What is left of the marks, in parts of what the error of measuring them explains.
    left_over: f64,
    /// Whether the marks are predicted better with what was found than without.
    is_better: bool,
    values: Vec<Value>,
    stored: Option<String>,
}

/// What it prints without marks.
#[derive(Clone, Debug, Serialize)]
struct OfTouches {
    touches: usize,
    expected_before_mm: f64,
    expected_after_mm: f64,
    /// Error of shape over the sheet that is expected with the marks of a pattern and these touches, rms.
    expected_with_marks_mm: f64,
}

/// Runs the command.
///
/// # Errors
/// The table cannot be read or does not fit to the machine; errors of the configuration and of files.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let refused = |cause: String| ProgramError::new(code::USAGE, cause);
    if let Some(file) = &arguments.pattern {
        return write_pattern(&config, file, arguments.side.into());
    }
    let Some(file) = &arguments.marks else {
        if arguments.touch.is_empty() {
            return Err(refused(
                "name the table of the marks; etherpen calibrate --pattern marks.svg writes one, and their drawing"
                    .into(),
            ));
        }
        return of_touches(arguments, &config);
    };
    let store = arguments.store.then(|| arguments.config.file_to_store(&config));
    let store = store.transpose()?;
    let table = read(file)?;
    if table.origin.is_some_and(|origin| origin != marks::origin(&config)) {
        let text = format!(
            "{}: its marks were drawn with other dimensions, marks of the axes or another sheet than the configuration has now (it may \
             have what was found already): draw a new pattern",
            file.display()
        );
        return Err(ProgramError::new(code::INPUT, text));
    }
    let marks = table.marks;
    let places: Vec<[f64; 2]> = marks.iter().map(|mark| mark.wanted_mm).collect();
    let unusable = |cause: String| ProgramError::new(code::INPUT, format!("{}: {cause}", file.display()));
    let found = calibrate(&config, &marks, &arguments.touch, arguments.error).map_err(unusable)?;
    let [expected_before_mm, expected_after_mm] =
        expected_mm(&config, &places, &arguments.touch, arguments.error).map_err(unusable)?;
    let mut answer = Answer {
        marks: marks.len(),
        shape_before: found.before,
        shape_after: found.after,
        predicted: found.predicted,
        expected_before_mm,
        expected_after_mm,
        left_over: found.left_over,
        is_better: found.is_better(),
        values: values(&config, &found),
        stored: None,
    };
    if arguments.store && !answer.is_better {
        let text = format!(
            "nothing is stored: marks are {:.3} mm from where all others predict them with what was found, and {:.3} mm from their \
             places as the machine is; measure more exactly, or leave it as it is",
            answer.predicted.rms_mm, answer.shape_before.rms_mm
        );
        return Err(ProgramError::new(code::FAILED, text));
    }
    if let Some(path) = store {
        let changed = store_dimensions(&path, &config, &found.config)?;
        eprintln!(
            "{} changed in {}. Home again before the next drawing.",
            counted(changed, "value"),
            path.display()
        );
        answer.stored = Some(path.display().to_string());
    }
    match arguments.json {
        true => print_json(&answer),
        false => print(&answer.text()),
    }
}

fn print(text: &str) -> Result<(), ProgramError> {
    std::io::stdout()
        .write_all(text.as_bytes())
        .or_else(ProgramError::of_stdout)
}

fn read(file: &Path) -> Result<Table, ProgramError> {
    let input = |cause: String| ProgramError::new(code::INPUT, format!("{}: {cause}", file.display()));
    let length = std::fs::metadata(file).map_err(|cause| input(cause.to_string()))?.len();
    if length > TABLE_BYTES_MAX {
        return Err(input("it is too long for a table of marks".into()));
    }
    let text = std::fs::read_to_string(file).map_err(|cause| input(cause.to_string()))?;
    marks::read(&text).map_err(input)
}

fn write_pattern(config: &Config, file: &Path, side: usize) -> Result<(), ProgramError> {
    let table = file.with_extension("csv");
    let refused = |text: String| ProgramError::new(code::USAGE, text);
    if !file
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("svg"))
    {
        return Err(refused(format!(
            "{}: the drawing is an SVG, and its table the CSV beside it: name it so, marks.svg",
            file.display()
        )));
    }
    // The table may have measured values, and the drawing may be somebody's.
    if let Some(path) = [file, &table].into_iter().find(|path| path.exists()) {
        return Err(refused(format!(
            "{} exists; name another drawing, or move it away",
            path.display()
        )));
    }
    let places = marks::places(&config.paper, side).map_err(refused)?;
    let written = marks::table(&places, marks::origin(config));
    for (path, text) in [(file, marks::svg(&config.paper, &places)), (&table, written)] {
        crate::output_file::write(path, text.as_bytes())
            .map_err(|cause| ProgramError::failed(format!("{} cannot be written", path.display()), cause))?;
    }
    eprintln!(
        "Written: {} and {}. Draw it, measure the crosses, fill in the table, then: etherpen calibrate {}",
        file.display(),
        table.display(),
        table.display()
    );
    Ok(())
}

fn of_touches(arguments: &Arguments, config: &Config) -> Result<(), ProgramError> {
    let refused = |cause: String| ProgramError::new(code::USAGE, cause);
    let touches = &arguments.touch;
    let [expected_before_mm, expected_after_mm] =
        expected_mm(config, &[], touches, arguments.error).map_err(refused)?;
    let places = marks::places(&config.paper, arguments.side.into()).map_err(refused)?;
    let [_, expected_with_marks_mm] = expected_mm(config, &places, touches, arguments.error).map_err(refused)?;
    let answer = OfTouches {
        touches: touches.len(),
        expected_before_mm,
        expected_after_mm,
        expected_with_marks_mm,
    };
    if arguments.json {
        return print_json(&answer);
    }
    print(&format!(
        "{} would take the usual error of shape from {expected_before_mm:.3} to {expected_after_mm:.3} mm rms; {} marks take it \
         to {expected_with_marks_mm:.3}.\nNothing was found: touches are for height and tilt (etherpen paper --touch). Draw marks: \
         etherpen calibrate --pattern marks.svg\n",
        match touches.len() {
            1 => "One touch".to_owned(),
            count => format!("{count} touches"),
        },
        places.len(),
    ))
}

/// What was found, each value in its own unit.
fn values(config: &Config, found: &Found) -> Vec<Value> {
    let of = |(Parameter { what, .. }, [change, error]): (&Parameter, &[f64; 2])| {
        let (before, after) = (value(config, *what), value(&found.config, *what));
        let (name, unit, factor) = match *what {
            What::Dimension(key, Some(index)) => (format!("geometry.{key}[{index}]"), "degrees", 1.0),
            What::Dimension(key, None) => (format!("geometry.{key}"), "mm", 1.0),
            What::Sync(axis) => {
                let motion = axes::motion(config.geometry.kind(), axis);
                let key = if motion == Motion::Linear {
                    "sync_mm"
                } else {
                    "sync_angle_rad"
                };
                (
                    format!("axes[{axis}].{key}"),
                    motion.unit(Quantity::Position),
                    motion.factor(),
                )
            }
            What::Pitch(axis) => (format!("axes[{axis}].pitch_mm"), "times what it was", 1.0),
        };
        let after = if matches!(what, What::Pitch(_)) {
            1.0 + change
        } else {
            after
        };
        Value {
            name,
            unit,
            before: factor * before,
            after: factor * after,
            error: factor * error,
        }
    };
    found.parameters.iter().zip(&found.changes).map(of).collect()
}

impl Answer {
    fn text(&self) -> String {
        let distance = |distance: &Distance| format!("{:.3} mm rms, {:.3} at most", distance.rms_mm, distance.max_mm);
        let mut text = format!(
            "{} marks, the sheet placed best:\n  as the machine is           {}\n  with what was found         {}\n  each \
             predicted by all others {}\n",
            self.marks,
            distance(&self.shape_before),
            distance(&self.shape_after),
            distance(&self.predicted)
        );
        for Value {
            name,
            unit,
            before,
            after,
            error,
        } in &self.values
        {
            text.push_str(&format!(
                "{name:32} {before:>12.5} -> {after:>12.5} {unit} (standard error {error:.5})\n"
            ));
        }
        if self.left_over > LEFT_OVER {
            text.push_str(&format!(
                "What is left is {:.1} times what measuring with --error explains: it was measured less well, or the machine differs in a \
                 way that has no dimension here (out of square, say).\n",
                self.left_over
            ));
        }
        if !self.is_better {
            text.push_str("The marks are predicted no better than without: leave the machine as it is.\n");
        }
        text.push_str(&format!(
            "expected error of shape over the sheet: usually {:.3} mm rms, with these marks {:.3}\n",
            self.expected_before_mm, self.expected_after_mm
        ));
        if self.stored.is_none() {
            text.push_str("Not stored; --store does that.\n");
        }
        text
    }
}
