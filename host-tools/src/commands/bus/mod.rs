//! `etherpen bus`: inspects and changes the slaves, with this computer's master or a running firmware's.

mod files;
mod objects;
mod registers;
mod slaves;
mod table;

use super::ConfigArguments;
use super::ports::OptionalPort;
use crate::bus::access::BusAccess;
use crate::bus::connection;
use crate::bus::objects::parse_object;
use crate::bus::value::Type;
use crate::error::{ProgramError, code};
use etherpen::config::Config;
use etherpen::ethercat::state::AlState;
use etherpen::ethercat::wire::coe::Object;
use etherpen_segment::transport::{Endpoint, udp_address};
use files::FileArguments;
use std::net::SocketAddrV4;
use std::path::PathBuf;

/// Options of `etherpen bus`.
///
/// Slaves count from 1 in chain order. Objects are written INDEX:SUB with a hexadecimal index, for instance 6041:0.
/// This computer's master assigns addresses to the slaves and changes their states only on request. No other master may
/// use the bus.
/// --port takes over the connection of a program that is drawing.
#[derive(clap::Args, Debug)]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    way: WayArguments,
    /// Print the result as JSON on stdout.
    #[arg(long, global = true)]
    json: bool,
    #[command(flatten)]
    config: ConfigArguments,
}

/// How to reach the bus: one of these.
#[derive(clap::Args, Debug)]
pub(super) struct WayArguments {
    /// Run the master on this computer, with raw frames on this network interface; needs permission for raw sockets.
    #[arg(long, value_name = "IF", global = true)]
    interface: Option<String>,
    /// Run the master on this computer, with EtherCAT in UDP to this IPv4 address, HOST or HOST:PORT (default port
    /// 34980).
    #[arg(long, value_name = "ADDR", value_parser = udp_address, global = true)]
    udp: Option<SocketAddrV4>,
    /// Run the master on this computer, with the Unix socket of `etherpen segment --unix`; waits up to 2 s for it.
    #[arg(long, value_name = "PATH", global = true)]
    unix: Option<PathBuf>,
    #[command(flatten)]
    port: OptionalPort,
}

/// What to do.
#[derive(clap::Subcommand, Debug)]
enum Action {
    /// List the slaves in chain order, with identity and state.
    Scan,
    /// Show everything about one slave, or about all. A master on this computer takes up to 64 slaves, the robot up to 16.
    Info {
        /// The slave, from 1.
        #[arg(value_name = "N", value_parser = slave_number)]
        slave: Option<u8>,
    },
    /// Bring a slave to a state, step by step. A slave that no axis uses gets outputs of 0. OP lasts while outputs are
    /// sent: until this program ends, and longer with --port.
    State {
        /// The slave, from 1.
        #[arg(value_name = "N", value_parser = slave_number)]
        slave: u8,
        /// init, preop, safeop or op.
        #[arg(value_parser = al_state)]
        state: AlState,
    },
    /// Read, write and list a slave's objects (CoE).
    Sdo {
        #[command(subcommand)]
        action: SdoAction,
    },
    /// Read or write a file of a slave (FoE), for instance its firmware. The slave goes through INIT to BOOT, which has
    /// mailboxes of its own, and back to INIT.
    Foe {
        #[command(subcommand)]
        action: FileAction,
    },
    /// Show registers of the slave controllers: those with a name, or LEN bytes from ADDR.
    Registers {
        /// Slave, from 1. Default: all.
        #[arg(value_name = "N", value_parser = slave_number)]
        slave: Option<u8>,
        /// First address, hexadecimal.
        #[arg(value_name = "ADDR", value_parser = address)]
        address: Option<u16>,
        /// Number of bytes.
        #[arg(value_name = "LEN", default_value_t = 16)]
        length: u16,
    },
    /// Show the error counters of every port, and the cables that they point at.
    Errors {
        /// Clear the counters afterwards.
        #[arg(long)]
        clear: bool,
    },
    /// Show the state of every slave and its changes until interrupted; with --json, one object per line.
    Watch,
}

/// What to do with a file.
#[derive(clap::Subcommand, Debug)]
enum FileAction {
    /// Read a file of a slave into a file on this computer.
    Read(FileArguments),
    /// Write a file on this computer into a slave.
    Write(FileArguments),
}

/// What to do with objects.
#[derive(clap::Subcommand, Debug)]
enum SdoAction {
    /// Read an object.
    Read {
        /// The slave, from 1.
        #[arg(value_name = "N", value_parser = slave_number)]
        slave: u8,
        /// INDEX:SUB, the index hexadecimal.
        #[arg(value_parser = parse_object)]
        object: Object,
        /// Type of the object. Default: the type that the slave reports.
        #[arg(long = "type", value_name = "T")]
        kind: Option<Type>,
        /// All sub-indices at once, from SUB (0 or 1), as bytes.
        #[arg(long)]
        complete: bool,
    },
    /// Write an object.
    Write {
        /// The slave, from 1.
        #[arg(value_name = "N", value_parser = slave_number)]
        slave: u8,
        /// INDEX:SUB, the index hexadecimal.
        #[arg(value_parser = parse_object)]
        object: Object,
        /// The value: decimal, 0x hexadecimal, text, or pairs of hexadecimal digits for bytes.
        #[arg(allow_hyphen_values = true)]
        value: String,
        /// Its type.
        #[arg(long = "type", value_name = "T")]
        kind: Type,
        /// All sub-indices at once, from SUB (0 or 1), as bytes.
        #[arg(long)]
        complete: bool,
    },
    /// List the object dictionary that the slave reports.
    List {
        /// The slave, from 1.
        #[arg(value_name = "N", value_parser = slave_number)]
        slave: u8,
        /// Also list the entries of every object.
        #[arg(long)]
        entries: bool,
    },
}

fn slave_number(text: &str) -> Result<u8, String> {
    match text.parse() {
        Ok(0) | Err(_) => Err(format!("'{text}' is no slave; they count from 1 to 255")),
        Ok(number) => Ok(number),
    }
}

fn al_state(text: &str) -> Result<AlState, String> {
    let states = [
        AlState::Init,
        AlState::PreOperational,
        AlState::SafeOperational,
        AlState::Operational,
    ];
    let known = states.into_iter().find(|state| state.name().eq_ignore_ascii_case(text));
    known.ok_or(format!("'{text}' is no state; there are init, preop, safeop and op"))
}

fn address(text: &str) -> Result<u16, String> {
    let digits = text.strip_prefix("0x").or(text.strip_prefix("0X")).unwrap_or(text);
    u16::from_str_radix(digits, 16).map_err(|_| format!("'{text}' is no address; write it hexadecimal, 0 to ffff"))
}

impl WayArguments {
    fn endpoint(&self) -> Result<Endpoint, String> {
        match (&self.interface, &self.udp, &self.unix) {
            (Some(name), None, None) => Ok(Endpoint::Interface(name.clone())),
            (None, Some(address), None) => Ok(Endpoint::Udp(*address)),
            (None, None, Some(path)) => Ok(Endpoint::Unix(path.clone())),
            _ => Err("say how the bus is reached by one of --interface, --udp, --unix, --port".into()),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Wrong usage, no connection, or what the bus refused.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let written = match &arguments.action {
        Action::Sdo {
            action: SdoAction::Write { value, kind, .. },
        } => kind.encode(value).map_err(|why| ProgramError::new(code::USAGE, why))?,
        Action::Foe {
            action: FileAction::Write(file),
        } => std::fs::read(file.path())
            .map_err(|cause| ProgramError::new(code::USAGE, format!("{}: {cause}", file.path().display())))?,
        _ => Vec::new(),
    };
    let config = arguments.config.load()?;
    let mut access = arguments.way.open(&config)?;
    act(&mut *access, &arguments.action, &written, arguments.json)
}

impl WayArguments {
    /// Opens the way. A firmware without a configuration gets `config`.
    ///
    /// # Errors
    /// Wrong usage, or no connection.
    pub(super) fn open(&self, config: &Config) -> Result<Box<dyn BusAccess>, ProgramError> {
        let port = self.port.unless(self.other())?;
        match (port, self.endpoint()) {
            (Some(port), _) => {
                let firmware = connection::firmware(&port, config)?;
                if let Some(owner) = &firmware.owner {
                    eprintln!("through {owner}");
                }
                Ok(firmware.access)
            }
            (None, Ok(endpoint)) => connection::own_master(&endpoint),
            (None, Err(why)) => Err(ProgramError::new(code::USAGE, why)),
        }
    }

    /// The option beside --port that selects the way to the bus, if one is given.
    pub(super) fn other(&self) -> Option<&'static str> {
        let interface = self.interface.as_ref().map(|_| "--interface");
        interface
            .or(self.udp.map(|_| "--udp"))
            .or(self.unix.as_ref().map(|_| "--unix"))
    }
}

fn act(access: &mut dyn BusAccess, action: &Action, written: &[u8], json: bool) -> Result<(), ProgramError> {
    match action {
        Action::Scan => slaves::scan(access, json),
        Action::Info { slave } => slaves::info(access, *slave, json),
        Action::State { slave, state } => slaves::state(access, *slave, *state, json),
        Action::Sdo { action } => match action {
            SdoAction::Read {
                slave,
                object,
                kind,
                complete,
            } => objects::read(access, *slave, *object, *kind, *complete, json),
            SdoAction::Write {
                slave,
                object,
                kind,
                complete,
                ..
            } => objects::write(access, *slave, *object, (*kind, written), *complete, json),
            SdoAction::List { slave, entries } => objects::list(access, *slave, *entries, json),
        },
        Action::Foe { action } => match action {
            FileAction::Read(file) => files::read(access, file, json),
            FileAction::Write(file) => files::write(access, file, written, json),
        },
        Action::Registers {
            slave: Some(slave),
            address: Some(address),
            length,
        } => registers::dump(access, *slave, *address, *length, json),
        Action::Registers { slave, .. } => registers::named(access, *slave, json),
        Action::Errors { clear } => registers::errors(access, *clear, json),
        Action::Watch => slaves::watch(access, json, &*super::ended_by_a_signal()?),
    }
}
