//! `etherpen export`, `plot` and `stats`: evaluate a recording.

use super::print_json;
use crate::error::{ProgramError, code};
use crate::output_file::OutputFile;
use crate::output_file::{refuse_input, unwritable, write_bytes};
use crate::recording::Playback;
use crate::recording::export::{ExportError, Exported, table_columns, write_csv, write_parquet};
use crate::recording::plot::{Form, plot as draw};
use crate::recording::signals::{Signal, named};
use crate::recording::statistics::{Statistics, statistics};
use crate::terminal::counted;
use etherpen::config::Config;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};

/// Parses a number of seconds of the command line.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds.is_finite() && seconds >= 0.0 => Ok(seconds),
        _ => Err("give seconds, for example 1.5".into()),
    }
}

/// Which recording, and which part of it.
#[derive(clap::Args, Debug)]
struct Part {
    /// Recording, an MCAP file; an incomplete one is read as far as possible.
    file: PathBuf,
    /// Start of the part to use, s from the start of the recording.
    #[arg(long, value_name = "S", value_parser = seconds)]
    from: Option<f64>,
    /// End of the part to use, s from the start of the recording.
    #[arg(long, value_name = "S", value_parser = seconds)]
    to: Option<f64>,
}

impl Part {
    fn open(&self) -> Result<Playback<BufReader<File>>, ProgramError> {
        if let (Some(from), Some(to)) = (self.from, self.to)
            && from > to
        {
            return Err(ProgramError::new(
                code::USAGE,
                format!("--from {from} is after --to {to}"),
            ));
        }
        let mut playback = Playback::open(&self.file).map_err(|cause| unreadable(&self.file, &cause))?;
        playback.select(self.from, self.to);
        Ok(playback)
    }

    /// Prints what is wrong with the file.
    fn tell(&self, playback: &Playback<BufReader<File>>) {
        for notice in playback.notices() {
            eprintln!("{}: {notice}", self.file.display());
        }
    }
}

fn unreadable(path: &Path, cause: &io::Error) -> ProgramError {
    ProgramError::new(code::INPUT, format!("{} cannot be read: {cause}", path.display()))
}

fn signals(list: &str, config: &Config) -> Result<Vec<Signal>, ProgramError> {
    named(list, config).map_err(|cause| ProgramError::new(code::USAGE, cause))
}

/// Options of `etherpen export`.
#[derive(clap::Args, Debug)]
pub struct ExportArguments {
    #[command(flatten)]
    part: Part,
    /// Write a table as CSV, its columns as in telemetry.csv; - is stdout.
    #[arg(long, value_name = "OUT", required_unless_present = "parquet")]
    csv: Option<PathBuf>,
    /// Write a table as Apache Parquet; a missing value is NaN.
    #[arg(long, value_name = "OUT", conflicts_with = "csv")]
    parquet: Option<PathBuf>,
    /// Only the time and these signals, separated by commas; * matches any characters. q1_error_rad and so on (q1_error_mm of
    /// a linear axis) are the following errors.
    #[arg(long, value_name = "LIST")]
    signals: Option<String>,
    /// Print the number of rows as JSON on stdout, or on stderr if the table goes to stdout.
    #[arg(long)]
    json: bool,
}

/// Runs `etherpen export`.
///
/// # Errors
/// The recording cannot be read, the signals do not exist, or the table cannot be written.
pub fn export(arguments: &ExportArguments) -> Result<(), ProgramError> {
    let part = &arguments.part;
    let mut playback = part.open()?;
    let config = playback.config().unwrap_or_default();
    let chosen = arguments.signals.as_deref().map(|list| signals(list, &config));
    let columns = table_columns(&config, chosen.transpose()?);
    let path = arguments.csv.as_ref().or(arguments.parquet.as_ref());
    let path = path.map_or(Path::new("-"), PathBuf::as_path);
    refuse_input(path, std::slice::from_ref(&part.file))?;
    let on_stdout = arguments.csv.is_some() && path == Path::new("-");
    let mut out = match on_stdout {
        true => OutputFile::create_or_stdout(path),
        false => OutputFile::create(path),
    }
    .map_err(|cause| unwritable(path, &cause))?;
    let exported = match arguments.csv {
        Some(_) => write_csv(&mut playback, &columns, &mut out),
        None => write_parquet(&mut playback, &columns, &mut out),
    };
    let exported = exported.map_err(|error| match error {
        ExportError::Read(cause) => unreadable(&part.file, &cause),
        ExportError::Write(cause) => unwritable(path, &cause),
    })?;
    out.commit().map_err(|cause| unwritable(path, &cause))?;
    part.tell(&playback);
    let Exported { rows, missing } = &exported;
    let (rows, columns) = (counted(*rows, "row"), counted(columns.len(), "column"));
    eprintln!("{rows}, {columns}; samples missing: {missing}.");
    if arguments.json && on_stdout {
        eprintln!("{}", serde_json::to_string(&exported).unwrap_or_default());
    } else if arguments.json {
        print_json(&exported)?;
    }
    Ok(())
}

/// Options of `etherpen plot`.
#[derive(clap::Args, Debug)]
pub struct PlotArguments {
    #[command(flatten)]
    part: Part,
    /// The signals, separated by commas; * matches any characters: q1_ref_rad,q1_rad,q*_error_rad,mode.
    #[arg(long, value_name = "LIST")]
    signals: String,
    /// The picture, .svg or .png.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
}

/// Runs `etherpen plot`.
///
/// # Errors
/// The recording cannot be read or has no sample, the signals do not exist, or the picture cannot be written.
pub fn plot(arguments: &PlotArguments) -> Result<(), ProgramError> {
    let (part, path) = (&arguments.part, &arguments.output);
    let form = match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => Form::Svg,
        Some("png") => Form::Png,
        _ => {
            let text = format!("{}: a picture is a file .svg or .png", path.display());
            return Err(ProgramError::new(code::USAGE, text));
        }
    };
    refuse_input(path, std::slice::from_ref(&part.file))?;
    let mut playback = part.open()?;
    let signals = signals(&arguments.signals, &playback.config().unwrap_or_default())?;
    let picture = draw(&mut playback, &signals, form).map_err(|cause| unreadable(&part.file, &cause))?;
    part.tell(&playback);
    let Some(picture) = picture else {
        let text = format!("{}: there is no sample in this part of it", part.file.display());
        return Err(ProgramError::new(code::INPUT, text));
    };
    write_bytes(path, &picture)
}

/// Options of `etherpen stats`.
#[derive(clap::Args, Debug)]
pub struct StatsArguments {
    #[command(flatten)]
    part: Part,
    /// Print the figures as JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `etherpen stats`.
///
/// # Errors
/// The recording cannot be read.
pub fn stats(arguments: &StatsArguments) -> Result<(), ProgramError> {
    let part = &arguments.part;
    let mut playback = part.open()?;
    let figures = statistics(&mut playback).map_err(|cause| unreadable(&part.file, &cause))?;
    part.tell(&playback);
    if arguments.json {
        return print_json(&figures);
    }
    io::stdout()
        .write_all(text(&figures).as_bytes())
        .or_else(ProgramError::of_stdout)
}

fn text(figures: &Statistics) -> String {
    let mut text = String::new();
    // Writing into a string cannot fail.
    let _ = writeln!(
        text,
        "{:.3} s from {}: {}, {} missing in {}; {}, {}\n",
        figures.duration_s,
        figures.source,
        counted(figures.samples, "sample"),
        figures.missing,
        counted(figures.gaps, "gap"),
        counted(figures.statuses, "status message"),
        counted(figures.events, "event")
    );
    for of in &figures.modes {
        let _ = writeln!(text, "{:<16} {:>12.3} s", format!("{:?}", of.mode), of.seconds);
    }
    let _ = writeln!(
        text,
        "\n{:<16} {:>13} {:>13} {:>13} {:>13}",
        "signal", "min", "max", "mean", "rms"
    );
    for of in &figures.signals {
        let [min, max, mean, rms] = [of.min, of.max, of.mean, of.rms].map(|value| format!("{value:.6}"));
        let _ = writeln!(text, "{:<16} {min:>13} {max:>13} {mean:>13} {rms:>13}", of.name);
    }
    let _ = writeln!(
        text,
        "\nlargest following error in motion: {}",
        figures.following_error_max.error_text()
    );
    text
}
