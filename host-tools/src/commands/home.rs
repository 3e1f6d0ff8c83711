//! `etherpen home` of a machine with home switches: powers the drives, lets the firmware lead the axes to their switches, and
//! shows the pose.

use super::ended_by_a_signal;
use crate::cell::{Cell, CellOptions};
use crate::error::{ProgramError, code};
use crate::job::reference::{Referenced, all};
use crate::job::{Job, JobOptions, Ready, Task};
use crate::link::port::PortName;
use crate::machine::Order;
use crate::machine::access::{self, OwnPort};
use crate::simulation::{self, Host};
use etherpen::config::Config;
use etherpen::messages::{Sample, Status};
use etherpen::robots::JointAngles;

/// Longest simulated time, ms.
const SIMULATED_MAX_MS: u32 = 600_000;

/// A job in virtual time.
struct Simulated(Job);

impl Host for Simulated {
    fn exchange(&mut self, ms: u32, from_firmware: &[u8], to_firmware: &mut Vec<u8>, room: usize) {
        self.0.step(u64::from(ms), from_firmware, to_firmware, room);
    }

    fn is_over(&self) -> bool {
        self.0.outcome().is_some()
    }
}

/// Homes the machine at a port; its drives keep their power.
///
/// # Errors
/// There is no connection, or the machine could not be homed.
pub fn at_port(config: &Config, port: &PortName) -> Result<Referenced, ProgramError> {
    let own = OwnPort {
        config: &|| Ok(config.clone()),
        interrupted: &ended_by_a_signal,
        tell: &|waiting| eprintln!("{waiting}"),
    };
    let effect = access::carry_out(port, own, Order::Prepare(Ready::Referenced))?;
    found(config, effect.snapshot.status.as_ref(), effect.snapshot.sample.as_ref())
}

/// Homes the machine of the virtual cell.
///
/// # Errors
/// The machine could not be homed.
pub fn simulated(config: &Config, options: CellOptions) -> Result<Referenced, ProgramError> {
    let mut cell = Cell::new(config, options);
    let task = Task::Prepare(Ready::Referenced);
    let mut host = Simulated(Job::new(config.clone(), task, JobOptions::default()));
    simulation::run(&mut cell, &mut host, SIMULATED_MAX_MS);
    let Simulated(job) = host;
    match job.outcome() {
        Some(Ok(())) => found(config, job.status(), job.sample()),
        Some(Err(error)) => Err(error.into()),
        None => Err(ProgramError::new(
            code::FAILED,
            "the run ended before the machine was homed",
        )),
    }
}

/// What the machine shows after it was homed.
fn found(config: &Config, status: Option<&Status>, sample: Option<&Sample>) -> Result<Referenced, ProgramError> {
    let increments = status
        .filter(|status| status.referenced)
        .and_then(|status| all(&status.increments));
    match (increments, sample) {
        (Some(increments), Some(sample)) => Ok(Referenced {
            config: config.clone(),
            pose: JointAngles(sample.measured_rad.map(f64::from)),
            increments,
        }),
        _ => Err(ProgramError::new(
            code::FAILED,
            "the machine was homed, and its pose did not arrive",
        )),
    }
}
