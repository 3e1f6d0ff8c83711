//! What may differ between recorded answers and those of the segment, and why.

use super::Part;
use std::ops::Range;

/// Bits that may differ from the recording.
struct Excuse {
    first: u16,
    last: u16,
    bits: u8,
    reason: &'static str,
}

const fn excuse(first: u16, last: u16, bits: u8, reason: &'static str) -> Excuse {
    Excuse {
        first,
        last,
        bits,
        reason,
    }
}

const OTHER_CONTROLLER: &str = "silicon: another controller";
const OTHER_MEMORY: &str = "information memory: busy, its size, or that of a read";
const MAIL: &str = "status of sync managers: mailboxes of that time";
const TIMES: &str = "clocks of that time";

/// What may differ, register by register. Numbers of FMMUs and sync managers, links, station addresses, states, and offsets and
/// delays of clocks are not in it.
const EXCUSES: [Excuse; 10] = [
    excuse(0x0000, 0x0003, 0xFF, OTHER_CONTROLLER),
    excuse(0x0006, 0x0009, 0xFF, OTHER_CONTROLLER),
    excuse(
        0x0110,
        0x0110,
        0x07,
        "process interface: running, watchdog, detection of links",
    ),
    excuse(
        0x0140,
        0x0141,
        0xFF,
        "process interface: configured by the device's own memory",
    ),
    // Emulated by the processor, bytes of a read, bytes of an address; a failed load; the command that runs; busy.
    excuse(0x0502, 0x0502, 0xF0, OTHER_MEMORY),
    excuse(0x0503, 0x0503, 0x9F, OTHER_MEMORY),
    excuse(0x050C, 0x050F, 0xFF, OTHER_MEMORY),
    // Written, read, full, buffers in use.
    excuse(0x080D, 0x080D, 0xCF, MAIL),
    excuse(0x0900, 0x091F, 0xFF, TIMES),
    excuse(0x092C, 0x092F, 0xFF, TIMES),
];

/// Why the data may differ from the recording; `None` if they must not.
pub(super) fn data_excused(recorded: &Part, actual: &Part) -> Option<&'static str> {
    if recorded.register >= MEMORY {
        return mail_excused(&recorded.data, &actual.data);
    }
    let mut reason = None;
    for (at, (was, is)) in (recorded.register..).zip(recorded.data.iter().zip(&actual.data)) {
        if was != is {
            let found = EXCUSES
                .iter()
                .find(|excuse| (excuse.first..=excuse.last).contains(&at) && (was ^ is) & !excuse.bits == 0)?;
            reason = Some(found.reason);
        }
    }
    reason
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
fn mail_excused(recorded: &[u8], actual: &[u8]) -> Option<&'static str> {
    // Six bytes of header: the last holds type and counter.
    let [.., kind] = recorded.get(..6)? else { return None };
    if kind & 0x0F == EOE {
        return Some("EoE: the device's own network");
    }
    // Behind it CoE's service, SDO command or operation, then index and subindex.
    let [recorded, actual] = [recorded.get(5..16)?, actual.get(5..16)?];
    let [.., service] = [recorded, actual].map(|mail| mail[2] >> 4);
    if kind & 0x0F != COE || recorded[0] != actual[0] {
        return None;
    }
    let same = |range: Range<usize>| recorded.get(range.clone()) == actual.get(range);
    match (recorded[2] >> 4, service) {
        (SDO_RESPONSE, SDO_RESPONSE) => same(4..7).then_some("values of another dictionary"),
        (SDO_REQUEST, SDO_REQUEST) if recorded[3] & actual[3] & 0x80 != 0 => {
            same(4..11).then_some("an abort with the bit of complete access")
        }
        (SDO_RESPONSE, SDO_REQUEST) if actual[3] == 0x80 => {
            let aborted = same(4..7) && ABORTS.iter().any(|code| actual.get(7..11) == Some(code));
            aborted.then_some("objects of another dictionary")
        }
        (SDO_INFORMATION, SDO_INFORMATION) if actual[3] == INFORMATION_ERROR => {
            let missing = actual.get(7..11) == Some(&ABORTS[0]);
            missing.then_some("objects of another dictionary")
        }
        (SDO_INFORMATION, SDO_INFORMATION) => same(3..4).then_some("lists and names of another dictionary"),
        _ => None,
    }
}

/// Why the working counter may differ: whether a mailbox is full depends on when the device had something to say.
pub(super) fn counter_excused(part: &Part) -> Option<&'static str> {
    match part.register {
        MEMORY.. if matches!(part.command, 1 | 4) => Some("mailboxes were full at other times"),
        _ => None,
    }
}
