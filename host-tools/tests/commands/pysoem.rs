//! pysoem (SOEM), an independent master, on the virtual segment.
//!
//! With `ETHERPEN_REQUIRE_PYSOEM` set, as in continuous integration, the test fails where it would be left out.

use crate::other_masters::OtherMaster;
use host_tools::setup;
use serde_json::{Value, json};

const MASTER: OtherMaster = OtherMaster {
    name: "pysoem",
    require: "ETHERPEN_REQUIRE_PYSOEM",
    ensure: setup::ensure_pysoem,
    script: "pysoem_master.py",
};
const SLAVES: &str = "ek1100,el1008,el2004,ax2000,akd,cia402";
/// Vendor, product, revision and name of each slave in the chain.
const IDENTITIES: [(u32, u32, u32, &str); 6] = [
    (2, 0x044C_2C52, 0x0012_0000, "EK1100 EtherCAT Coupler"),
    (2, 0x03F0_3052, 0x0010_0000, "EL1008 8 digital inputs 24 V, 3 ms"),
    (2, 0x07D4_3052, 0x0010_0000, "EL2004 4 digital outputs 24 V, 0.5 A"),
    (2, 0x07D0_6014, 0x0000_110A, "AX2000-B110 EtherCAT Drive"),
    (0x006A, 0x0041_4B44, 0x0000_0002, "AKD EtherCAT Drive (CoE)"),
    (0x0E7E, 0x0402, 0x0001_0000, "etherpen CiA 402 drive"),
];
/// Object "Device name" of the drives.
const DEVICE_NAMES: [&str; 3] = ["AX2000-B110 EtherCAT Drive", "AKD", "etherpen CiA 402 drive"];
/// First slave with a mailbox and a clock, from 0; all behind it have them too.
const DRIVES_FROM: usize = 3;
/// Places of the terminals, from 0.
const EL1008: usize = 1;
const EL2004: usize = 2;
/// States as the AL status register has them.
const STATES: [(&str, u8); 5] = [
    ("PREOP", 2),
    ("SAFEOP", 4),
    ("OP", 8),
    ("OP after the cycles", 8),
    ("INIT", 1),
];
/// Cycles required without a wrong working counter.
const CYCLES: u64 = 10_000;
/// Inputs add 1, outputs 2: EL1008, EL2004, and both for each of three drives.
const WORKING_COUNTER: u64 = 1 + 2 + 3 * 3;
/// Object "Device name" as a key of the SDO information.
const DEVICE_NAME: &str = "0x1008";
/// SYNC0, active (register 0x0981).
const SYNC0_ACTIVE: u8 = 3;
const SYNC0_NS: u32 = 1_000_000;
#[test]
fn pysoem_brings_up_terminals_and_drives_and_exchanges_ten_thousand_cycles_without_a_wrong_counter() {
    let Some(report) = MASTER.run(SLAVES, CYCLES) else {
        return;
    };
    let slaves = report["slaves"].as_array().expect("a list");
    assert_eq!(slaves.len(), IDENTITIES.len(), "{report:#}");
    for (slave, (vendor, product, revision, name)) in slaves.iter().zip(IDENTITIES) {
        let seen = ["vendor", "product", "revision", "name"].map(|key| &slave[key]);
        assert_eq!(seen, [&json!(vendor), &json!(product), &json!(revision), &json!(name)]);
    }
    for (name, state) in STATES {
        assert_eq!(
            report["states"][name],
            Value::from(vec![state; IDENTITIES.len()]),
            "{name}"
        );
    }
    assert_eq!(report["working_counter"], WORKING_COUNTER);
    // Every cycle has this counter, none another.
    assert_eq!(
        report["working_counters"],
        json!({ WORKING_COUNTER.to_string(): CYCLES })
    );
    // Nor have those that were needed until every motor had moved.
    assert_eq!(report["more_working_counters"], json!([WORKING_COUNTER]));
    assert_eq!(
        (&report["cycles_disabled"], &report["clocks"]),
        (&json!(0), &json!(true))
    );

    let (terminals, drives) = slaves.split_at(DRIVES_FROM);
    assert!(
        terminals.iter().all(|slave| slave["device_name"].is_null()),
        "{report:#}"
    );
    for (drive, name) in drives.iter().zip(DEVICE_NAMES) {
        assert_eq!(drive["device_name"], name);
        assert_eq!(drive["objects"][DEVICE_NAME], "Device name", "{drive:#}");
        let sync0 = json!({ "activation": SYNC0_ACTIVE, "cycle_ns": SYNC0_NS, "runs": true });
        assert_eq!(drive["sync0"], sync0, "{name}");
        let moved = drive["moved"].as_i64().expect("increments");
        assert!(moved > 0, "{name} moved by {moved} increments");
    }
    assert_eq!(slaves[EL1008]["inputs"], "00", "nothing is wired to the inputs");
    let digital = &slaves[EL2004]["digital"];
    assert!(digital["set"] != 0 && digital["held"] == digital["set"], "{digital}");
    assert_eq!(digital["fed"], true, "the watchdog of the outputs");
    println!("pysoem {}: {CYCLES} cycles, none wrong", report["pysoem"]);
}
