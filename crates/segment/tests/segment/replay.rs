//! Recorded traffic of third-party masters and slaves, replayed as requests against the segment.
//!
//! Every request of a capture passes the segment at its recorded time, or one a millisecond where the recorded slaves were
//! simulated and answered at once; what comes back is compared with what the recorded slaves answered: the working counter of every datagram, and the data of registers that both define.

use etherpen_ethercat::wire::sii::checksum;
use etherpen_segment::rig::{APWR, BWR, frame_of};
use etherpen_segment::{ControllerType, Flywheel, PlaceOptions, Segment, SegmentOptions, SlaveKind};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write as _;
use std::path::Path;

mod excuses;
mod recordings;
use excuses::{Reason, counter_excused, data_excused};
use recordings::{AKD, Expected, FOUR_DRIVES, RECORDINGS, Recorded, Recording, Speed};

/// Bit of the first byte of a source address that the first slave controller sets.
const SOURCE_MARK: u8 = 0x02;
/// Most exchanges that a recorded slave may take for a change of state.
const CHANGE_EXCHANGES_MAX: usize = 20;

/// One datagram of a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Part {
    command: u8,
    device: u16,
    register: u16,
    data: Vec<u8>,
    counter: u16,
}

/// Longest pause between two requests that is replayed as it was, ns: nothing in the segment takes longer.
const PAUSE_MAX_NS: u64 = 1_000_000_000;
/// Pause between two requests with one time, ns: some drivers stamp the frames of several milliseconds together.
const TOGETHER_NS: u64 = 1_000_000;
/// When a replay begins, ns.
const BEGINNING_NS: u64 = 5_000_000;
/// Option of an interface: units of its times, as a negative power of ten.
const OPTION_RESOLUTION: u16 = 9;

/// Nanoseconds of a unit of the times of an interface; microseconds unless its options say otherwise.
fn unit_ns(mut options: &[u8]) -> u64 {
    while let [kind_low, kind_high, length_low, length_high, rest @ ..] = options {
        let length = usize::from(u16::from_le_bytes([*length_low, *length_high]));
        if u16::from_le_bytes([*kind_low, *kind_high]) == OPTION_RESOLUTION {
            let digits = u32::from(*rest.first().expect("a resolution"));
            assert!(digits <= 9, "units of 10^-{digits} s");
            return 10_u64.pow(9 - digits);
        }
        options = rest.get(length.next_multiple_of(4)..).unwrap_or(&[]);
    }
    1_000
}

/// The packets of a pcapng file with one interface and their times, ns, in order.
fn packets(file: &[u8]) -> Vec<(u64, Vec<u8>)> {
    let word = |at: usize| {
        file.get(at..)
            .and_then(|rest| rest.first_chunk())
            .map_or(0, |bytes| u32::from_le_bytes(*bytes))
    };
    assert_eq!((word(0), word(8)), (0x0A0D_0D0A, 0x1A2B_3C4D), "pcapng, little-endian");
    let (mut at, mut found, mut unit) = (0, Vec::new(), 1_000);
    while at + 12 <= file.len() {
        let length = word(at + 4) as usize;
        assert!(length >= 12 && at + length <= file.len(), "block at {at}");
        if word(at) == 1 {
            unit = unit_ns(&file[at + 16..at + length - 4]);
        }
        if word(at) == 6 {
            let bytes = word(at + 20) as usize;
            let time = u64::from(word(at + 12)) << 32 | u64::from(word(at + 16));
            found.push((time.wrapping_mul(unit), file[at + 28..at + 28 + bytes].to_vec()));
        }
        at += length;
    }
    found
}

fn parts(frame: &[u8]) -> Vec<Part> {
    let mut found = Vec::new();
    let (mut at, mut more) = (16, true);
    while more && at + 12 <= frame.len() {
        let short = |at: usize| u16::from_le_bytes([frame[at], frame[at + 1]]);
        let length = usize::from(short(at + 6) & 0x07FF);
        more = short(at + 6) & 0x8000 != 0;
        let end = at + 10 + length;
        if end + 2 > frame.len() {
            break;
        }
        found.push(Part {
            command: frame[at],
            device: short(at + 2),
            register: short(at + 4),
            data: frame[at + 10..end].to_vec(),
            counter: short(end),
        });
        at = end + 2;
    }
    found
}

/// A request and the reply to it.
struct Exchanged {
    /// Time since the first request, ns; a pause is at most [`PAUSE_MAX_NS`], and [`TOGETHER_NS`] where none was recorded.
    time_ns: u64,
    request: Vec<u8>,
    reply: Vec<u8>,
}

/// Requests and the replies to them. Replies of silicon carry a mark in their source address; in a recording without
/// marks the second frame with an index is the reply to the first.
fn exchanges(file: &[u8]) -> Vec<Exchanged> {
    let (mut open, mut found) = (BTreeMap::new(), Vec::<Exchanged>::new());
    let packets = packets(file);
    let is_marked = |packet: &Vec<u8>| packet.get(6).is_some_and(|byte| byte & SOURCE_MARK != 0);
    let marked = packets.iter().any(|(_, packet)| is_marked(packet));
    let mut before_ns = packets.first().map_or(0, |(time_ns, _)| *time_ns);
    for (sent_ns, packet) in packets {
        if packet.get(12..14) != Some(&[0x88, 0xA4]) || packet.len() < 28 {
            continue;
        }
        let index = packet[17];
        let is_reply = if marked {
            is_marked(&packet)
        } else {
            open.contains_key(&index)
        };
        match open.remove(&index).filter(|_| is_reply) {
            Some((asked_ns, request)) => {
                let pause_ns = match u64::saturating_sub(asked_ns, before_ns) {
                    0 => TOGETHER_NS,
                    pause_ns => pause_ns.min(PAUSE_MAX_NS),
                };
                before_ns = asked_ns.max(before_ns);
                found.push(Exchanged {
                    time_ns: found.last().map_or(0, |last| last.time_ns) + pause_ns,
                    request,
                    reply: packet,
                });
            }
            None if is_reply => {}
            None => drop(open.insert(index, (sent_ns, packet))),
        }
    }
    found
}

/// Places of the station addresses that a recording assigns, or uses without having assigned any.
fn recorded_stations(exchanges: &[Exchanged]) -> BTreeMap<u16, usize> {
    let asked = || exchanges.iter().flat_map(|exchange| parts(&exchange.request));
    let assigned = asked().filter(|part| part.command == 2 && part.register == 0x0010 && part.data.len() >= 2);
    let station = |part: &Part| u16::from_le_bytes([part.data[0], part.data[1]]);
    let assigned: BTreeMap<_, _> = assigned
        .map(|part| (station(&part), usize::from(0u16.wrapping_sub(part.device))))
        .collect();
    if !assigned.is_empty() {
        return assigned;
    }
    let used: BTreeSet<_> = asked()
        .filter(|part| matches!(part.command, 4 | 5))
        .map(|part| part.device)
        .collect();
    used.into_iter().zip(0..).collect()
}

/// Content of the information memories that a recording reads, by position or station address.
fn recorded_images(exchanges: &[Exchanged], slaves: usize) -> Vec<Vec<u8>> {
    let stations = recorded_stations(exchanges);
    let mut images = vec![vec![0xFF; 4096]; slaves];
    let mut addresses = vec![0usize; slaves];
    for exchange in exchanges {
        for (asked, answered) in parts(&exchange.request).iter().zip(parts(&exchange.reply)) {
            let slave = match asked.command {
                1 | 2 => Some(usize::from(0u16.wrapping_sub(asked.device))),
                4 | 5 => stations.get(&asked.device).copied(),
                _ => continue,
            };
            let Some(slave) = slave.filter(|slave| *slave < images.len()) else {
                continue;
            };
            if matches!(asked.command, 2 | 5) && asked.register == 0x0502 && asked.data.len() >= 4 {
                addresses[slave] = 2 * usize::from(u16::from_le_bytes([asked.data[2], asked.data[3]]));
            }
            // What was read from the status on holds the content behind six bytes.
            let content = match (asked.command, asked.register) {
                (1 | 4, 0x0508) => &answered.data[..],
                (1 | 4, 0x0502) => answered.data.get(6..).unwrap_or(&[]),
                _ => continue,
            };
            if answered.counter == 1 {
                let at = addresses[slave];
                for (target, byte) in images[slave].iter_mut().skip(at).zip(content) {
                    *target = *byte;
                }
            }
        }
    }
    images
}

struct Outcome {
    datagrams: usize,
    data_compared: usize,
    /// Differences that count, as text.
    differences: Vec<String>,
    /// Datagrams that differ for a reason. One that differs for two counts for both.
    excused: BTreeMap<Reason, usize>,
}

impl Outcome {
    /// Counts a datagram that differs for these reasons.
    fn excuse(&mut self, reasons: BTreeSet<Reason>) {
        for reason in reasons {
            *self.excused.entry(reason).or_default() += 1;
        }
    }

    /// What is not as expected: a difference without a reason, or more or fewer with one.
    fn unexpected(&self, expected: &Expected, file: &str) -> Vec<String> {
        let mut found = self.differences.clone();
        let excused: Vec<_> = self.excused.iter().map(|(reason, count)| (*reason, *count)).collect();
        let is = (self.datagrams, self.data_compared, &excused[..]);
        if is != (expected.datagrams, expected.same, expected.excused) {
            found.push(format!("{file}: {is:?}, expected {expected:?}"));
        }
        found
    }
}

/// Slaves with these information memories.
fn of_images(images: Vec<Vec<u8>>) -> Vec<SlaveKind> {
    images.into_iter().map(|image| SlaveKind::Sii(image.into())).collect()
}

/// A segment of these slaves, the ones from files on this type of controller, as fast as the recorded ones.
fn segment_of(slaves: Vec<SlaveKind>, controller: Option<ControllerType>, speed: Speed) -> Segment<Flywheel> {
    let mut place = PlaceOptions {
        controller,
        ..PlaceOptions::default()
    };
    place.processor.mailbox_ms = speed.mailbox_ms;
    let options = SegmentOptions {
        places: vec![place; slaves.len()],
        slaves,
        sii_busy_us: speed.memory_us,
        ..SegmentOptions::default()
    };
    Segment::new(&options, Flywheel::default())
}

/// Brings a segment to where a recording begins: station addresses, and a state of all slaves.
fn begin(segment: &mut Segment<Flywheel>, stations: &BTreeMap<u16, usize>, state: u8) {
    for (station, place) in stations {
        let position = 0u16.wrapping_sub(*place as u16);
        segment.frame(1_000, &frame_of(&[(APWR, position, 0x0010, &station.to_le_bytes())]));
    }
    segment.frame(2_000, &frame_of(&[(BWR, 0, 0x0120, &[state, 0])]));
}

/// When the requests of a recording pass the segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pace {
    /// As they were recorded: what a slave sends by itself comes where it came there.
    Recorded,
    /// One a millisecond: the processor of a slave of the segment runs once a millisecond.
    Millisecond,
}

impl Pace {
    /// The time of an exchange, ns.
    fn time_ns(self, number: usize, exchange: &Exchanged) -> u64 {
        BEGINNING_NS
            + match self {
                Self::Recorded => exchange.time_ns,
                Self::Millisecond => number as u64 * 1_000_000,
            }
    }
}

/// Replays a recording against a segment.
fn replay(exchanges: &[Exchanged], segment: &mut Segment<Flywheel>, pace: Pace) -> Outcome {
    let mut outcome = Outcome {
        datagrams: 0,
        data_compared: 0,
        differences: Vec::new(),
        excused: BTreeMap::new(),
    };
    for (number, exchange) in exchanges.iter().enumerate() {
        let later = exchanges.iter().skip(number).take(CHANGE_EXCHANGES_MAX);
        let later: Vec<Part> = later.flat_map(|exchange| parts(&exchange.reply)).collect();
        let replies = segment.frame_at_ns(pace.time_ns(number, exchange), &exchange.request);
        assert_eq!(replies.len(), 1, "exchange {number}");
        let [recorded, actual] = [&exchange.reply, &replies[0]].map(|reply| parts(reply));
        assert_eq!(recorded.len(), actual.len(), "exchange {number}");
        for (recorded, actual) in recorded.iter().zip(actual) {
            outcome.datagrams += 1;
            if recorded.counter != actual.counter {
                match counter_excused(recorded) {
                    Some(reason) => outcome.excuse([reason].into()),
                    None => outcome.differences.push(format!(
                        "exchange {number}: command {} register {:#06x}: working counter {} recorded, {} here",
                        recorded.command, recorded.register, recorded.counter, actual.counter
                    )),
                }
                continue;
            }
            if recorded.command == 12 || recorded.command == 10 {
                continue;
            }
            if recorded.data == actual.data {
                outcome.data_compared += 1;
                continue;
            }
            // A state comes later in the recording, or is read by another command there.
            let is_state = |part: &Part| part.register == 0x0130 && part.data.first() == actual.data.first();
            let comes = recorded.register == 0x0130 && later.iter().any(is_state);
            let later = comes.then(|| [Reason::StateLater].into());
            match data_excused(recorded, &actual).or(later) {
                Some(reasons) => outcome.excuse(reasons),
                None => outcome.differences.push(format!(
                    "exchange {number}: command {} register {:#06x}: data {:02x?} recorded, {:02x?} here",
                    recorded.command, recorded.register, recorded.data, actual.data
                )),
            }
        }
    }
    println!(
        "{} datagrams, {} with the recorded data",
        outcome.datagrams, outcome.data_compared
    );
    println!("{:?}", outcome.excused);
    for difference in outcome.differences.iter().take(40) {
        println!("{difference}");
    }
    outcome
}

#[test]
fn requests_to_a_real_akd_are_answered_as_the_akd_did() {
    let Some(folder) = std::env::var_os("ETHERPEN_REAL_DEVICES").map(std::path::PathBuf::from) else {
        // Not `eprintln!`: the test harness shows its output only for failing tests.
        let _ = writeln!(
            std::io::stderr(),
            "ETHERPEN_REAL_DEVICES is not set: the replay of soem-sdinfo-akd.pcapng is left out"
        );
        return;
    };
    let file = std::fs::read(folder.join("soem-sdinfo-akd.pcapng")).unwrap();
    let image = std::fs::read(folder.join("akd.hex")).unwrap();
    let outcome = replay(
        &exchanges(&file),
        &mut segment_of(of_images(vec![image]), Some(ControllerType::Akd), Speed::AKD),
        Pace::Recorded,
    );
    let unexpected = outcome.unexpected(&AKD, "soem-sdinfo-akd.pcapng");
    assert_eq!(unexpected, Vec::<String>::new());
}

#[test]
fn requests_to_four_simulated_drives_are_answered_as_those_did() {
    let file = include_bytes!("../../../../tests/data/ethercat/soem-slaveinfo_vs_kickcat-4xEVS-NET.pcapng");
    let exchanges = exchanges(file);
    let mut images = recorded_images(&exchanges, 4);
    // The master reads the lists of equal slaves once.
    if let [first, others @ ..] = images.as_mut_slice() {
        let unread = |byte: &&mut u8| **byte == 0xFF;
        for image in others {
            let bytes = image.iter_mut().zip(first.iter());
            bytes
                .filter(|(byte, _)| unread(byte))
                .for_each(|(byte, same)| *byte = *same);
        }
    }
    let outcome = replay(
        &exchanges,
        &mut segment_of(of_images(images), None, Speed::SIMULATED),
        Pace::Millisecond,
    );
    let unexpected = outcome.unexpected(&FOUR_DRIVES, "soem-slaveinfo_vs_kickcat-4xEVS-NET.pcapng");
    assert_eq!(unexpected, Vec::<String>::new());
}

/// The slaves of a recording: what was not read of a memory is like that of the first slave.
fn recorded_slaves(recording: &Recording, folder: &Path, exchanges: &[Exchanged]) -> Vec<SlaveKind> {
    let mut images = recorded_images(exchanges, recording.slaves.len());
    if let [first, others @ ..] = images.as_mut_slice() {
        for (byte, same) in others.iter_mut().flat_map(|image| image.iter_mut().zip(first.iter())) {
            *byte = if *byte == 0xFF { *same } else { *byte };
        }
    }
    let slaves = recording.slaves.iter().zip(images);
    let kinds = slaves.map(|(slave, mut image)| match slave {
        Recorded::Kind(kind) => kind.clone(),
        Recorded::Dump(file) => SlaveKind::Sii(std::fs::read(folder.join(file)).unwrap().into()),
        Recorded::Read(word) => {
            image[..2].copy_from_slice(&word.to_le_bytes());
            image[2..14].fill(0);
            image[14] = checksum(&image[..14]);
            SlaveKind::Sii(image.into())
        }
    });
    kinds.collect()
}

#[test]
fn requests_of_three_masters_are_answered_as_the_recorded_slaves_did() {
    let Some(folder) = std::env::var_os("ETHERPEN_REAL_DEVICES").map(std::path::PathBuf::from) else {
        let _ = writeln!(
            std::io::stderr(),
            "ETHERPEN_REAL_DEVICES is not set: the replay of recordings is left out"
        );
        return;
    };
    let mut unexpected = Vec::new();
    for recording in &RECORDINGS {
        println!("{}", recording.file);
        let file = std::fs::read(folder.join(recording.file)).unwrap();
        let exchanges = exchanges(&file);
        let mut segment = segment_of(
            recorded_slaves(recording, &folder, &exchanges),
            recording.controller,
            recording.speed,
        );
        if let Some(state) = recording.begins_in {
            begin(&mut segment, &recorded_stations(&exchanges), state);
        }
        let mut outcome = replay(&exchanges, &mut segment, recording.pace);
        for explained in recording.explained {
            let named = format!("register {:#06x}", explained.register);
            let before = outcome.differences.len();
            outcome.differences.retain(|difference| !difference.contains(&named));
            let found = before - outcome.differences.len();
            assert_eq!(found, explained.differences, "{}: {}", recording.file, explained.reason);
            println!("{found:5} {}", explained.reason);
        }
        unexpected.extend(outcome.unexpected(&recording.expected, recording.file));
    }
    assert_eq!(unexpected, Vec::<String>::new());
}
