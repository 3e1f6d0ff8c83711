//! What may differ between recorded answers and those of the segment, and why.

use super::Part;
use std::collections::BTreeSet;
use std::ops::Range;

/// Why an answer may differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Reason {
    /// Another slave controller: type, revision and build.
    Controller,
    /// Another slave controller: size of its memory, kinds of ports, features.
    Features,
    /// Process interface: running, watchdog, detection of links.
    InterfaceStatus,
    /// Process interface: configured by the device's own memory.
    InterfaceSettings,
    /// Information memory: emulated by the processor, bytes of a read, bytes of an address.
    MemorySize,
    /// Information memory: a failed load, the command that runs, busy.
    MemoryStatus,
    /// Information memory: the bytes behind those of a read.
    MemoryData,
    /// Status of sync managers: mailboxes of that time.
    MailboxStatus,
    /// Times of that time.
    Times,
    /// Difference of a clock from the reference.
    TimeDifference,
    /// A mailbox was full at another time: that depends on when the device had something to say.
    MailboxFull,
    /// A state that the recorded slave reached a little later.
    StateLater,
    /// EoE: the device's own network.
    Network,
    /// Values of another dictionary.
    Values,
    /// Objects of another dictionary.
    Objects,
    /// Lists and names of another dictionary.
    Names,
    /// An abort with the bit of complete access.
    AbortOfComplete,
}

/// Bits that may differ from the recording.
struct Excuse {
    first: u16,
    last: u16,
    bits: u8,
    reason: Reason,
}

const fn excuse(first: u16, last: u16, bits: u8, reason: Reason) -> Excuse {
    Excuse {
        first,
        last,
        bits,
        reason,
    }
}

/// What may differ, register by register. Numbers of FMMUs and sync managers, links, station addresses, states, and offsets and
/// delays of clocks are not in it.
const EXCUSES: [Excuse; 10] = [
    excuse(0x0000, 0x0003, 0xFF, Reason::Controller),
    excuse(0x0006, 0x0009, 0xFF, Reason::Features),
    excuse(0x0110, 0x0110, 0x07, Reason::InterfaceStatus),
    excuse(0x0140, 0x0141, 0xFF, Reason::InterfaceSettings),
    excuse(0x0502, 0x0502, 0xF0, Reason::MemorySize),
    excuse(0x0503, 0x0503, 0x9F, Reason::MemoryStatus),
    excuse(0x050C, 0x050F, 0xFF, Reason::MemoryData),
    // Written, read, full, buffers in use.
    excuse(0x080D, 0x080D, 0xCF, Reason::MailboxStatus),
    excuse(0x0900, 0x091F, 0xFF, Reason::Times),
    excuse(0x092C, 0x092F, 0xFF, Reason::TimeDifference),
];

/// Why the data may differ from the recording, each reason once; `None` if they must not.
pub(super) fn data_excused(recorded: &Part, actual: &Part) -> Option<BTreeSet<Reason>> {
    if recorded.register >= MEMORY {
        return mail_excused(&recorded.data, &actual.data).map(|reason| [reason].into());
    }
    let mut reasons = BTreeSet::new();
    for (at, (was, is)) in (recorded.register..).zip(recorded.data.iter().zip(&actual.data)) {
        if was != is {
            let found = EXCUSES
                .iter()
                .find(|excuse| (excuse.first..=excuse.last).contains(&at) && (was ^ is) & !excuse.bits == 0)?;
            reasons.insert(found.reason);
        }
    }
    (!reasons.is_empty()).then_some(reasons)
}

/// Where a controller's memory begins.
const MEMORY: u16 = 0x1000;
/// Types of mail.
const EOE: u8 = 2;
const COE: u8 = 3;
/// CoE's services: an abort is a request.
const SDO_REQUEST: u8 = 2;
const SDO_RESPONSE: u8 = 3;
const SDO_INFORMATION: u8 = 8;
/// Operation of SDO information that reports an error.
const INFORMATION_ERROR: u8 = 7;
/// "No such object", "no such subindex".
const ABORTS: [[u8; 4]; 2] = [[0x00, 0x00, 0x02, 0x06], [0x11, 0x00, 0x09, 0x06]];

/// Why an answer in a mailbox may differ: the slave of the segment has another dictionary than the recorded one, so that
/// values, names and lists differ, and objects may be missing; what is answered has to be the same.
fn mail_excused(recorded: &[u8], actual: &[u8]) -> Option<Reason> {
    // Six bytes of header: the last holds type and counter.
    let [.., kind] = recorded.get(..6)? else { return None };
    if kind & 0x0F == EOE {
        return Some(Reason::Network);
    }
    // Behind it CoE's service, SDO command or operation, then index and subindex.
    let [recorded, actual] = [recorded.get(5..16)?, actual.get(5..16)?];
    let [.., service] = [recorded, actual].map(|mail| mail[2] >> 4);
    if kind & 0x0F != COE || recorded[0] != actual[0] {
        return None;
    }
    let same = |range: Range<usize>| recorded.get(range.clone()) == actual.get(range);
    match (recorded[2] >> 4, service) {
        (SDO_RESPONSE, SDO_RESPONSE) => same(4..7).then_some(Reason::Values),
        (SDO_REQUEST, SDO_REQUEST) if recorded[3] & actual[3] & 0x80 != 0 => {
            same(4..11).then_some(Reason::AbortOfComplete)
        }
        (SDO_RESPONSE, SDO_REQUEST) if actual[3] == 0x80 => {
            let aborted = same(4..7) && ABORTS.iter().any(|code| actual.get(7..11) == Some(code));
            aborted.then_some(Reason::Objects)
        }
        (SDO_INFORMATION, SDO_INFORMATION) if actual[3] == INFORMATION_ERROR => {
            let missing = actual.get(7..11) == Some(&ABORTS[0]);
            missing.then_some(Reason::Objects)
        }
        (SDO_INFORMATION, SDO_INFORMATION) => same(3..4).then_some(Reason::Names),
        _ => None,
    }
}

/// Why the working counter may differ.
pub(super) fn counter_excused(part: &Part) -> Option<Reason> {
    match part.register {
        MEMORY.. if matches!(part.command, 1 | 4) => Some(Reason::MailboxFull),
        _ => None,
    }
}
