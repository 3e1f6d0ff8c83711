//! All kinds of slaves on one segment, driven by hand-made frames.

use crate::{TestRig, motors, rig_of};
use etherpen_segment::rig::*;
use etherpen_segment::{DriveState, SegmentOptions, parse_slaves};

const OUTPUTS: u16 = 0x1400;
const INPUTS: u16 = 0x1600;

fn segment(list: &str) -> TestRig {
    let slaves = parse_slaves(list).expect("a list");
    let mut rig = rig_of(SegmentOptions {
        slaves,
        ..SegmentOptions::default()
    });
    let count = rig.bus.slaves().len() as u16;
    for position in 0..count {
        let station = 0x1001 + position;
        let written = rig.ask(APWR, 0u16.wrapping_sub(position), 0x0010, &station.to_le_bytes());
        assert_eq!(written.1, 1);
    }
    rig
}

/// Mailboxes of a generic drive, and PREOP.
fn to_preop(rig: &mut TestRig, station: u16) {
    rig.write(station, 0x0800, &[0x00, 0x10, 0x00, 0x01, 0x26, 0, 1, 0]);
    rig.write(station, 0x0808, &[0x00, 0x12, 0x00, 0x01, 0x22, 0, 1, 0]);
    rig.mail_bytes = 256;
    rig.write(station, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(station), (2, 0));
}

/// Process data of `bytes` (out, in) bytes, and OP with these first outputs.
fn to_op(rig: &mut TestRig, station: u16, bytes: (u8, u8), outputs: &[u8]) {
    rig.write(station, 0x0810, &[0x00, 0x14, bytes.0, 0, 0x64, 0, 1, 0]);
    rig.write(station, 0x0818, &[0x00, 0x16, bytes.1, 0, 0x20, 0, 1, 0]);
    rig.write(station, 0x0120, &[4, 0]);
    assert_eq!(rig.al_status(station), (4, 0));
    rig.write(station, OUTPUTS, outputs);
    rig.write(station, 0x0120, &[8, 0]);
    rig.write(station, OUTPUTS, outputs);
    assert_eq!(rig.al_status(station), (8, 0));
}

#[test]
fn a_coupler_has_no_mailbox_and_goes_to_op_at_once() {
    let mut rig = segment("ek1100,ax2000");
    for state in [2, 4, 8] {
        rig.write(0x1001, 0x0120, &[state, 0]);
        assert_eq!(rig.al_status(0x1001), (state.into(), 0));
    }
    assert_eq!(rig.read(0x1001, 0x0000, 10)[4..], [8, 8, 8, 0x3B, 0xFC, 0x00]);
    rig.write(0x1002, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(0x1002), (0x11, 0x0016), "the drive needs its mailboxes");
}

#[test]
fn a_generic_drive_runs_in_velocity_mode_with_its_default_mapping() {
    let mut rig = segment("cia402");
    to_preop(&mut rig, 0x1001);
    assert_eq!(rig.download(0x1001, 0x6060, 0, &[9]), 0);
    let outputs = |control: u8| [control, 0, 0x20, 0x4E, 0, 0];
    to_op(&mut rig, 0x1001, (6, 6), &outputs(0));
    for control in [6, 7, 15] {
        for _ in 0..4 {
            rig.write(0x1001, OUTPUTS, &outputs(control));
        }
    }
    assert_eq!(rig.bus.slaves()[0].drive, DriveState::OperationEnabled);
    for _ in 0..100 {
        rig.write(0x1001, OUTPUTS, &outputs(15));
    }
    let inputs = rig.read(0x1001, INPUTS, 6);
    assert_eq!(inputs[0] & 0x6F, 0x27);
    let speed = motors(&rig)[0].speed_rad_s;
    let expected = 20_000.0 * 1_875.0 / 262_144.0 / 60.0 * std::f64::consts::TAU;
    assert!((speed - expected).abs() < 1e-2, "{speed} {expected}");
}

#[test]
fn a_mapping_is_changed_only_while_its_number_is_zero() {
    let mut rig = segment("cia402");
    to_preop(&mut rig, 0x1001);
    let entry = |index: u16, bits: u8| (u32::from(index) << 16 | u32::from(bits)).to_le_bytes();
    assert_eq!(rig.download(0x1001, 0x1600, 1, &entry(0x6071, 16)), 0x0601_0003);
    assert_eq!(rig.download(0x1001, 0x1600, 0, &[0]), 0);
    assert_eq!(rig.download(0x1001, 0x1600, 1, &entry(0x6064, 32)), 0x0604_0041);
    assert_eq!(rig.download(0x1001, 0x1600, 1, &entry(0x6071, 32)), 0x0604_0041);
    assert_eq!(rig.download(0x1001, 0x1600, 1, &entry(0x6123, 16)), 0x0602_0000);
    for (sub, entry) in [(1, entry(0x6071, 16)), (2, entry(0, 8)), (3, entry(0x6040, 16))] {
        assert_eq!(rig.download(0x1001, 0x1600, sub, &entry), 0);
    }
    assert_eq!(rig.download(0x1001, 0x1600, 0, &[3]), 0);
    let complete = [0x31, 0x13, 0x1C, 0, 4, 0, 0, 0, 1, 0, 0x02, 0x1A];
    assert_eq!(rig.sdo(0x1001, &complete)[0], 0x60);
    to_op(&mut rig, 0x1001, (5, 11), &[0; 5]);
    assert_eq!(rig.download(0x1001, 0x1600, 0, &[0]), 0x0800_0022, "not in OP");
}

#[test]
fn torque_mode_accelerates_and_the_brake_holds_when_it_is_left() {
    let mut rig = segment("ax2000*4");
    rig.mailboxes();
    rig.write(0x1004, 0x0120, &[2, 0]);
    assert_eq!(rig.download(0x1004, 0x6060, 0, &[0xFD]), 0);
    for (index, pdo) in [(0x1C12, [3, 0x17]), (0x1C13, [3, 0x1B])] {
        assert_eq!(rig.download(0x1004, index, 0, &[0]), 0);
        assert_eq!(rig.download(0x1004, index, 1, &pdo), 0);
        assert_eq!(rig.download(0x1004, index, 0, &[1]), 0);
    }
    rig.write(0x1004, 0x0810, &[0x00, 0x11, 4, 0, 0x64, 0, 1, 0]);
    rig.write(0x1004, 0x0818, &[0x40, 0x11, 8, 0, 0x20, 0, 1, 0]);
    rig.write(0x1004, 0x0120, &[4, 0]);
    rig.write(0x1004, 0x1100, &[0; 4]);
    rig.write(0x1004, 0x0120, &[8, 0]);
    for control in [6, 7, 15] {
        for _ in 0..4 {
            rig.write(0x1004, 0x1100, &[0, 0, control, 0]);
        }
    }
    for _ in 0..50 {
        rig.write(0x1004, 0x1100, &[0xF4, 0x01, 15, 0]);
    }
    let inputs = rig.read(0x1004, 0x1140, 8);
    assert_eq!(inputs[4..6], [0xF4, 0x01], "500 digits");
    let speed = motors(&rig)[3].speed_rad_s;
    assert!(speed > 1.0, "{speed}");
    for _ in 0..100 {
        rig.write(0x1004, 0x1100, &[0xF4, 0x01, 0, 0]);
    }
    assert_eq!(motors(&rig)[3].speed_rad_s, 0.0);
}

#[test]
fn every_listed_object_is_described_and_can_be_read() {
    for (list, station, mail_bytes) in [("ax2000", 0x1001, 512), ("cia402", 0x1001, 256)] {
        let mut rig = segment(list);
        if mail_bytes == 256 {
            to_preop(&mut rig, station);
        } else {
            rig.write(station, 0x0800, &[0x00, 0x18, 0x00, 0x02, 0x26, 0, 1, 0]);
            rig.write(station, 0x0808, &[0x00, 0x1C, 0x00, 0x02, 0x22, 0, 1, 0]);
            rig.write(station, 0x0120, &[2, 0]);
        }
        rig.post(station, &[0, 0x80, 1, 0, 0, 0, 1, 0]);
        let answer = rig.fetch(station);
        assert_eq!((answer[1], answer[2]), (0x80, 2), "one fragment");
        let indices: Vec<[u8; 2]> = answer[8..].chunks(2).map(|bytes| [bytes[0], bytes[1]]).collect();
        assert!(indices.len() >= 18, "{}", indices.len());
        for [low, high] in indices {
            rig.post(station, &[0, 0x80, 3, 0, 0, 0, low, high]);
            let object = rig.fetch(station);
            assert_eq!(object[2], 4, "{high:02x}{low:02x}");
            assert!(object.len() > 12, "a name");
            for sub in 0..=object[10] {
                rig.post(station, &[0, 0x80, 5, 0, 0, 0, low, high, sub, 0]);
                let entry = rig.fetch(station);
                assert_eq!(entry[2], 6, "{high:02x}{low:02x}:{sub}");
                let bytes = usize::from(u16::from_le_bytes([entry[12], entry[13]])) / 8;
                let value = rig.sdo(station, &[0x40, low, high, sub, 0, 0, 0, 0]);
                assert_eq!(outcome(&value), 0, "{high:02x}{low:02x}:{sub}");
                let is_expedited = value[0] & 2 != 0;
                match bytes {
                    0 => {}
                    _ if is_expedited => {
                        assert_eq!(4 - usize::from(value[0] >> 2 & 3), bytes, "{high:02x}{low:02x}:{sub}");
                    }
                    // A text; the other kind of bytes is a file that may be shorter.
                    _ => {
                        let size = u32::from_le_bytes([value[4], value[5], value[6], value[7]]) as usize;
                        assert!(size <= bytes, "{high:02x}{low:02x}:{sub}");
                        let is_text = entry[10..12] == [9, 0];
                        assert!(!is_text || size == bytes, "{high:02x}{low:02x}:{sub}");
                    }
                }
            }
        }
    }
}
