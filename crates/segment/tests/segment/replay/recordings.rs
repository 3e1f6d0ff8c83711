//! The recordings, and what their replay gives.

use super::Pace;
use super::excuses::Reason;
use etherpen_segment::SlaveKind;

/// What a replay gives, to the datagram: nothing in requests or segment is random.
#[derive(Debug)]
pub(super) struct Expected {
    pub(super) datagrams: usize,
    /// Datagrams with the recorded data.
    pub(super) same: usize,
    /// Datagrams that differ for a reason, in the order of the reasons.
    pub(super) excused: &'static [(Reason, usize)],
}

/// A real AKD, asked by SOEM for its dictionary.
pub(super) const AKD: Expected = Expected {
    datagrams: 3378,
    same: 3241,
    excused: &[
        (Reason::Controller, 1),
        (Reason::Features, 2),
        (Reason::InterfaceSettings, 1),
        (Reason::MemorySize, 53),
        (Reason::MailboxStatus, 46),
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
        begins_in: None,
        expected: Expected {
            datagrams: 2838,
            same: 1589,
            excused: &[
                (Reason::MemorySize, 355),
                (Reason::MemoryStatus, 478),
                (Reason::Times, 363),
                (Reason::TimeDifference, 1),
            ],
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
        begins_in: None,
        expected: Expected {
            datagrams: 650,
            same: 358,
            excused: &[
                (Reason::MemorySize, 81),
                (Reason::MemoryStatus, 154),
                (Reason::Times, 105),
            ],
        },
        explained: &[],
    },
    Recording {
        file: "soem-dual-lan9252.pcapng",
        pace: Pace::Recorded,
        slaves: &[Recorded::Read(LAN9252), Recorded::Read(LAN9252)],
        begins_in: None,
        expected: Expected {
            datagrams: 888,
            same: 188,
            excused: &[
                (Reason::Controller, 1),
                (Reason::Features, 2),
                (Reason::InterfaceStatus, 2),
                (Reason::MemorySize, 78),
                (Reason::MailboxStatus, 592),
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
        begins_in: None,
        expected: Expected {
            datagrams: 290,
            same: 242,
            excused: &[(Reason::MemorySize, 12), (Reason::MemoryStatus, 36), (Reason::Times, 4)],
        },
        explained: &[],
    },
    Recording {
        file: "soem-slaveinfo-sdo_vs_kickcat-k64f.pcapng",
        pace: Pace::Millisecond,
        slaves: &[Recorded::Read(0)],
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
        begins_in: None,
        expected: Expected {
            datagrams: 9305,
            same: 1143,
            excused: &[
                (Reason::Controller, 6),
                (Reason::Features, 4),
                (Reason::MemorySize, 4),
                (Reason::MemoryData, 3),
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
        begins_in: Some(2),
        expected: Expected {
            datagrams: 290,
            same: 290,
            excused: &[],
        },
        explained: &[],
    },
];
