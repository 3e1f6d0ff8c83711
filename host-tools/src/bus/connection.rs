//! Connections to a bus: with a master on this computer, or through the master of a running firmware.

use super::access::{AccessError, BusAccess};
use crate::error::{ProgramError, code};
use crate::job::error::JobError;
use crate::link::ownership::Owner;
use crate::link::port::{Line, Port, PortName};
use crate::link::session::{Event, Session, session_number};
use crate::link::text::bus::bus_error;
use crate::machine::{Client, Order, Reply};
use crate::master::{Master, MasterError};
use etherpen::config::Config;
use etherpen::ethercat::diagnostics::{ServiceError, ServiceReply, ServiceRequest, ServiceResult};
use etherpen_segment::transport::{self, Endpoint, TransportError};
use std::time::{Duration, Instant};

/// Longest time for which a request to a busy bus is repeated.
const BUSY_MAX: Duration = Duration::from_secs(60);
/// Longest wait for one answer.
const ANSWER_MAX: Duration = Duration::from_secs(60);
/// Longest wait for a firmware's greeting, ms.
const GREETING_MAX_MS: u64 = 5_000;
/// Longest silence of a firmware, ms.
const SILENCE_MAX_MS: u64 = 5_000;
/// Pause before a request to a busy bus is repeated.
const PAUSE: Duration = Duration::from_millis(100);
/// Longest wait for a segment that was started together with this program.
const SEGMENT_MAX: Duration = Duration::from_secs(2);

/// Carries one request to the bus and its answer back.
trait Carrier {
    fn ask(&mut self, request: ServiceRequest) -> Result<ServiceResult, ProgramError>;

    /// Lets time pass without a request.
    fn rest(&mut self, pause: Duration) -> Result<(), ProgramError>;
}

/// Repeats a request while the bus is busy.
struct Patient<C>(C);

impl<C: Carrier> BusAccess for Patient<C> {
    fn request(&mut self, request: ServiceRequest) -> Result<ServiceReply, AccessError> {
        let until = Instant::now() + BUSY_MAX;
        loop {
            match self.0.ask(request.clone()).map_err(AccessError::Lost)? {
                Ok(reply) => return Ok(reply),
                Err(ServiceError::Busy | ServiceError::Interrupted) if !request.changes() && Instant::now() < until => {
                    self.0.rest(PAUSE).map_err(AccessError::Lost)?;
                }
                Err(error) => return Err(AccessError::Refused(error)),
            }
        }
    }
}

/// Opens the bus with a master on this computer. The slaves keep their states until a request changes one.
///
/// # Errors
/// The transport to the segment cannot be opened.
pub(crate) fn own_master(endpoint: &Endpoint) -> Result<Box<dyn BusAccess>, ProgramError> {
    let transport = opened(|| transport::open(endpoint), SEGMENT_MAX);
    let transport = transport.map_err(|error| ProgramError::new(code::CONNECTION, error))?;
    let master = Master::look(transport).map_err(|error| ProgramError::new(code::FAILED, master_error(&error)))?;
    Ok(Box::new(Patient(master)))
}

/// Opens the way to a segment, again for a while as long as nobody listens there yet.
fn opened<T>(mut open: impl FnMut() -> Result<T, TransportError>, longest: Duration) -> Result<T, TransportError> {
    let until = Instant::now() + longest;
    loop {
        match open() {
            Err(TransportError::Nobody(_)) if Instant::now() < until => std::thread::sleep(PAUSE),
            opened => return opened,
        }
    }
}

impl Carrier for Master {
    fn ask(&mut self, request: ServiceRequest) -> Result<ServiceResult, ProgramError> {
        self.request(request, ANSWER_MAX)
            .map_err(|error| ProgramError::new(code::CONNECTION, master_error(&error)))
    }

    fn rest(&mut self, pause: Duration) -> Result<(), ProgramError> {
        std::thread::sleep(pause);
        Ok(())
    }
}

/// A bus reached through a firmware's master.
pub(crate) struct FirmwareBus {
    /// Carries out the requests.
    pub(crate) access: Box<dyn BusAccess>,
    /// The program that has the port open and passes the requests on; `None` if this program opened the port.
    pub(crate) owner: Option<Owner>,
}

/// Connects to a running firmware's master. A firmware without a configuration gets `config` and brings up its bus.
///
/// # Errors
/// There is no connection, or the firmware refused the configuration.
pub(crate) fn firmware(port: &PortName, config: &Config) -> Result<FirmwareBus, ProgramError> {
    if let Some(client) = Client::find(port) {
        return Ok(FirmwareBus {
            owner: Some(client.owner().clone()),
            access: Box::new(Patient(client)),
        });
    }
    let port = Port::open(port).map_err(|cause| ProgramError::new(code::CONNECTION, cause))?;
    let mut linked = Linked {
        line: Line::start(port),
        session: Session::new(session_number()),
    };
    linked.session.connect();
    let welcome = linked.wait(GREETING_MAX_MS, |event| match event {
        Event::Connected(welcome) => Some(Ok(welcome)),
        Event::VersionRefused { host, firmware } => Some(Err(JobError::Version { host, firmware })),
        _ => None,
    })?;
    if welcome.config.is_none() {
        linked.session.configure(config.clone());
        linked.wait(GREETING_MAX_MS, |event| match event {
            Event::Configured(result) => Some(result.map(|_| ()).map_err(JobError::Config)),
            _ => None,
        })?;
    }
    Ok(FirmwareBus {
        access: Box::new(Patient(linked)),
        owner: None,
    })
}

/// The program that has the port open; it also chose the firmware's configuration.
impl Carrier for Client {
    fn ask(&mut self, request: ServiceRequest) -> Result<ServiceResult, ProgramError> {
        match self.carry_out(Order::Bus(request))? {
            Reply::Bus(result) => Ok(result),
            _ => Err(ProgramError::failed("the bus", "an answer to another question came")),
        }
    }

    fn rest(&mut self, pause: Duration) -> Result<(), ProgramError> {
        std::thread::sleep(pause);
        Ok(())
    }
}

/// A firmware at the end of a line.
struct Linked {
    line: Line,
    session: Session,
}

impl Linked {
    /// Runs the session until `found` accepts an event, at most `longest_ms`.
    fn wait<T>(
        &mut self,
        longest_ms: u64,
        mut found: impl FnMut(Event) -> Option<Result<T, JobError>>,
    ) -> Result<T, ProgramError> {
        let mut begun_ms = None;
        loop {
            let now_ms = self.step()?;
            let waited_ms = now_ms - *begun_ms.get_or_insert(now_ms);
            while let Some(event) = self.session.next_event() {
                if event == Event::Restarted {
                    return Err(ProgramError::from(&JobError::Restarted));
                }
                if let Some(result) = found(event) {
                    return result.map_err(|error| ProgramError::from(&error));
                }
            }
            match self.session.silence_ms(now_ms) {
                Some(silent_ms) if silent_ms > SILENCE_MAX_MS => {
                    return Err(ProgramError::from(&JobError::LinkLost { silent_ms }));
                }
                _ if waited_ms > longest_ms => return Err(ProgramError::from(&JobError::NoAnswer { waited_ms })),
                _ => {}
            }
        }
    }

    fn step(&mut self) -> Result<u64, ProgramError> {
        let session = &mut self.session;
        self.line
            .exchange(|now_ms, incoming, outgoing, room| {
                session.receive(incoming, now_ms);
                outgoing.resize(room, 0);
                let length = session.transmit(now_ms, outgoing);
                outgoing.truncate(length);
            })
            .map_err(|error| ProgramError::new(code::CONNECTION, error))
    }
}

impl Carrier for Linked {
    fn ask(&mut self, request: ServiceRequest) -> Result<ServiceResult, ProgramError> {
        self.session.bus(request);
        let longest_ms = u64::try_from(ANSWER_MAX.as_millis()).unwrap_or(u64::MAX);
        self.wait(longest_ms, |event| match event {
            Event::Bus(result) => Some(Ok(result)),
            _ => None,
        })
    }

    fn rest(&mut self, pause: Duration) -> Result<(), ProgramError> {
        let until = Instant::now() + pause;
        while Instant::now() < until {
            self.step()?;
            // Nothing waits for an event now.
            while self.session.next_event().is_some() {}
        }
        Ok(())
    }
}

/// Why the master on this computer cannot run, and what to try.
fn master_error(error: &MasterError) -> String {
    match error {
        MasterError::Refused { position, error, .. } => match position {
            Some(position) => format!("slave {}: {}", u16::from(*position) + 1, bus_error(error)),
            None => bus_error(error),
        },
        MasterError::Transport(cause) => {
            format!("the way to the segment was lost ({cause}); is the interface up, does the segment still run?")
        }
        MasterError::Silent { waited } => {
            format!(
                "nothing was heard of the bus for {:.0} s; try again",
                waited.as_secs_f64()
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_segment_that_does_not_listen_yet_is_waited_for_and_nothing_else() {
        let nobody = || TransportError::Nobody("bus.sock".into());
        let mut calls = 0;
        let mut third = || {
            calls += 1;
            if calls < 3 { Err(nobody()) } else { Ok(calls) }
        };
        assert_eq!(opened(&mut third, BUSY_MAX).unwrap(), 3);
        assert!(matches!(
            opened(|| Err::<(), _>(nobody()), Duration::ZERO),
            Err(TransportError::Nobody(_))
        ));
        let mut calls = 0;
        let other = opened(
            || {
                calls += 1;
                Err::<(), _>(TransportError::NoSocket("bus.sock".into()))
            },
            BUSY_MAX,
        );
        assert!(matches!(other, Err(TransportError::NoSocket(_))));
        assert_eq!(calls, 1);
    }
}
