//! `etherpen doctor`: checks everything that the other commands need, and shows what to try where something is wrong.
//!
//! Nothing is changed: no tool is installed, no drive gets power, and the firmware is only greeted and asked for its
//! status.

use super::ports::OptionalPort;
use super::{ConfigArguments, print_json};
use crate::error::{ProgramError, code};
use crate::job::error::JobError;
use crate::link::port::{Line, Port, PortName};
use crate::link::session::session_number;
use crate::link::session::{Event, Session};
use crate::link::text;
use crate::terminal::{counted, in_colour};
use crate::{probe, setup};
use etherpen::messages::{Status, Welcome};
use nix::errno::Errno;
use nix::sys::socket::{AddressFamily, SockFlag, SockProtocol, SockType, socket};
use serde::Serialize;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Longest wait for a firmware's greeting and status, ms.
const ANSWER_MAX_MS: u64 = 3_000;

/// Options of `etherpen doctor`.
///
/// A warning is something that only some commands need; a failure is something that is there, or was asked for, and does
/// not work. With --port the firmware there is greeted: a program that is connected to it loses its connection, and a
/// drawing of its is held. Exit codes: 0 nothing failed; 1 something failed; 2 wrong usage.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    port: OptionalPort,
    /// Print the checks as a JSON array on stdout.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum CheckVerdict {
    Ok,
    Warning,
    Failed,
}

/// One check.
#[derive(Clone, Debug, Serialize)]
struct Check {
    check: &'static str,
    verdict: CheckVerdict,
    found: String,
    /// What to try; empty when nothing has to be done.
    #[serde(rename = "try")]
    remedy: String,
}

impl Check {
    fn ok(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            check,
            verdict: CheckVerdict::Ok,
            found: found.into(),
            remedy: String::new(),
        }
    }

    fn warning(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: CheckVerdict::Warning,
            remedy: remedy.into(),
            ..Self::ok(check, found)
        }
    }

    fn failed(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: CheckVerdict::Failed,
            ..Self::warning(check, found, remedy)
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A port's name is invalid, or a check failed.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let port = arguments.port.unless(None)?;
    let mut checks = vec![toolchain(), qemu(), probe_rs(), st_link(), raw_sockets(), namespaces()];
    checks.push(configuration(&arguments.config));
    checks.extend(match &port {
        Some(name) => firmware(name),
        None => vec![ports()],
    });
    if arguments.json {
        print_json(&checks)?;
    } else {
        checks.iter().for_each(print);
    }
    match checks
        .iter()
        .filter(|check| check.verdict == CheckVerdict::Failed)
        .count()
    {
        0 => Ok(()),
        failed => Err(ProgramError::new(
            code::FAILED,
            format!("{failed} of {} failed", counted(checks.len(), "check")),
        )),
    }
}

fn print(check: &Check) {
    let verdict = match check.verdict {
        CheckVerdict::Ok => in_colour("ok     ", "32"),
        CheckVerdict::Warning => in_colour("warning", "33"),
        CheckVerdict::Failed => in_colour("failed ", "31"),
    };
    println!("{verdict}  {:13}  {}", check.check, check.found);
    for line in check.remedy.lines() {
        println!("                        {line}");
    }
}

fn toolchain() -> Check {
    const NAME: &str = "rust";
    let Some(version) = setup::version_line("rustc") else {
        return Check::failed(NAME, "no Rust toolchain", "install rustup from https://rustup.rs");
    };
    if setup::has_target() {
        return Check::ok(
            NAME,
            format!("{version}, target {} (its own linker, no gcc)", setup::TARGET),
        );
    }
    let found = format!("{version}, without the boards' target {}", setup::TARGET);
    let remedy = format!("rustup target add {}   (demo, verify and flash do it)", setup::TARGET);
    Check::warning(NAME, found, remedy)
}

fn qemu() -> Check {
    const NAME: &str = "emulator";
    let Some(version) = setup::version_line(setup::QEMU) else {
        let remedy = "sudo apt-get install -y --no-install-recommends qemu-system-arm   (demo and verify do it)";
        return Check::warning(NAME, format!("no {}", setup::QEMU), remedy);
    };
    match setup::major(&version) {
        Some(major) if major < setup::QEMU_MAJOR_MIN => {
            let remedy = format!("install version {} or newer", setup::QEMU_MAJOR_MIN);
            Check::failed(NAME, format!("{version}: too old"), remedy)
        }
        _ => Check::ok(NAME, version),
    }
}

fn probe_rs() -> Check {
    const NAME: &str = "probe-rs";
    let Some(path) = probe::probe_rs() else {
        return Check::warning(
            NAME,
            "not installed; only flash needs it",
            format!("{}   (or: etherpen flash --install)", probe::INSTALL),
        );
    };
    let shown = path.display().to_string();
    match setup::version_line(&shown) {
        Some(version) => Check::ok(NAME, format!("{version}, {shown}")),
        None => Check::failed(
            NAME,
            format!("{shown} cannot be started"),
            format!("{} --force", probe::INSTALL),
        ),
    }
}

fn st_link() -> Check {
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

/// Requirements of `bus --interface` and `segment --interface`.
fn raw_sockets() -> Check {
    const NAME: &str = "raw sockets";
    let opened = socket(
        AddressFamily::Packet,
        SockType::Raw,
        SockFlag::SOCK_CLOEXEC,
        SockProtocol::EthAll,
    );
    match opened {
        Ok(_) => Check::ok(NAME, "bus --interface and segment --interface may be used"),
        Err(Errno::EPERM | Errno::EACCES) => {
            let program = std::env::current_exe().unwrap_or_else(|_| "etherpen".into());
            let remedy = format!(
                "run it as root, or once: sudo setcap cap_net_raw+ep {}",
                program.display()
            );
            Check::warning(NAME, "no right to use network interfaces by raw sockets", remedy)
        }
        Err(cause) => Check::warning(
            NAME,
            format!("no raw sockets here ({cause})"),
            "use --udp or --unix instead",
        ),
    }
}

/// Requirements of the tests with two interfaces on one computer.
fn namespaces() -> Check {
    const NAME: &str = "namespaces";
    /// CAP_SYS_ADMIN and CAP_NET_ADMIN (capabilities(7)).
    const NEEDED: u64 = 1 << 21 | 1 << 12;
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let rights = effective.and_then(|text| u64::from_str_radix(text.trim(), 16).ok());
    let allowed = rights.is_some_and(|rights| rights & NEEDED == NEEDED);
    match (allowed, setup::is_installed("ip")) {
        (true, true) => Check::ok(NAME, "a second network namespace may be made"),
        (_, false) => Check::warning(
            NAME,
            "no program ip; the tests against another master are skipped",
            "sudo apt-get install -y --no-install-recommends iproute2",
        ),
        (false, true) => Check::warning(
            NAME,
            "no right to make network namespaces; the tests against another master are skipped",
            "run the tests as root",
        ),
    }
}

fn configuration(arguments: &ConfigArguments) -> Check {
    const NAME: &str = "configuration";
    match arguments.load() {
        Ok(config) => {
            let hash = config.hash().unwrap_or_default();
            Check::ok(NAME, format!("{}, hash {hash:016x}", source(arguments)))
        }
        Err(error) => Check::failed(
            NAME,
            error.message,
            "samples/etherpen.toml lists all values with their defaults",
        ),
    }
}

fn source(arguments: &ConfigArguments) -> String {
    match &arguments.config {
        Some(path) => path.display().to_string(),
        None if Path::new("etherpen.toml").exists() => "etherpen.toml".into(),
        None => "built-in (no etherpen.toml here)".into(),
    }
}

/// Existing serial ports, if none was given.
fn ports() -> Check {
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

/// What to do about a device that the user may not open.
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

/// The given port, and the firmware behind it.
fn firmware(name: &PortName) -> Vec<Check> {
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
