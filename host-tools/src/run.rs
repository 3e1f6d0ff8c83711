//! One drawing against the virtual cell: with the tasks in virtual time, or with a firmware image in the emulator.
//!
//! Both runs connect the job to the cell and produce the same kind of data; they differ only in how the firmware's
//! tasks are executed. Neither depends on the wall clock.

use crate::captured_cell::CapturedCell;
use crate::cell::{Cell, CellOptions, Physics};
use crate::drawing::preparation::prepare::Prepared;
use crate::drawing::preparation::wire::to_wire;
use crate::emulator::{self, Emulator, EmulatorError, LINK_BYTES_MAX, LogLine};
use crate::error::{ProgramError, code};
use crate::job::error::JobError;
use crate::job::{Job, JobOptions, JobReport};
use crate::simulation::{self, Host};
use etherpen::config::Config;
use etherpen::messages::PathVertex;
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Longest simulated time, ms: a day.
const LIMIT_MS: u32 = 86_400_000;
/// Virtual milliseconds between two checks of the job in a simulation.
const LOOK_MS: u32 = 100;
/// Wall time between two checks of the job in the emulator.
const LOOK: Duration = Duration::from_millis(50);

/// Destination of a capture.
pub type Sink = Box<dyn Write + Send>;

/// A drawing and its cell.
#[derive(Clone, Debug)]
pub struct RunTask {
    /// The configuration.
    pub config: Config,
    /// The path.
    pub path: Vec<PathVertex>,
    /// The virtual cell.
    pub cell: CellOptions,
}

impl RunTask {
    /// This task in a cell with these properties.
    #[must_use]
    pub fn in_cell(mut self, physics: Physics) -> Self {
        self.cell.physics = physics;
        self
    }

    fn job(&self) -> Job {
        let options = JobOptions {
            // The virtual machine starts there.
            at_marks: true,
            ..JobOptions::default()
        };
        Job::draw(self.config.clone(), self.path.clone(), options)
    }

    fn cell(&self, sink: Option<Sink>) -> io::Result<CapturedCell> {
        CapturedCell::new(Cell::new(&self.config, self.cell.clone()), sink)
    }
}

/// A task for a prepared file in the default cell.
pub fn task(config: &Config, prepared: &Prepared) -> RunTask {
    let path = prepared.path.iter().map(to_wire).collect();
    RunTask {
        config: config.clone(),
        path,
        cell: CellOptions::default(),
    }
}

/// Result of a run.
pub struct Drawn {
    /// Data collected by the job.
    pub job: JobReport,
    /// Result of the job; `None` if it did not end.
    pub outcome: Option<Result<(), JobError>>,
    /// The cell with its ink.
    pub cell: Cell,
    /// Cost of a run in virtual time.
    pub cost: Option<Cost>,
}

/// Cost of a run in virtual time for this process.
#[derive(Clone, Copy, Debug)]
pub struct Cost {
    /// Virtual time elapsed, s.
    pub virtual_s: f64,
    /// Processor time of the whole process, s.
    pub processor_s: f64,
}

/// Processor time used by this process so far, s.
fn processor_s() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Why a run has no result.
#[derive(Debug)]
pub enum RunError {
    /// The capture could not be written.
    Capture(io::Error),
    /// The emulator failed.
    Emulator(EmulatorError),
}

impl std::fmt::Display for RunError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Capture(cause) => write!(f, "the capture of the bus cannot be written: {cause}"),
            Self::Emulator(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for RunError {}

impl From<&RunError> for ProgramError {
    fn from(error: &RunError) -> Self {
        match error {
            RunError::Emulator(error) => error.into(),
            RunError::Capture(_) => Self::new(code::FAILED, error),
        }
    }
}

struct SimulatedHost<'a> {
    job: Job,
    look: &'a mut dyn FnMut(&mut Job),
}

impl Host for SimulatedHost<'_> {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.job.step(u64::from(ms), from_firmware, to_firmware, room);
        if ms.is_multiple_of(LOOK_MS) {
            (self.look)(&mut self.job);
        }
    }

    fn is_over(&self) -> bool {
        self.job.outcome().is_some()
    }
}

/// Draws in virtual time in this process; `look` gets the job ten times a virtual second.
///
/// # Errors
/// The capture cannot be written.
pub fn simulate(task: &RunTask, sink: Option<Sink>, look: &mut dyn FnMut(&mut Job)) -> Result<Drawn, RunError> {
    simulated(task, task.cell(sink), look)
}

/// [`simulate`] on a machine that is as another configuration says, whatever the controller is told.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_on(machine: &Config, task: &RunTask, look: &mut dyn FnMut(&mut Job)) -> Result<Drawn, RunError> {
    let cell = CapturedCell::new(Cell::new(machine, task.cell.clone()), None);
    simulated(task, cell, look)
}

fn simulated(
    task: &RunTask,
    cell: io::Result<CapturedCell>,
    look: &mut dyn FnMut(&mut Job),
) -> Result<Drawn, RunError> {
    let mut cell = cell.map_err(RunError::Capture)?;
    let mut host = SimulatedHost { job: task.job(), look };
    let begun_s = processor_s();
    let passed_ms = simulation::run(&mut cell, &mut host, LIMIT_MS);
    let cost = Cost {
        virtual_s: f64::from(passed_ms) / 1_000.0,
        processor_s: processor_s() - begun_s,
    };
    (host.look)(&mut host.job);
    let outcome = host.job.outcome().copied();
    let cell = cell.finish().map_err(RunError::Capture)?;
    Ok(Drawn {
        job: host.job.into_report(),
        outcome,
        cell,
        cost: Some(cost),
    })
}

impl emulator::Link for Job {
    fn exchange(&mut self, ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        if self.outcome().is_none() {
            self.step(u64::from(ms), from_device, to_device, LINK_BYTES_MAX);
        }
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Draws with a firmware image in the emulator; `look` gets the job twenty times a second of wall time.
///
/// # Errors
/// The emulator cannot be started or ended before the job did, or the capture cannot be written.
pub fn emulate(
    task: &RunTask,
    image: &Path,
    sink: Option<Sink>,
    look: &mut dyn FnMut(&mut Job),
    log: impl FnMut(&LogLine) + Send + 'static,
) -> Result<Drawn, RunError> {
    let cell = Arc::new(Mutex::new(task.cell(sink).map_err(RunError::Capture)?));
    let job = Arc::new(Mutex::new(task.job()));
    let options = emulator::Options::default();
    let emulator = Emulator::start(image, &options, cell.clone(), job.clone(), log).map_err(RunError::Emulator)?;
    while lock(&job).outcome().is_none() && emulator.is_running() {
        look(&mut lock(&job));
        std::thread::sleep(LOOK);
    }
    look(&mut lock(&job));
    let ended = emulator.stop();
    let outcome = lock(&job).outcome().copied();
    if outcome.is_none() {
        ended.map_err(RunError::Emulator)?;
    }
    let job = std::mem::replace(&mut *lock(&job), task.job());
    let cell = std::mem::replace(&mut *lock(&cell), task.cell(None).map_err(RunError::Capture)?);
    Ok(Drawn {
        job: job.into_report(),
        outcome,
        cell: cell.finish().map_err(RunError::Capture)?,
        cost: None,
    })
}
