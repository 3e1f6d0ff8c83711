//! Which code is mutated, and which tests and campaign judge its mutants.

/// Code with its judges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    /// Files and folders, from the root of the sources.
    pub sources: &'static [&'static str],
    /// Why an error there is dangerous.
    pub reason: &'static str,
    /// Tests, the quickest first.
    pub suites: &'static [Suite],
    /// Profile of the campaign whose faults reach this code most often.
    pub profile: &'static str,
}

/// The tests of one program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Suite {
    /// Folder of the package, from the root of the sources; empty for the firmware's.
    pub package: &'static str,
    /// Name of the integration test; empty for the tests inside the library.
    pub target: &'static str,
}

impl std::fmt::Display for Suite {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.package, self.target) {
            ("", "") => write!(f, "src"),
            ("", target) => write!(f, "tests/{target}"),
            (package, "") => write!(f, "{package}"),
            (package, target) => write!(f, "{package}/tests/{target}"),
        }
    }
}

const fn library(package: &'static str) -> Suite {
    Suite { package, target: "" }
}

const fn integration(package: &'static str, target: &'static str) -> Suite {
    Suite { package, target }
}

/// Tests of the firmware's library and of its closed loop.
const FIRMWARE: &[Suite] = &[
    library(""),
    integration("", "clocks"),
    integration("", "drives"),
    integration("", "ethercat"),
    integration("", "reactions"),
];
/// Tests of the EtherCAT master, alone and with the virtual segment.
const MASTER: &[Suite] = &[
    library("crates/ethercat"),
    integration("crates/ethercat", "wire"),
    integration("crates/drives", "master"),
    integration("", "ethercat"),
    integration("", "reactions"),
];
/// Tests of the planner, in whole drawings and alone.
const PLANNER: &[Suite] = &[
    integration("", "robots"),
    integration("", "simulated_drawing"),
    library("crates/motion"),
];

/// All mutated code. What only diagnoses, prints or describes (the object dictionary, names of a slave, cables for
/// display) and the drivers of the boards are left out.
pub(crate) const PARTS: &[Part] = &[
    Part {
        sources: &["src/application"],
        reason: "decides when drives have power and when the robot may move; latches faults",
        suites: FIRMWARE,
        profile: "operator",
    },
    Part {
        sources: &["src/control"],
        reason: "the 1 ms loop: commands to the drives, supervision, plausibility of the feedback",
        suites: FIRMWARE,
        profile: "drives",
    },
    Part {
        sources: &["src/config"],
        reason: "bounds of every number that the other parts rely on",
        suites: FIRMWARE,
        profile: "all",
    },
    Part {
        sources: &["src/coordinator"],
        reason: "admits what the host orders, and tells the host what happened",
        suites: FIRMWARE,
        profile: "operator",
    },
    Part {
        sources: &["src/network"],
        reason: "without addresses no telegram leaves; foreign frames share the wire",
        suites: FIRMWARE,
        profile: "bus",
    },
    Part {
        sources: &[
            "crates/drives/src/akd.rs",
            "crates/drives/src/configuration.rs",
            "crates/drives/src/ethercat_group.rs",
            "crates/drives/src/factory.rs",
            "crates/drives/src/generic.rs",
            "crates/drives/src/homing.rs",
            "crates/drives/src/layout.rs",
            "crates/drives/src/lib.rs",
            "crates/drives/src/position_range.rs",
            "crates/drives/src/probe.rs",
            "crates/drives/src/servo_axis.rs",
        ],
        reason: "control words, scaling and the drives' state machine",
        suites: &[
            library("crates/drives"),
            integration("crates/drives", "master"),
            library(""),
            integration("", "drives"),
            integration("", "ethercat"),
            integration("", "reactions"),
        ],
        profile: "drives",
    },
    Part {
        sources: &[
            "crates/ethercat/src/acyclic.rs",
            "crates/ethercat/src/clock",
            "crates/ethercat/src/coe.rs",
            "crates/ethercat/src/configure",
            "crates/ethercat/src/cyclic",
            "crates/ethercat/src/cyclic.rs",
            "crates/ethercat/src/encapsulation.rs",
            "crates/ethercat/src/foe.rs",
            "crates/ethercat/src/frame_port.rs",
            "crates/ethercat/src/mailbox.rs",
            "crates/ethercat/src/place.rs",
            "crates/ethercat/src/plan.rs",
            "crates/ethercat/src/process_data.rs",
            "crates/ethercat/src/queue.rs",
            "crates/ethercat/src/state.rs",
            "crates/ethercat/src/supervisor",
            "crates/ethercat/src/telegram",
            "crates/ethercat/src/telegram.rs",
            "crates/ethercat/src/topology.rs",
            "crates/ethercat/src/wire/datagram.rs",
            "crates/ethercat/src/wire/frame.rs",
            "crates/ethercat/src/wire/udp.rs",
        ],
        reason: "which frames count, the drives' clock, bring-up, watchdogs and repair",
        suites: MASTER,
        profile: "bus",
    },
    Part {
        sources: &["crates/motion/src"],
        reason: "limits of speed, acceleration and area; a plan that ends at rest",
        suites: PLANNER,
        profile: "all",
    },
];

/// The part that a file belongs to.
#[must_use]
pub(crate) fn part_of(file: &str) -> Option<&'static Part> {
    let holds = |source: &str| {
        file.strip_prefix(source)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
    };
    PARTS
        .iter()
        .find(|part| part.sources.iter().any(|source| holds(source)))
}
