//! What tells two equal slaves apart: alias, serial number and the number of the switches.

use crate::{TestRig, rig_of};
use etherpen_segment::rig::*;
use etherpen_segment::{Fault, SegmentOptions, SlaveList};

fn segment(list: &str) -> TestRig {
    let SlaveList { slaves, places, .. } = list.parse().expect("a list");
    let mut rig = rig_of(SegmentOptions {
        slaves,
        places,
        ..SegmentOptions::default()
    });
    for position in 0..rig.bus.slaves().len() as u16 {
        let station = 0x1001 + position;
        rig.ask(APWR, 0u16.wrapping_sub(position), 0x0010, &station.to_le_bytes());
    }
    rig
}

/// Eight bytes of the information memory from this word on.
fn memory(rig: &mut TestRig, station: u16, word: u8) -> Vec<u8> {
    rig.write(station, 0x0502, &[0x00, 0x01, word, 0, 0, 0]);
    rig.read(station, 0x0508, 8)
}

#[test]
fn an_alias_is_in_the_register_and_answers_once_it_is_enabled() {
    let mut rig = segment("ek1100,cia402@alias=0xABCD,el1004@alias=7");
    assert_eq!(rig.read(0x1002, 0x0012, 2), [0xCD, 0xAB]);
    assert_eq!(rig.read(0x1003, 0x0012, 2), [7, 0]);
    assert_eq!(rig.read(0x1001, 0x0012, 2), [0, 0]);
    assert_eq!(memory(&mut rig, 0x1002, 4)[..2], [0xCD, 0xAB]);
    assert_eq!(rig.read(0x1003, 0x0110, 1)[0] & 1, 1, "the checksum fits");
    assert_eq!(rig.ask(FPRD, 0xABCD, 0x0012, &[0; 2]).1, 0);
    rig.write(0x1002, 0x0103, &[1]);
    assert_eq!(rig.ask(FPRD, 0xABCD, 0x0012, &[0; 2]), (vec![0xCD, 0xAB], 1));
}

#[test]
fn a_serial_number_is_in_the_memory_and_in_the_identity_object() {
    let mut rig = segment("cia402,cia402@serial=0x01020304,el2004@serial=9");
    let serials: Vec<Vec<u8>> = (0x1001..=0x1003)
        .map(|station| memory(&mut rig, station, 0x0E)[..4].to_vec())
        .collect();
    assert_eq!(serials, [[1, 0, 0, 0], [4, 3, 2, 1], [9, 0, 0, 0]]);
    rig.mail_bytes = 256;
    rig.write(0x1002, 0x0800, &[0x00, 0x10, 0x00, 0x01, 0x26, 0, 1, 0]);
    rig.write(0x1002, 0x0808, &[0x00, 0x12, 0x00, 0x01, 0x22, 0, 1, 0]);
    rig.write(0x1002, 0x0120, &[2, 0]);
    assert_eq!(rig.upload(0x1002, 0x1018, 4)[4..8], [4, 3, 2, 1]);
}

#[test]
fn a_master_that_asks_for_the_switches_reads_their_number_in_the_status_code() {
    let mut rig = segment("cia402@id=0x1234,cia402");
    for station in [0x1001, 0x1002] {
        rig.write(station, 0x0120, &[0x21, 0]);
    }
    assert_eq!(rig.al_status(0x1001), (0x21, 0x1234));
    assert_eq!(rig.al_status(0x1002), (0x01, 0), "no switches");
    rig.write(0x1001, 0x0120, &[0x01, 0]);
    assert_eq!(rig.al_status(0x1001), (0x01, 0));
    rig.write(0x1001, 0x0120, &[0x28, 0]);
    assert_eq!(rig.al_status(0x1001), (0x11, 0x0011), "an error needs the register");
    let flags = [0x1001, 0x1002].map(|station| {
        let general = (0x40..0x80).find(|word| memory(&mut rig, station, *word)[..2] == [30, 0]);
        memory(&mut rig, station, general.expect("the general category") + 2 + 5)[1]
    });
    assert_eq!(flags, [0x08, 0x00]);
}

#[test]
fn another_product_in_a_place_has_nothing_of_what_was_set_on_the_old_one() {
    let mut rig = segment("cia402@alias=3@serial=7@id=5");
    rig.bus.inject("swap 1 ax2000".parse::<Fault>().expect("a fault"));
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    rig.write(0, 0x0010, &[0x01, 0x10]);
    assert_eq!(rig.read(0x1001, 0x0012, 2), [0, 0]);
    assert_eq!(memory(&mut rig, 0x1001, 0x0E)[..4], 1001u32.to_le_bytes());
    rig.write(0x1001, 0x0120, &[0x21, 0]);
    assert_eq!(rig.al_status(0x1001), (1, 0));
}
