//! The examples of the master on a raw socket, at the other end of a cable to a virtual chain.
//!
//! What the example did is asked at the chain's control socket: outputs of terminals, the angle of a motor.

use crate::network::Network;
use crate::program::{Folder, etherpen};
use crate::segment::{Segment, tell};
use host_tools::setup;
use std::process::{Child, Command, ExitStatus};
use std::time::{Duration, Instant};

/// Wall time of an attempt, and how many there are.
const ATTEMPT: Duration = Duration::from_secs(60);
const ATTEMPTS: u32 = 5;
/// Time between two looks at the chain.
const LOOK: Duration = Duration::from_millis(20);

/// A program that ends with this value, also when a test fails.
struct Example(Child);

impl Drop for Example {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs an example on a cable to these slaves until `done`, which asks the chain and gets how the example ended. The
/// chain's time is this computer's: where a busy one makes a drive's watchdog expire, the example is started again.
fn on_a_cable(
    example: &str,
    slaves: &str,
    mut done: impl FnMut(&dyn Fn(&str) -> serde_json::Value, Option<ExitStatus>) -> bool,
) {
    let Some(network) = Network::new(&format!("the test of the example '{example}' on an interface")) else {
        return;
    };
    let folder = Folder::new();
    let socket = folder.join("control.sock");
    let [at_segment, at_master] = network.interfaces();
    let mut program = etherpen(&folder);
    program.args(["segment", "--interface", at_segment, "--slaves", slaves, "--control"]);
    program.arg(&socket);
    let segment = Segment::start(&mut network.command(0, &program));
    let mut program = Command::new(setup::build_host_example(example).expect("the example builds"));
    program.arg(at_master);
    let asked = |command: &str| tell(&folder, &socket, command).1;
    for _ in 0..ATTEMPTS {
        let mut running = Example(network.command(1, &program).spawn().expect("it starts"));
        let started = Instant::now();
        while started.elapsed() < ATTEMPT {
            let ended = running.0.try_wait().expect("a child");
            if done(&asked, ended) {
                drop(running);
                segment.end();
                return;
            }
            std::thread::sleep(LOOK);
        }
    }
    panic!("the example '{example}' did not do it in {ATTEMPTS} attempts");
}

#[test]
fn the_terminals_example_passes_inputs_on_to_outputs_through_a_raw_socket() {
    // Inputs of the EL1008; the EL2004 has the lower four.
    let mut patterns = [("05", "05"), ("fa", "0a"), ("0c", "0c")].into_iter().peekable();
    on_a_cable("terminals", "ek1100,el1008,el2004", |chain, ended| {
        assert_eq!(ended, None, "the example goes on for ever");
        let Some((inputs, outputs)) = patterns.peek() else {
            return true;
        };
        chain(&format!("set el1008 {inputs}"));
        if chain("get el2004")["outputs"] == *outputs {
            patterns.next();
        }
        false
    });
}

#[test]
fn the_drive_example_turns_a_motor_through_a_raw_socket() {
    let mut farthest_rad = 0.0_f64;
    on_a_cable("drive", "cia402", |chain, ended| {
        let angle_rad = chain("get cia402")["angle_rad"].as_f64();
        farthest_rad = farthest_rad.max(angle_rad.unwrap_or(0.0));
        if let Some(status) = ended {
            assert!(status.success(), "{status}");
        }
        // How far it turns is tested in the chain's own time; here the looks are some way apart, and an attempt in which none
        // falls into the turn is repeated.
        ended.is_some() && farthest_rad > 1.0
    });
}
