//! `etherpen status`: state of the machine, and the program that uses it.

use super::Arguments;
use super::io::Shown;
use crate::axes::{PerAxis, axes};
use crate::commands::print_json;
use crate::error::ProgramError;
use crate::job::progress::Progress;
use crate::link::ownership::Owner;
use crate::link::text;
use crate::machine::Snapshot;
use crate::machine::access::MachineAccess;
use crate::terminal::counted;
use etherpen::application::Mode;
use etherpen::config::Config;
use etherpen::drives::cia402::StatusWord;
use etherpen::messages::{Counters, Sample, SlaveStatus, Status};
use etherpen::motion::Pen;
use etherpen::robots::{JointAngles, Kinematics};
use serde::Serialize;
use std::borrow::Cow;

/// One drive.
#[derive(Debug, Serialize)]
struct Drive {
    slave: usize,
    vendor: u32,
    product: u32,
    al_state: String,
    al_code: u16,
    status_word: u16,
    state: String,
}

/// What is printed with `--json`.
#[derive(Debug, Serialize)]
struct Answer<'a> {
    connected: bool,
    lost: Option<String>,
    board: Option<String>,
    firmware: Option<String>,
    mode: Option<Mode>,
    mode_text: Option<Cow<'static, str>>,
    /// Whether the fault was acknowledged, and bus and drives are being brought back.
    recovering: Option<bool>,
    fault: Option<String>,
    referenced: bool,
    override_percent: Option<u8>,
    config: Option<String>,
    /// Why positions are not shown, if the machine works with another configuration.
    remark: Option<&'static str>,
    #[serde(flatten)]
    joints: PerAxis,
    position_mm: Option<[f64; 3]>,
    pen: Option<Pen>,
    increments: Option<Vec<Option<i32>>>,
    counters: Option<Counters>,
    drives: Vec<Drive>,
    /// The named inputs and outputs of terminals.
    io: Vec<Shown>,
    doing: Option<&'a str>,
    drawing: Option<&'a str>,
    progress: Option<&'a Progress>,
    interrupted: bool,
    owner: Option<&'a Owner>,
}

/// Remark about a machine with another configuration.
const OTHER_CONFIGURATION: &str =
    "the machine works with another configuration, so its positions are not shown: name its file (--config)";

/// Runs the command.
///
/// # Errors
/// There is no machine.
pub(super) fn run(arguments: &Arguments) -> Result<(), ProgramError> {
    let config = arguments.config.load()?;
    let port = arguments.port.find()?;
    let mut access = arguments.with_own_port(|own| MachineAccess::find(&port, own))?;
    let snapshot = access.state()?;
    let answer = answer(&config, &snapshot, access.owner());
    if arguments.json {
        return print_json(&answer);
    }
    print(&answer, &snapshot);
    Ok(())
}

fn answer<'a>(config: &Config, snapshot: &'a Snapshot, owner: Option<&'a Owner>) -> Answer<'a> {
    let status = snapshot.status.as_ref();
    let referenced = status.is_some_and(|status| status.referenced);
    // Another configuration may be that of another machine.
    let in_force = status.and_then(|status| status.config);
    let is_other = in_force.is_some() && in_force != config.hash();
    // Without a reference the angles are known only within a motor turn.
    let sample = snapshot.sample.as_ref().filter(|_| referenced && !is_other);
    let joints = sample.map(|sample: &Sample| sample.measured_rad.map(f64::from));
    let position = joints.and_then(|joints| {
        Kinematics::new(&config.geometry)
            .ok()?
            .forward(&JointAngles(joints))
            .ok()
    });
    Answer {
        connected: snapshot.welcome.is_some(),
        lost: snapshot.lost.as_ref().map(|lost| lost.text.clone()),
        board: snapshot.welcome.as_ref().map(|welcome| welcome.board.to_string()),
        firmware: snapshot.welcome.as_ref().map(|welcome| welcome.firmware.to_string()),
        mode: status.map(|status| status.mode),
        mode_text: status.map(text::doing),
        recovering: status.map(|status| status.recovering),
        fault: status.and_then(text::fault_of),
        referenced,
        override_percent: status.map(|status| status.override_percent),
        config: in_force.map(crate::job::history::hash_text),
        remark: is_other.then_some(OTHER_CONFIGURATION),
        joints: PerAxis::new("joints", axes(config), joints.as_ref()),
        position_mm: position.map(Into::into),
        pen: snapshot.sample.filter(|_| referenced).map(|sample| sample.pen),
        increments: status.map(|status| status.increments.into_iter().take(config.bus.drives.into()).collect()),
        counters: status.map(|status| status.counters),
        drives: status.map(drives).unwrap_or_default(),
        io: status.map(|status| Shown::all(config, status)).unwrap_or_default(),
        doing: snapshot.phase.as_deref(),
        drawing: snapshot.drawing.as_deref(),
        progress: snapshot.progress.as_ref(),
        interrupted: snapshot.interrupted,
        owner,
    }
}

fn drives(status: &Status) -> Vec<Drive> {
    let drive = |(slave, status): (usize, &SlaveStatus)| Drive {
        slave,
        vendor: status.vendor,
        product: status.product,
        al_state: text::bus::al_state(status.al_state),
        al_code: status.al_code,
        status_word: status.status_word,
        state: format!("{:?}", StatusWord(status.status_word).state()),
    };
    (1..).zip(&status.slaves).map(drive).collect()
}

fn print(answer: &Answer, snapshot: &Snapshot) {
    match (&answer.board, &answer.firmware, &answer.lost) {
        (Some(board), Some(firmware), _) => println!("firmware {firmware} on board {board}"),
        (_, _, Some(lost)) => println!("not connected: {lost}"),
        _ => println!("not connected"),
    }
    if let Some(owner) = answer.owner {
        println!("in use by {owner}");
    }
    if let Some(mode) = &answer.mode_text {
        println!("mode: {mode}");
    }
    if let Some(fault) = &answer.fault {
        println!("fault: {fault}");
    }
    println!("referenced: {}", if answer.referenced { "yes" } else { "no" });
    if let Some(percent) = answer.override_percent {
        println!("speed override: {percent} %");
    }
    if let Some(remark) = answer.remark {
        println!("{remark}");
    }
    if answer.joints.iter().next().is_some() {
        println!("joints: {}", answer.joints.text());
    }
    if let Some([x, y, z]) = answer.position_mm {
        println!("position: {x:.2}, {y:.2}, {z:.2} mm");
    }
    for drive in &answer.drives {
        println!(
            "slave {}: {}, {} (status word {:#06x})",
            drive.slave, drive.al_state, drive.state, drive.status_word
        );
    }
    answer.io.iter().for_each(Shown::print);
    if let Some(counters) = &answer.counters {
        println!(
            "{}: {} late, {} lost, {}, {}",
            counted(counters.cycles, "cycle"),
            counters.cycles_late,
            counted(counters.frames_lost, "frame"),
            counted(counters.working_counter_errors, "working counter error"),
            counted(counters.setpoint_underruns, "reference underrun")
        );
        if counters.path_stops_left > 0 {
            println!(
                "{} left the path and ended in the drives' quick stop",
                counted(counters.path_stops_left, "stop")
            );
        }
    }
    if let (Some(drawing), Some(progress)) = (answer.drawing, answer.progress) {
        println!(
            "{drawing}: stroke {} of {}, {:.0} s drawn, {:.0} s left",
            progress.strokes, progress.strokes_total, progress.elapsed_s, progress.left_s
        );
    }
    if let Some(doing) = answer.doing {
        println!("doing: {doing}");
    }
    if snapshot.interrupted {
        println!("the drawing is held after a lost connection: etherpen resume continues it, etherpen cancel ends it");
    }
}
