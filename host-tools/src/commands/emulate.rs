//! `etherpen emulate`: the firmware in QEMU with the virtual cell, left running.

use super::{CellArguments, ConfigArguments};
use crate::captured_cell::CapturedCell;
use crate::cell::{Cell, CellOptions, read_faults};
use crate::emulator::free_running::FreeRunning;
use crate::emulator::tcp_line::{LineEvent, TcpLine};
use crate::emulator::{Emulator, LogLine, Options, Pace};
use crate::error::{ProgramError, code};
use crate::setup;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Options of `etherpen emulate`.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    /// TCP port of the serial link on 127.0.0.1; 0 takes a free one.
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Speed of virtual time.
    #[arg(long, value_enum, default_value_t = PaceArgument::Realtime)]
    pace: PaceArgument,
    /// Run without lockstep, with the serial link on the board's UART, to play with. A delay of the emulator that
    /// exceeds the drives' watchdog ends in a fault; samples/play.toml has longer limits.
    #[arg(long)]
    free_running: bool,
    /// Give the firmware the emulator's own network instead of the virtual cell, for EtherCAT in UDP: it gets its
    /// address by DHCP and reaches a segment on this computer (etherpen segment --udp 127.0.0.1:34980) as 10.0.2.2.
    /// Needs --free-running, and transport = "udp", segment = "10.0.2.2" in the job's configuration.
    #[arg(long, requires = "free_running", conflicts_with_all = ["faults", "cell"])]
    udp: bool,
    /// File with scripted faults of the virtual segment, one per line.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    /// Show the firmware's log on stderr.
    #[arg(long)]
    log: bool,
    #[command(flatten)]
    cell: CellArguments,
    #[command(flatten)]
    config: ConfigArguments,
}

/// Speed of virtual time.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum PaceArgument {
    /// As fast as the machine can.
    Max,
    /// Never ahead of wall time.
    Realtime,
}

/// Time between two checks of a free-running emulator.
const LOOK: Duration = Duration::from_millis(100);

/// Runs the command until it is interrupted or the emulator ends.
///
/// # Errors
/// A tool is missing, the port is taken, or the emulator ended by itself.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let physics = arguments.cell.load()?;
    let faults = read_faults(arguments.faults.as_deref(), config.bus.drives.into())?;
    setup::ensure_sources()?;
    setup::ensure_qemu()?;
    let image = setup::build_firmware("emulated")?;
    let cell = Cell::new(
        &config,
        CellOptions {
            physics,
            faults,
            ..CellOptions::default()
        },
    );
    let cell = CapturedCell::new(cell, None).map_err(|cause| ProgramError::failed("the cell", cause))?;
    let show_log = arguments.log;
    let pace = match arguments.pace {
        PaceArgument::Max => Pace::Max,
        PaceArgument::Realtime => Pace::RealTime,
    };
    let options = Options {
        pace,
        ..Options::default()
    };
    let log = move |line: &LogLine| {
        if show_log {
            eprintln!("{line}");
        }
    };
    if arguments.free_running {
        let started = match arguments.udp {
            true => FreeRunning::start_on_user_network(&image, &options.qemu, arguments.port, log),
            false => FreeRunning::start(&image, &options.qemu, arguments.port, cell, log),
        };
        return free_run(started.map_err(|error| ProgramError::from(&error))?);
    }
    let show = |event| match event {
        LineEvent::Connected(address) => eprintln!("connected: {address}"),
        LineEvent::Disconnected => eprintln!("disconnected"),
    };
    let line = TcpLine::listen(arguments.port, show).map_err(|cause| {
        ProgramError::new(
            code::CONNECTION,
            format!("port {} on 127.0.0.1 cannot be used: {cause}", arguments.port),
        )
    })?;
    let address = line
        .address()
        .map_err(|cause| ProgramError::failed("the port", cause))?;
    let emulator = Emulator::start(&image, &options, cell, line, log).map_err(|error| ProgramError::from(&error))?;
    announce(&address.to_string())?;
    emulator.wait().map(|_| ()).map_err(|error| ProgramError::from(&error))
}

fn announce(address: &str) -> Result<(), ProgramError> {
    writeln!(std::io::stdout(), "tcp:{address}").or_else(ProgramError::of_stdout)?;
    eprintln!("The firmware runs in the emulator. In another terminal:");
    let program = std::env::args().next().unwrap_or_else(|| "etherpen".into());
    let sample = Some("samples/astronaut.png").filter(|sample| Path::new(sample).exists());
    eprintln!("  {program} draw {} --port tcp:{address}", sample.unwrap_or("FILE"));
    eprintln!("Ctrl-C ends it.");
    Ok(())
}

/// Runs without lockstep until the emulator ends.
fn free_run(running: FreeRunning) -> Result<(), ProgramError> {
    announce(&format!("127.0.0.1:{}", running.port()))?;
    while running.is_running() {
        std::thread::sleep(LOOK);
    }
    running.stop().map_err(|error| ProgramError::from(&error))
}
