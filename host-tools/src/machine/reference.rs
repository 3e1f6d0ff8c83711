//! Takes the reference of a machine whose port another program has.

use super::{Client, Order, Snapshot};
use crate::error::{ProgramError, code};
use crate::job::Ready;
use crate::job::reference::{Reading, Referenced, Wanted, all};
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::messages::Command;
use std::time::{Duration, Instant};

/// Longest wait for the state of another program's machine, and time between two checks.
const STATE_MAX: Duration = Duration::from_secs(5);
const LOOK: Duration = Duration::from_millis(20);

/// Takes the reference through the program that has the port.
///
/// # Errors
/// The program works with another configuration, or the machine does not take the reference.
pub fn reference_through(
    mut client: Client,
    acknowledge: bool,
    config: &Config,
    wanted: &Wanted,
) -> Result<Referenced, ProgramError> {
    let owner = client.owner().clone();
    if wanted.calibrate {
        let text = format!(
            "--calibrate gives the machine another configuration, and {owner} owns the port with its own; end that \
             program, then calibrate"
        );
        return Err(ProgramError::new(code::CONNECTION, text));
    }
    let mode = client.snapshot()?.status.map(|status| status.mode);
    if acknowledge && mode == Some(Mode::Fault) {
        client.carry_out(Order::Settle(Command::Acknowledge))?;
    }
    client.carry_out(Order::Prepare(Ready::Bus))?;
    let increments = known(&mut client, |snapshot| all(&snapshot.status.as_ref()?.increments))?;
    refuse_other_configuration(&mut client, config)?;
    client.carry_out(Order::Settle(wanted.command(config, &increments)))?;
    let mut reading = Reading::default();
    let found = known(&mut client, |snapshot| {
        reading.take(config, snapshot.status.as_ref()?, snapshot.sample.as_ref())
    });
    eprintln!("through {owner}");
    found
}

/// Refuses a machine that works with another configuration, through the program that has its port. A machine that has none
/// yet is not refused.
///
/// # Errors
/// The configurations differ, or that program has ended.
pub fn refuse_other_configuration(client: &mut Client, config: &Config) -> Result<(), ProgramError> {
    let in_force = client.snapshot()?.status.and_then(|status| status.config);
    if in_force.is_none() || in_force == config.hash() {
        return Ok(());
    }
    let text = format!(
        "{} owns the port and works with another configuration; use the same one (--config), or end that program",
        client.owner()
    );
    Err(ProgramError::new(code::USAGE, text))
}

/// A value from the machine's state, once it is known.
fn known<T>(client: &mut Client, mut said: impl FnMut(&Snapshot) -> Option<T>) -> Result<T, ProgramError> {
    let until = Instant::now() + STATE_MAX;
    while Instant::now() < until {
        if let Some(known) = said(&client.snapshot()?) {
            return Ok(known);
        }
        std::thread::sleep(LOOK);
    }
    let text = "the machine does not report its resolvers' positions; check the bus (etherpen bus scan)";
    Err(ProgramError::new(code::FAILED, text))
}
