//! Frames, registers, states, mailboxes and motions of four drives.

use crate::{four_drives, motors, rig, rig_of, script};
use etherpen_segment::capture::Capture;
use etherpen_segment::random::Random;
use etherpen_segment::rig::*;
use etherpen_segment::{
    AX2000_NAME, AlState, CATCH_UP_MS_MAX, DriveOptions, DriveState, Fault, Flywheel, ResolverFault, Segment,
    SegmentOptions,
};

#[test]
fn a_broadcast_read_counts_the_slaves_and_marks_the_source_address() {
    let mut rig = rig();
    let replies = rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    let (data, count) = content(&replies[0], 2);
    assert_eq!((data, count), (vec![1, 0], 4));
    assert_eq!(replies[0][6], 0x12);
    assert_eq!(
        replies[0][DATA - 8..DATA - 6],
        [4, 0],
        "each slave counts the position up"
    );
}

#[test]
fn a_changed_link_is_reported_in_the_interrupt_field_until_it_is_read() {
    let mut rig = rig();
    rig.addresses();
    let ask = frame_of(&[(BRD, 0, 0x0130, &[0, 0])]);
    let event = |rig: &mut crate::TestRig| rig.send(&ask)[0][DATA - 2..DATA].to_vec();
    assert_eq!(event(&mut rig), [0, 0], "masked");
    rig.ask(BWR, 0, 0x0200, &[4, 0]);
    assert_eq!(event(&mut rig), [4, 0], "since power-up");
    for station in 0x1001..=0x1004 {
        assert_eq!(event(&mut rig), [4, 0]);
        rig.read(station, if station % 2 == 0 { 0x0110 } else { 0x0111 }, 1);
    }
    assert_eq!(event(&mut rig), [0, 0]);
    rig.bus.inject(Fault::Cut(2));
    rig.send(&ask);
    rig.send(&ask);
    assert_eq!(event(&mut rig), [4, 0]);
    rig.read(0x1002, 0x0110, 2);
    assert_eq!(event(&mut rig), [0, 0]);
}

#[test]
fn a_broken_or_foreign_frame_is_ignored() {
    let good = frame_of(&[(BRD, 0, 0x0130, &[0, 0]), (LRW, 0, 0, &[0; 30])]);
    let mut rig = rig();
    let mut random = Random::new(11);
    for length in 0..good.len() {
        rig.bus.frame(0, &good[..length]);
    }
    for _ in 0..20_000 {
        let mut frame = good.clone();
        for _ in 0..=random.bits() % 4 {
            let at = (random.bits() % frame.len() as u64) as usize;
            frame[at] = random.bits() as u8;
        }
        rig.bus.frame(0, &frame);
    }
    let mut arp = good;
    (arp[12], arp[13]) = (0x08, 0x06);
    assert!(rig.send(&arp).is_empty());
}

#[test]
fn the_information_memory_is_read_through_its_registers() {
    let mut rig = rig();
    rig.addresses();
    for (word, expected) in [
        (0x08u32, [2, 0, 0, 0, 0x14, 0x60, 0xD0, 0x07]),
        (0x0C, [0x0A, 0x11, 0, 0, 3, 0, 0, 0]),
    ] {
        let mut command = vec![0x00, 0x01];
        command.extend_from_slice(&word.to_le_bytes());
        rig.write(0x1003, 0x0502, &command);
        assert_eq!(rig.read(0x1003, 0x0502, 2), [0x40, 0x00]);
        assert_eq!(rig.read(0x1003, 0x0508, 8), expected);
    }
}

#[test]
fn hand_made_frames_bring_the_drives_from_init_to_op() {
    let mut rig = rig();
    rig.bring_up();
    let angles = motors(&rig);
    assert!(
        rig.bus
            .slaves()
            .iter()
            .all(|slave| slave.al_state == AlState::Operational)
    );
    let (positions, status) = rig.cycle([0; 4], 0x0F);
    assert!(status.iter().all(|status| status & 0x6F == 0x27), "{status:x?}");
    for (position, motor) in positions.iter().zip(angles) {
        let turns = motor.angle_rad / std::f64::consts::TAU;
        let expected = (turns * f64::from(1 << 20)).floor().rem_euclid(f64::from(1 << 20));
        assert_eq!(f64::from(*position), expected, "slave {}", motor.slave);
    }
}

#[test]
fn a_step_up_without_its_configuration_is_refused_with_its_code() {
    let mut rig = rig();
    rig.addresses();
    rig.request(2);
    assert_eq!(rig.al_status(0x1001), (0x11, 0x0016));
    rig.mailboxes();
    rig.request(0x11);
    rig.request(2);
    rig.request(4);
    assert_eq!(rig.al_status(0x1001), (0x12, 0x001D));
    rig.request(0x12);
    rig.process_data();
    rig.request(4);
    rig.request(8);
    for _ in 0..250 {
        rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    }
    assert_eq!(rig.al_status(0x1001), (0x14, 0x001B));
}

#[test]
fn silence_of_the_bus_stops_the_motors_and_leaves_op() {
    let mut rig = rig();
    rig.bring_up();
    for _ in 0..50 {
        rig.cycle([60_000; 4], 0x0F);
    }
    let before = motors(&rig);
    assert!(before.iter().all(|motor| motor.speed_rad_s > 36.0), "{before:?}");
    let last_us = rig.time_us - 1000;
    rig.bus.advance_to(last_us + 9_600);
    assert!(
        rig.bus
            .slaves()
            .iter()
            .all(|slave| slave.drive == DriveState::OperationEnabled)
    );
    rig.bus.advance_to(last_us + 10_600);
    let (expired, slaves) = (motors(&rig), rig.bus.slaves());
    assert!(slaves.iter().all(|slave| slave.al_state == AlState::SafeOperational));
    assert!(slaves.iter().all(|slave| slave.al_status_code == 0x001B));
    rig.bus.advance_to(last_us + 100_000);
    let (stopped, slaves) = (motors(&rig), rig.bus.slaves());
    assert!(stopped.iter().all(|motor| motor.speed_rad_s == 0.0), "{stopped:?}");
    assert!(
        slaves
            .iter()
            .all(|slave| (slave.drive, slave.drive_error) == (DriveState::Fault, 0x8130))
    );
    rig.time_us = last_us + 101_000;
    assert_eq!(rig.al_status(0x1002), (0x14, 0x001B));
    let ramp_rad = before[0].speed_rad_s.powi(2) / (2.0 * DriveOptions::default().quick_stop_rad_s2);
    let way_rad = stopped[0].angle_rad - expired[0].angle_rad;
    assert!(
        (way_rad - ramp_rad).abs() < 0.1 * ramp_rad,
        "{way_rad} after a ramp of {ramp_rad}"
    );
}

#[test]
fn a_velocity_step_answers_with_the_bandwidth_and_the_delays() {
    for (bandwidth_hz, delay) in [(50.0, 0), (100.0, 1), (200.0, 2)] {
        let drive = DriveOptions {
            bandwidth_hz,
            input_delay_ms: delay,
            output_delay_ms: delay,
            ..DriveOptions::default()
        };
        let mut rig = rig_of(SegmentOptions {
            drives: vec![drive; 4],
            ..four_drives()
        });
        rig.bring_up();
        let digits = 20_000;
        let start = rig.cycle([0; 4], 0x0F).0[0];
        let rate = std::f64::consts::TAU * bandwidth_hz;
        let increments_s = f64::from(digits) * 1_875.0 / 262_144.0 / 60.0 * f64::from(1 << 20);
        for cycle in 0..30 {
            let (positions, _) = rig.cycle([digits; 4], 0x0F);
            let time_s = (f64::from(cycle) - 2.0 * delay as f64).max(0.0) * 1e-3;
            let expected = increments_s * (time_s - (1.0 - (-rate * time_s).exp()) / rate);
            let moved = f64::from((positions[0] - start).rem_euclid(1 << 20));
            assert!(
                (moved - expected).abs() < 2.0,
                "{bandwidth_hz} Hz, cycle {cycle}: {moved} {expected}"
            );
        }
    }
}

#[test]
fn objects_are_read_written_and_refused_with_the_right_codes() {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    rig.request(2);
    let station = 0x1001;
    assert_eq!(
        rig.upload(station, 0x1018, 2),
        [0x43, 0x18, 0x10, 2, 0x14, 0x60, 0xD0, 0x07]
    );
    let name = rig.upload(station, 0x1008, 0);
    assert_eq!((name[0], &name[8..]), (0x41, AX2000_NAME.as_bytes()));
    assert_eq!(outcome(&rig.upload(station, 0x1018, 9)), 0x0609_0011);
    assert_eq!(outcome(&rig.upload(station, 0x5555, 0)), 0x0602_0000);
    assert_eq!(rig.download(station, 0x1000, 0, &[0; 4]), 0x0601_0002);
    assert_eq!(rig.download(station, 0x6060, 0, &[0, 0]), 0x0607_0012);
    assert_eq!(rig.download(station, 0x6085, 0, &[1]), 0x0607_0013);
    assert_eq!(rig.download(station, 0x6060, 0, &[9]), 0x0609_0030);
    assert_eq!(rig.download(station, 0x1C12, 1, &[2, 0x17]), 0x0601_0003);
    assert_eq!(rig.download(station, 0x1C12, 0, &[0]), 0);
    assert_eq!(rig.download(station, 0x1C12, 1, &[4, 0x17]), 0x0604_0041);
    assert_eq!(rig.download(station, 0x1C12, 1, &[2, 0x17]), 0);
    assert_eq!(rig.download(station, 0x1C12, 0, &[1]), 0);
    let complete = |sub| [0x50, 0x18, 0x10, sub, 0, 0, 0, 0];
    let identity = rig.sdo(station, &complete(0));
    assert_eq!(identity[8..14], [4, 0, 2, 0, 0, 0], "sub-index 0 takes 16 bits");
    assert_eq!(rig.sdo(station, &complete(1))[8..], identity[10..]);
    assert_eq!(outcome(&rig.sdo(station, &complete(2))), 0x0601_0000);
}

#[test]
fn a_long_object_travels_in_segments_both_ways() {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    rig.request(2);
    let station = 0x1002;
    let text: Vec<u8> = (0..1200u32).map(|n| (n * 7) as u8).collect();
    let mut sdo = vec![0x21, 0xFE, 0x2F, 0];
    sdo.extend_from_slice(&1200u32.to_le_bytes());
    sdo.extend_from_slice(&text[..400]);
    assert_eq!(rig.sdo(station, &sdo)[0], 0x60);
    for (command, part) in [(0x00, &text[400..800]), (0x11, &text[800..])] {
        let mut sdo = vec![command];
        sdo.extend_from_slice(part);
        assert_eq!(rig.sdo(station, &sdo)[0], 0x20 | command & 0x10);
    }
    let first = rig.upload(station, 0x2FFE, 0);
    let mut read = first[8..].to_vec();
    for toggle in [0x00, 0x10] {
        let part = rig.sdo(station, &[0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(part[0] & 0x10, toggle);
        read.extend_from_slice(&part[1..]);
        assert_eq!(part[0] & 1 != 0, read.len() == 1200, "the last part says so");
    }
    assert_eq!(read, text);
    assert_eq!(outcome(&rig.sdo(station, &[0x60, 0, 0, 0, 0, 0, 0, 0])), 0x0504_0001);
}

#[test]
fn a_lost_answer_is_fetched_again_by_the_repeat_bit() {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    rig.request(2);
    let answer = rig.upload(0x1001, 0x1000, 0);
    rig.write(0x1001, 0x080E, &[0x03]);
    assert_eq!(rig.read(0x1001, 0x080F, 1)[0] & 0x02, 0x02);
    assert_eq!(rig.fetch(0x1001)[2..], answer);
}

#[test]
fn a_drive_fault_sends_an_emergency_and_stops_that_drive() {
    let mut rig = rig();
    rig.bring_up();
    rig.bus.inject(Fault::Drive(2, 0x2310));
    for _ in 0..20 {
        rig.cycle([0; 4], 0x0F);
    }
    let (_, status) = rig.cycle([0; 4], 0x0F);
    assert_eq!(status.map(|status| status & 0x4F), [0x07, 0x08, 0x07, 0x07]);
    assert_eq!(rig.fetch(0x1002), [0, 0x10, 0x10, 0x23, 1, 0, 0, 0, 0, 0]);
}

#[test]
fn logical_reads_and_writes_count_three_and_one_reads_others_write() {
    let mut rig = rig();
    rig.bring_up();
    let frame = frame_of(&[(LRW, 0, 1, &[0; 0x40 + 24])]);
    let replies = rig.send(&frame);
    assert_eq!(content(&replies[0], 0x40 + 24).1, 12);
    let (_, count) = rig.ask(FRMW, 0x1002, 0x0910, &[0; 4]);
    assert_eq!(count, 4);
    let (data, count) = rig.ask(APRD, 0u16.wrapping_sub(3), 0x0010, &[0, 0]);
    assert_eq!((data, count), (vec![0x04, 0x10], 1));
}

#[test]
fn a_pulled_cable_a_bypass_and_a_power_cycle_shorten_the_chain() {
    let mut rig = script("ms 10 cut 2\nms 20 join\nms 30 remove 1\nms 40 insert 1\nms 50 power 4 15");
    rig.addresses();
    let mut counts = Vec::new();
    while rig.bus.time_ms() < 70 {
        let count = rig.ask(BRD, 0, 0x0130, &[0, 0]).1;
        counts.push((rig.bus.time_ms(), count));
    }
    let at = |ms: u64| {
        counts
            .iter()
            .find(|(time_ms, _)| *time_ms == ms)
            .map(|(_, count)| *count)
    };
    assert_eq!([9, 12, 22, 32, 42, 52, 68].map(at), [4, 2, 4, 3, 4, 3, 4].map(Some));
    assert_eq!(
        rig.ask(FPRD, 0x1004, 0x0130, &[0, 0]).1,
        0,
        "the station address is gone"
    );
    assert_eq!(rig.ask(FPRD, 0x1003, 0x0130, &[0, 0]).1, 1);
    cut_at_the_master();
}

fn cut_at_the_master() {
    let mut rig = script("frame 1 cut 0");
    assert!(rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])])).is_empty());
}

#[test]
fn frame_faults_do_what_they_say() {
    let text = "frame 1 drop\nframe 2 lose\nframe 3 duplicate\nframe 4 truncate 30\nframe 5 index 3\n\
                frame 6 foreign\nframe 7 counter -1\nframe 8 delay 2\nframe 11..12 drop\nms 14 stall 3";
    let mut rig = script(text);
    let ask = frame_of(&[(BRD, 0, 0x0130, &[0, 0])]);
    let replies: Vec<_> = (0..20).map(|_| rig.send(&ask)).collect();
    let counts: Vec<_> = replies.iter().map(Vec::len).collect();
    assert_eq!(counts[..12], [0, 0, 2, 1, 1, 2, 1, 0, 1, 2, 0, 0]);
    assert_eq!(counts[12..], [1, 1, 0, 0, 0, 1, 1, 1], "three milliseconds of silence");
    assert_eq!(replies[3][0].len(), 30);
    assert_eq!(replies[4][0][17], 3);
    assert_eq!(replies[5][0][12..14], [0x88, 0xB5]);
    assert_eq!(content(&replies[6][0], 2).1, 3);
}

#[test]
fn a_stuck_resolver_moves_again_and_a_retreat_is_of_one_slave() {
    let mut rig = rig();
    rig.bring_up();
    rig.bus.inject(Fault::Resolver(1, ResolverFault::Stuck, 10));
    rig.cycle([20_000; 4], 0x0F);
    let stuck: Vec<i32> = (0..8).map(|_| rig.cycle([20_000; 4], 0x0F).0[0]).collect();
    assert!(stuck[3..].iter().all(|position| *position == stuck[3]), "{stuck:?}");
    for _ in 0..10 {
        rig.cycle([20_000; 4], 0x0F);
    }
    assert_ne!(rig.cycle([20_000; 4], 0x0F).0[0], stuck[7]);
    rig.bus.inject(Fault::Retreat(3, 0x0027));
    rig.cycle([0; 4], 0x0F);
    assert_eq!(rig.al_status(0x1003), (0x14, 0x0027));
    assert_eq!(rig.al_status(0x1001), (8, 0));
}

#[test]
fn a_silent_mailbox_answers_when_its_time_is_over() {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    rig.request(2);
    rig.bus.inject(Fault::Silence(2, 20));
    let upload = [0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0];
    rig.post(0x1002, &upload);
    for _ in 0..18 {
        assert_eq!(rig.read(0x1002, 0x080D, 1)[0] & 0x08, 0);
    }
    assert_eq!(rig.fetch(0x1002)[2..], [0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00]);
}

#[test]
fn no_registers_mailboxes_or_frames_break_the_segment() {
    let seed = 23;
    println!("seed {seed}");
    let mut random = Random::new(seed);
    let mut rig = rig();
    rig.bring_up();
    let registers = [
        0x0010, 0x0120, 0x0400, 0x0500, 0x0502, 0x0600, 0x0800, 0x0F80, 0x1000, 0x1800, 0x1C00, 0x2FF0,
    ];
    for _ in 0..30_000 {
        let length = [1, 2, 4, 8, 16, 64, 512][(random.bits() % 7) as usize];
        let mut data: Vec<u8> = (0..length).map(|_| random.bits() as u8).collect();
        let register = registers[(random.bits() % 12) as usize] + (random.bits() % 20) as u16;
        if register & !3 == 0x1800 && length > 8 {
            let kind = 3 | data[5] & 0xF0;
            data[..8].copy_from_slice(&[10, 0, 0, 0, 0, kind, 0, 0x20]);
        }
        let command = (random.bits() % 16) as u8;
        let device = [0, 0xFFFF, 0x1001, 0x1003][(random.bits() % 4) as usize];
        rig.send(&frame_of(&[(command, device, register, &data)]));
    }
    rig.bus.inject(Fault::Join);
    // Loops may be closed and controllers reset: power-up ends that.
    (1..=4).for_each(|slave| rig.bus.inject(Fault::Power(slave, 1)));
    rig.time_us += 5_000;
    assert_eq!(rig.ask(BRD, 0, 0x0130, &[0, 0]).1, 4);
}

#[test]
fn a_clock_that_jumps_or_runs_back_is_survived() {
    let mut segment = Segment::new(&four_drives(), Flywheel::default());
    segment.advance_to(1_000_000);
    segment.advance_to(1_010_000);
    segment.advance_to(0);
    assert_eq!(segment.time_ms(), 10);
    segment.advance_to(1 << 60);
    assert_eq!(segment.time_ms(), 10 + CATCH_UP_MS_MAX + 1, "a jump is passed over");
}

#[test]
fn tshark_finds_ethercat_and_nothing_malformed_in_a_capture() {
    let mut rig = rig();
    rig.capture = Some(Capture::new(Vec::new()).expect("memory"));
    rig.bring_up();
    for _ in 0..20 {
        rig.cycle([1000; 4], 0x0F);
    }
    let file = rig.capture.take().expect("set").finish().expect("memory");
    let path = std::env::temp_dir().join(format!("segment-capture-{}.pcapng", std::process::id()));
    std::fs::write(&path, file).expect("a temporary file");
    let count = |filter: &str| {
        let output = std::process::Command::new("tshark")
            .arg("-r")
            .arg(&path)
            .args(["-Y", filter, "-T", "fields", "-e", "frame.number"])
            .output();
        output.ok().map(|output| {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            String::from_utf8_lossy(&output.stdout).lines().count()
        })
    };
    let damaged = count("_ws.malformed || _ws.expert.severity >= \"Error\"");
    let counts = (damaged, count("ecat"), count("ecat_mailbox.coe"));
    std::fs::remove_file(&path).expect("the file just written");
    let (Some(damaged), Some(frames), Some(mails)) = counts else {
        eprintln!("tshark is not installed: nothing was dissected");
        return;
    };
    assert_eq!(damaged, 0);
    assert!(frames > 100 && mails > 8, "{frames} frames, {mails} with mail");
}
