//! The dead-man switch behind a program that has the port: a suspended client stops the robot.

use crate::program::{Folder, Running, etherpen, run, wait_until};
use etherpen::config::Config;
use host_tools::cell::CellOptions;
use host_tools::console::virtual_cell::{Firmware, VirtualCell};
use host_tools::error::code;
use rustix::process::Signal;

/// Speed below which a joint counts as at rest, rad/s; at 20 mm/s the fastest has 0.04.
const STANDS_RAD_S: f64 = 5e-3;
/// Longest time, by the cell's clock, from the client's stop to the motors' standstill, ms: the firmware's dead-man
/// time, a sign of life in transit and the ramp; the rest allows for a computer that does not schedule the port's owner
/// for a while.
const STOP_MAX_MS: u64 = 1_000;

struct Rig {
    folder: Folder,
    cell: VirtualCell,
}

impl Rig {
    fn command(&self, words: &[&str]) -> std::process::Command {
        let mut command = etherpen(&self.folder);
        command.args(words).env("ETHERPEN_PORT", self.cell.port().to_string());
        command
    }

    fn moves(&self) -> bool {
        let speeds = self.cell.state().velocities.0;
        speeds.iter().any(|speed| speed.abs() > STANDS_RAD_S)
    }
}

/// Whether a process was stopped by a signal, by its line in /proc.
fn is_stopped(program: &Running) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", program.id())).unwrap_or_default();
    stat.rsplit_once(')')
        .is_some_and(|(_, rest)| rest.trim_start().starts_with('T'))
}

#[test]
fn a_client_that_is_stopped_while_it_jogs_through_a_console_stops_the_robot() {
    let cell = VirtualCell::start(&Config::default(), CellOptions::default(), Firmware::Simulated);
    let rig = Rig {
        folder: Folder::new(),
        cell: cell.expect("the cell starts"),
    };
    let port = rig.cell.port().to_string();
    let mut console =
        Running::start(etherpen(&rig.folder).args(["console", "--listen", "127.0.0.1:0", "--port", &port]));
    console.wait_for("address", |console| console.stdout().contains("http://").then_some(()));
    let enabled = || run(&mut rig.command(&["enable"])).0 == Some(0);
    wait_until("enabled drives", enabled);
    let mut jog = Running::start(&mut rig.command(&["jog", "0,20,0", "--for", "8"]));
    jog.wait_for("motion", |_| rig.moves().then_some(()));
    let begun_ms = rig.cell.state().time_ms;
    wait_until("a motion of half a second", || {
        rig.cell.state().time_ms > begun_ms + 500
    });
    assert!(rig.moves(), "the jog goes on while its client lives");
    jog.signal(Signal::STOP);
    wait_until("a client that stands", || is_stopped(&jog));
    let stopped_ms = rig.cell.state().time_ms;
    wait_until("motors that stand", || !rig.moves());
    let took_ms = rig.cell.state().time_ms - stopped_ms;
    println!("the motors stood {took_ms} ms after their client, by the cell's clock");
    assert!(took_ms <= STOP_MAX_MS, "{took_ms} ms");
    let joints = rig.cell.state().joints;
    wait_until("two more seconds", || {
        rig.cell.state().time_ms > stopped_ms + took_ms + 2_000
    });
    jog.signal(Signal::CONT);
    assert_eq!(jog.end().code(), Some(i32::from(code::FAILED)), "{}", jog.stderr());
    assert!(jog.stderr().contains("fell silent"), "{}", jog.stderr());
    let now = rig.cell.state().joints;
    let drift = now.0.iter().zip(joints.0).map(|(now, then)| (now - then).abs());
    assert!(drift.fold(0.0, f64::max) < 1e-3, "the jog does not go on by itself");
    let (status, _, stderr) = run(&mut rig.command(&["jog", "0,-20,0", "--for", "0.3"]));
    assert_eq!(status, Some(0), "{stderr}");
}
