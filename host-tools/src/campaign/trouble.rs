//! Random faults, in the words of the segment's script.

use super::chance::Chance;
use super::machine::Chain;

/// Longest duration of a fault that ends by itself, ms.
const LASTS_MAX_MS: u32 = 1_500;
/// Longest time for which a feedback is frozen, ms.
const STUCK_MAX_MS: u32 = 12_000;
/// Longest time that a drive's processor takes after power-up, for a change of its state and for an answer, ms.
const BOOT_MAX_MS: u32 = 10_000;
const TRANSITION_MAX_MS: u32 = 3_000;
const ANSWER_MAX_MS: u32 = 200;
/// AL status codes that slaves give with a fall or a refusal.
const CODES: [u16; 5] = [0, 0x001A, 0x001B, 0x002C, 0xFFFF];

/// A fault of a frame.
pub(super) fn of_frames(chance: &mut Chance) -> String {
    match chance.below(14) {
        0 => "drop".into(),
        1 => "lose".into(),
        2 => format!("delay {}", 1 + chance.below(4)),
        3 => "duplicate".into(),
        4 => format!("truncate {}", chance.below(80)),
        5 => format!("overlong {}", 1 + chance.below(60)),
        6 => format!("index {}", 1 + chance.below(200)),
        7 => format!("counter {}", chance.one_of(&[-2, -1, 1, 2, 200])),
        // Type 1 is that of every sound reply.
        8 => format!("type {}", (2 + chance.below(15)) % 16),
        9 => "more".into(),
        10 => "circulate".into(),
        11 => "vlan".into(),
        12 => "foreign".into(),
        _ => "reflect".into(),
    }
}

/// A fault of the chain or of a slave.
pub(super) fn of_the_bus(chance: &mut Chance, chain: &Chain) -> String {
    let number = chance.below(chain.slaves as u64);
    let slave = 1 + number;
    let drive = chain.drive(number);
    let lasts_ms = chance.milliseconds(LASTS_MAX_MS);
    let code = chance.one_of(&CODES);
    match chance.below(16) {
        0 => format!("stall {lasts_ms}"),
        1 => format!("cut {}", slave - 1),
        2 => "join".into(),
        3 => format!("crc {} {}", slave - 1, 1 + chance.below(100)),
        4 => format!("remove {slave}"),
        5 => format!("insert {slave}"),
        6 => format!("swap {drive} {}", chance.one_of(&["ax2000", "cia402"])),
        7 => format!("power {slave} {lasts_ms}"),
        8 => format!("retreat {slave} {code}"),
        9 => format!("fall {slave} {} {code}", chance.one_of(&["init", "preop", "safeop"])),
        10 => format!("refuse {slave} {} {code}", chance.one_of(&["preop", "safeop", "op"])),
        11 => format!("pdi {slave} {lasts_ms}"),
        12 => format!(
            "sii {slave} {}",
            chance.one_of(&["busy", "refused", "blank", "damaged", "owned", "whole"])
        ),
        13 => of_a_processor(chance, drive),
        14 => of_files(chance, drive),
        _ => of_a_mailbox(chance, drive, lasts_ms),
    }
}

/// A slave's processor that is slow from now on, or has other manners.
fn of_a_processor(chance: &mut Chance, slave: u64) -> String {
    match chance.below(6) {
        0 | 1 => format!("processor {slave} boot {}", chance.milliseconds(BOOT_MAX_MS)),
        2 => format!(
            "processor {slave} transition {}",
            chance.milliseconds(TRANSITION_MAX_MS)
        ),
        3 => format!("processor {slave} mailbox {}", chance.milliseconds(ANSWER_MAX_MS)),
        4 => format!("processor {slave} sii {}", chance.one_of(&["needed", "free"])),
        _ => format!("processor {slave} repeat {}", chance.one_of(&["known", "ignored"])),
    }
}

/// A file server of a slave that is busy, refuses, numbers its packets wrongly or is silent.
fn of_files(chance: &mut Chance, slave: u64) -> String {
    match chance.below(4) {
        0 => format!("foe {slave} busy {}", 1 + chance.below(20)),
        1 => format!("foe {slave} error {:#x}", 0x8000 + chance.below(16)),
        2 => format!("foe {slave} packet"),
        _ => format!("foe {slave} silent {}", 1 + chance.below(4)),
    }
}

/// A fault of a terminal, or of the outputs on the way to all slaves. A chain without terminals counts as one with a coupler
/// and two of them behind its drives.
pub(super) fn of_a_terminal(chance: &mut Chance, chain: &Chain) -> String {
    let slave = match chain.terminals.as_slice() {
        [] => chain.slaves as u64 + 2 + chance.below(2),
        terminals => chance.one_of(terminals) as u64,
    };
    let lasts_ms = chance.milliseconds(LASTS_MAX_MS);
    let code = chance.one_of(&CODES);
    match chance.below(8) {
        0 => format!("remove {slave}"),
        1 => format!("insert {slave}"),
        2 => format!("power {slave} {lasts_ms}"),
        3 => format!("fall {slave} {} {code}", chance.one_of(&["init", "preop", "safeop"])),
        4 => format!("crc {} {}", slave - 1, 1 + chance.below(100)),
        5 => format!("cut {}", slave - 1),
        6 => format!("deaf {slave} {lasts_ms}"),
        _ => format!("mute {lasts_ms}"),
    }
}

/// A fault of the cables of the second and the third drive, of the first two where there are no more, of their supply, or of
/// the outputs on the way to them.
pub(super) fn of_exchanged_cables(chance: &mut Chance, chain: &Chain) -> String {
    let first = u64::from(chain.drives.len() > 2);
    let [one, other] = [first, first + 1].map(|number| chain.drive(number));
    let slave = [one, other][chance.below(2) as usize];
    let lasts_ms = chance.milliseconds(LASTS_MAX_MS);
    match chance.below(8) {
        0 | 1 => format!("recable {one} {other}"),
        2 | 3 => format!("power {slave} {lasts_ms}"),
        4 => format!("cut {}", slave - 1),
        5 => "join".into(),
        6 => format!("deaf {slave} {lasts_ms}"),
        _ => format!("mute {lasts_ms}"),
    }
}

impl Chain {
    /// A drive by its number, from 0; numbers behind the last one begin anew.
    fn drive(&self, number: u64) -> u64 {
        let index = number % (self.drives.len() as u64).max(1);
        self.drives.get(index as usize).map_or(1, |slave| *slave as u64)
    }
}

/// The words that end a fault which does not end by itself.
pub(super) fn end(words: &str) -> Option<String> {
    let mut parts = words.split(' ');
    match (parts.next()?, parts.next()?) {
        ("sii", slave) => Some(format!("sii {slave} whole")),
        ("remove", slave) => Some(format!("insert {slave}")),
        ("swap", slave) => Some(format!("swap {slave} ax2000")),
        ("slip" | "reverse" | "jump", slave) => Some(format!("stuck {slave} 0")),
        ("cut", _) => Some("join".to_owned()),
        ("recable", _) => Some(words.to_owned()),
        _ => None,
    }
}

/// The words that end a fault which does not end by itself, for one in two of those that leave the robot where it was.
pub(super) fn end_of(chance: &mut Chance, words: &str) -> Option<String> {
    let end = end(words).filter(|end| !end.starts_with("swap") && !end.starts_with("stuck"));
    end.filter(|_| chance.one_in(2))
}

fn of_a_mailbox(chance: &mut Chance, slave: u64, lasts_ms: u32) -> String {
    let request = 1 + chance.below(12);
    match chance.below(6) {
        0 => format!("silence {slave} {lasts_ms}"),
        1 => format!("mailbox {slave} {request} abort 0x08000020"),
        2 => format!("mailbox {slave} {request} silent"),
        3 => format!("mailbox {slave} {request} lost"),
        4 => format!("mailbox {slave} {request} counter"),
        _ => format!("mailbox {slave} {request} flood 6"),
    }
}

/// A fault of a drive or of its position feedback.
pub(super) fn of_a_drive(chance: &mut Chance, chain: &Chain) -> String {
    let number = chance.below(chain.drives.len() as u64);
    let slave = chain.drive(number);
    let lasts_ms = chance.milliseconds(LASTS_MAX_MS);
    match chance.below(9) {
        0 => format!("fault {slave} 0x2310"),
        1 => format!("mains {slave} {lasts_ms}"),
        2 => format!("stuck {slave} {}", chance.milliseconds(STUCK_MAX_MS)),
        3 => format!("stuck {slave} {lasts_ms}"),
        4 => format!("slip {slave} {} {lasts_ms}", chance.below(100)),
        5 => {
            let increments = chance.scaled(1.0, 600_000.0) as i64;
            format!("jump {slave} {}", increments * chance.one_of(&[-1, 1]))
        }
        6 => format!("reverse {slave} {lasts_ms}"),
        7 => format!("noise {slave} {} {lasts_ms}", chance.scaled(1.0, 100_000.0) as u32),
        _ => format!("exchange {slave} {} {lasts_ms}", chain.drive(number + 1)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::machine::Machine;
    use crate::cell::Script;
    use crate::settings::machines::MACHINES;

    #[test]
    fn all_words_are_those_of_the_script() {
        for machine in MACHINES {
            let chain = &Machine::load(machine.name).expect("a bundled machine").chain;
            let mut chance = Chance::new(1);
            for _ in 0..1_000 {
                for words in [
                    of_frames(&mut chance),
                    of_the_bus(&mut chance, chain),
                    of_a_drive(&mut chance, chain),
                    of_a_terminal(&mut chance, chain),
                    of_exchanged_cables(&mut chance, chain),
                ] {
                    let script: Script = format!("ms 1 {words}")
                        .parse()
                        .unwrap_or_else(|cause| panic!("{words}: {cause}"));
                    let slaves = chain.slaves + if chain.terminals.is_empty() { 3 } else { 0 };
                    script.check(slaves).unwrap_or_else(|cause| panic!("{words}: {cause}"));
                }
            }
        }
    }
}
