//! Masters of other projects in Python, on the virtual segment: one cable, two network namespaces.
//!
//! A script brings the slaves up and prints what it saw as JSON; the rules are in the tests. Without root, raw sockets or PyPI a
//! test says that it was left out. It fails instead where its variable is set.

use crate::network::Network;
use crate::program::{Folder, Running, etherpen, wait_until};
use host_tools::setup::SetupError;
use nix::sys::socket::{AddressFamily, SockFlag, SockProtocol, SockType, socket};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// Longest run of a master; the scripts give up by themselves when an answer does not come within two minutes.
const PATIENCE: Duration = Duration::from_secs(30 * 60);

/// Most runs of a master that ends because an answer was late: its time is this computer's, and KickCAT waits some milliseconds.
const ATTEMPTS: u32 = 5;
/// What KickCAT says then.
const LOST: &str = "datagram state is LOST";

/// A master of another project.
pub(crate) struct OtherMaster {
    /// Name of the Python package.
    pub(crate) name: &'static str,
    /// Environment variable; set to anything, the test fails where it would be left out.
    pub(crate) require: &'static str,
    /// Finds a Python with the package, or installs it.
    pub(crate) ensure: fn() -> Result<PathBuf, SetupError>,
    /// File name of its script beside this file. It gets the interface and the number of cycles.
    pub(crate) script: &'static str,
}

impl OtherMaster {
    /// Says that the test was not run, past the test harness too; fails if it had to be run.
    fn leave_out(&self, why: &str) {
        let message = format!("SKIPPED the test with {}: {why}", self.name);
        println!("{message}");
        eprintln!("{message}");
        let required = std::env::var_os(self.require).is_some_and(|value| !value.is_empty());
        assert!(!required, "{} is set, but: {message}", self.require);
    }

    /// What the master saw of a segment of these slaves; `None` if it cannot be run here.
    pub(crate) fn run(&self, slaves: &str, cycles: u64) -> Option<Value> {
        if let Err(why) = has_raw_sockets() {
            self.leave_out(&why);
            return None;
        }
        let python = match (self.ensure)() {
            Ok(python) => python,
            Err(missing) => {
                self.leave_out(&missing.to_string());
                return None;
            }
        };
        let Some(network) = Network::new(&format!("the test with {}", self.name)) else {
            self.leave_out("it makes network namespaces, which takes root");
            return None;
        };
        for _ in 1..ATTEMPTS {
            if let Some(report) = self.attempt(&network, &python, slaves, cycles) {
                return Some(report);
            }
        }
        let report = self.attempt(&network, &python, slaves, cycles);
        Some(report.unwrap_or_else(|| panic!("{}: frames were lost {ATTEMPTS} times", self.name)))
    }

    /// What the master saw; `None` if it ended because this computer was too busy to answer it in time.
    fn attempt(&self, network: &Network, python: &Path, slaves: &str, cycles: u64) -> Option<Value> {
        let folder = Folder::new();
        let [at_segment, at_master] = network.interfaces();
        let mut program = etherpen(&folder);
        program.args(["segment", "--slaves", slaves, "--interface", at_segment]);
        let mut segment = Running::start(&mut network.command(0, &program));
        segment.wait_for("segment", |running| {
            running.stdout().contains("interface:").then_some(())
        });
        let script = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/commands")
            .join(self.script);
        let mut program = Command::new(python);
        // `-B` leaves no byte code among the sources.
        program.arg("-B").arg(script).args([at_master, &cycles.to_string()]);
        let mut master = Running::start(&mut network.command(1, &program));
        let status = master.end_within(PATIENCE);
        let (said, told) = (master.stderr(), segment.stderr());
        // What ended it stands in the last line; a master may have tried several times before.
        let ended_by = said.lines().rfind(|line| !line.trim().is_empty());
        if !status.success() && ended_by.is_some_and(|line| line.contains(LOST)) {
            println!("{}: {said}", self.name);
            return None;
        }
        assert!(status.success(), "{}: {status}; {said}; segment: {told}", self.name);
        // The end of a program may be seen before the last of what it printed; a master may print lines of its own before.
        let report = || {
            let printed = master.stdout();
            let from = printed.find('{')?;
            serde_json::from_str(&printed[from..]).ok()
        };
        wait_until("the master's report", || {
            report().is_some_and(|value: Value| value.is_object())
        });
        report()
    }
}

/// Whether this process may use network interfaces directly.
fn has_raw_sockets() -> Result<(), String> {
    let family = AddressFamily::Packet;
    let opened = socket(family, SockType::Raw, SockFlag::SOCK_CLOEXEC, SockProtocol::EthAll);
    opened
        .map(drop)
        .map_err(|cause| format!("no raw sockets here ({cause})"))
}
