//! What a slave with a processor checks, and when: sync managers, acknowledgements, access to its memory, time.

use crate::{rig, rig_of};
use etherpen_segment::random::Random;
use etherpen_segment::rig::*;
use etherpen_segment::{AlState, Fault, SegmentOptions, SlaveOptions, parse_slaves};

type TestRig = crate::TestRig;

const STATION: u16 = 0x1002;

/// Four AX2000 in SAFEOP.
fn safe() -> TestRig {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    rig.request(2);
    rig.process_data();
    rig.request(4);
    assert_eq!(rig.al_status(STATION), (4, 0));
    rig
}

#[test]
fn an_error_hides_every_request_until_it_is_acknowledged() {
    let mut rig = safe();
    rig.bus.inject(Fault::Retreat(2, 0x001B));
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    for request in [1, 2, 4, 8] {
        rig.write(STATION, 0x0120, &[request, 0]);
        assert_eq!(rig.al_status(STATION), (0x14, 0x001B), "request {request}");
    }
    rig.write(STATION, 0x0120, &[0x11, 0]);
    assert_eq!(rig.al_status(STATION), (1, 0));
    rig.write(STATION, 0x0120, &[8, 0]);
    assert_eq!(rig.al_status(STATION), (0x11, 0x0011));
    rig.write(STATION, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(STATION), (0x11, 0x0011));
    rig.write(STATION, 0x0120, &[1, 0]);
    assert_eq!(rig.al_status(STATION), (1, 0), "INIT in INIT acknowledges");
}

#[test]
fn the_working_counter_tells_which_slave_left_the_cyclic_states() {
    let mut rig = safe();
    let lrw = |rig: &mut TestRig| rig.ask(LRW, 0, 1, &[0; 0x40 + 24]).1;
    assert_eq!(lrw(&mut rig), 12);
    rig.write(STATION, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(STATION), (2, 0));
    assert_eq!(lrw(&mut rig), 9, "PREOP: both sync managers are locked");
    assert_eq!(rig.read(STATION, 0x0817, 1), [1], "by the processor");
    rig.write(STATION, 0x0120, &[4, 0]);
    assert_eq!(rig.al_status(STATION), (4, 0));
    assert_eq!(lrw(&mut rig), 12);
}

#[test]
fn mailboxes_are_locked_in_init() {
    let mut rig = rig();
    rig.addresses();
    rig.mailboxes();
    assert_eq!(rig.ask(FPWR, STATION, 0x1800, &[0; 512]).1, 0);
    rig.request(2);
    assert_eq!(rig.read(STATION, 0x080D, 1), [0x00]);
    assert_eq!(rig.ask(FPRD, STATION, 0x1C00, &[0; 2]).1, 0, "empty");
    assert_eq!(rig.ask(FPWR, STATION, 0x1800, &[0; 512]).1, 1);
    rig.request(1);
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(rig.ask(FPWR, STATION, 0x1800, &[0; 512]).1, 0);
}

#[test]
fn a_sync_manager_that_the_master_takes_away_is_noticed() {
    for (register, data, expected) in [
        (0x0816, [0u8].as_slice(), (0x12, 0x001D)),
        (0x081E, &[0], (0x12, 0x001E)),
        (0x0806, &[0], (0x11, 0x0016)),
        (0x080E, &[0], (0x11, 0x0016)),
        (0x0800, &[0; 32], (0x11, 0x0016)),
    ] {
        let mut rig = safe();
        rig.write(STATION, register, data);
        assert_eq!(rig.al_status(STATION), expected, "{register:#x}");
        assert_eq!(rig.al_status(0x1003), (4, 0));
    }
}

#[test]
fn another_length_of_a_sync_manager_is_noticed_in_safeop_and_in_op() {
    let mut random = Random::new(3);
    let mut lengths: Vec<u16> = (0..12).map(|_| (random.bits() % 64) as u16).collect();
    lengths.extend([0, 1, 5, 6, 7, 0x0106]);
    for (is_in_op, manager, code) in [
        (false, 0x0810, 0x001D),
        (false, 0x0818, 0x001E),
        (true, 0x0810, 0x001D),
        (true, 0x0818, 0x001E),
    ] {
        for length in &lengths {
            let mut rig = safe();
            let state = if is_in_op { 8 } else { 4 };
            if is_in_op {
                rig.cycle([0; 4], 0);
                rig.request(8);
                rig.cycle([0; 4], 0);
            }
            assert_eq!(rig.al_status(STATION), (state, 0));
            // In one frame: the sync manager is never seen to be off.
            let frame = frame_of(&[
                (FPWR, STATION, manager + 6, &[0]),
                (FPWR, STATION, manager + 2, &length.to_le_bytes()),
                (FPWR, STATION, manager + 6, &[1]),
            ]);
            rig.send(&frame);
            let what = format!("{length} bytes in {manager:#x}, OP {is_in_op}");
            // The process data of an AX2000 have six bytes.
            let expected = if *length == 6 { (state, 0) } else { (0x12, code) };
            assert_eq!(rig.al_status(STATION), expected, "{what}");
            assert_eq!(rig.al_status(0x1003), (state, 0), "{what}");
        }
    }
}

#[test]
fn a_request_for_preop_comes_before_the_loss_of_its_sync_managers() {
    let mut rig = safe();
    let frame = frame_of(&[
        (FPWR, STATION, 0x0816, &[0]),
        (FPWR, STATION, 0x081E, &[0]),
        (FPWR, STATION, 0x0120, &[2, 0]),
    ]);
    rig.send(&frame);
    assert_eq!(rig.al_status(STATION), (2, 0));
}

#[test]
fn start_and_length_of_an_enabled_sync_manager_stay() {
    let mut rig = safe();
    let before = rig.read(STATION, 0x0810, 5);
    rig.write(STATION, 0x0810, &[0x00, 0x12, 9, 0, 0x20, 0, 1, 0]);
    assert_eq!(rig.read(STATION, 0x0810, 5), before);
    assert_eq!(rig.al_status(STATION), (4, 0), "nothing has changed");
    rig.write(STATION, 0x0810, &[0; 8]);
    assert_eq!(rig.read(STATION, 0x0810, 5), before, "this write disables it only");
    assert_eq!(rig.read(STATION, 0x0815, 2), [0x30, 0]);
    rig.write(STATION, 0x0810, &[0; 8]);
    assert_eq!(rig.read(STATION, 0x0810, 5), [0; 5]);
}

/// The AX2000 of a chain with mailboxes and these options, in INIT.
fn with_options(options: SlaveOptions) -> TestRig {
    let mut rig = rig();
    for slave in 1..=4 {
        rig.bus.set_slave_options(slave, options);
    }
    rig.addresses();
    rig.mailboxes();
    rig
}

#[test]
fn a_processor_that_reads_its_memory_refuses_preop_until_it_may() {
    let mut rig = with_options(SlaveOptions {
        reads_sii: true,
        ..SlaveOptions::default()
    });
    rig.request(2);
    assert_eq!(rig.al_status(STATION), (0x11, 0x0050));
    rig.write(STATION, 0x0500, &[1]);
    rig.write(STATION, 0x0120, &[0x12, 0]);
    assert_eq!(rig.al_status(STATION), (2, 0));
    assert_eq!(rig.al_status(0x1003), (0x11, 0x0050), "access is given to one slave");
}

#[test]
fn a_memory_that_is_handed_over_takes_no_command() {
    let mut rig = rig();
    rig.addresses();
    let read = |word: u8| [0x00, 0x01, word, 0, 0, 0];
    rig.write(STATION, 0x0502, &read(0x08));
    let identity = rig.read(STATION, 0x0508, 8);
    rig.write(STATION, 0x0500, &[1]);
    assert_eq!(rig.ask(FPWR, STATION, 0x0502, &read(0x00)).1, 0);
    assert_eq!(rig.ask(BWR, 0, 0x0502, &read(0x08)).1, 3, "the others take it");
    assert_eq!(rig.read(STATION, 0x0502, 2), [0x40, 0x00], "idle");
    assert_eq!(rig.read(STATION, 0x0508, 8), identity, "nothing new");
    rig.write(STATION, 0x0500, &[0]);
    rig.write(STATION, 0x0502, &read(0x00));
    assert_ne!(rig.read(STATION, 0x0508, 8), identity);
}

#[test]
fn a_processor_that_still_starts_leaves_the_request_unread() {
    let options = SlaveOptions {
        boot_ms: 100,
        ..SlaveOptions::default()
    };
    let mut rig = rig();
    rig.addresses();
    rig.bus.set_slave_options(2, options);
    assert_eq!(rig.ask(BWR, 0, 0x0120, &[0x11, 0]).1, 4);
    assert_eq!(rig.ask(BWR, 0, 0x0120, &[0x11, 0]).1, 3, "one is unread");
    assert_eq!(rig.ask(FPWR, STATION, 0x0120, &[0x11, 0]).1, 0);
    rig.mailboxes();
    assert_eq!(rig.ask(BWR, 0, 0x0120, &[2, 0]).1, 3);
    assert_eq!((rig.al_status(STATION), rig.al_status(0x1003)), ((1, 0), (2, 0)));
    rig.time_us += 90_000;
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    assert_eq!(rig.ask(FPWR, STATION, 0x0120, &[2, 0]).1, 1);
    assert_eq!(rig.al_status(STATION), (2, 0));
    rig.bus.inject(Fault::Power(2, 5));
    rig.time_us += 20_000;
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    let second = 0u16.wrapping_sub(1);
    assert_eq!(rig.ask(APWR, second, 0x0120, &[0x11, 0]).1, 1);
    assert_eq!(
        rig.ask(APWR, second, 0x0120, &[0x11, 0]).1,
        0,
        "it starts anew after power-up"
    );
}

#[test]
fn a_change_of_state_takes_its_time() {
    let mut rig = with_options(SlaveOptions {
        transition_ms: 20,
        ..SlaveOptions::default()
    });
    rig.request(2);
    let mut waited = 0;
    while rig.al_status(STATION) != (2, 0) {
        waited += 1;
        assert!(waited < 30);
    }
    assert!((18..=21).contains(&waited), "{waited} ms");
    rig.request(1);
    assert_eq!(rig.ask(BWR, 0, 0x0120, &[2, 0]).1, 4, "the first one was read");
    assert_eq!(rig.ask(BWR, 0, 0x0120, &[2, 0]).1, 0, "the second one waits");
}

#[test]
fn a_slow_mailbox_takes_the_request_at_once_and_answers_late() {
    let mut rig = with_options(SlaveOptions {
        mailbox_ms: 38,
        ..SlaveOptions::default()
    });
    rig.request(2);
    let mut message = upload(1);
    message.resize(512, 0);
    rig.write(STATION, 0x1800, &message);
    assert_eq!(rig.read(STATION, 0x0805, 1), [0x02], "taken");
    let mut waited = 0;
    while rig.read(STATION, 0x080D, 1)[0] & 0x08 == 0 {
        waited += 1;
        assert!(waited < 60);
    }
    assert!((36..=39).contains(&waited), "{waited} ms");
    assert_eq!(rig.read(STATION, 0x1C00, 512)[6..16], DEVICE_TYPE);
}

#[test]
fn a_blank_board_answers_registers_and_disturbs_nobody() {
    let mut rig = rig_of(SegmentOptions {
        slaves: parse_slaves("ek1100,blank,el1008,ax2000").expect("a list"),
        ..SegmentOptions::default()
    });
    rig.addresses();
    assert_eq!(rig.read(STATION, 0x0000, 8), [0xC0, 0x02, 0, 0, 3, 4, 4, 0x1F]);
    assert_eq!(rig.read(STATION, 0x0110, 1)[0] & 3, 0, "nothing was loaded");
    for word in [0x00, 0x08, 0x18, 0x40] {
        rig.write(STATION, 0x0502, &[0x00, 0x01, word, 0, 0, 0]);
        assert_eq!(
            rig.read(STATION, 0x0502, 2),
            [0x80, 0x18],
            "a wrong checksum, so nothing is loaded"
        );
        let data = rig.read(STATION, 0x0508, 8);
        assert_eq!(data, [0xFF, 0xFF, 0xFF, 0xFF, 0, 0, 0, 0], "four bytes a read");
    }
    assert_eq!(rig.al_status(STATION), (1, 0));
    assert_eq!(rig.ask(BWR, 0, 0x0120, &[0x11, 0]).1, 4);
    assert_eq!(rig.ask(BWR, 0, 0x0120, &[0x11, 0]).1, 3, "nobody reads it");
    assert_eq!(rig.al_status(STATION), (1, 0));
    rig.write(0x1003, 0x0120, &[8, 0]);
    rig.write(0x1004, 0x0800, &[0x00, 0x18, 0x00, 0x02, 0x26, 0, 1, 0]);
    rig.write(0x1004, 0x0808, &[0x00, 0x1C, 0x00, 0x02, 0x22, 0, 1, 0]);
    rig.write(0x1004, 0x0120, &[2, 0]);
    assert_eq!(rig.al_status(0x1004), (2, 0));
    let states: Vec<AlState> = rig.bus.slaves().iter().map(|slave| slave.al_state).collect();
    let expected = [
        AlState::Init,
        AlState::Init,
        AlState::Operational,
        AlState::PreOperational,
    ];
    assert_eq!(states, expected);
}

/// An SDO upload of the device type as a whole mailbox message with this counter.
fn upload(counter: u8) -> Vec<u8> {
    let mut message = vec![10, 0, 0, 0, 0, 3 | counter << 4];
    message.extend_from_slice(&[0, 0x20, 0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    message
}

const DEVICE_TYPE: [u8; 10] = [0, 0x30, 0x43, 0x00, 0x10, 0, 0x92, 0x01, 0x02, 0x00];

#[test]
fn first_and_last_byte_hand_a_mailbox_over() {
    let mut rig = safe();
    let request = upload(0);
    assert_eq!(rig.ask(FPWR, STATION, 0x1800, &request).1, 1);
    assert_eq!(rig.read(STATION, 0x0805, 1)[0] & 0x08, 0, "not handed over yet");
    let frame = frame_of(&[
        (FPWR, STATION, 0x1800, &request),
        (FPWR, STATION, 0x19FF, &[0]),
        (FPRD, STATION, 0x0805, &[0]),
    ]);
    let reply = rig.send(&frame).remove(0);
    assert_eq!(reply[DATA + 16 + 12 + 1 + 12], 0x09, "full");
    assert_eq!(rig.read(STATION, 0x0805, 1), [0x02], "taken");
    while rig.ask(FPRD, STATION, 0x1C00, &[0; 2]) == (vec![0, 0], 0) {}
    assert_eq!(
        rig.read(STATION, 0x080D, 1)[0] & 0x08,
        0x08,
        "two bytes do not empty it"
    );
    let frame = frame_of(&[(FPRD, STATION, 0x1C00, &[0; 16]), (FPRD, STATION, 0x1DFF, &[7])]);
    let reply = rig.send(&frame).remove(0);
    assert_eq!(reply[DATA..DATA + 2], [10, 0]);
    assert_eq!(reply[DATA + 6..DATA + 16], DEVICE_TYPE);
    assert_eq!(rig.read(STATION, 0x080D, 1), [0x02], "empty again");
    assert_eq!(rig.ask(FPRD, STATION, 0x1C00, &[0; 2]).1, 0);
}

#[test]
fn the_mailbox_state_can_be_mapped_into_cyclic_data() {
    let mut rig = safe();
    let state = [0, 0, 0, 9, 1, 0, 0, 0, 0x0D, 0x08, 3, 1, 1, 0, 0, 0];
    rig.write(STATION, 0x0620, &state);
    assert_eq!(rig.ask(LRD, 0, 0x0900, &[0]), (vec![0], 1));
    let mut message = upload(1);
    message.resize(512, 0);
    rig.write(STATION, 0x1800, &message);
    assert_eq!(rig.ask(LRD, 0, 0x0900, &[0]), (vec![1], 1));
}

#[test]
fn unasked_mail_of_another_protocol_comes_before_the_answer() {
    let mut rig = safe();
    rig.bus.inject(Fault::Ethernet(2));
    rig.send(&frame_of(&[(BRD, 0, 0x0130, &[0, 0])]));
    let mut message = upload(1);
    message.resize(512, 0);
    rig.write(STATION, 0x1800, &message);
    let mut kinds = Vec::new();
    for _ in 0..10 {
        let (mail, count) = rig.ask(FPRD, STATION, 0x1C00, &[0; 512]);
        if count == 1 {
            kinds.push((mail[5] & 0x0F, mail[5] >> 4));
            match mail[5] & 0x0F {
                2 => assert_eq!(
                    (mail[..2].to_vec(), mail[22..24].to_vec()),
                    (vec![46, 0], vec![0x08, 0x06]),
                    "ARP"
                ),
                _ => assert_eq!(mail[6..16], DEVICE_TYPE),
            }
        }
    }
    assert_eq!(kinds, [(2, 1), (3, 2)], "types and counters");
    assert_eq!(rig.bus.injected()["eoe"], 1);
}
