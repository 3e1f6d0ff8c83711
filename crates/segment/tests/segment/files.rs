//! File access, BOOT, and the drive AKD, by hand-made frames.

use crate::{TestRig, rig_of};
use etherpen_segment::rig::*;
use etherpen_segment::{Fault, SegmentOptions, SlaveList};

const STATION: u16 = 0x1001;

fn segment(list: &str) -> TestRig {
    let SlaveList { slaves, places, .. } = list.parse().expect("a list");
    let mut rig = rig_of(SegmentOptions {
        slaves,
        places,
        ..SegmentOptions::default()
    });
    rig.ask(APWR, 0, 0x0010, &STATION.to_le_bytes());
    rig
}

/// Mailboxes of BOOT of the generic drive: 400 bytes out, 300 bytes in.
const BOOT_OUT: [u8; 8] = [0x00, 0x18, 0x90, 0x01, 0x26, 0, 1, 0];
const BOOT_IN: [u8; 8] = [0x00, 0x1A, 0x2C, 0x01, 0x22, 0, 1, 0];

/// One message of file access and the body of its answer.
fn ask(rig: &mut TestRig, counter: u8, body: &[u8]) -> Vec<u8> {
    let mut message = vec![body.len() as u8, (body.len() >> 8) as u8, 0, 0, 0, 4 | counter << 4];
    message.extend_from_slice(body);
    message.resize(400, 0);
    rig.write(STATION, 0x1800, &message);
    for _ in 0..10 {
        if rig.read(STATION, 0x080D, 1)[0] & 0x08 != 0 {
            let mail = rig.read(STATION, 0x1A00, 300);
            let length = usize::from(u16::from_le_bytes([mail[0], mail[1]]));
            assert_eq!(mail[5] & 0x0F, 4, "file access");
            return mail[6..6 + length].to_vec();
        }
    }
    panic!("no answer");
}

#[test]
fn bootstrap_needs_its_own_mailboxes_and_keeps_files() {
    let mut rig = segment("cia402@password=7");
    rig.write(STATION, 0x0120, &[3, 0]);
    assert_eq!(rig.al_status(STATION), (0x11, 0x0015));
    rig.write(STATION, 0x0800, &BOOT_OUT);
    rig.write(STATION, 0x0808, &BOOT_IN);
    rig.write(STATION, 0x0120, &[0x13, 0]);
    assert_eq!(rig.al_status(STATION), (3, 0));
    let denied = ask(&mut rig, 1, b"\x02\0\x08\0\0\0fw.bin");
    assert_eq!(denied[..6], [5, 0, 0x0A, 0x80, 0, 0]);
    assert_eq!(ask(&mut rig, 2, b"\x02\0\x07\0\0\0fw.bin"), [4, 0, 0, 0, 0, 0]);
    let mut full = vec![3, 0, 1, 0, 0, 0];
    full.extend_from_slice(&[0xA5; 388]);
    assert_eq!(ask(&mut rig, 3, &full), [4, 0, 1, 0, 0, 0]);
    assert_eq!(ask(&mut rig, 4, &[3, 0, 2, 0, 0, 0, 1, 2, 3]), [4, 0, 2, 0, 0, 0]);
    let file = rig.bus.file(1, "fw.bin").expect("it is there");
    assert_eq!((file.len(), &file[387..]), (391, &[0xA5, 1, 2, 3][..]));
    let first = ask(&mut rig, 5, b"\x01\0\x07\0\0\0fw.bin");
    assert_eq!((first.len(), first[..6].to_vec()), (294, vec![3, 0, 1, 0, 0, 0]));
    assert_eq!(ask(&mut rig, 6, &[4, 0, 1, 0, 0, 0]).len(), 6 + 391 - 288);
    rig.write(STATION, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(STATION), (0x13, 0x0011), "only INIT leads out");
    rig.write(STATION, 0x0120, &[0x11, 0]);
    assert_eq!(rig.al_status(STATION), (1, 0));
}

#[test]
fn slaves_without_bootstrap_refuse_it() {
    let mut rig = segment("ax2000");
    rig.write(STATION, 0x0120, &[3, 0]);
    assert_eq!(rig.al_status(STATION), (0x11, 0x0013));
}

/// A drive AKD in PREOP with its mailboxes.
fn akd() -> TestRig {
    let mut rig = segment("akd");
    rig.write(STATION, 0x0800, &[0x00, 0x18, 0x00, 0x04, 0x26, 0, 1, 0]);
    rig.write(STATION, 0x0808, &[0x00, 0x1C, 0x00, 0x04, 0x22, 0, 1, 0]);
    rig.write(STATION, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(STATION), (2, 0));
    rig
}

/// Writes a CoE request; returns the answer.
fn sdo(rig: &mut TestRig, counter: u8, request: [u8; 8]) -> Vec<u8> {
    let mut message = vec![10, 0, 0, 0, 0, 3 | counter << 4, 0, 0x20];
    message.extend_from_slice(&request);
    message.resize(1024, 0);
    rig.write(STATION, 0x1800, &message);
    for _ in 0..10 {
        if rig.read(STATION, 0x080D, 1)[0] & 0x08 != 0 {
            return rig.read(STATION, 0x1C00, 1024)[8..16].to_vec();
        }
    }
    panic!("no answer");
}

#[test]
fn an_akd_has_the_registers_that_captures_show() {
    let mut rig = akd();
    assert_eq!(
        rig.read(STATION, 0x0000, 10),
        [0x04, 0x02, 0x43, 0, 3, 4, 4, 0x0F, 0x84, 0x01]
    );
    assert_eq!(rig.read(STATION, 0x0140, 2), [0x08, 0x0C]);
    assert_eq!(rig.read(STATION, 0x0502, 2), [0x20, 0x00]);
    assert_eq!(rig.read(STATION, 0x0910, 8)[4..], [0; 4], "a clock of 32 bits");
    rig.write(STATION, 0x0502, &[0x00, 0x01, 0x0A, 0, 0, 0]);
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(rig.read(STATION, 0x0508, 8), [b'D', b'K', b'A', 0, 0, 0, 0, 0]);
}

#[test]
fn the_default_assignment_of_an_akd_is_refused_and_a_fixed_one_is_not() {
    let mut rig = akd();
    let managers = |rig: &mut TestRig, bytes: u8| {
        rig.write(STATION, 0x0810, &[0x00, 0x11, bytes, 0, 0x24, 0, 1, 0]);
        rig.write(STATION, 0x0818, &[0x40, 0x11, bytes, 0, 0x20, 0, 1, 0]);
    };
    assert_eq!(
        sdo(&mut rig, 1, [0x40, 0x12, 0x1C, 0, 0, 0, 0, 0])[4],
        4,
        "0x1600 to 0x1603"
    );
    managers(&mut rig, 17);
    rig.write(STATION, 0x0120, &[4, 0]);
    assert_eq!(rig.al_status(STATION), (0x12, 0x001D));
    for (counter, index, pdo) in [(2, 0x12, [0x01, 0x17]), (5, 0x13, [0x01, 0x1B])] {
        let [low, high] = pdo;
        for (step, request) in [
            [0x2F, index, 0x1C, 0, 0, 0, 0, 0],
            [0x2B, index, 0x1C, 1, low, high, 0, 0],
            [0x2F, index, 0x1C, 0, 1, 0, 0, 0],
        ]
        .into_iter()
        .enumerate()
        {
            assert_eq!(sdo(&mut rig, counter + step as u8, request)[0], 0x60);
        }
    }
    rig.write(STATION, 0x0816, &[0]);
    rig.write(STATION, 0x081E, &[0]);
    managers(&mut rig, 6);
    rig.write(STATION, 0x0120, &[0x14, 0]);
    assert_eq!(rig.al_status(STATION), (4, 0));
}

#[test]
fn an_akd_maps_eight_bytes_into_a_pdo_and_no_more() {
    let mut rig = akd();
    let map = |rig: &mut TestRig, entries: &[[u8; 4]]| {
        let clear = sdo(rig, 1, [0x2F, 0x00, 0x16, 0, 0, 0, 0, 0]);
        assert_eq!(clear[0], 0x60);
        for (sub, [a, b, c, d]) in (1..).zip(entries) {
            assert_eq!(sdo(rig, 1 + sub, [0x23, 0x00, 0x16, sub, *a, *b, *c, *d])[0], 0x60);
        }
        sdo(rig, 5, [0x2F, 0x00, 0x16, 0, entries.len() as u8, 0, 0, 0])
    };
    let (control, target, velocity) = ([0x10, 0, 0x40, 0x60], [0x20, 0, 0x7A, 0x60], [0x20, 0, 0xFF, 0x60]);
    assert_eq!(map(&mut rig, &[control, target])[0], 0x60, "six bytes");
    let answer = map(&mut rig, &[control, target, velocity]);
    assert_eq!(
        (answer[0], &answer[4..]),
        (0x80, &[0x42, 0, 0x04, 0x06][..]),
        "ten bytes"
    );
}

#[test]
fn an_akd_answers_a_set_address_and_announces_it_16_ms_later() {
    let mut rig = akd();
    let mut message = vec![4, 0, 0, 0, 0, 2 | 1 << 4, 2, 0x01, 0, 0];
    message.resize(1024, 0);
    rig.write(STATION, 0x1800, &message);
    let mut mails = Vec::new();
    for ms in 0..40u32 {
        if rig.read(STATION, 0x080D, 1)[0] & 0x08 != 0 {
            let mail = rig.read(STATION, 0x1C00, 1024);
            mails.push((ms, mail[5] & 0x0F, mail[6]));
        }
    }
    let [(answered, 2, 3), (announced, 2, 0)] = mails[..] else {
        panic!("{mails:?}");
    };
    assert!((14..=18).contains(&(announced - answered)), "{mails:?}");
}

#[test]
fn a_processor_that_reads_the_memory_has_it_meanwhile() {
    let mut rig = segment("cia402@sii=needed@transition=20");
    rig.write(STATION, 0x0800, &[0x00, 0x10, 0x00, 0x01, 0x26, 0, 1, 0]);
    rig.write(STATION, 0x0808, &[0x00, 0x12, 0x00, 0x01, 0x22, 0, 1, 0]);
    rig.write(STATION, 0x0500, &[1]);
    assert_eq!(rig.read(STATION, 0x0501, 1), [0]);
    rig.write(STATION, 0x0120, &[2, 0]);
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(rig.read(STATION, 0x0501, 1), [1]);
    rig.write(STATION, 0x0500, &[0]);
    rig.write(STATION, 0x0502, &[0x00, 0x01, 0x08, 0, 0, 0]);
    assert_eq!(rig.read(STATION, 0x0503, 1)[0] & 0x20, 0x20, "refused");
    rig.time_us += 30_000;
    assert_eq!(rig.al_status(STATION), (2, 0));
    assert_eq!(rig.read(STATION, 0x0501, 1), [0]);
}

#[test]
fn manners_of_a_processor_change_while_it_runs() {
    let mut rig = segment("cia402");
    for fault in ["processor 1 transition 30", "processor 1 boot 50"] {
        rig.bus.inject(fault.parse::<Fault>().expect(fault));
    }
    rig.write(STATION, 0x0800, &[0x00, 0x10, 0x00, 0x01, 0x26, 0, 1, 0]);
    rig.write(STATION, 0x0808, &[0x00, 0x12, 0x00, 0x01, 0x22, 0, 1, 0]);
    rig.write(STATION, 0x0120, &[2, 0]);
    rig.time_us += 20_000;
    assert_eq!(rig.al_status(STATION), (1, 0));
    rig.time_us += 20_000;
    assert_eq!(rig.al_status(STATION), (2, 0));
}
