//! `etherpen segment`: runs the virtual segment alone, in real time, for any master.

use super::endpoint::SegmentArguments;
use super::{CellArguments, ConfigArguments, ended_by_a_signal, print_json};
use crate::cell::{Cell, CellOptions, SCRIPT_HELP, SlaveList, read_faults, usual_slaves};
use crate::error::{ProgramError, code};
use crate::output_file::refuse_input;
use crate::segment::{SegmentSummary, ServedSegment, capture};
use crate::terminal::counted;
use etherpen_segment::transport;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// Options of `etherpen segment`.
#[derive(clap::Args, Debug)]
#[command(after_long_help = SCRIPT_HELP)]
pub struct Arguments {
    #[command(flatten)]
    segment: SegmentArguments,
    /// Slaves in the order of the chain: ax2000, cia402, ek1100, el1004, el1008, el2004, el2008, blank or sii:FILE, with
    /// *N for N of a kind, for instance ax2000*4,ek1100,el2004. Settings of a slave follow its kind: @alias=N,
    /// @serial=N, @id=N (its switches), @clock=32 or 64, @boot=MS, @transition=MS, @mailbox=MS, @sii=needed (its
    /// processor reads the information memory itself), for instance ax2000@alias=3@serial=7. Default: an AX2000 for each
    /// configured drive.
    #[arg(long, value_name = "LIST")]
    slaves: Option<SlaveList>,
    /// File with scripted faults, one per line; the long help (--help) describes the language.
    #[arg(long, value_name = "FILE")]
    faults: Option<PathBuf>,
    /// Record every frame in both directions as pcapng, for Wireshark.
    #[arg(long, value_name = "FILE")]
    pcap: Option<PathBuf>,
    /// Print a summary as JSON on stdout at the end.
    #[arg(long)]
    json: bool,
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
    if let Some(pcap) = &arguments.pcap {
        refuse_input(pcap, &inputs(arguments))?;
    }
    let config = arguments.config.load()?;
    let SlaveList { slaves, places, .. } = arguments.slaves.clone().unwrap_or_else(|| SlaveList {
        slaves: usual_slaves(&config),
        ..SlaveList::default()
    });
    let faults = read_faults(arguments.faults.as_deref(), slaves.len())?;
    let options = CellOptions {
        physics: arguments.cell.load()?,
        faults,
        slaves: slaves.clone(),
        places,
        ..CellOptions::default()
    };
    let cell = Cell::new(&config, options);
    let ended = ended_by_a_signal()?;
    let port =
        transport::listen(&arguments.segment.endpoint()).map_err(|error| ProgramError::new(code::CONNECTION, error))?;
    let capture = arguments.pcap.as_deref().map(capture).transpose()?;
    let listens = port.endpoint().to_string();
    if arguments.json {
        eprintln!("{listens}");
    } else {
        writeln!(io::stdout(), "{listens}").map_err(|cause| ProgramError::failed("stdout", cause))?;
    }
    eprintln!(
        "{}; Ctrl-C ends the segment.",
        counted(cell.state().slaves.len(), "slave")
    );
    let mut served = ServedSegment::new(cell, slaves, port, capture);
    let begun = Instant::now();
    while !ended.load(Ordering::Relaxed) {
        served.step(&mut || eprintln!("the first frame has come"))?;
    }
    let summary = served.finish(listens, begun.elapsed())?;
    if arguments.json {
        print_json(&summary)
    } else {
        tell(&summary);
        Ok(())
    }
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
