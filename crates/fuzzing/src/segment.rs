//! Any bytes as frames to the virtual segment, and as a fault script.
//!
//! Frames: the first byte chooses the state of the slaves, then follow records of a length (two bytes) and that many
//! bytes: a frame from its EtherCAT header on, or a whole frame if the length's highest bit is set.

use etherpen_segment::rig::{APRD, APWR, BRD, BWR, FPRD, FPWR, FRMW, LRD, LRW, LWR, Rig, content, frame_of};
use etherpen_segment::{Flywheel, SCRIPT_HELP, Script, Segment, SegmentOptions, SlaveKind};

/// Flag of a record with an Ethernet header.
const WHOLE: u16 = 0x8000;
/// Most frames of an input.
const FRAMES_MAX: usize = 64;
/// Time for which a script runs, ms.
const SCRIPT_MS: u64 = 64;
/// Registers: station address, AL control, control of the information memory, its data.
const STATION: u16 = 0x0010;
const AL_CONTROL: u16 = 0x0120;
const SII_CONTROL: u16 = 0x0502;
const SII_DATA: u16 = 0x0508;

fn drives() -> Vec<SlaveKind> {
    vec![SlaveKind::Ax2000; 4]
}

fn segment(slaves: Vec<SlaveKind>, faults: Script) -> Segment<Flywheel> {
    let options = SegmentOptions {
        slaves,
        sii_busy_us: 0,
        faults,
        ..SegmentOptions::default()
    };
    Segment::new(&options, Flywheel::default())
}

/// Four drives in OP with power, and the time then, us.
fn operational() -> (Segment<Flywheel>, u64) {
    thread_local! {
        static READY: (Segment<Flywheel>, u64) = {
            let mut rig = Rig::new(segment(drives(), Script::default()));
            rig.bring_up();
            (rig.bus, rig.time_us)
        };
    }
    READY.with(Clone::clone)
}

/// Passes frames to the virtual segment.
pub(crate) fn frames(bytes: &[u8]) {
    let Some((&state, mut rest)) = bytes.split_first() else {
        return;
    };
    let (mut segment, mut time_us) = match state & 3 {
        0 => operational(),
        1 => (segment(drives(), Script::default()), 0),
        _ => (
            segment(
                vec![SlaveKind::Cia402, SlaveKind::Ek1100, SlaveKind::Ax2000],
                Script::default(),
            ),
            0,
        ),
    };
    for _ in 0..FRAMES_MAX {
        let Some((length, behind)) = rest.split_first_chunk() else {
            break;
        };
        let length = u16::from_le_bytes(*length);
        let (frame, behind) = behind.split_at(behind.len().min(usize::from(length & !WHOLE)));
        rest = behind;
        time_us += 1_000;
        let replies = if length & WHOLE == 0 {
            segment.payload(time_us, frame)
        } else {
            segment.frame(time_us, frame)
        };
        assert!(replies.len() <= 1, "one reply at most without a fault");
    }
    let motors = segment.motors();
    assert!(
        motors.into_iter().all(|motor| motor.angle_rad.is_finite()),
        "a motor at no angle"
    );
}

/// Frames of a master: states, mailboxes, process data, memories.
pub(crate) fn frame_seeds() -> Vec<Vec<u8>> {
    let read_mode = [10, 0, 0, 0, 0, 0x13, 0, 0x20, 0x40, 0x60, 0x60, 0, 0, 0, 0, 0];
    let mut mailbox = vec![0; 128];
    mailbox[..read_mode.len()].copy_from_slice(&read_mode);
    let frames = [
        frame_of(&[(BRD, 0, 0x0130, &[0; 2]), (APWR, 0, STATION, &[1, 0x10])]),
        frame_of(&[(BWR, 0, AL_CONTROL, &[2, 0]), (FPRD, 0x1001, 0, &[0; 16])]),
        frame_of(&[(FPWR, 0x1001, 0x0800, &[0, 0x18, 0, 1, 0x26, 0, 1, 0])]),
        frame_of(&[(FPWR, 0x1001, 0x1800, &mailbox)]),
        frame_of(&[(FPRD, 0x1001, 0x1C00, &[0; 128])]),
        frame_of(&[(
            FPWR,
            0x1002,
            0x0600,
            &[0, 0, 0, 1, 6, 0, 0, 7, 0, 0x11, 0, 1, 1, 0, 0, 0],
        )]),
        frame_of(&[(LRD, 0x0040, 1, &[0; 24]), (LWR, 0, 1, &[0; 24])]),
        frame_of(&[(LRW, 0, 1, &[0; 24]), (FRMW, 0x1001, 0x0910, &[0; 8])]),
        frame_of(&[
            (APWR, 0, SII_CONTROL, &[0, 1, 8, 0, 0, 0]),
            (APRD, 0, SII_DATA, &[0; 4]),
        ]),
    ];
    let record = |frame: &Vec<u8>| [&((frame.len() - 14) as u16).to_le_bytes(), &frame[14..]].concat();
    let all: Vec<u8> = frames.iter().flat_map(record).collect();
    let mut seeds = vec![];
    for state in 0..3 {
        seeds.push([&[state], all.as_slice()].concat());
    }
    let whole = |frame: &Vec<u8>| [&(frame.len() as u16 | WHOLE).to_le_bytes(), frame.as_slice()].concat();
    seeds.push([&[0], frames.iter().flat_map(whole).collect::<Vec<u8>>().as_slice()].concat());
    seeds
}

/// Reads a fault script; one that fits the chain runs with a master that reads states and process data.
pub(crate) fn script(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let script = match text.parse::<Script>() {
        Ok(script) => script,
        Err(error) => {
            assert!(error.line >= 1 && !error.to_string().is_empty());
            return;
        }
    };
    if let Err(error) = script.check(drives().len()) {
        assert!(error.line <= text.lines().count() && !error.to_string().is_empty());
        return;
    }
    let mut segment = segment(drives(), script);
    let frame = frame_of(&[(BRD, 0, 0x0130, &[0; 2]), (LRD, 0x0040, 1, &[0; 24])]);
    for ms in 1..=SCRIPT_MS {
        segment.frame(1_000 * ms, &frame);
    }
}

/// The help's examples, and every fault once.
pub(crate) fn script_seeds() -> Vec<Vec<u8>> {
    let (examples, _) = SCRIPT_HELP.split_once("Faults of a frame").unwrap_or_default();
    let line = |line: &str| {
        line.strip_prefix("  ")
            .and_then(|line| line.split("  ").next())
            .map(str::to_owned)
    };
    let mut seeds: Vec<Vec<u8>> = examples.lines().filter_map(line).map(String::into_bytes).collect();
    seeds.push(EVERY_FAULT.as_bytes().to_vec());
    seeds
}

const EVERY_FAULT: &str = "\
frame 1 drop\nframe 2 lose\nframe 3 delay 2\nframe 4 duplicate\nframe 5..6 truncate 30\nframe 7 overlong 4\n\
frame 8 index 1\nframe 9 counter -1\nframe 10 type 4\nframe 11 more\nframe 12 circulate\nframe 13 vlan\n\
frame 14 foreign\nframe 15 reflect\nevery 20 lose\nchance 0.01 lose # seeded\n1% of frames: truncate 40\n\
ms 3 stall 2\nms 4 cut 2\nms 5 join\nms 6 crc 1 3\nms 7 remove 1\nms 8 insert 1\nms 9 swap 2 ek1100\nms 10 power 3 4\n\
ms 11 retreat 1 0x1a\nms 12 fall 2 safeop 0x1b\nms 13 refuse 1 op 0x1e\nms 14 pdi 2 5\nms 15 sii 1 busy\n\
ms 16 sii 1 whole\nms 17 silence 3 9\nms 18 mailbox 1 2 abort 0x06010000\nms 19 mailbox 1 0x6060:0 flood 3\n\
ms 20 fault 1 0x7300\nms 21 mains 2 5\nms 22 stuck 1 9\nms 23 slip 2 50 9\nms 24 jump 3 -1000\nms 25 reverse 4 9\n\
ms 26 noise 1 100 9\nms 27 exchange 1 2 9\n";

/// Lets a master read a slave's memory and bring it up, without caring for the outcome.
pub(crate) fn visit(kind: SlaveKind) {
    let mut segment = segment(vec![kind], Script::default());
    let read = |word: u8| {
        frame_of(&[
            (APWR, 0, SII_CONTROL, &[0, 1, word, 0, 0, 0]),
            (APRD, 0, SII_DATA, &[0; 4]),
        ])
    };
    let mut frames = vec![frame_of(&[(APWR, 0, STATION, &[1, 0x10])])];
    frames.extend([0, 8, 0x18, 0x40, 0xFF].map(read));
    for state in [2, 4, 8] {
        frames.push(frame_of(&[
            (BWR, 0, AL_CONTROL, &[state, 0]),
            (FPRD, 0x1001, 0x0800, &[0; 64]),
        ]));
        frames.push(frame_of(&[
            (FPWR, 0x1001, 0x1000, &[0x55; 64]),
            (FPRD, 0x1001, 0x1400, &[0; 64]),
        ]));
    }
    for (ms, frame) in (1..).zip(&frames) {
        assert!(segment.frame(1_000 * ms, frame).len() <= 1);
    }
}

/// The information memory of a virtual slave, read through its registers.
pub(crate) fn image_of(kind: SlaveKind) -> Vec<u8> {
    let mut segment = segment(vec![kind], Script::default());
    let mut image = Vec::new();
    for word in (0..1024_u16).step_by(2) {
        let [low, high] = word.to_le_bytes();
        let mut ms = 3 * u64::from(word);
        let mut pass = |frame: &[u8]| {
            ms += 1;
            segment.frame(1_000 * ms, frame).swap_remove(0)
        };
        pass(&frame_of(&[(APWR, 0, SII_CONTROL, &[0, 1, low, high, 0, 0])]));
        let reply = pass(&frame_of(&[(APRD, 0, SII_DATA, &[0; 4])]));
        image.extend(content(&reply, 4).0);
    }
    image
}
