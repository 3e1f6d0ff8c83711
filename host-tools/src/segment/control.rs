//! Commands to a running segment: from its prompt (stdin), and from programs at its control socket.
//!
//! Every line is one command ([`COMMAND_HELP`]) and has one answer: a line of JSON at the socket and with `--json`, text
//! at the prompt. Nothing blocks: input that is not there is looked for again a millisecond later. A segment in the
//! background of a shell does not touch the terminal.

use super::{SlaveSummary, state_name};
use crate::error::{ProgramError, code};
use etherpen_segment::control::{Bits, COMMAND_HELP, Command, Inputs, Names, Side};
use etherpen_segment::{Fault, Load, Segment, SlaveKind};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use serde_json::{Value, json};
use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::FileTypeExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest line, bytes.
const LINE_BYTES_MAX: usize = 64 * 1024;
/// Most unsent bytes of answers before a client is dropped.
const UNSENT_BYTES_MAX: usize = 4 << 20;
/// Most clients at a time.
const CLIENTS_MAX: usize = 16;
/// Longest wait of [`tell`] for the answer.
const ANSWER_MAX: Duration = Duration::from_secs(10);
/// Most bits of inputs that a command can reach, as bytes.
const INPUT_BYTES_MAX: usize = 8192;

/// Lines from a stream that is read without waiting.
#[derive(Debug, Default)]
struct Lines {
    bytes: Vec<u8>,
    ended: bool,
}

impl Lines {
    /// Reads what is there.
    fn read(&mut self, source: &mut impl Read) {
        let mut buffer = [0; 4096];
        match source.read(&mut buffer) {
            Ok(0) => self.ended = true,
            Ok(length) => self.bytes.extend_from_slice(buffer.get(..length).unwrap_or_default()),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(_) => self.ended = true,
        }
        self.ended |= self.bytes.len() > LINE_BYTES_MAX;
    }

    /// The next complete line; the last one need not be closed.
    fn next(&mut self) -> Option<String> {
        let line: Vec<u8> = match self.bytes.iter().position(|byte| *byte == b'\n') {
            Some(at) => self.bytes.drain(..=at).collect(),
            None if self.ended && !self.bytes.is_empty() => std::mem::take(&mut self.bytes),
            None => return None,
        };
        Some(String::from_utf8_lossy(&line).trim().to_owned())
    }
}

/// A program at the control socket.
#[derive(Debug)]
struct Client {
    stream: UnixStream,
    lines: Lines,
    unsent: Vec<u8>,
}

/// What the commands need beside the segment.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Surroundings {
    /// Time in which the segment stood still because this process did not run, ms.
    pub(crate) paused_ms: u64,
}

/// The prompt and the control socket of a segment.
#[derive(Debug)]
pub(crate) struct Control {
    names: Names,
    prompt: Option<Lines>,
    json: bool,
    listener: Option<(UnixListener, PathBuf)>,
    clients: Vec<Client>,
    /// Whether a command has asked for the end.
    ends: bool,
}

impl Control {
    /// Commands from stdin, answered as text or as JSON, and from a Unix socket, if there is a path for one.
    ///
    /// # Errors
    /// The socket cannot be opened.
    pub(crate) fn new(names: Names, json: bool, socket: Option<&Path>) -> Result<Self, ProgramError> {
        Ok(Self {
            names,
            prompt: Some(Lines::default()),
            json,
            listener: socket.map(listen).transpose()?,
            clients: Vec::new(),
            ends: false,
        })
    }

    /// Whether a command has asked for the end.
    pub(crate) fn has_ended(&self) -> bool {
        self.ends
    }

    /// Carries out the commands that are there.
    ///
    /// # Errors
    /// stdout is closed.
    pub(crate) fn serve<L: Load>(
        &mut self,
        segment: &mut Segment<L>,
        surroundings: Surroundings,
    ) -> Result<(), ProgramError> {
        self.serve_prompt(segment, surroundings)?;
        self.accept();
        let mut clients = std::mem::take(&mut self.clients);
        for client in &mut clients {
            client.lines.read(&mut client.stream);
            while let Some(line) = client.lines.next() {
                if let Some(answer) = self.answer(&line, segment, surroundings) {
                    client.unsent.extend_from_slice(answer.to_string().as_bytes());
                    client.unsent.push(b'\n');
                }
            }
        }
        clients.retain_mut(Client::send);
        self.clients = clients;
        Ok(())
    }

    fn serve_prompt<L: Load>(
        &mut self,
        segment: &mut Segment<L>,
        surroundings: Surroundings,
    ) -> Result<(), ProgramError> {
        let Some(mut prompt) = self.prompt.take() else {
            return Ok(());
        };
        let stdin = io::stdin();
        if is_readable(stdin.as_fd()) {
            prompt.read(&mut Unbuffered(stdin.as_fd()));
        }
        while let Some(line) = prompt.next() {
            let Some(answer) = self.answer(&line, segment, surroundings) else {
                continue;
            };
            let text = if self.json { answer.to_string() } else { text(&answer) };
            writeln!(io::stdout(), "{text}").or_else(ProgramError::of_stdout)?;
        }
        self.prompt = (!prompt.ended).then_some(prompt);
        Ok(())
    }

    fn accept(&mut self) {
        let Some((listener, _)) = &self.listener else { return };
        while self.clients.len() < CLIENTS_MAX
            && let Ok((stream, _)) = listener.accept()
        {
            if stream.set_nonblocking(true).is_ok() {
                self.clients.push(Client {
                    stream,
                    lines: Lines::default(),
                    unsent: Vec::new(),
                });
            }
        }
    }

    /// The answer to a line; `None` for an empty one.
    fn answer<L: Load>(&mut self, line: &str, segment: &mut Segment<L>, surroundings: Surroundings) -> Option<Value> {
        let result = match self.names.command(line) {
            Ok(None) => return None,
            Ok(Some(command)) => self.carry_out(&command, segment, surroundings),
            Err(error) => Err(error.to_string()),
        };
        Some(match result {
            Ok(mut answer) => {
                answer["ok"] = true.into();
                answer
            }
            Err(error) => json!({ "ok": false, "error": error }),
        })
    }

    fn carry_out<L: Load>(
        &mut self,
        command: &Command,
        segment: &mut Segment<L>,
        surroundings: Surroundings,
    ) -> Result<Value, String> {
        Ok(match command {
            Command::Help => json!({ "help": COMMAND_HELP }),
            Command::Quit => {
                self.ends = true;
                json!({})
            }
            Command::List => self.list(segment, surroundings),
            Command::Get { slave, bits: None } => self.slave(*slave, segment),
            Command::Get {
                slave,
                bits: Some(bits),
            } => self.bits(*slave, *bits, segment)?,
            Command::Set { slave, inputs } => {
                set(segment, *slave, inputs)?;
                self.slave(*slave, segment)
            }
            Command::Cable { slave, plugged } => {
                let cable = slave.saturating_sub(1);
                let fault = if *plugged {
                    Fault::Plug(cable)
                } else {
                    Fault::Cut(cable)
                };
                segment.inject(fault);
                json!({ "slave": slave, "plugged": plugged })
            }
            Command::Fault(fault) => {
                segment.inject(*fault);
                json!({ "fault": fault.name() })
            }
        })
    }

    fn list<L: Load>(&self, segment: &Segment<L>, surroundings: Surroundings) -> Value {
        let slaves: Vec<Value> = (1..=segment.slaves().len())
            .map(|slave| self.slave(slave, segment))
            .collect();
        json!({
            "time_ms": segment.time_ms(),
            "paused_ms": surroundings.paused_ms,
            "frames": segment.frames(),
            "travel_ns": segment.travel_ns(),
            "faults": segment.injected(),
            "slaves": slaves,
        })
    }

    /// Everything about one slave.
    fn slave<L: Load>(&self, slave: usize, segment: &Segment<L>) -> Value {
        let states = segment.slaves();
        let (Some(state), Some(kind)) = (
            slave.checked_sub(1).and_then(|at| states.get(at)),
            self.names.kind(slave),
        ) else {
            return Value::Null;
        };
        let summary = SlaveSummary::new(slave, kind, state);
        let motor = segment.motors().find(|motor| motor.slave == slave && kind.is_drive());
        json!({
            "slave": slave,
            "name": self.names.name(slave),
            "kind": kind.name(),
            "powered": state.powered,
            "reached": state.reached,
            "al_state": state_name(state.al_state),
            "al_status_code": summary.al_status_code,
            "al_status_text": summary.al_status_text,
            "inputs": segment.inputs(slave).map(|bytes| hex(&bytes)),
            "outputs": segment.outputs(slave).map(|bytes| hex(&bytes)),
            "drive": summary.drive,
            "drive_error": summary.drive_error,
            "angle_rad": motor.map(|motor| motor.angle_rad),
            "speed_rad_s": motor.map(|motor| motor.speed_rad_s),
        })
    }

    fn bits<L: Load>(&self, slave: usize, bits: Bits, segment: &Segment<L>) -> Result<Value, String> {
        let (inputs, outputs) = (segment.inputs(slave), segment.outputs(slave));
        let (side, bytes) = match (bits.side, inputs, outputs) {
            (Some(Side::Inputs) | None, Some(inputs), _) => ("in", inputs),
            (Some(Side::Outputs) | None, _, Some(outputs)) => ("out", outputs),
            _ => return Err(format!("slave {slave} has no such process data")),
        };
        let value = number(&bytes, bits.first, bits.count)
            .ok_or_else(|| format!("slave {slave} has {} bits there", 8 * bytes.len()))?;
        Ok(json!({
            "slave": slave,
            "name": self.names.name(slave),
            "kind": self.names.kind(slave).map(SlaveKind::name),
            "side": side,
            "bit": bits.first + 1,
            "bits": bits.count,
            "value": value,
        }))
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        if let Some((_, path)) = &self.listener {
            // The socket may have been removed by somebody else.
            let _ = fs::remove_file(path);
        }
    }
}

impl Client {
    /// Sends what the client takes; returns whether it is still there.
    fn send(&mut self) -> bool {
        match self.stream.write(&self.unsent) {
            Ok(length) => drop(self.unsent.drain(..length)),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(_) => return false,
        }
        let done = self.lines.ended && self.unsent.is_empty();
        !done && self.unsent.len() <= UNSENT_BYTES_MAX
    }
}

/// Reads a descriptor without a buffer of its own.
struct Unbuffered<'a>(BorrowedFd<'a>);

impl Read for Unbuffered<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        Ok(rustix::io::read(self.0, buffer)?)
    }
}

/// Whether a read of stdin does not wait, and a terminal is not another program's.
fn is_readable(stdin: BorrowedFd) -> bool {
    let mut waiting = [PollFd::new(&stdin, PollFlags::IN)];
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    let ready = poll(&mut waiting, Some(&now)).is_ok_and(|ready| ready > 0);
    let foreground = match rustix::termios::tcgetpgrp(stdin) {
        Ok(group) => group == rustix::process::getpgrp(),
        Err(error) => error == Errno::NOTTY,
    };
    ready && foreground
}

fn listen(path: &Path) -> Result<(UnixListener, PathBuf), ProgramError> {
    let failed = |cause: io::Error| {
        ProgramError::new(
            code::CONNECTION,
            format!("the control socket {}: {cause}", path.display()),
        )
    };
    let is_socket = fs::symlink_metadata(path).is_ok_and(|metadata| metadata.file_type().is_socket());
    if is_socket && UnixStream::connect(path).is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused) {
        fs::remove_file(path).map_err(failed)?;
    }
    let listener = UnixListener::bind(path).map_err(|error| match error.kind() {
        ErrorKind::AddrInUse => ProgramError::new(
            code::CONNECTION,
            format!("the control socket {}: it is taken", path.display()),
        ),
        _ => failed(error),
    })?;
    listener.set_nonblocking(true).map_err(failed)?;
    Ok((listener, path.to_owned()))
}

/// Sends a command to the segment with this control socket and returns its answer.
///
/// # Errors
/// There is no such segment, it does not answer, or it refuses the command.
pub(crate) fn tell(socket: &Path, command: &str) -> Result<Value, ProgramError> {
    let failed = |cause: io::Error| {
        ProgramError::new(
            code::CONNECTION,
            format!("the control socket {}: {cause}", socket.display()),
        )
    };
    let mut stream = UnixStream::connect(socket).map_err(failed)?;
    stream.set_read_timeout(Some(ANSWER_MAX)).map_err(failed)?;
    stream.write_all(format!("{command}\n").as_bytes()).map_err(failed)?;
    stream.shutdown(std::net::Shutdown::Write).map_err(failed)?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).map_err(failed)?;
    let answer: Value = serde_json::from_str(&answer)
        .map_err(|_| ProgramError::new(code::CONNECTION, "the segment ended before it answered"))?;
    match answer["error"].as_str() {
        Some(error) => Err(ProgramError::new(code::FAILED, error)),
        None => Ok(answer),
    }
}

fn set<L: Load>(segment: &mut Segment<L>, slave: usize, inputs: &Inputs) -> Result<(), String> {
    let present = segment
        .inputs(slave)
        .ok_or_else(|| format!("slave {slave} has no inputs that can be set"))?;
    let bytes = match inputs {
        Inputs::Bytes(bytes) => bytes.clone(),
        Inputs::Bits { first, count, value } => {
            let needed = (first + count).div_ceil(8).min(INPUT_BYTES_MAX);
            let mut bytes = present.clone();
            bytes.resize(bytes.len().max(needed), 0);
            for index in 0..*count {
                let at = first + index;
                if let Some(byte) = bytes.get_mut(at / 8) {
                    *byte = *byte & !(1 << (at % 8)) | ((value >> index & 1) as u8) << (at % 8);
                }
            }
            bytes
        }
    };
    segment.set_inputs(slave, &bytes);
    let room = segment.inputs(slave).map_or(0, |inputs| inputs.len());
    if room < bytes.len() {
        segment.set_inputs(slave, &present);
        return Err(format!("slave {slave} has {} bits of inputs", 8 * room));
    }
    Ok(())
}

/// Bits of process data as a number; `None` beyond their end.
fn number(bytes: &[u8], first: usize, count: usize) -> Option<u64> {
    let mut value = 0;
    for index in (0..count).rev() {
        let at = first + index;
        value = value << 1 | u64::from(bytes.get(at / 8)? >> (at % 8) & 1);
    }
    Some(value)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// An answer for people.
pub(crate) fn text(answer: &Value) -> String {
    let field = |name: &str| answer.get(name).filter(|value| !value.is_null());
    if let Some(error) = field("error").and_then(Value::as_str) {
        return error.to_owned();
    }
    if let Some(help) = field("help").and_then(Value::as_str) {
        return help.to_owned();
    }
    if let Some(value) = field("value") {
        return value.to_string();
    }
    if let Some(fault) = field("fault").and_then(Value::as_str) {
        return format!("{fault}: injected");
    }
    if let (Some(slave), Some(plugged)) = (field("slave"), field("plugged")) {
        let done = if plugged == true { "plugged in" } else { "pulled" };
        return format!("the cable to slave {slave} is {done}");
    }
    if let Some(slaves) = field("slaves").and_then(Value::as_array) {
        let mut lines: Vec<String> = slaves.iter().map(slave_text).collect();
        lines.push(format!(
            "{} ms, stood still for {} ms, {} frames; faults {}",
            answer["time_ms"], answer["paused_ms"], answer["frames"], answer["faults"]
        ));
        return lines.join("\n");
    }
    match field("kind") {
        Some(_) => slave_text(answer),
        None => "done".to_owned(),
    }
}

fn slave_text(slave: &Value) -> String {
    let word = |name: &str| slave[name].as_str().map(str::to_owned);
    let mut line = format!("{:>3} {:<8}", slave["slave"], word("kind").unwrap_or_default());
    let reached = slave["reached"] == true;
    let state = if reached {
        word("al_state").unwrap_or_default()
    } else {
        "not reached".to_owned()
    };
    line += &format!(" {state:<11}");
    for (label, name) in [("", "name"), ("in ", "inputs"), ("out ", "outputs"), ("", "drive")] {
        if let Some(value) = word(name).filter(|value| !value.is_empty()) {
            line += &format!(" {label}{value}");
        }
    }
    if let Some(angle) = slave["angle_rad"].as_f64() {
        line += &format!(" {angle:.4} rad");
    }
    if slave["al_status_code"] != 0 {
        line += &format!(
            " AL status code {}: {}",
            slave["al_status_code"], slave["al_status_text"]
        );
    }
    line.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_counted_from_the_lowest_of_the_first_byte() {
        let bytes = [0b1000_0001, 0xFF, 0x00];
        assert_eq!(number(&bytes, 0, 1), Some(1));
        assert_eq!(number(&bytes, 7, 2), Some(3));
        assert_eq!(number(&bytes, 8, 16), Some(0x00FF));
        assert_eq!(number(&bytes, 20, 5), None);
    }

    #[test]
    fn lines_come_when_they_are_complete() {
        let mut lines = Lines::default();
        lines.read(&mut "list\nget".as_bytes());
        assert_eq!((lines.next().as_deref(), lines.next()), (Some("list"), None));
        lines.read(&mut " 1\n".as_bytes());
        assert_eq!(lines.next().as_deref(), Some("get 1"));
        lines.read(&mut "quit".as_bytes());
        lines.read(&mut [].as_slice());
        assert_eq!((lines.next().as_deref(), lines.ended), (Some("quit"), true));
    }
}
