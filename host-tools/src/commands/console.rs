//! `etherpen console`: the operator's page, for a real machine, the emulator or a simulation in virtual time.

use super::pen_change::PenChangeArguments;
use super::ports::OptionalPort;
use super::{CellArguments, ConfigArguments, ended_by_a_signal};
use crate::cell::{CellOptions, read_faults};
use crate::console::Console;
use crate::console::server::Server;
use crate::console::virtual_cell::{Firmware, VirtualCell};
use crate::error::{ProgramError, code};
use crate::setup;
use etherpen::config::Config;
use std::io::Read;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Bytes of a token.
const TOKEN_BYTES: usize = 16;
/// Time between two checks for a signal.
const LOOK: Duration = Duration::from_millis(100);

/// Options of `etherpen console`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    port: OptionalPort,
    /// Run the firmware image in QEMU with the virtual cell; this is the default without --port.
    #[arg(long, conflicts_with = "simulate")]
    emulate: bool,
    /// Run the firmware's tasks and the virtual cell in this process, in real time; needs no other program.
    #[arg(long)]
    simulate: bool,
    /// Address of the page. With an address other than 127.0.0.1, anyone who has the token can use the page.
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8340")]
    listen: SocketAddr,
    /// Open the page in a browser.
    #[arg(long)]
    open: bool,
    /// File with scripted faults of the virtual segment, one per line (etherpen segment --help describes them).
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    #[command(flatten)]
    pen_change: PenChangeArguments,
    #[command(flatten)]
    cell: CellArguments,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Runs the command until it is interrupted.
///
/// # Errors
/// The configuration cannot be used, a tool is missing, or the address is taken.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let pen_change = arguments.pen_change.place(&config)?;
    let ended = ended_by_a_signal()?;
    let (port, cell) = match arguments.port.unless(arguments.without_port())? {
        Some(port) => (port, None),
        None => {
            let (cell, kind) = virtual_cell(arguments, &config)?;
            (cell.port(), Some((cell, kind)))
        }
    };
    let file = arguments.config.file_to_store(&config).map_err(|error| error.message);
    let token = token()?;
    let console = Console::start(config, token.clone(), port, cell, pen_change)
        .map_err(|cause| ProgramError::new(code::CONNECTION, cause))?;
    console.store_sheet_in(file);
    let server = Server::start(console.clone(), arguments.listen).map_err(|cause| {
        let listen = arguments.listen;
        let text = format!("{listen} cannot be used: {cause}; choose another one with --listen 127.0.0.1:0");
        ProgramError::new(code::CONNECTION, text)
    })?;
    let url = format!("http://{}/#token={token}", shown(server.address()));
    println!("{url}");
    if !server.address().ip().is_loopback() {
        eprintln!(
            "etherpen: everybody who reaches {} sees the machine; who has the token commands it",
            server.address()
        );
    }
    eprintln!("Open this address in a browser. Ctrl-C ends the console; a robot that is drawing then holds.");
    if arguments.open {
        open(&url);
    }
    let mut told = None;
    while !ended.load(Ordering::Relaxed) {
        std::thread::sleep(LOOK);
        tell_connection(&console, &mut told);
    }
    Ok(())
}

impl Arguments {
    /// An option that excludes a port.
    fn without_port(&self) -> Option<&'static str> {
        let options = [
            (self.emulate, "--emulate"),
            (self.simulate, "--simulate"),
            (self.faults.is_some(), "--faults"),
            (self.cell.given().is_some(), "--cell"),
        ];
        options.into_iter().find_map(|(given, name)| given.then_some(name))
    }
}

/// Reports when the connection to the robot breaks or is restored, with the reason.
fn tell_connection(console: &Console, told: &mut Option<Result<String, String>>) {
    let Some(connection) = console.connection() else { return };
    if told.as_ref() == Some(&connection) {
        return;
    }
    match &connection {
        Ok(firmware) => eprintln!("etherpen: connected: {firmware}"),
        Err(why) => eprintln!("etherpen: no robot: {why}; trying again every second"),
    }
    *told = Some(connection);
}

/// An address as a browser on this computer can use it.
fn shown(address: SocketAddr) -> String {
    match address.ip().is_unspecified() {
        true => format!("localhost:{}", address.port()),
        false => address.to_string(),
    }
}

fn virtual_cell(arguments: &Arguments, config: &Config) -> Result<(VirtualCell, &'static str), ProgramError> {
    let options = CellOptions {
        physics: arguments.cell.load()?,
        faults: read_faults(arguments.faults.as_deref(), config.bus.drives.into())?,
        ..CellOptions::default()
    };
    let (firmware, kind) = if arguments.simulate {
        (Firmware::Simulated, "simulated")
    } else {
        if !arguments.emulate && !setup::is_installed(setup::QEMU) {
            let text = "QEMU is not installed. Try: etherpen console --simulate (needs nothing), --emulate (installs \
                        QEMU), or --port /dev/ttyACM0 for a board";
            return Err(ProgramError::new(code::TOOL, text));
        }
        setup::ensure_sources()?;
        setup::ensure_qemu()?;
        (Firmware::Emulated(setup::build_firmware("emulated")?), "emulated")
    };
    let cell =
        VirtualCell::start(config, options, firmware).map_err(|cause| ProgramError::failed("the cell", cause))?;
    Ok((cell, kind))
}

/// A random token that cannot be guessed.
fn token() -> Result<String, ProgramError> {
    let mut bytes = [0; TOKEN_BYTES];
    std::fs::File::open("/dev/urandom")
        .and_then(|mut source| source.read_exact(&mut bytes))
        .map_err(|cause| ProgramError::failed("no random numbers", cause))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Opens a browser, if there is one; the address was printed either way.
fn open(url: &str) {
    let opened = Command::new("xdg-open")
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    if let Err(cause) = opened {
        eprintln!("etherpen: no browser could be opened (xdg-open: {cause})");
    }
}
