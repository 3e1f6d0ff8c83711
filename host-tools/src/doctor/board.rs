//! Checks of the board: its debug probe, its ports and its firmware.

use super::Check;
use crate::job::error::JobError;
use crate::link::port::{Line, Port, PortName};
use crate::link::session::{Event, Session, session_number};
use crate::link::text;
use crate::probe;
use etherpen::messages::{Status, Welcome};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Longest wait for a firmware's greeting and status, ms.
const ANSWER_MAX_MS: u64 = 3_000;

/// Debug probes on USB, and the permission to open them.
pub(super) fn st_link() -> Check {
    const NAME: &str = "debug probe";
    let links = probe::st_links(Path::new(probe::USB_DEVICES));
    if links.is_empty() {
        let remedy = "connect the board's ST-LINK (USB connector CN1) to this computer";
        return Check::warning(NAME, "no ST-LINK on USB", remedy);
    }
    let named = |link: &probe::StLink| format!("{} ({})", link.name, link.selector());
    let shown: Vec<String> = links.iter().map(named).collect();
    let shown = shown.join(", ");
    match links.iter().find_map(|link| link.access().err()) {
        None => Check::ok(NAME, shown),
        Some(cause) => Check::failed(NAME, format!("{shown} may not be opened ({cause})"), probe::UDEV_RULE),
    }
}

/// The serial ports of this computer.
pub(super) fn ports() -> Check {
    const NAME: &str = "port";
    let present = serial2::SerialPort::available_ports().unwrap_or_default();
    let shown: Vec<String> = present.iter().map(|path| shown_port(path)).collect();
    if shown.is_empty() {
        return Check::warning(
            NAME,
            "no serial port",
            "plug in the board, or start etherpen emulate; then: etherpen doctor --port P",
        );
    }
    let found = format!("present: {}", shown.join(", "));
    match present.iter().find_map(|path| no_access(path)) {
        None => Check::ok(NAME, format!("{found}; --port P greets the firmware there")),
        Some(remedy) => Check::warning(NAME, found, remedy),
    }
}

/// A serial port's name, and its role on a board.
fn shown_port(path: &Path) -> String {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let shown = path.display();
    match probe::board_port(Path::new(probe::SERIAL_PORTS), name) {
        Some(probe::BoardPort::StLink) => format!("{shown} (the ST-LINK's serial line)"),
        Some(probe::BoardPort::Firmware) => format!("{shown} (the firmware's own USB)"),
        None => shown.to_string(),
    }
}

/// What to do about a device that the user cannot open.
fn no_access(device: &Path) -> Option<String> {
    let error = std::fs::OpenOptions::new().read(true).write(true).open(device).err()?;
    if error.kind() != std::io::ErrorKind::PermissionDenied {
        return None;
    }
    let group = std::fs::metadata(device)
        .ok()
        .and_then(|device| group_name(device.gid()));
    let group = group.unwrap_or_else(|| "dialout".into());
    Some(format!(
        "{} belongs to the group {group}: sudo usermod -aG {group} $USER, then log in again",
        device.display()
    ))
}

/// A group's name, from the system's list (group(5)).
fn group_name(wanted: u32) -> Option<String> {
    let groups = std::fs::read_to_string("/etc/group").ok()?;
    groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let (name, number) = (fields.next()?, fields.nth(1)?);
        (number.parse() == Ok(wanted)).then(|| name.to_owned())
    })
}

/// A port, and the firmware behind it.
pub(super) fn firmware(name: &PortName) -> Vec<Check> {
    const PORT: &str = "port";
    const FIRMWARE: &str = "firmware";
    let port = match Port::open(name) {
        Ok(port) => port,
        Err(cause) => {
            let text = cause.to_string();
            let (found, remedy) = text.split_once("; ").unwrap_or((&text, ""));
            let remedy = match name {
                PortName::Serial(path) => no_access(path).unwrap_or_else(|| remedy.to_owned()),
                _ => remedy.to_owned(),
            };
            return vec![Check::failed(PORT, found, remedy)];
        }
    };
    let mut checks = vec![Check::ok(PORT, format!("{name} is open"))];
    match handshake(port) {
        Ok((welcome, status)) => {
            checks.push(Check::ok(
                FIRMWARE,
                format!(
                    "{} on {}, protocol version {}",
                    welcome.firmware, welcome.board, welcome.protocol
                ),
            ));
            checks.extend(text::previous_run(&welcome.previous).map(previous));
            checks.extend(status.as_ref().map(state));
        }
        Err(error) => {
            let remedy = match *error {
                JobError::Version { host, firmware } if firmware < host => {
                    "write this version's firmware into the board: etherpen flash"
                }
                JobError::Version { .. } => {
                    "use the program of the firmware's version, or flash the board: etherpen flash"
                }
                _ => {
                    "check that it is the board's port and that no other program has it open; press the board's reset \
                      button, or write the firmware again: etherpen flash"
                }
            };
            checks.push(Check::failed(FIRMWARE, error.to_string(), remedy));
        }
    }
    checks
}

/// How the previous run ended.
fn previous(text: String) -> Check {
    Check::warning(
        "previous run",
        text,
        "nothing now; look into it if it comes again (the firmware's log says more: probe-rs attach)",
    )
}

/// State of the controller.
fn state(status: &Status) -> Check {
    const NAME: &str = "machine";
    let mode = text::mode(status.mode);
    match &status.fault {
        None => Check::ok(NAME, mode),
        Some(fault) => Check::warning(NAME, mode, text::fault(fault)),
    }
}

/// Greets the firmware and waits for its status.
fn handshake(port: Port) -> Result<(Welcome, Option<Status>), Box<JobError>> {
    let mut line = Line::start(port);
    let mut session = Session::new(session_number());
    session.connect();
    let (mut begun_ms, mut welcome) = (None, None);
    loop {
        let stepped = line.exchange(|now_ms, incoming, outgoing, room| {
            session.receive(incoming, now_ms);
            outgoing.resize(room, 0);
            let length = session.transmit(now_ms, outgoing);
            outgoing.truncate(length);
        });
        let waited_ms = match &stepped {
            Ok(now_ms) => now_ms - *begun_ms.get_or_insert(*now_ms),
            Err(_) => ANSWER_MAX_MS + 1,
        };
        while let Some(event) = session.next_event() {
            match (event, welcome.take()) {
                (Event::Connected(greeting), _) => {
                    session.inquire();
                    welcome = Some(greeting);
                }
                (Event::VersionRefused { host, firmware }, _) => {
                    return Err(JobError::Version { host, firmware }.into());
                }
                (Event::Status(status), Some(greeting)) => return Ok((greeting, Some(status))),
                (_, before) => welcome = before,
            }
        }
        if waited_ms > ANSWER_MAX_MS {
            return match welcome {
                Some(greeting) => Ok((greeting, None)),
                None => Err(JobError::NoAnswer { waited_ms }.into()),
            };
        }
    }
}
