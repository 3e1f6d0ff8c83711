//! `etherpen segment`: runs the virtual segment alone, in real time, for any master.

use super::endpoint::SegmentArguments;
use super::{CellArguments, ConfigArguments, ended_by_a_signal, print_json};
use crate::cell::{Cell, CellOptions, SCRIPT_HELP, SlaveList, read_faults, usual_slaves};
use crate::error::{ProgramError, code};
use crate::output_file::refuse_input;
use crate::segment::control::{Control, tell as tell_segment, text};
use crate::segment::{SegmentSummary, ServedSegment, capture};
use crate::terminal::counted;
use etherpen_segment::control::{COMMAND_HELP, Names};
use etherpen_segment::transport;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Time in which the segment stood still after which the operator is told first, ms; then at its double.
const PAUSE_TOLD_MS: u64 = 100;

/// Options of `etherpen segment`.
#[derive(clap::Args, Debug)]
#[command(after_long_help = format!("{COMMAND_HELP}\n\n{SCRIPT_HELP}"))]
pub struct Arguments {
    #[command(flatten)]
    segment: SegmentArguments,
    /// Slaves in the order of the chain: ax2000, cia402, akd, ek1100, ek1122, el1004, el1008, el2004, el2008, ai2, ao2, blank,
    /// sii:FILE or esi:FILE#DEVICE (DEVICE: type or product code, with :REVISION if need be), with *N for N of a kind,
    /// for instance ax2000*4,ek1100,el2004. Settings of a slave follow its kind: @name=NAME (for commands), @alias=N,
    /// @serial=N, @id=N (its switches), @password=N (of its files), @clock=32 or 64,
    /// @controller=et1100, lan9252 or akd (of a slave from a file), @managers=OUT/IN (the sync managers, 2 to 7,
    /// of a drive's outputs and inputs), @range=turn (a drive whose position counts one motor turn; untold: without saying so), @lock=MS (its clock follows the reference clock that
    /// slowly), @lrw=no (its controller lets LRW pass), @units=pairs (it takes writes of at most two FMMUs or sync managers),
    /// @boot=MS, @transition=MS, @mailbox=MS, @sii=needed (its processor reads the information memory itself), for instance ax2000@alias=3@serial=7. Branches follow a slave in parentheses, at port
    /// 2, then 3, or with their port: ek1100,ek1122(ax2000*2)(3:cia402),el1008. Default: an AX2000 for each configured
    /// drive.
    #[arg(long, value_name = "LIST")]
    slaves: Option<SlaveList>,
    /// File with scripted faults, one per line; the long help (--help) describes the language.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    /// Record every frame in both directions as pcapng, for Wireshark.
    #[arg(long, value_name = "FILE")]
    pcap: Option<PathBuf>,
    /// Take commands at this Unix socket too (stream, one command a line, one line of JSON as the answer).
    #[arg(long, value_name = "PATH")]
    control: Option<PathBuf>,
    /// Print the answers to commands and a summary at the end as JSON on stdout.
    #[arg(long)]
    json: bool,
    /// The command of --tell, for instance: set door.1 1.
    #[arg(
        value_name = "COMMAND",
        requires = "tell",
        trailing_var_arg = true,
        allow_hyphen_values = true
    )]
    command: Vec<String>,
    #[command(flatten)]
    cell: CellArguments,
    #[command(flatten)]
    config: ConfigArguments,
}

/// All files that the command reads.
fn inputs(arguments: &Arguments) -> Vec<PathBuf> {
    let config = arguments.config.file().map(|(path, _)| path);
    let slaves = arguments.slaves.iter().flat_map(|list| list.files.iter().cloned());
    let others = arguments.faults.clone().into_iter().chain(arguments.cell.file());
    slaves.chain(others).chain(config).collect()
}

/// Runs the command until it is interrupted.
///
/// # Errors
/// The transport cannot be opened or was lost, or a file cannot be read or written.
pub fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    if let Some(socket) = arguments.segment.tell() {
        return tell_other(socket, arguments);
    }
    if let Some(pcap) = &arguments.pcap {
        refuse_input(pcap, &inputs(arguments))?;
    }
    let config = arguments.config.load()?;
    let list = arguments.slaves.clone().unwrap_or_else(|| SlaveList {
        slaves: usual_slaves(&config),
        ..SlaveList::default()
    });
    let names = Names::new(&list);
    let SlaveList {
        slaves,
        places,
        branches,
        ..
    } = list;
    let faults = read_faults(arguments.faults.as_deref(), slaves.len())?;
    let options = CellOptions {
        physics: arguments.cell.load()?,
        faults,
        slaves: slaves.clone(),
        places,
        branches,
        ..CellOptions::default()
    };
    let cell = Cell::new(&config, options);
    let ended = ended_by_a_signal()?;
    let port =
        transport::listen(&arguments.segment.endpoint()).map_err(|error| ProgramError::new(code::CONNECTION, error))?;
    let mut control = Control::new(names, arguments.json, arguments.control.as_deref())?;
    let capture = arguments.pcap.as_deref().map(capture).transpose()?;
    let listens = port.endpoint().to_string();
    if arguments.json {
        eprintln!("{listens}");
    } else {
        writeln!(io::stdout(), "{listens}").or_else(ProgramError::of_stdout)?;
    }
    eprintln!(
        "{}; help lists the commands, Ctrl-C ends the segment.",
        counted(cell.state().slaves.len(), "slave")
    );
    let mut served = ServedSegment::new(cell, slaves, port, capture);
    let begun = Instant::now();
    let mut tell_ms = PAUSE_TOLD_MS;
    while !ended.load(Ordering::Relaxed) && !control.has_ended() {
        served.step(&mut || eprintln!("the first frame has come"))?;
        served.obey(&mut control)?;
        let paused_ms = served.paused_ms();
        if paused_ms >= tell_ms {
            eprintln!("this program did not run: the segment stood still, {paused_ms} ms so far");
            tell_ms = 2 * paused_ms;
        }
    }
    drop(control);
    let summary = served.finish(listens, begun.elapsed())?;
    if arguments.json {
        print_json(&summary)
    } else {
        tell(&summary);
        Ok(())
    }
}

/// Sends a command to another segment and prints its answer.
fn tell_other(socket: &Path, arguments: &Arguments) -> Result<(), ProgramError> {
    let answer = tell_segment(socket, &arguments.command.join(" "))?;
    if arguments.json {
        return print_json(&answer);
    }
    writeln!(io::stdout(), "{}", text(&answer)).or_else(ProgramError::of_stdout)
}

/// Prints the summary at the end.
fn tell(summary: &SegmentSummary) {
    eprintln!(
        "{} in, {} out in {:.1} s; not EtherCAT: {}; {} ms without the processor",
        counted(summary.frames, "frame"),
        summary.replies,
        summary.seconds,
        summary.ignored,
        summary.paused_ms
    );
    for slave in &summary.slaves {
        let error = match slave.al_status_code {
            0 => String::new(),
            number => format!(", AL status code {number:#06x}: {}", slave.al_status_text),
        };
        let drive = slave.drive.as_ref().map_or(String::new(), |drive| format!(", {drive}"));
        eprintln!(
            "slave {}: {}, {}{drive}{error}",
            slave.slave, slave.kind, slave.al_state
        );
    }
}
