//! Named inputs and outputs in a recording, against the frames on the wire.

use crate::program::{Folder, etherpen, run, strokes};
use std::fs;
use std::path::Path;

/// First logical address of a slave's process data, by its place from 0: each slave has 64 bytes.
const LOGICAL_START: u32 = 0x0001_0000;
const LOGICAL_STEP: u32 = 64;
/// Commands of datagrams with logical addresses.
const LRD: u8 = 10;
const LWR: u8 = 11;
const LRW: u8 = 12;
/// Lengths of the headers of a frame and of a datagram, and of the working counter, bytes.
const FRAME_HEADER: usize = 16;
const DATAGRAM_HEADER: usize = 10;
const WORKING_COUNTER: usize = 2;
/// Times of the wire and of the samples agree within this, ms.
const CLOSE_MS: f64 = 2.0;

/// A value, and the time from which it is there, ms.
type Change = (f64, i64);

/// Frames of a capture (pcapng with nanoseconds): time, ms, and bytes.
fn frames(capture: &[u8]) -> Vec<(f64, &[u8])> {
    const ENHANCED_PACKET: u32 = 6;
    let word = |at: usize| u32::from_le_bytes(capture[at..at + 4].try_into().expect("a word"));
    let mut frames = Vec::new();
    let mut at = 0;
    while at < capture.len() {
        if word(at) == ENHANCED_PACKET {
            let time_ns = u64::from(word(at + 12)) << 32 | u64::from(word(at + 16));
            let length = word(at + 20) as usize;
            frames.push((time_ns as f64 * 1e-6, &capture[at + 28..at + 28 + length]));
        }
        at += word(at + 4) as usize;
    }
    frames
}

/// Values of a byte of the process data in the replies, under a mask, each with its first time.
fn on_the_wire(capture: &[u8], slave: u32, commands: [u8; 2], value: impl Fn(u8) -> i64) -> Vec<Change> {
    let wanted = LOGICAL_START + LOGICAL_STEP * slave;
    let mut changes: Vec<Change> = Vec::new();
    for (time_ms, frame) in frames(capture) {
        let mut at = FRAME_HEADER;
        while let Some(header) = frame.get(at..at + DATAGRAM_HEADER) {
            let logical = u32::from_le_bytes(header[2..6].try_into().expect("an address"));
            let length = usize::from(u16::from_le_bytes([header[6], header[7]]) & 0x07FF);
            let is_last = header[7] & 0x80 == 0;
            let data = at + DATAGRAM_HEADER;
            let counter = &frame[data + length..data + length + WORKING_COUNTER];
            let place = wanted.wrapping_sub(logical) as usize;
            // Requests have a working counter of 0.
            if commands.contains(&header[0]) && place < length && counter != [0, 0] {
                let value = value(frame[data + place]);
                if changes.last().is_none_or(|(_, last)| *last != value) {
                    changes.push((time_ms, value));
                }
            }
            if is_last {
                break;
            }
            at = data + length + WORKING_COUNTER;
        }
    }
    changes
}

/// Values of a column of `telemetry.csv`, each with its first time, from the first one that is there on.
fn in_the_table(table: &str, column: &str) -> Vec<Change> {
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = lines.next().expect("names");
    let index = names.iter().position(|name| *name == column).expect("the column");
    let mut changes: Vec<Change> = Vec::new();
    let mut was_missing = false;
    for line in lines {
        let Ok(value) = line[index].parse() else {
            was_missing = true;
            continue;
        };
        if was_missing && changes.last().is_none_or(|(_, last)| *last != value) {
            changes.push((line[0].parse().expect("a time"), value));
        }
    }
    changes
}

fn assert_same(column: &str, recorded: &[Change], on_the_wire: &[Change]) {
    let values = |changes: &[Change]| changes.iter().map(|(_, value)| *value).collect::<Vec<_>>();
    assert_eq!(
        values(recorded),
        values(on_the_wire),
        "{column}: {recorded:?} {on_the_wire:?}"
    );
    // The first value was on the wire before the operating mode let the samples show it.
    for ((recorded_ms, _), (wire_ms, _)) in recorded.iter().zip(on_the_wire).skip(1) {
        assert!(
            (recorded_ms - wire_ms).abs() <= CLOSE_MS,
            "{column}: {recorded_ms} ms, on the wire {wire_ms} ms"
        );
    }
}

/// Draws in virtual time; returns the capture of the bus, and the table.
fn drawn(folder: &Folder, config: &Path) -> (Vec<u8>, String) {
    let out = folder.join("out");
    let mut command = etherpen(folder);
    command.arg("simulate").arg(strokes()).arg("--config").arg(config);
    let (status, _, stderr) = run(command.arg("--out").arg(&out));
    assert_eq!(status, Some(0), "{stderr}");
    let read = |name: &str| fs::read(out.join(name)).expect("an output file");
    (
        read("bus.pcapng"),
        String::from_utf8(read("telemetry.csv")).expect("text"),
    )
}

#[test]
fn switches_and_a_word_in_a_recording_are_those_on_the_wire() {
    let folder = Folder::new();
    let machine = host_tools::setup::workspace().join("samples/machines/gantry.toml");
    let word = "\n[[io]]\nname = \"switches\"\nslave = 1\nbit = 0\ntype = \"i8\"\n";
    let text = fs::read_to_string(machine).expect("the gantry") + word;
    let (capture, table) = drawn(&folder, &folder.file("gantry.toml", &text));
    for (bit, column) in ["io_x_home", "io_y_home", "io_z_home"].into_iter().enumerate() {
        let recorded = in_the_table(&table, column);
        let seen = on_the_wire(&capture, 1, [LRD, LRW], |byte| i64::from(byte >> bit & 1));
        assert!(
            recorded.len() >= 5,
            "{column}: each switch is left and entered twice, {recorded:?}"
        );
        assert_same(column, &recorded, &seen);
    }
    let recorded = in_the_table(&table, "io_switches");
    let seen = on_the_wire(&capture, 1, [LRD, LRW], |byte| i64::from(byte.cast_signed()));
    assert_same("io_switches", &recorded, &seen);
}

#[test]
fn a_lamp_in_a_recording_is_the_one_on_the_wire() {
    let folder = Folder::new();
    let lamp = "\n[[io]]\nname = \"lamp\"\nslave = 6\ndirection = \"out\"\nbit = 2\nrole = \"lamp\"\n";
    let (capture, table) = drawn(&folder, &folder.file("lamp.toml", lamp));
    let recorded = in_the_table(&table, "io_lamp");
    let seen = on_the_wire(&capture, 6, [LWR, LRW], |byte| i64::from(byte >> 2 & 1));
    assert!(recorded.len() > 20, "it blinks fast in motion: {recorded:?}");
    assert_same("io_lamp", &recorded, &seen);
}
