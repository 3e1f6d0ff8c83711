//! The client's end: another process's machine, its orders and what it records.

use super::super::account::Account;
use super::super::{Answer, Failure, NoNews, Order, Snapshot};
use super::{Ask, Greeting, PATIENCE, Question, Response, Said, VERSION, send};
use crate::error::code;
use crate::link::ownership::{Owner, socket_path};
use crate::link::port::PortName;
use std::io::{self, BufRead, BufReader, ErrorKind};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between two signs of life of a client that waits for the end of a motion. A jog is repeated every 40 ms, and
/// the firmware's dead-man time is 100 ms.
const SIGN: Duration = Duration::from_millis(20);

/// Another process's machine.
#[derive(Debug)]
pub struct Client {
    owner: Owner,
    reader: BufReader<UnixStream>,
    next: u64,
    /// An incomplete line.
    begun: Vec<u8>,
}

impl Client {
    /// Finds the owner of a port, if it shares its machine.
    pub fn find(port: &PortName) -> Option<Self> {
        Self::connect(&socket_path(port).ok()?)
    }

    fn connect(path: &Path) -> Option<Self> {
        let stream = UnixStream::connect(path).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).ok()?;
        stream.set_write_timeout(Some(PATIENCE)).ok()?;
        let mut reader = BufReader::new(stream);
        let mut line = String::new();
        reader.read_line(&mut line).ok()?;
        let greeting: Greeting = serde_json::from_str(&line).ok()?;
        (greeting.etherpen == VERSION).then_some(Self {
            owner: greeting.owner,
            reader,
            next: 1,
            begun: Vec::new(),
        })
    }

    /// The owner of the port.
    pub fn owner(&self) -> &Owner {
        &self.owner
    }

    /// Gives an order and waits for its answer.
    ///
    /// # Errors
    /// Why the order was not carried out, or that the owner has ended.
    pub fn carry_out(&mut self, order: Order) -> Answer {
        self.carry_out_unless(order, &AtomicBool::new(false))
    }

    /// Gives an order and waits for its answer. A motion is cancelled when `interrupted` becomes true: then this connection
    /// is closed, which ends no other program's motion.
    ///
    /// # Errors
    /// Why the order was not carried out, that the owner has ended, or the interrupt.
    pub(in crate::machine) fn carry_out_unless(&mut self, order: Order, interrupted: &AtomicBool) -> Answer {
        let said = match order {
            Order::Motion(_) => self.ask_alive(Ask::Order(order), interrupted)?,
            order => self.ask(Ask::Order(order), None)?,
        };
        match said {
            Said::Answer(answer) => answer,
            Said::Snapshot(_) | Said::Account(_) => Err(self.gone(&"an answer to another question came")),
        }
    }

    /// The last known state of the machine.
    ///
    /// # Errors
    /// The owner has ended.
    pub fn snapshot(&mut self) -> Result<Snapshot, Failure> {
        match self.ask(Ask::Snapshot, Some(PATIENCE))? {
            Said::Snapshot(snapshot) => Ok(snapshot),
            Said::Answer(_) | Said::Account(_) => Err(self.gone(&"an answer to another question came")),
        }
    }

    /// Asks for everything that is recorded; it arrives as accounts from now on.
    ///
    /// # Errors
    /// The owner has ended.
    pub(in crate::machine) fn begin_following(&mut self) -> Result<(), Failure> {
        let question = Question {
            id: self.next,
            ask: Ask::Follow,
        };
        send(self.reader.get_mut(), &question).map_err(|cause| self.gone(&cause))
    }

    /// The next account for a follower; waits at most `longest` between two parts of it.
    pub(in crate::machine) fn next_account(&mut self, longest: Duration) -> Result<Account, NoNews> {
        let stream = self.reader.get_mut();
        stream.set_read_timeout(Some(longest)).map_err(|_| NoNews::Closed)?;
        match self.reader.read_until(b'\n', &mut self.begun) {
            Ok(_) if self.begun.last() == Some(&b'\n') => {}
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                return Err(NoNews::Timeout);
            }
            Ok(_) | Err(_) => return Err(NoNews::Closed),
        }
        let response: Option<Response> = serde_json::from_slice(&self.begun).ok();
        self.begun.clear();
        match response.map(|response| response.said) {
            Some(Said::Account(digits)) => Account::from_digits(&digits).ok_or(NoNews::Closed),
            _ => Err(NoNews::Closed),
        }
    }

    fn gone(&self, cause: &dyn std::fmt::Display) -> Failure {
        Failure::new(
            code::CONNECTION,
            format!(
                "{} owns the port and does not answer ({cause}); look at it, or end it",
                self.owner
            ),
        )
    }

    fn ask(&mut self, ask: Ask, longest: Option<Duration>) -> Result<Said, Failure> {
        let id = self.next;
        self.next = id.wrapping_add(1);
        self.exchange(&Question { id, ask }, longest)
            .map_err(|cause| self.gone(&cause))
    }

    /// Asks, and sends signs of life until the answer arrives.
    fn ask_alive(&mut self, ask: Ask, interrupted: &AtomicBool) -> Result<Said, Failure> {
        let id = self.next;
        self.next = id.wrapping_add(1);
        match self.exchange_alive(&Question { id, ask }, interrupted) {
            Ok(Some(said)) => Ok(said),
            Ok(None) => Err(Failure::new(code::FAILED, "interrupted; the motion was cancelled")),
            Err(cause) => Err(self.gone(&cause)),
        }
    }

    /// The answer; `None` after an interrupt, which closes the connection.
    fn exchange_alive(&mut self, question: &Question, interrupted: &AtomicBool) -> io::Result<Option<Said>> {
        let id = question.id;
        let stream = self.reader.get_mut();
        stream.set_read_timeout(Some(SIGN))?;
        send(stream, question)?;
        loop {
            if interrupted.load(Ordering::Relaxed) {
                self.reader.get_mut().shutdown(Shutdown::Both)?;
                return Ok(None);
            }
            send(self.reader.get_mut(), &Question { id, ask: Ask::Alive })?;
            match self.reader.read_until(b'\n', &mut self.begun) {
                Ok(_) if self.begun.last() == Some(&b'\n') => break,
                Ok(_) => return Err(ErrorKind::UnexpectedEof.into()),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(error) => return Err(error),
            }
        }
        let line = std::mem::take(&mut self.begun);
        answer_to(id, &line).map(Some)
    }

    fn exchange(&mut self, question: &Question, longest: Option<Duration>) -> io::Result<Said> {
        let stream = self.reader.get_mut();
        stream.set_read_timeout(longest)?;
        send(stream, question)?;
        let mut line = String::new();
        if self.reader.read_line(&mut line)? == 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        answer_to(question.id, line.as_bytes())
    }
}

fn answer_to(id: u64, line: &[u8]) -> io::Result<Said> {
    let response: Response = serde_json::from_slice(line)?;
    match response.id == id {
        true => Ok(response.said),
        false => Err(io::Error::new(ErrorKind::InvalidData, "another question's answer")),
    }
}
