//! KickCAT, an independent master, on the virtual segment.
//!
//! Its package from PyPI brings a master only; slaves it simulates in other programs, which the package does not have.

use crate::other_masters::OtherMaster;
use host_tools::setup;
use serde_json::{Value, json};

const MASTER: OtherMaster = OtherMaster {
    name: "kickcat",
    require: "ETHERPEN_REQUIRE_KICKCAT",
    ensure: setup::ensure_kickcat,
    script: "kickcat_master.py",
};
const SLAVES: &str = "ek1100,el1008,el2004,ax2000,cia402,cia402";
/// Bytes in and out of each slave.
const LENGTHS: [[u64; 2]; 6] = [[0, 0], [1, 0], [0, 1], [6, 6], [6, 6], [6, 6]];
/// Vendors of the slaves with CoE, as object 0x1018:1 tells them.
const VENDORS: [Option<u64>; 6] = [None, None, None, Some(2), Some(0x0E7E), Some(0x0E7E)];
/// Cycles in one go without a wrong working counter: KickCAT judges them itself.
const CYCLES: u64 = 1_000;

#[test]
fn kickcat_brings_up_terminals_and_drives_and_finds_every_working_counter_right() {
    let Some(report) = MASTER.run(SLAVES, CYCLES) else {
        return;
    };
    assert_eq!(report["lengths"], json!(LENGTHS), "{report:#}");
    assert_eq!(report["vendors"], json!(VENDORS), "{report:#}");
    assert_eq!(report["cycles"], CYCLES);
    assert_eq!(report["states"], Value::from(vec!["OPERATIONAL"; 6]), "{report:#}");
    let inputs = report["inputs"].as_array().expect("a list");
    assert_eq!(inputs[1], "00", "nothing is wired to the inputs");
    // The status words of drives without power: position and status of the AX2000, status and position of the others.
    let drives = [&inputs[3], &inputs[4], &inputs[5]].map(|inputs| inputs.as_str().expect("bytes"));
    assert!(
        drives[0].ends_with("5002") && drives[1].starts_with("5002") && drives[2].starts_with("5002"),
        "{drives:?}"
    );
    println!("kickcat: {CYCLES} cycles, none wrong, after {} goes", report["goes"]);
}
