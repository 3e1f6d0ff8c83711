//! `etherpen draw`: a file to paper, on a running machine or emulator.

use super::display::Display;
use super::outputs::{Outcome, make_folder, summarise};
use super::prepare::{planned_s, prepare_with, to_wire};
use super::{CommandError, DrawingArguments, code, job_error, session_number};
use crate::link::job::{Control, Job, JobOptions};
use crate::link::port::{Port, PortName, RunError, run_job};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};

/// Options of `etherpen draw`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// Photograph (PNG, JPEG), vectors (SVG, G-code, HPGL) or CSV to draw; - reads it from standard input.
    file: PathBuf,
    /// The machine: /dev/tty.., tcp:host:port or unix:path.
    #[arg(long)]
    port: String,
    /// Acknowledge a fault that is latched from before (lost drives are brought back), and cancel a drawing that was
    /// left behind.
    #[arg(long)]
    acknowledge: bool,
    #[command(flatten)]
    drawing: DrawingArguments,
}

/// Runs the command.
///
/// # Errors
/// The file or the configuration cannot be used, there is no connection, or the drawing failed.
pub fn run(arguments: &Arguments) -> Result<(), CommandError> {
    let config = arguments.drawing.config.load()?;
    let name: PortName = arguments
        .port
        .parse()
        .map_err(|cause| CommandError::new(code::USAGE, cause))?;
    let prepared = prepare_with(&arguments.file, &config, &arguments.drawing.source)?;
    if let Some(dir) = &arguments.drawing.out {
        make_folder(dir)?;
    }
    let port = Port::open(&name).map_err(|cause| CommandError::new(code::CONNECTION, cause))?;
    let vertices: Vec<_> = prepared.path.iter().map(to_wire).collect();
    let options = JobOptions {
        session: session_number(),
        acknowledge: arguments.acknowledge,
        ..JobOptions::default()
    };
    let mut job = Job::draw(config.clone(), vertices, options);
    let mut display = Display::new();
    let result = run_job(port, &mut job, &operator()?, &mut |show| display.show(&show));
    display.finish();
    let job = job.into_report();
    let planned_s = planned_s(&config, &prepared.path);
    let image = job
        .welcome
        .as_ref()
        .map_or_else(String::new, |welcome| format!("{} {}", welcome.board, welcome.firmware));
    let outcome = Outcome {
        config: &config,
        prepared: &prepared,
        job: &job,
        cell: None,
        image,
        planned_s,
        completed: result.is_ok(),
    };
    let report = outcome.report();
    // A drawing that never began has nothing to show.
    if let Some(dir) = &arguments.drawing.out
        && !job.samples.is_empty()
    {
        outcome.write(dir, &report)?;
    }
    result.map_err(|error| match error {
        RunError::Job(error) => job_error(&error),
        RunError::Port(error) => CommandError::new(code::CONNECTION, error),
    })?;
    summarise(&report, arguments.drawing.out.as_deref());
    if arguments.drawing.json {
        super::print_json(&report)?;
    }
    Ok(())
}

/// What the person at the keyboard asks for: Ctrl-C holds, Enter resumes, a second Ctrl-C cancels.
pub(super) fn operator() -> Result<Receiver<Control>, CommandError> {
    let (sender, receiver) = mpsc::channel();
    let mut signals =
        Signals::new([SIGINT, SIGTERM]).map_err(|cause| CommandError::failed("watching for signals", cause))?;
    let resume = sender.clone();
    let held = Arc::new(AtomicBool::new(false));
    let holding = held.clone();
    std::thread::spawn(move || {
        for signal in signals.forever() {
            let again = holding.swap(true, Ordering::Relaxed);
            let control = if again || signal == SIGTERM {
                Control::Cancel
            } else {
                Control::Hold
            };
            if control == Control::Hold {
                eprintln!("\nholding: Enter resumes, Ctrl-C again cancels");
            }
            if sender.send(control).is_err() {
                return;
            }
        }
    });
    std::thread::spawn(move || {
        for _ in std::io::stdin().lines().map_while(Result::ok) {
            held.store(false, Ordering::Relaxed);
            if resume.send(Control::Resume).is_err() {
                return;
            }
        }
    });
    Ok(receiver)
}
