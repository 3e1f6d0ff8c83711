//! Slaves without a processor: couplers and terminals whose controller emulates the device.

use crate::{TestRig, rig_of};
use etherpen_segment::random::Random;
use etherpen_segment::rig::*;
use etherpen_segment::{AlState, Fault, PlaceOptions, SegmentOptions, SlaveKind, SlaveList, parse_slaves};

/// Place of the datagram's data in a frame of one datagram.
const LOGICAL: u16 = 0x0000;

fn segment(list: &str) -> TestRig {
    addressed(parse_slaves(list).expect("a list"))
}

fn addressed(slaves: Vec<SlaveKind>) -> TestRig {
    let mut rig = rig_of(SegmentOptions {
        slaves,
        ..SegmentOptions::default()
    });
    for position in 0..rig.bus.slaves().len() as u16 {
        let station = 0x1001 + position;
        let written = rig.ask(APWR, 0u16.wrapping_sub(position), 0x0010, &station.to_le_bytes());
        assert_eq!(written.1, 1);
    }
    rig
}

/// Maps `bits` bits from a bit of the logical byte 0 to the first bit of a physical address; `kind` 1 reads, 2 writes.
fn fmmu(first_bit: u8, bits: u8, physical: u16, kind: u8) -> [u8; 16] {
    let [low, high] = physical.to_le_bytes();
    let last_bit = first_bit + bits - 1;
    [
        0,
        0,
        0,
        0,
        last_bit / 8 + 1,
        0,
        first_bit,
        last_bit % 8,
        low,
        high,
        0,
        kind,
        1,
        0,
        0,
        0,
    ]
}

/// EK1100, EL1004, EL2004: inputs in bits 0 to 3 and outputs in bits 4 to 7 of one logical byte.
fn station_of_three() -> TestRig {
    let mut rig = segment("ek1100,el1004,el2004");
    rig.write(0x1002, 0x0800, &[0x00, 0x10, 1, 0, 0x00, 0, 1, 0]);
    rig.write(0x1002, 0x0600, &fmmu(0, 4, 0x1000, 1));
    rig.write(0x1003, 0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 9, 0]);
    rig.write(0x1003, 0x0600, &fmmu(4, 4, 0x0F00, 2));
    rig
}

fn exchange(rig: &mut TestRig, outputs: u8) -> (u8, u16) {
    let (data, count) = rig.ask(LRW, LOGICAL, 0, &[outputs]);
    (data[0], count)
}

#[test]
fn the_silicon_answers_a_state_request_in_the_same_frame_and_echoes_the_acknowledgement() {
    let mut rig = segment("ek1100,el1004,el2004");
    let status = |rig: &mut TestRig, request: &[u8]| {
        let frame = frame_of(&[(BWR, 0, 0x0120, request), (FPRD, 0x1002, 0x0130, &[0; 6])]);
        let replies = rig.send(&frame);
        let second = DATA + request.len() + 2 + 10;
        (
            content(&replies[0], request.len()).1,
            replies[0][second..second + 6].to_vec(),
        )
    };
    for (request, shown) in [
        ([0x11, 0], 0x11),
        ([0x12, 0], 0x12),
        ([0x02, 0], 0x02),
        ([0x08, 0], 0x08),
        ([0x01, 0], 0x01),
        ([0x08, 0xFF], 0x08),
        ([0x31, 0], 0x11),
    ] {
        assert_eq!(status(&mut rig, &request), (3, vec![shown, 0, 0, 0, 0, 0]));
        assert_eq!(status(&mut rig, &request).0, 3, "never unread");
    }
    assert_eq!(status(&mut rig, &[0x11]).0, 3, "one byte is enough");
}

#[test]
fn init_to_op_takes_one_write_and_the_segment_shows_it() {
    let mut rig = segment("ek1100,el2004,ax2000");
    for station in [0x1001, 0x1002] {
        rig.write(station, 0x0120, &[8, 0]);
        assert_eq!(rig.al_status(station), (8, 0));
    }
    let states: Vec<AlState> = rig.bus.slaves().iter().map(|slave| slave.al_state).collect();
    assert_eq!(states, [AlState::Operational, AlState::Operational, AlState::Init]);
    rig.write(0x1003, 0x0120, &[8, 0]);
    assert_eq!(rig.al_status(0x1003), (0x11, 0x0011), "a drive has a processor");
}

#[test]
fn emulation_comes_from_the_information_memory_with_its_checksum() {
    let mut rig = segment("ek1100,el1008,ax2000");
    assert_eq!(rig.read(0x1001, 0x0140, 2), [0x00, 0x0D]);
    assert_eq!(rig.read(0x1002, 0x0140, 2), [0x04, 0x01]);
    assert_eq!(rig.read(0x1003, 0x0140, 2), [0x08, 0x0C]);
    assert_eq!(rig.read(0x1001, 0x0110, 1)[0] & 3, 1, "no process interface");
    assert_eq!(rig.read(0x1002, 0x0110, 1)[0] & 3, 3);
    let mut image = vec![0; 128];
    image[1] = 1;
    image[14] = 1;
    let mut rig = addressed(vec![SlaveKind::Sii(image.into())]);
    assert_eq!(rig.read(0x1001, 0x0140, 2), [0, 0], "a wrong checksum");
    rig.write(0x1001, 0x0120, &[8, 0]);
    assert_eq!(rig.al_status(0x1001), (0x11, 0x0011), "a processor refuses");
}

#[test]
fn the_registers_of_each_silicon_are_there_and_those_beyond_are_not() {
    let mut rig = segment("ek1100,el1004,el2004,cia402");
    for (station, from_4, features) in [
        (0x1001, [8, 8, 8, 0x3B], [0xFC, 0x00]),
        (0x1002, [3, 4, 1, 0x4A], [0xFC, 0x01]),
        (0x1003, [3, 4, 1, 0x4A], [0xFC, 0x01]),
        (0x1004, [8, 8, 8, 0x0F], [0xCC, 0x01]),
    ] {
        assert_eq!(rig.read(station, 0x0004, 4), from_4, "{station:#x}");
        assert_eq!(rig.read(station, 0x0008, 2), features, "{station:#x}");
    }
    assert_eq!(rig.read(0x1001, 0x0000, 2), [0x11, 0x00]);
    assert_eq!(rig.ask(BRD, 0, 0x0000, &[0, 0]).0, [0x13, 0x01]);
    let counts = |rig: &mut TestRig, register, length: usize| -> Vec<u16> {
        (0..8)
            .map(|unit| rig.ask(BWR, 0, register + unit * length as u16, &vec![0; length]).1)
            .collect()
    };
    assert_eq!(counts(&mut rig, 0x0600, 16), [4, 4, 4, 2, 2, 2, 2, 2]);
    assert_eq!(counts(&mut rig, 0x0800, 8), [4, 4, 4, 4, 2, 2, 2, 2]);
    assert_eq!(rig.ask(BWR, 0, 0x0600, &[0; 256]).1, 4, "a part of it exists");
    assert_eq!(rig.ask(BWR, 0, 0x0680, &[0; 16]).1, 0, "no silicon has a ninth unit");
    assert_eq!(rig.ask(FPRD, 0x1002, 0x1400, &[0]).1, 0, "behind one KiB");
    assert_eq!(rig.ask(FPRD, 0x1001, 0x1400, &[0]).1, 1);
}

#[test]
fn a_terminal_latches_receive_times_and_has_no_system_time() {
    let mut rig = segment("ek1100,el1004,el2004,ax2000");
    assert_eq!(rig.ask(BWR, 0, 0x0900, &[0; 4]).1, 4);
    let times = rig.read(0x1002, 0x0900, 16);
    assert_ne!((&times[..4], &times[4..8]), ([0; 4].as_slice(), [0; 4].as_slice()));
    for (register, length) in [
        (0x0910, 8),
        (0x0918, 8),
        (0x0920, 8),
        (0x0928, 4),
        (0x0930, 2),
        (0x0980, 2),
        (0x09A0, 8),
    ] {
        assert_eq!(
            rig.ask(FPRD, 0x1002, register, &vec![7; length]),
            (vec![7; length], 0),
            "{register:#x}"
        );
        assert_eq!(rig.ask(FPWR, 0x1002, register, &vec![0; length]).1, 0, "{register:#x}");
        assert_eq!(rig.ask(FPRD, 0x1001, register, &vec![7; length]).1, 1, "{register:#x}");
    }
    assert_eq!(rig.ask(FRMW, 0x1001, 0x0910, &[0; 8]).1, 2, "coupler and drive");
    assert_eq!(rig.ask(ARMW, 0, 0x0910, &[0; 4]).1, 2);
    assert_eq!(
        rig.ask(FRMW, 0x1002, 0x0910, &[0; 8]).1,
        2,
        "it cannot be the reference"
    );
}

#[test]
fn process_data_of_terminals_pass_in_preop_already_each_in_its_own_bits() {
    let mut rig = station_of_three();
    rig.bus.set_inputs(2, &[0b0101]);
    assert_eq!(exchange(&mut rig, 0xFF), (0xF5, 3), "INIT");
    rig.request(2);
    assert_eq!(exchange(&mut rig, 0xA0), (0xA5, 3));
    assert_eq!(rig.read(0x1002, 0x1000, 1), [0b0101]);
    rig.bus.set_inputs(2, &[0b1010]);
    assert_eq!(exchange(&mut rig, 0x00), (0x0A, 3), "new inputs in the next frame");
    assert_eq!(rig.ask(LRD, LOGICAL, 0, &[0xF0]), (vec![0xFA], 1));
    assert_eq!(rig.ask(LWR, LOGICAL, 0, &[0x30]), (vec![0x30], 1));
    assert_eq!(rig.bus.inputs(2), Some(vec![0b1010]));
    assert_eq!(
        (rig.bus.inputs(1), rig.bus.outputs(1), rig.bus.outputs(2)),
        (None, None, None)
    );
}

#[test]
fn outputs_act_in_op_only_and_end_with_the_watchdog_not_with_the_state() {
    let mut rig = station_of_three();
    rig.write(0x1003, 0x0400, &2498u16.to_le_bytes());
    rig.write(0x1003, 0x0420, &100u16.to_le_bytes());
    let mut seen = Vec::new();
    for state in [1, 2, 4, 8, 4, 8] {
        rig.request(state);
        exchange(&mut rig, 0x90);
        seen.push(rig.bus.outputs(3).expect("outputs")[0]);
    }
    assert_eq!(seen, [0, 0, 0, 0b1001, 0, 0b1001]);
    for _ in 0..8 {
        assert_eq!(rig.al_status(0x1003), (8, 0));
    }
    assert_eq!(rig.bus.outputs(3), Some(vec![0b1001]));
    for _ in 0..4 {
        assert_eq!(rig.al_status(0x1003), (8, 0));
    }
    assert_eq!(rig.bus.outputs(3), Some(vec![0]), "10 ms without outputs");
    assert_eq!(rig.read(0x1003, 0x0440, 3), [0, 0, 1]);
    assert_eq!(rig.al_status(0x1003), (8, 0), "the state stays");
    exchange(&mut rig, 0x60);
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(rig.bus.outputs(3), Some(vec![0b0110]));
    assert_eq!(rig.read(0x1003, 0x0440, 3), [1, 0, 1]);
}

#[test]
fn terminals_that_share_a_logical_byte_leave_each_others_bits_alone() {
    let mut rig = segment("el2004,el2008");
    rig.write(0x1001, 0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 9, 0]);
    rig.write(0x1002, 0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 9, 0]);
    rig.write(0x1001, 0x0600, &fmmu(2, 4, 0x0F00, 2));
    rig.write(0x1002, 0x0600, &fmmu(6, 8, 0x0F00, 2));
    rig.request(8);
    let (_, count) = rig.ask(LRW, LOGICAL, 0, &[0b0110_0100, 0b0011_1111]);
    assert_eq!(count, 4);
    assert_eq!(rig.bus.outputs(1), Some(vec![0b1001]));
    assert_eq!(rig.bus.outputs(2), Some(vec![0b1111_1101]));
    let mut half = fmmu(0, 4, 0x0F00, 2);
    half[10] = 4;
    rig.write(0x1002, 0x0600, &half);
    assert_eq!(rig.ask(LWR, LOGICAL, 0, &[0]).1, 2);
    assert_eq!(rig.bus.outputs(2), Some(vec![0b0000_1101]), "the lower half stays");
}

#[test]
fn without_its_sync_manager_an_output_does_not_act() {
    let mut rig = segment("el2004");
    rig.write(0x1001, 0x0600, &fmmu(0, 4, 0x0F00, 2));
    rig.request(8);
    assert_eq!(rig.ask(LWR, LOGICAL, 0, &[0x0F]).1, 1, "plain memory");
    assert_eq!(rig.bus.outputs(1), Some(vec![0]));
    assert_eq!(rig.read(0x1001, 0x0F00, 1), [0x0F]);
    rig.write(0x1001, 0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 9, 0]);
    rig.write(0x1001, 0x0F00, &[0x06]);
    assert_eq!(rig.bus.outputs(1), Some(vec![6]));
}

/// Categories of an information memory, read through the registers of a slave.
fn categories(rig: &mut TestRig, station: u16) -> Vec<(u16, Vec<u8>)> {
    let mut image = Vec::new();
    for word in (0..256u32).step_by(4) {
        let mut command = vec![0x00, 0x01];
        command.extend_from_slice(&word.to_le_bytes());
        rig.write(station, 0x0502, &command);
        image.extend(rig.read(station, 0x0508, 8));
    }
    let (mut at, mut found) = (0x80, Vec::new());
    while image[at..at + 2] != [0xFF, 0xFF] {
        let bytes = 2 * usize::from(u16::from_le_bytes([image[at + 2], image[at + 3]]));
        let kind = u16::from_le_bytes([image[at], image[at + 1]]);
        found.push((kind, image[at + 4..at + 4 + bytes].to_vec()));
        at += 4 + bytes;
    }
    found
}

#[test]
fn the_memories_of_terminals_describe_them() {
    let mut rig = segment("el1008,el2004,ek1100");
    let inputs = categories(&mut rig, 0x1001);
    let outputs = categories(&mut rig, 0x1002);
    let kinds = |list: &[(u16, Vec<u8>)]| -> Vec<u16> { list.iter().map(|(kind, _)| *kind).collect() };
    assert_eq!(kinds(&inputs), [10, 30, 40, 41, 43, 50]);
    assert_eq!(kinds(&outputs), [10, 30, 40, 41, 43, 51]);
    assert_eq!((&inputs[2].1, &outputs[2].1), (&vec![2, 0xFF], &vec![1, 0xFF]));
    assert_eq!(inputs[3].1, [0x00, 0x10, 1, 0, 0x00, 0, 1, 4]);
    assert_eq!(outputs[3].1, [0x00, 0x0F, 0, 0, 0x44, 0, 9, 3]);
    assert_eq!((inputs[5].1.len(), outputs[5].1.len()), (8 * 16, 4 * 16));
    assert_eq!(
        outputs[5].1[16..32],
        [1, 0x16, 1, 0, 0, 0, 0x11, 0, 0x10, 0x70, 1, 0, 1, 1, 0, 0]
    );
    let coupler = categories(&mut rig, 0x1003);
    assert_eq!(kinds(&coupler), [10, 30]);
    assert_eq!(coupler[1].1[12..14], (-2000i16).to_le_bytes());
    assert_eq!(coupler[1].1[16..18], [0x31, 0x01], "MII, E-bus, MII");
}

/// Checksum of an information memory: CRC 8 with polynomial 0x07 and start value 0xFF.
fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0xFF, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc: u8, _| {
            crc << 1 ^ if crc & 0x80 != 0 { 0x07 } else { 0 }
        })
    })
}

/// A slave with eight outputs in each of two sync managers, and a virtual input, as an image with this first word.
fn two_managers(configuration: u16) -> Vec<u8> {
    let mut image = vec![0; 0x80];
    image[..2].copy_from_slice(&configuration.to_le_bytes());
    image[14] = checksum(&image[..14]);
    image.extend_from_slice(&[40, 0, 2, 0, 1, 1, 2, 0xFF]);
    image.extend_from_slice(&[41, 0, 12, 0]);
    image.extend_from_slice(&[0x00, 0x0F, 0, 0, 0x44, 0, 9, 3]);
    image.extend_from_slice(&[0x01, 0x0F, 0, 0, 0x44, 0, 9, 3]);
    image.extend_from_slice(&[0x98, 0x09, 0, 0, 0x00, 0, 4, 4]);
    let pdo = |number: u8| {
        let mut pdo = vec![number, 0x16, 1, number / 8, 0, 0, 0x11, 0];
        pdo.extend_from_slice(&[0, 0x70, number + 1, 0, 1, 1, 0, 0]);
        pdo
    };
    let pdos: Vec<u8> = (0..16).flat_map(pdo).collect();
    image.extend_from_slice(&[51, 0, 128, 0]);
    image.extend_from_slice(&pdos);
    image.extend_from_slice(&[0xFF, 0xFF]);
    image
}

#[test]
fn an_image_becomes_a_terminal_with_the_sync_managers_that_it_lists() {
    let mut rig = addressed(vec![SlaveKind::Ek1100, SlaveKind::Sii(two_managers(0x0104).into())]);
    assert_eq!(rig.read(0x1002, 0x0004, 2), [3, 4]);
    rig.write(0x1002, 0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 1, 0]);
    rig.write(0x1002, 0x0808, &[0x01, 0x0F, 1, 0, 0x44, 0, 1, 0]);
    rig.write(0x1002, 0x0600, &fmmu(0, 8, 0x0F00, 2));
    let mut second = fmmu(0, 8, 0x0F01, 2);
    second[0] = 1;
    rig.write(0x1002, 0x0610, &second);
    let (data, count) = rig.ask(LRW, LOGICAL, 0, &[0x12, 0x34]);
    assert_eq!((data, count), (vec![0x12, 0x34], 2), "two mapping units count once");
    rig.request(8);
    assert_eq!(rig.bus.outputs(2), Some(vec![0x12, 0x34]));
    assert_eq!(rig.bus.inputs(2), None, "a virtual sync manager has no memory");
}

#[test]
fn no_image_and_no_frames_break_a_terminal() {
    let seed = 17;
    println!("seed {seed}");
    let mut random = Random::new(seed);
    for round in 0..300u64 {
        let mut image = two_managers([0x0104, 0x0008][(round % 2) as usize]);
        for _ in 0..random.bits() % 20 {
            let at = 0x30 + (random.bits() % (image.len() as u64 - 0x30)) as usize;
            image[at] = random.bits() as u8;
        }
        let mut rig = addressed(vec![SlaveKind::Sii(image.into()), SlaveKind::El2008, SlaveKind::Blank]);
        for _ in 0..200 {
            let mut data: Vec<u8> = (0..random.bits() % 20).map(|_| random.bits() as u8).collect();
            data.iter_mut().skip(6).step_by(8).for_each(|byte| *byte |= 1);
            let register = [0x0120, 0x0500, 0x0600, 0x0800, 0x0808, 0x0F00, 0x0FF8, 0x1000, 0x13F8];
            let register = register[(random.bits() % 9) as usize];
            let device = [0x1001, 0x1002, 0x1003, 0][(random.bits() % 4) as usize];
            let command = (random.bits() % 15) as u8;
            rig.send(&frame_of(&[(command, device, register, &data), (LRW, 0, 0, &[0; 32])]));
            rig.bus.set_inputs(1 + (random.bits() % 4) as usize, &data);
        }
        for slave in 0..5 {
            let lengths = [rig.bus.inputs(slave), rig.bus.outputs(slave)].map(|bytes| bytes.map(|bytes| bytes.len()));
            let most = 8 * usize::from(u16::MAX);
            assert!(lengths.into_iter().flatten().all(|length| length <= most));
        }
    }
}

#[test]
fn an_emulated_image_with_powered_clock_units_has_a_clock() {
    let mut listed = two_managers(0x0104);
    listed.truncate(listed.len() - 2);
    listed.extend_from_slice(&[60, 0, 0, 0, 0xFF, 0xFF]);
    let mut coupler = two_managers(0x0D00);
    coupler.truncate(0x80);
    for (image, from_4) in [
        (two_managers(0x0104), [3, 4, 1, 0x4A, 0xFC, 0x01]),
        (listed, [3, 4, 1, 0x4A, 0xFC, 0x00]),
        (two_managers(0x0504), [3, 4, 1, 0x4A, 0xFC, 0x00]),
        (coupler, [8, 8, 8, 0x3B, 0xFC, 0x00]),
    ] {
        let mut rig = addressed(vec![SlaveKind::El1004, SlaveKind::Sii(image.into())]);
        assert_eq!(rig.read(0x1002, 0x0004, 6), from_4);
        assert_eq!(rig.ask(BRD, 0, 0x0910, &[0; 8]).1, u16::from(from_4[5] == 0));
        rig.write(0x1002, 0x0500, &[1]);
        rig.write(0x1002, 0x0120, &[8, 0]);
        assert_eq!(rig.al_status(0x1002), (8, 0), "a memory handed over does no harm");
    }
}

#[test]
fn a_power_cycle_brings_a_terminal_back_to_init_with_its_outputs_off() {
    let mut rig = station_of_three();
    rig.request(8);
    exchange(&mut rig, 0xF0);
    assert_eq!(rig.bus.outputs(3), Some(vec![0x0F]));
    rig.bus.inject(Fault::Power(3, 3));
    rig.time_us += 2_000;
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(rig.bus.outputs(3), Some(vec![0]));
    rig.time_us += 5_000;
    let third = 0u16.wrapping_sub(2);
    assert_eq!(rig.ask(APRD, third, 0x0130, &[0; 2]), (vec![1, 0], 1));
    assert_eq!(rig.ask(APRD, third, 0x0800, &[9; 8]).0, [0, 0, 0, 0, 0, 0x30, 0, 0]);
    for fault in [
        Fault::Retreat(2, 0x1B),
        Fault::Processor(2, 50),
        Fault::Refuse(2, AlState::PreOperational, 7),
    ] {
        rig.bus.inject(fault);
    }
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(rig.al_status(0x1002), (8, 0), "no processor, no fault of it");
    rig.write(0x1002, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(0x1002), (2, 0));
}

#[test]
fn a_processor_without_a_mailbox_checks_the_sync_managers_of_the_image() {
    let mut rig = addressed(vec![SlaveKind::Sii(two_managers(0x0008).into())]);
    rig.write(0x1001, 0x0120, &[2, 0]);
    rig.write(0x1001, 0x0120, &[4, 0]);
    assert_eq!(rig.al_status(0x1001), (0x12, 0x001D));
    rig.write(0x1001, 0x0800, &[0x00, 0x0F, 1, 0, 0x44, 0, 1, 0]);
    rig.write(0x1001, 0x0808, &[0x01, 0x0F, 1, 0, 0x44, 0, 1, 0]);
    rig.write(0x1001, 0x0120, &[0x14, 0]);
    assert_eq!(rig.al_status(0x1001), (4, 0));
    rig.write(0x1001, 0x0F00, &[0x12, 0x34]);
    rig.write(0x1001, 0x0120, &[8, 0]);
    rig.write(0x1001, 0x0F00, &[0x56, 0x78]);
    assert_eq!(rig.al_status(0x1001), (8, 0));
    assert_eq!(rig.bus.outputs(1), Some(vec![0x56, 0x78]));
}

#[test]
fn a_32_bit_clock_reads_as_64_bits_with_an_upper_half_of_zero() {
    let clocks = etherpen_segment::ClockOptions {
        width: etherpen_segment::ClockWidth::Bits32,
        ..etherpen_segment::ClockOptions::default()
    };
    let mut rig = rig_of(SegmentOptions {
        slaves: parse_slaves("cia402").expect("a list"),
        clocks,
        ..SegmentOptions::default()
    });
    assert_eq!(rig.ask(APRD, 0, 0x0008, &[0; 2]).0, [0x84, 0x01]);
    rig.ask(APWR, 0, 0x0920, &[0xFF; 8]);
    let (time, count) = rig.ask(APRD, 0, 0x0910, &[0xFF; 8]);
    assert_eq!((&time[4..], count), ([0; 4].as_slice(), 1));
    assert_ne!(time[..4], [0; 4]);
    assert_eq!(
        rig.ask(APRD, 0, 0x0920, &[0; 8]),
        (vec![0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 0, 0], 1)
    );
}

/// A terminal with a byte of outputs and one of inputs, each in a sync manager of its own; its memory may say that LRW is not
/// supported.
fn both_ways(has_lrw: bool) -> SlaveKind {
    let mut image = two_managers(0x0104);
    image.truncate(0x80);
    let mut general = [0; 32];
    general[11] = if has_lrw { 0 } else { 1 << 1 };
    image.extend_from_slice(&[30, 0, 16, 0]);
    image.extend_from_slice(&general);
    image.extend_from_slice(&[41, 0, 8, 0]);
    image.extend_from_slice(&[0x00, 0x10, 1, 0, 0x44, 0, 1, 3]);
    image.extend_from_slice(&[0x00, 0x11, 1, 0, 0x00, 0, 1, 4]);
    image.extend_from_slice(&[0xFF, 0xFF]);
    SlaveKind::Sii(image.into())
}

#[test]
fn a_controller_without_lrw_lets_it_pass_unchanged_and_uncounted_and_takes_lrd_and_lwr() {
    let no_lrw = PlaceOptions {
        ignores_lrw: true,
        ..PlaceOptions::default()
    };
    for (kind, place, bit, takes) in [
        (both_ways(true), PlaceOptions::default(), 0, true),
        (both_ways(false), PlaceOptions::default(), 0, false),
        (both_ways(true), no_lrw, 0x02, false),
    ] {
        let mut rig = rig_of(SegmentOptions {
            slaves: vec![kind],
            places: vec![place],
            ..SegmentOptions::default()
        });
        rig.ask(APWR, 0, 0x0010, &0x1001_u16.to_le_bytes());
        assert_eq!(rig.read(0x1001, 0x0009, 1)[0] & 0x02, bit, "bit 9 of the features");
        rig.write(0x1001, 0x0800, &[0x00, 0x10, 1, 0, 0x44, 0, 1, 0]);
        rig.write(0x1001, 0x0808, &[0x00, 0x11, 1, 0, 0x00, 0, 1, 0]);
        rig.write(0x1001, 0x0600, &fmmu(0, 8, 0x1000, 2));
        let mut inputs = fmmu(0, 8, 0x1100, 1);
        inputs[0] = 1;
        rig.write(0x1001, 0x0610, &inputs);
        rig.bus.set_inputs(1, &[0xA5]);
        rig.write(0x1001, 0x0120, &[8, 0]);
        let (data, count) = rig.ask(LRW, LOGICAL, 0, &[0x12, 0x34]);
        let outputs = rig.bus.outputs(1);
        match takes {
            true => assert_eq!((data, count, outputs), (vec![0x12, 0xA5], 3, Some(vec![0x12]))),
            false => assert_eq!((data, count, outputs), (vec![0x12, 0x34], 0, Some(vec![0]))),
        }
        assert_eq!(rig.ask(LRD, LOGICAL, 0, &[0, 0]), (vec![0, 0xA5], 1));
        assert_eq!(rig.ask(LWR, LOGICAL, 0, &[0x56, 0x78]), (vec![0x56, 0x78], 1));
        assert_eq!(rig.bus.outputs(1), Some(vec![0x56]));
    }
}

#[test]
fn a_controller_that_takes_its_units_in_pairs_refuses_longer_writes_as_a_whole() {
    let SlaveList { slaves, places, .. } = "ek1100@units=pairs".parse().expect("a list");
    let mut rig = rig_of(SegmentOptions {
        slaves,
        places,
        ..SegmentOptions::default()
    });
    rig.ask(APWR, 0, 0x0010, &0x1001_u16.to_le_bytes());
    for (register, block, units) in [(0x0600, 16, 8), (0x0800, 8, 8)] {
        for first in 0..units {
            for (count, is_taken) in [(1, true), (2, true), (3, false), (4, false)] {
                let data = vec![0x11; block * count];
                let at = register + (block * first) as u16;
                let counted = rig.ask(FPWR, 0x1001, at, &data).1 == 1;
                assert_eq!(counted, is_taken, "{count} units from {at:#06x} on");
            }
        }
    }
}
