//! The recordings, and what their replay gives.

use super::Pace;
use super::excuses::Reason;
use etherpen_segment::{ControllerType, SlaveKind};

/// What a replay gives, to the datagram: nothing in requests or segment is random.
#[derive(Debug)]
pub(super) struct Expected {
    pub(super) datagrams: usize,
    /// Datagrams with the recorded data.
    pub(super) same: usize,
    /// Datagrams that differ for a reason, in the order of the reasons.
    pub(super) excused: &'static [(Reason, usize)],
}

/// How fast recorded slaves are: the times with the fewest differences.
#[derive(Clone, Copy, Debug)]
pub(super) struct Speed {
    /// Time in which their processors answer a message, ms.
    pub(super) mailbox_ms: u64,
    /// Time in which their information memories answer, us.
    pub(super) memory_us: u64,
}

impl Speed {
    /// Slaves that are simulated.
    pub(super) const SIMULATED: Self = Self {
        mailbox_ms: 0,
        memory_us: 10,
    };
    /// An AKD, whose processor emulates the information memory.
    pub(super) const AKD: Self = Self {
        mailbox_ms: 1,
        memory_us: 10,
    };
    /// A coupler with terminals.
    const TERMINALS: Self = Self {
        mailbox_ms: 0,
        memory_us: 700,
    };
}

/// A real AKD, asked by SOEM for its dictionary.
pub(super) const AKD: Expected = Expected {
    datagrams: 3378,
    same: 3320,
    excused: &[
        (Reason::InterfaceSettings, 1),
        (Reason::MemoryStatus, 7),
        (Reason::MailboxStatus, 16),
        (Reason::Times, 3),
        (Reason::StateLater, 3),
        (Reason::Values, 16),
        (Reason::Objects, 12),
    ],
};

/// Four simulated drives, asked by SOEM.
pub(super) const FOUR_DRIVES: Expected = Expected {
    datagrams: 786,
    same: 340,
    excused: &[
        (Reason::Controller, 1),
        (Reason::InterfaceSettings, 4),
        (Reason::MemorySize, 108),
        (Reason::MemoryStatus, 108),
        (Reason::MailboxStatus, 219),
        (Reason::Times, 20),
        (Reason::Values, 30),
        (Reason::Objects, 60),
        (Reason::AbortOfComplete, 4),
    ],
};

/// A slave of a recording.
pub(super) enum Recorded {
    /// A kind that the segment has.
    Kind(SlaveKind),
    /// The dump of its information memory.
    Dump(&'static str),
    /// The content of its information memory that the recorded master read, behind this first word.
    Read(u16),
}

/// A recording.
pub(super) struct Recording {
    pub(super) file: &'static str,
    pub(super) pace: Pace,
    pub(super) slaves: &'static [Recorded],
    /// Type of the controllers, if the information memories do not suggest it.
    pub(super) controller: Option<ControllerType>,
    pub(super) speed: Speed,
    /// State in which the recording begins, if it begins with slaves that have station addresses.
    pub(super) begins_in: Option<u8>,
    pub(super) expected: Expected,
    /// Differences that are expected besides those.
    pub(super) explained: &'static [Explained],
}

/// Differences of one register that have a reason.
pub(super) struct Explained {
    pub(super) register: u16,
    pub(super) differences: usize,
    pub(super) reason: &'static str,
}

/// Word 0 of a terminal with device emulation, alone and with powered clock units.
const TERMINAL: u16 = 0x0104;
const TERMINAL_WITH_CLOCK: u16 = 0x0D04;
/// Word 0 of a LAN9252 with a processor, as its registers 0x0140 and 0x0141 show it.
const LAN9252: u16 = 0x0E89;

pub(super) const RECORDINGS: [Recording; 7] = [
    Recording {
        file: "replay-dc.pcapng",
        pace: Pace::Recorded,
        slaves: &[
            Recorded::Dump("ek1100.hex"),
            Recorded::Dump("el2828.hex"),
            Recorded::Read(TERMINAL_WITH_CLOCK),
        ],
        controller: None,
        speed: Speed::TERMINALS,
        begins_in: None,
        expected: Expected {
            datagrams: 2838,
            same: 2217,
            excused: &[(Reason::Times, 363), (Reason::TimeDifference, 1)],
        },
        explained: &[],
    },
    Recording {
        file: "replay-ek1100-alias-address.pcapng",
        pace: Pace::Recorded,
        slaves: &[
            Recorded::Dump("ek1100.hex"),
            Recorded::Dump("el2828.hex"),
            Recorded::Read(TERMINAL_WITH_CLOCK),
        ],
        controller: None,
        speed: Speed::TERMINALS,
        begins_in: None,
        expected: Expected {
            datagrams: 650,
            same: 543,
            excused: &[(Reason::MemoryStatus, 2), (Reason::Times, 105)],
        },
        explained: &[],
    },
    Recording {
        file: "soem-dual-lan9252.pcapng",
        pace: Pace::Recorded,
        slaves: &[Recorded::Read(LAN9252), Recorded::Read(LAN9252)],
        controller: Some(ControllerType::Lan9252),
        speed: Speed {
            mailbox_ms: 36,
            memory_us: 300,
        },
        begins_in: None,
        expected: Expected {
            datagrams: 888,
            same: 762,
            excused: &[
                (Reason::InterfaceStatus, 2),
                (Reason::MailboxStatus, 99),
                (Reason::Times, 8),
                (Reason::StateLater, 5),
                (Reason::Values, 6),
                (Reason::Objects, 6),
            ],
        },
        explained: &[],
    },
    Recording {
        file: "soem-sdinfo-ek1100-el1004.pcapng",
        pace: Pace::Recorded,
        slaves: &[Recorded::Dump("ek1100.hex"), Recorded::Read(TERMINAL)],
        controller: None,
        speed: Speed {
            memory_us: 500,
            ..Speed::TERMINALS
        },
        begins_in: None,
        expected: Expected {
            datagrams: 290,
            same: 273,
            excused: &[(Reason::MemorySize, 12), (Reason::MemoryStatus, 1), (Reason::Times, 4)],
        },
        explained: &[],
    },
    Recording {
        file: "soem-slaveinfo-sdo_vs_kickcat-k64f.pcapng",
        pace: Pace::Millisecond,
        slaves: &[Recorded::Read(0)],
        controller: None,
        speed: Speed::SIMULATED,
        begins_in: None,
        expected: Expected {
            datagrams: 541,
            same: 200,
            excused: &[
                (Reason::Controller, 1),
                (Reason::InterfaceStatus, 1),
                (Reason::InterfaceSettings, 1),
                (Reason::MemorySize, 63),
                (Reason::MailboxStatus, 185),
                (Reason::Times, 5),
                (Reason::Values, 13),
                (Reason::Objects, 51),
                (Reason::Names, 19),
            ],
        },
        explained: &[Explained {
            register: 0x0130,
            differences: 2,
            reason: "a simulated slave that goes to SAFEOP although the sync manager of its inputs is off",
        }],
    },
    Recording {
        file: "twincat-akd-nc-mode.pcapng",
        pace: Pace::Recorded,
        slaves: &[Recorded::Dump("akd.hex")],
        controller: Some(ControllerType::Akd),
        speed: Speed::AKD,
        begins_in: None,
        expected: Expected {
            datagrams: 9305,
            same: 1153,
            excused: &[
                (Reason::Times, 8122),
                (Reason::MailboxFull, 7),
                (Reason::StateLater, 14),
                (Reason::Network, 9),
            ],
        },
        explained: &[],
    },
    Recording {
        file: "twincat-run-ek1100-el1004.pcapng",
        pace: Pace::Recorded,
        slaves: &[Recorded::Dump("ek1100.hex"), Recorded::Kind(SlaveKind::El1004)],
        controller: None,
        speed: Speed::TERMINALS,
        begins_in: Some(2),
        expected: Expected {
            datagrams: 290,
            same: 290,
            excused: &[],
        },
        explained: &[],
    },
];
