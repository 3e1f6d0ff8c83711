//! Branches, loops, events and the reset of the controllers.

use crate::{TestRig, rig_of};
use etherpen_segment::rig::*;
use etherpen_segment::{ClockOptions, Fault, SegmentOptions, SlaveList};

fn segment(list: &str) -> TestRig {
    let SlaveList {
        slaves,
        places,
        branches,
        ..
    } = list.parse().expect("a list");
    let mut rig = rig_of(SegmentOptions {
        slaves,
        places,
        branches,
        clocks: ClockOptions {
            drift_max_ppm: 0.0,
            ..ClockOptions::default()
        },
        ..SegmentOptions::default()
    });
    for position in 0..rig.bus.slaves().len() as u16 {
        let station = 0x1001 + position;
        rig.ask(APWR, 0u16.wrapping_sub(position), 0x0010, &station.to_le_bytes());
    }
    rig
}

/// The ports of a slave whose loops are open.
fn open_ports(rig: &mut TestRig, station: u16) -> Vec<u8> {
    let status = u16::from_le_bytes(rig.read(station, 0x0110, 2).try_into().expect("two bytes"));
    (0..4).filter(|port| status >> (8 + 2 * port) & 3 == 2).collect()
}

fn answering(rig: &mut TestRig) -> u16 {
    rig.ask(BRD, 0, 0x0130, &[0, 0]).1
}

/// Slaves in the order of the frames: coupler, junction, one drive at its port 3, a terminal at port 1, two drives at
/// port 2, and a drive at port 2 of the coupler.
const TREE: &str = "ek1100(2:ax2000),ek1122(ax2000*2)(3:cia402),el1008";

#[test]
fn the_ports_of_a_tree_are_open_where_slaves_are() {
    let mut rig = segment(TREE);
    let ports: Vec<Vec<u8>> = (0x1001..=0x1007).map(|station| open_ports(&mut rig, station)).collect();
    let expected: [&[u8]; 7] = [&[0, 1, 2], &[0, 1, 2, 3], &[0], &[0], &[0, 1], &[0], &[0]];
    assert_eq!(ports, expected);
    assert_eq!(rig.read(0x1002, 0x0007, 1), [0xFA]);
    assert_eq!(rig.read(0x1003, 0x0000, 1), [0x11], "the drive at port 3 comes first");
    assert_eq!(rig.read(0x1004, 0x0000, 1), [0x12], "then the terminal at port 1");
}

#[test]
fn the_receive_times_of_a_tree_tell_its_cables() {
    let mut rig = segment(TREE);
    rig.ask(BWR, 0, 0x0900, &[0; 4]);
    let times = |rig: &mut TestRig, station| {
        let bytes = rig.read(station, 0x0900, 16);
        let (words, _) = bytes.as_chunks::<4>();
        words.iter().map(|word| u32::from_le_bytes(*word)).collect::<Vec<u32>>()
    };
    let junction = times(&mut rig, 0x1002);
    let since = |port: usize| junction[port].wrapping_sub(junction[0]);
    // Through a slave 300 ns, through a cable 50 ns: out, in, turned round, back.
    let branch = |slaves: u32| 300 + 50 + slaves * 300 + (slaves - 1) * (300 + 2 * 50) + 50;
    assert_eq!(since(3), branch(1));
    assert_eq!(since(1), since(3) + branch(1));
    assert_eq!(since(2), since(1) + branch(2));
    let coupler = times(&mut rig, 0x1001);
    let whole = coupler[1].wrapping_sub(coupler[0]);
    assert_eq!(whole, 300 + 50 + since(2) + 300 + 50);
    assert_eq!(coupler[2].wrapping_sub(coupler[1]), branch(1));
    let last = times(&mut rig, 0x1007);
    assert_eq!(last[2], 0, "no frame arrives there");
    assert_eq!(rig.bus.travel_ns(), Some(u64::from(whole + branch(1)) + 300 + 2 * 50));
}

#[test]
fn a_pulled_cable_takes_its_branch_away_and_no_other() {
    let mut rig = segment(TREE);
    for (fault, count) in [
        ("cut 4", 5),
        ("cut 2", 4),
        ("plug 4", 6),
        ("plug 2", 7),
        ("cut 1", 2),
        ("join", 7),
        ("remove 2", 6),
        ("insert 2", 7),
        ("cut 0", 0),
    ] {
        rig.bus.inject(fault.parse::<Fault>().expect(fault));
        let replies = rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
        let replies = if replies.is_empty() { 0 } else { answering(&mut rig) };
        let reached = rig.bus.slaves().iter().filter(|slave| slave.reached).count();
        let expected = if fault == "remove 2" { 3 } else { count };
        assert_eq!((replies, reached), (expected, usize::from(expected)), "{fault}");
    }
}

#[test]
fn a_closed_loop_ends_the_line_and_an_open_end_loses_the_frame() {
    let mut rig = segment("ek1100,cia402,cia402");
    rig.write(0x1001, 0x0101, &[0x0C]);
    assert_eq!(answering(&mut rig), 1);
    assert_eq!(
        rig.read(0x1001, 0x0110, 2),
        [0x31, 0x5E],
        "port 1 has a link and is closed"
    );
    assert!(rig.bus.slaves()[0].reached && !rig.bus.slaves()[1].reached);
    rig.write(0x1001, 0x0101, &[0x00]);
    assert_eq!(answering(&mut rig), 3);
    rig.write(0x1003, 0x0101, &[0x08]);
    assert!(rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])])).is_empty());
    assert_eq!(rig.bus.travel_ns(), None);
}

#[test]
fn a_temporary_setting_of_the_loops_ends_by_itself() {
    let mut rig = segment("ek1100,cia402");
    rig.write(0x1001, 0x0100, &[0x03, 0x0C]);
    assert_eq!(answering(&mut rig), 1);
    rig.time_us += 990_000;
    assert_eq!(answering(&mut rig), 1);
    rig.time_us += 20_000;
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(answering(&mut rig), 2);
    assert_eq!(rig.read(0x1001, 0x0101, 1), [0]);
}

#[test]
fn a_loop_that_closes_by_itself_opens_when_it_is_written_again() {
    let mut rig = segment("ek1100,cia402");
    rig.write(0x1001, 0x0101, &[0x04]);
    assert_eq!(answering(&mut rig), 2);
    for fault in [Fault::Cut(1), Fault::Join] {
        rig.bus.inject(fault);
        rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    }
    assert_eq!(answering(&mut rig), 1);
    rig.write(0x1001, 0x0101, &[0x04]);
    assert_eq!(answering(&mut rig), 2);
}

#[test]
fn foreign_frames_come_back_where_every_slave_lets_them_pass() {
    let mut rig = segment("ek1100,cia402");
    let mut foreign = vec![0xFF; 12];
    foreign.extend_from_slice(&[0x08, 0x06]);
    foreign.resize(60, 0);
    assert!(rig.send(&foreign).is_empty());
    rig.write(0x1001, 0x0100, &[0]);
    assert!(rig.send(&foreign).is_empty(), "the second slave destroys it");
    rig.write(0x1002, 0x0100, &[0]);
    assert_eq!(rig.send(&foreign), [foreign]);
}

#[test]
fn events_last_until_the_bus_reads_what_has_changed() {
    let mut rig = segment("ek1100,cia402");
    let station = 0x1002;
    let events = |rig: &mut TestRig| u16::from_le_bytes(rig.read(station, 0x0210, 2).try_into().expect("two bytes"));
    rig.read(station, 0x0110, 2);
    rig.al_status(station);
    assert_eq!(events(&mut rig), 0);
    rig.write(station, 0x0200, &[0xFC, 0x0F]);
    let field = |rig: &mut TestRig| {
        let replies = rig.send(&frame_of(&[(BRD, 0, 0x0000, &[0])]));
        u16::from_le_bytes([replies[0][24], replies[0][25]])
    };
    assert_eq!(field(&mut rig), 0);
    // Mailbox SMs, the second with an event for the bus (control bit 4).
    rig.write(station, 0x0800, &[0x00, 0x10, 0x00, 0x01, 0x26, 0, 1, 0]);
    rig.write(station, 0x0808, &[0x00, 0x12, 0x00, 0x01, 0x32, 0, 1, 0]);
    rig.write(station, 0x0120, &[2, 0]);
    assert_eq!(field(&mut rig), 0x0008, "the state has changed");
    assert_eq!((events(&mut rig), rig.al_status(station)), (0x0008, (2, 0)));
    assert_eq!(field(&mut rig), 0);
    rig.mail_bytes = 256;
    rig.post(station, &[0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    rig.send(&frame_of(&[(BRD, 0, 0x0000, &[0])]));
    assert_eq!(field(&mut rig), 0x0020, "mail in sync manager 1");
    rig.fetch(station);
    assert_eq!(field(&mut rig), 0);
    rig.bus.inject(Fault::Cut(1));
    rig.send(&frame_of(&[(BRD, 0, 0x0000, &[0])]));
    rig.bus.inject(Fault::Join);
    rig.send(&frame_of(&[(BRD, 0, 0x0000, &[0])]));
    assert_eq!(field(&mut rig), 0x0004, "the link has changed");
    rig.write(station, 0x0200, &[0, 0]);
    assert_eq!((field(&mut rig), events(&mut rig)), (0, 0x0004));
    assert_eq!(rig.ask(FPWR, station, 0x0210, &[0, 0]).1, 0, "not writable");
}

#[test]
fn three_bytes_in_three_frames_reset_a_controller() {
    let mut rig = segment("ek1100,cia402");
    let station = 0x1002;
    let write = |rig: &mut TestRig, byte: u8| rig.write(station, 0x0040, &[byte]);
    for bytes in ["RSE", "REX", "RRS"] {
        bytes.bytes().for_each(|byte| write(&mut rig, byte));
        assert_eq!(answering(&mut rig), 2, "{bytes}");
    }
    write(&mut rig, b'R');
    assert_eq!(rig.read(station, 0x0040, 1), [1]);
    write(&mut rig, b'E');
    assert_eq!(rig.read(station, 0x0040, 1), [2]);
    write(&mut rig, b'S');
    rig.time_us += 10_000;
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(answering(&mut rig), 1, "it loads its configuration");
    rig.time_us += 200_000;
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(answering(&mut rig), 2);
    assert_eq!(rig.ask(FPRD, station, 0x0130, &[0, 0]).1, 0, "its address is gone");
}

#[test]
fn three_resets_in_one_frame_are_none() {
    let mut rig = segment("cia402");
    let bytes: [(u8, u16, u16, &[u8]); 3] = [
        (FPWR, 0x1001, 0x0040, b"R"),
        (FPWR, 0x1001, 0x0040, b"E"),
        (FPWR, 0x1001, 0x0040, b"S"),
    ];
    rig.send(&frame_of(&bytes));
    rig.time_us += 20_000;
    assert_eq!(rig.ask(FPRD, 0x1001, 0x0130, &[0, 0]).1, 1);
}

#[test]
fn slaves_that_are_exchanged_are_away_with_what_is_behind_them_while_their_cables_lie_open() {
    // In the tree the drives at port 3 and the terminal at port 1 of the junction are exchanged.
    for (list, one, other, reached) in [("ax2000*4", 2, 3, 1), ("ax2000*4", 4, 2, 1), (TREE, 3, 4, 5)] {
        let mut rig = segment(list);
        let all = answering(&mut rig);
        let station = |rig: &mut TestRig, place: u16| {
            let (bytes, _) = rig.ask(APRD, 0_u16.wrapping_sub(place - 1), 0x0010, &[0; 2]);
            u16::from_le_bytes([bytes[0], bytes[1]])
        };
        let before = [one, other].map(|place| station(&mut rig, place));
        rig.bus.inject(Fault::Recable(one.into(), other.into()));
        for passed_ms in [0, 1, 100, 380] {
            rig.time_us += passed_ms * 1_000;
            assert_eq!(answering(&mut rig), reached, "{list}");
        }
        rig.time_us += 30_000;
        assert_eq!(answering(&mut rig), all, "{list}");
        let after = [other, one].map(|place| station(&mut rig, place));
        assert_eq!(before, after, "{list}");
    }
}
