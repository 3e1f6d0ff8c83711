//! Clocks, cables, processors, memories and scripted faults on the complete segment.

use crate::{TestRig, motors, rig, rig_of, script};
use etherpen_segment::rig::*;
use etherpen_segment::{
    AlState, ClockOptions, DriveState, Fault, Flywheel, MailFault, MailStep, Product, Segment, SegmentOptions,
    SlaveKind,
};

const ASK: (u8, u16, u16, &[u8]) = (BRD, 0, 0x0130, &[0, 0]);

fn long(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn chain(slaves: usize, drift_max_ppm: f64) -> TestRig {
    let clocks = ClockOptions {
        drift_max_ppm,
        cable_ns: 100,
        forwarding_ns: 400,
        ..ClockOptions::default()
    };
    let mut rig = rig_of(SegmentOptions {
        clocks,
        slaves: vec![SlaveKind::Ax2000; slaves],
        ..SegmentOptions::default()
    });
    if slaves == 4 {
        rig.addresses();
    }
    rig
}

#[test]
fn port_times_show_the_way_through_the_chain() {
    let mut rig = chain(4, 0.0);
    assert_eq!(rig.ask(BWR, 0, 0x0900, &[0; 4]).1, 4);
    let times: Vec<Vec<u8>> = (0x1001..=0x1004).map(|station| rig.read(station, 0x0900, 8)).collect();
    let round = |slave: usize| long(&times[slave], 4).wrapping_sub(long(&times[slave], 0));
    assert_eq!([round(0), round(1), round(2)], [3000, 2000, 1000]);
    assert_eq!(
        &times[3][4..],
        b"hoff",
        "nothing comes back to the last one's second port: no time"
    );
}

#[test]
fn offsets_delays_and_drift_datagrams_bring_all_clocks_together() {
    let mut rig = chain(4, 50.0);
    rig.ask(BWR, 0, 0x0900, &[0; 4]);
    let mut reference = None;
    for (place, station) in (0x1001..=0x1004u16).enumerate() {
        let local = rig.read(station, 0x0918, 8);
        let local = u64::from_le_bytes(std::array::from_fn(|byte| local[byte]));
        let delay = 500 * place as u64;
        let reference = *reference.get_or_insert(local);
        rig.write(station, 0x0920, &(reference + delay).wrapping_sub(local).to_le_bytes());
        rig.write(station, 0x0928, &(delay as u32).to_le_bytes());
    }
    for _ in 0..3000 {
        assert_eq!(rig.ask(FRMW, 0x1001, 0x0910, &[0; 8]).1, 4);
    }
    for station in 0x1002..=0x1004 {
        let difference = long(&rig.read(station, 0x092C, 4), 0) & 0x7FFF_FFFF;
        assert!(difference < 200, "slave {station:#x}: {difference} ns");
    }
}

#[test]
fn a_sync_unit_is_checked_on_the_way_to_op() {
    let mut rig = chain(4, 0.0);
    rig.mailboxes();
    rig.request(2);
    rig.process_data();
    let station = 0x1002;
    rig.write(station, 0x0981, &[1]);
    rig.write(station, 0x0120, &[4, 0]);
    assert_eq!(rig.al_status(station), (0x12, 0x0030), "activated without SYNC0");
    rig.write(station, 0x0981, &[0]);
    rig.write(station, 0x09A0, &1_000_000u32.to_le_bytes());
    rig.write(station, 0x0990, &1u64.to_le_bytes());
    rig.write(station, 0x0981, &[3]);
    rig.write(station, 0x0120, &[0x14, 0]);
    assert_eq!(rig.al_status(station), (4, 0));
    rig.write(station, 0x1100, &[0; 6]);
    rig.write(station, 0x0120, &[8, 0]);
    for _ in 0..250 {
        rig.ask(FPWR, station, 0x1100, &[0; 6]);
    }
    assert_eq!(rig.al_status(station), (0x14, 0x002D), "the start has passed");
    assert_eq!(rig.read(station, 0x0984, 1)[0] & 1, 1);
    rig.write(station, 0x0981, &[0]);
    let now = rig.read(station, 0x0910, 8);
    let now = u64::from_le_bytes(std::array::from_fn(|byte| now[byte]));
    rig.write(station, 0x0990, &(now + 20_000_000).to_le_bytes());
    rig.write(station, 0x0981, &[3]);
    rig.write(station, 0x0120, &[0x14, 0]);
    for _ in 0..30 {
        rig.ask(FPWR, station, 0x1100, &[0; 6]);
    }
    rig.write(station, 0x0120, &[8, 0]);
    rig.write(station, 0x1100, &[0; 6]);
    rig.write(station, 0x1100, &[0; 6]);
    assert_eq!(rig.al_status(station), (8, 0));
    rig.write(station, 0x0981, &[0]);
    assert_eq!(rig.al_status(station), (8, 0), "free run again");
}

const PULSED: u16 = 0x1002;

/// Outputs of a drive that is to turn.
fn turning(control: u8) -> [u8; 6] {
    [0x20, 0x4E, 0, 0, control, 0]
}

/// A chain whose second slave is a drive that turns, with SYNC0 of this period.
fn pulsed(cycle_ns: u32) -> TestRig {
    let mut rig = chain(4, 0.0);
    rig.mailboxes();
    rig.request(2);
    assert_eq!(rig.download(PULSED, 0x6060, 0, &[0xFE]), 0);
    rig.process_data();
    let now = rig.read(PULSED, 0x0910, 8);
    let now = u64::from_le_bytes(std::array::from_fn(|byte| now[byte]));
    rig.write(PULSED, 0x09A0, &cycle_ns.to_le_bytes());
    rig.write(PULSED, 0x0990, &(now + 20_000_000).to_le_bytes());
    rig.write(PULSED, 0x0981, &[3]);
    rig.write(PULSED, 0x0120, &[4, 0]);
    for _ in 0..30 {
        rig.ask(FPWR, PULSED, 0x1100, &turning(0));
    }
    rig.write(PULSED, 0x0120, &[8, 0]);
    for control in [6, 7, 15] {
        for _ in 0..25 {
            rig.write(PULSED, 0x1100, &turning(control));
        }
    }
    assert_eq!(rig.bus.slaves()[1].drive, DriveState::OperationEnabled);
    rig
}

#[test]
fn a_drive_takes_outputs_and_shows_inputs_at_the_pulses_only() {
    let mut rig = pulsed(10_000_000);
    let mut positions = Vec::new();
    for _ in 0..50 {
        rig.write(PULSED, 0x1100, &turning(15));
        positions.push(rig.read(PULSED, 0x1140, 4));
    }
    let changes = positions.windows(2).filter(|pair| pair[0] != pair[1]).count();
    assert!((9..=11).contains(&changes), "{changes} changes in 100 ms");
}

#[test]
fn a_motor_turns_as_fast_whatever_the_period_of_sync0_is() {
    let turned = |cycle_ns: u32| {
        let mut rig = pulsed(cycle_ns);
        let before_rad = motors(&rig)[1].angle_rad;
        for _ in 0..1_000 {
            rig.write(PULSED, 0x1100, &turning(15));
        }
        motors(&rig)[1].angle_rad - before_rad
    };
    let right_rad = turned(1_000_000);
    assert!(right_rad > 1.0, "{right_rad}");
    for cycle_ns in [
        125_000, 250_000, 500_000, 1_234_567, 1_500_000, 2_000_000, 2_500_000, 4_000_000,
    ] {
        let part = turned(cycle_ns) / right_rad;
        assert!((0.99..1.01).contains(&part), "{cycle_ns} ns: {part}");
    }
}

#[test]
fn outputs_that_come_behind_the_pulse_wait_for_the_next_one() {
    const STOP: [u8; 6] = [0, 0, 0, 0, 15, 0];
    // How far the motor turns if the outputs that stop it come so long behind a pulse, us.
    let turned = |behind_us: i64| {
        let mut rig = pulsed(4_000_000);
        let begun_us = rig.time_us;
        let time = |bytes: Vec<u8>| u64::from_le_bytes(std::array::from_fn(|byte| bytes[byte]));
        let now_ns = time(rig.read(PULSED, 0x0910, 8));
        // The pulse of three periods later.
        let ahead_ns = time(rig.read(PULSED, 0x0990, 8)) + 12_000_000 - now_ns;
        let before_rad = motors(&rig)[1].angle_rad;
        let at_us = begun_us.saturating_add_signed(ahead_ns as i64 / 1_000 + behind_us);
        while rig.time_us + 1_000 < at_us {
            rig.write(PULSED, 0x1100, &turning(15));
        }
        rig.time_us = at_us;
        rig.write(PULSED, 0x1100, &STOP);
        for _ in 0..30 {
            rig.write(PULSED, 0x1100, &STOP);
        }
        motors(&rig)[1].angle_rad - before_rad
    };
    let early_rad = turned(-3);
    for late_us in [1, 5, 900] {
        let more_rad = turned(late_us) - early_rad;
        let period_rad = early_rad * 4.0 / 12.0;
        println!("{late_us} us: {more_rad} of {period_rad} rad");
        assert!((0.5..1.5).contains(&(more_rad / period_rad)));
    }
}

#[test]
fn a_damaged_frame_is_counted_where_the_cable_ends_and_forwarded_behind() {
    let mut rig = chain(4, 0.0);
    rig.bus.inject(Fault::Crc(2, 3));
    rig.time_us += 2_000;
    rig.bus.advance_to(rig.time_us);
    for _ in 0..3 {
        assert!(rig.send(&frame_of(&[ASK])).is_empty());
    }
    assert_eq!(rig.send(&frame_of(&[ASK])).len(), 1);
    assert_eq!(rig.read(0x1002, 0x0300, 12), [0; 12]);
    assert_eq!(rig.read(0x1003, 0x0300, 12), [3, 3, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(rig.read(0x1004, 0x0300, 12), [3, 0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0]);
    rig.write(0x1003, 0x0300, &[0; 8]);
    assert_eq!(rig.read(0x1003, 0x0300, 2), [0, 0]);
    assert_eq!(rig.bus.injected().get("crc"), Some(&1));
}

#[test]
fn a_hung_processor_lets_its_watchdog_expire_and_the_controller_work() {
    let mut rig = chain(4, 0.0);
    rig.write(0x1002, 0x0400, &2498u16.to_le_bytes());
    rig.write(0x1002, 0x0410, &100u16.to_le_bytes());
    assert_eq!(rig.read(0x1002, 0x0110, 1)[0] & 3, 3);
    rig.bus.inject(Fault::Processor(2, 40));
    rig.write(0x1002, 0x0120, &[2, 0]);
    for _ in 0..20 {
        assert_eq!(rig.al_status(0x1002).0, 1, "no answer to the request");
    }
    assert_eq!(rig.read(0x1002, 0x0110, 1)[0] & 3, 1);
    assert_eq!(rig.read(0x1002, 0x0443, 1), [1]);
    for _ in 0..30 {
        rig.send(&frame_of(&[ASK]));
    }
    assert_eq!(rig.al_status(0x1002), (0x11, 0x0016), "the request was still there");
    assert_eq!(rig.read(0x1002, 0x0110, 1)[0] & 3, 3);
}

#[test]
fn faults_of_a_reply_change_what_they_say() {
    let text = "frame 1 overlong 7\nframe 2 type 4\nframe 3 more\nframe 4 circulate\nframe 5 vlan\nframe 6 reflect";
    let mut rig = script(text);
    let ask = frame_of(&[ASK]);
    let replies: Vec<_> = (0..6).map(|_| rig.send(&ask)).collect();
    assert_eq!(replies[0][0].len(), ask.len() + 7);
    assert_eq!(replies[0][0][14], ask[14] + 7);
    assert_eq!(replies[1][0][15] >> 4, 4);
    assert_eq!(replies[2][0][23] & 0x80, 0x80);
    assert_eq!(replies[3][0][23] & 0x40, 0x40);
    assert_eq!(replies[4][0][12..18], [0x81, 0x00, 0x00, 0x01, 0x88, 0xA4]);
    assert_eq!((replies[5].len(), &replies[5][0]), (2, &ask));
    let counts: Vec<_> = rig.bus.injected().iter().map(|(name, count)| (*name, *count)).collect();
    assert_eq!(
        counts,
        ["circulate", "more", "overlong", "reflect", "type", "vlan"].map(|name| (name, 1))
    );
}

#[test]
fn mailbox_faults_happen_at_their_step() {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    rig.request(2);
    let station = 0x1001;
    rig.bus.inject(Fault::Mailbox(
        1,
        MailStep::Object(0x6060, 0),
        MailFault::Abort(0x0800_0020),
    ));
    rig.bus
        .inject(Fault::Mailbox(1, MailStep::Request(2), MailFault::Flood(3)));
    rig.bus.inject(Fault::Mailbox(1, MailStep::Request(3), MailFault::Lost));
    rig.send(&frame_of(&[ASK]));
    assert_eq!(
        outcome(&rig.upload(station, 0x1000, 0)),
        0,
        "the first step is untouched"
    );
    rig.post(station, &[0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    for _ in 0..3 {
        assert_eq!(rig.fetch(station)[..4], [0, 0x10, 0x00, 0xFF]);
    }
    assert_eq!(rig.fetch(station)[2], 0x43);
    rig.post(station, &[0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    for _ in 0..5 {
        assert_eq!(rig.read(station, 0x080D, 1)[0] & 8, 0, "lost");
    }
    rig.write(station, 0x080E, &[0x03]);
    assert_eq!(rig.fetch(station)[2], 0x43, "the repeat brings it");
    assert_eq!(outcome(&rig.upload(station, 0x6060, 0)), 0x0800_0020);
    assert_eq!(outcome(&rig.upload(station, 0x6060, 0)), 0, "once");
}

#[test]
fn a_refused_state_and_a_swapped_slave_are_of_one_slave() {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    rig.bus.inject(Fault::Refuse(3, AlState::PreOperational, 0x8001));
    rig.send(&frame_of(&[ASK]));
    rig.request(2);
    assert_eq!((rig.al_status(0x1002), rig.al_status(0x1003)), ((2, 0), (0x11, 0x8001)));
    rig.request(0x12);
    assert_eq!(rig.al_status(0x1003), (2, 0));
    let before = motors(&rig);
    rig.bus.inject(Fault::Swap(2, Product::Ek1100));
    rig.send(&frame_of(&[ASK]));
    rig.send(&frame_of(&[ASK]));
    assert_eq!(rig.ask(FPRD, 0x1002, 0x0130, &[0; 2]).1, 0, "it has no station address");
    assert_eq!(rig.ask(APRD, 0u16.wrapping_sub(1), 0x0140, &[0; 2]), (vec![0, 0x0D], 1));
    assert_eq!(motors(&rig), before, "the motors stay where they are");
}

#[test]
fn a_payload_without_envelope_is_answered_without_envelope() {
    let options = SegmentOptions {
        slaves: vec![SlaveKind::Ax2000; 4],
        ..SegmentOptions::default()
    };
    let mut segment = Segment::new(&options, Flywheel::default());
    let frame = frame_of(&[ASK]);
    let replies = segment.payload(1_000, &frame[14..30]);
    assert_eq!(replies.len(), 1);
    assert_eq!((replies[0].len(), replies[0][14]), (16, 4));
    assert!(segment.payload(2_000, &[0x10]).is_empty());
}
