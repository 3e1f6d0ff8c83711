//! Files of a drive in BOOT: what commands do to the drive meanwhile, and to the file.

use crate::rig::{Rig, idle_rig_of};
use etherpen::ethercat::diagnostics::{FileRequest, Name, Piece, ServiceError, ServiceReply, ServiceRequest};
use etherpen::ethercat::error::BusError;
use etherpen::ethercat::event::Step;
use etherpen::ethercat::state::AlState as Asked;
use etherpen::ethercat::supervisor::{BusCommand, BusEvent};
use etherpen::ethercat::wire::coe::Object;
use etherpen::ethercat::wire::{Address, Command, FRAME_LEN_MAX, FrameBuilder, FrameView, register};
use etherpen::robots::AXES;
use etherpen_segment::FileFault;
use host_tools::cell::{AlState, CellOptions, Fault, SlaveList};

/// The slave whose file is transferred, from 0.
const SLAVE: u8 = 1;
const OTHERS: [usize; 3] = [0, 2, 3];
const REFUSED: BusEvent = BusEvent::Refused {
    position: Some(SLAVE),
    step: Step::Bootstrap,
    error: BusError::FileOpen,
};

/// Four drives with files that read their own memory on the way to PREOP and BOOT, on a bus without a command.
fn drives() -> Rig<'static> {
    let list: SlaveList = "cia402@sii=needed*4".parse().expect("a list");
    assert_eq!(list.slaves.len(), AXES);
    idle_rig_of(CellOptions {
        slaves: list.slaves,
        places: list.places,
        ..CellOptions::default()
    })
}

/// Four drives in OP.
fn operational_drives() -> Rig<'static> {
    let mut rig = drives();
    rig.start();
    rig.operational();
    rig.run_ms(20);
    rig
}

fn open(rig: &mut Rig<'_>) {
    let file = FileRequest {
        name: Name::try_from("fw.bin").expect("a short name"),
        password: 0,
        writes: true,
        bootstrap: true,
    };
    let opened = rig.ask(ServiceRequest::OpenFile { slave: SLAVE, file });
    assert_eq!(opened, Ok(ServiceReply::Done));
    assert_eq!(state(rig), AlState::Bootstrap);
}

fn write(rig: &mut Rig<'_>, byte: u8, last: bool) -> Result<ServiceReply, ServiceError> {
    let piece = Piece::from_slice(&[byte; 100]).expect("a short piece");
    rig.ask(ServiceRequest::WriteFile {
        slave: SLAVE,
        piece,
        last,
    })
}

/// Writes pieces whose bytes are their numbers; they are more than two packets.
fn write_pieces(rig: &mut Rig<'_>, numbers: core::ops::Range<u8>) {
    for number in numbers {
        assert_eq!(write(rig, number, number == 9), Ok(ServiceReply::Done));
    }
}

fn close(rig: &mut Rig<'_>) {
    let closed = rig.ask(ServiceRequest::CloseFile { slave: SLAVE });
    assert_eq!(closed, Ok(ServiceReply::Done));
}

fn state(rig: &Rig<'_>) -> AlState {
    rig.cell.state().slaves[usize::from(SLAVE)].al_state
}

/// Whether the drive has the file that [`write_pieces`] has written.
fn has_file(rig: &Rig<'_>) -> bool {
    let content: Vec<u8> = (0..10).flat_map(|number| [number; 100]).collect();
    rig.cell.file(usize::from(SLAVE) + 1, "fw.bin") == Some(&content)
}

fn refusals(rig: &Rig<'_>) -> usize {
    rig.log.iter().filter(|event| **event == REFUSED).count()
}

/// Acknowledges and waits until all drives are in OP.
fn acknowledge(rig: &mut Rig<'_>) {
    rig.recover();
    rig.operational();
    rig.run_ms(20);
    assert!(rig.inputs.iter().all(Option::is_some));
    assert_eq!(state(rig), AlState::Operational);
}

/// Writes registers of the slave without the master.
fn write_as_another(rig: &mut Rig<'_>, register: u16, bytes: &[u8]) {
    let mut frame = [0; FRAME_LEN_MAX];
    let mut builder = FrameBuilder::new(&mut frame, [0x10, 0, 0, 0, 0, 2]).expect("room");
    let address = Address::station(0x1001 + u16::from(SLAVE), register);
    let data = builder.push(Command::Fpwr, 0xEE, address, bytes.len()).expect("room");
    data.copy_from_slice(bytes);
    let length = builder.finish();
    let replies = rig.cell.frame_at_ns(rig.sample_ns(), &frame[..length]);
    let view = FrameView::new_checked(&replies[0]).expect("a frame");
    let datagram = view.datagrams().next().expect("a datagram").expect("a whole one");
    assert_eq!(datagram.working_counter(), 1, "{register:#06x}");
}

#[test]
pub(crate) fn a_file_of_any_length_is_read_as_it_was_written_packet_by_packet() {
    let mut rig = drives();
    // A packet has 244 bytes: the mailbox of PREOP less two headers. One that is full is not the last.
    for length in [0, 1, 243, 244, 245, 488, 700, 1_000] {
        let content: Vec<u8> = (0..length).map(|at: usize| (at * 7 + at / 256) as u8).collect();
        open(&mut rig);
        let mut pieces: Vec<&[u8]> = content.chunks(100).collect();
        let end = pieces.pop().unwrap_or_default();
        for (piece, last) in pieces.into_iter().map(|piece| (piece, false)).chain([(end, true)]) {
            let piece = Piece::from_slice(piece).expect("a short piece");
            let slave = SLAVE;
            let written = rig.ask(ServiceRequest::WriteFile { slave, piece, last });
            assert_eq!(written, Ok(ServiceReply::Done));
        }
        close(&mut rig);
        let file = FileRequest {
            name: Name::try_from("fw.bin").expect("a short name"),
            password: 0,
            writes: false,
            bootstrap: false,
        };
        let opened = rig.ask(ServiceRequest::OpenFile { slave: SLAVE, file });
        assert_eq!(opened, Ok(ServiceReply::Done), "{length} bytes");
        let mut read = Vec::new();
        loop {
            match rig.ask(ServiceRequest::ReadFile { slave: SLAVE }) {
                Ok(ServiceReply::FilePiece { piece, last }) => {
                    read.extend(piece);
                    if last {
                        break;
                    }
                    assert!(read.len() <= length, "{length} bytes");
                }
                other => panic!("{length} bytes: {other:?}"),
            }
        }
        close(&mut rig);
        assert_eq!(read, content, "{length} bytes");
    }
}

#[test]
pub(crate) fn after_boot_objects_are_read_also_where_another_master_has_brought_the_drive_to_preop() {
    let mut rig = drives();
    open(&mut rig);
    write_pieces(&mut rig, 0..10);
    close(&mut rig);
    assert_eq!(state(&rig), AlState::Init);
    // The mailboxes of PREOP: start, length, control and activation of each.
    let mailboxes = [
        [0x00, 0x10, 0x00, 0x01, 0x26, 0, 1, 0],
        [0x00, 0x12, 0x00, 0x01, 0x22, 0, 1, 0],
    ];
    // Those of BOOT are switched off first: what is on cannot be changed.
    write_as_another(&mut rig, register::sync_manager(0), &[0; 16]);
    write_as_another(&mut rig, register::sync_manager(0), mailboxes.as_flattened());
    write_as_another(&mut rig, register::SII_CONFIG, &[register::SII_TO_PDI]);
    write_as_another(&mut rig, register::AL_CONTROL, &[AlState::PreOperational as u8, 0]);
    rig.run_ms(100);
    assert_eq!(state(&rig), AlState::PreOperational);
    let name = rig.value(ServiceRequest::Upload {
        slave: SLAVE,
        object: Object::new(0x1008, 0),
        complete: false,
        offset: 0,
    });
    assert_eq!(name, b"etherpen CiA 402 drive");
    assert_eq!(state(&rig), AlState::PreOperational);
}

#[test]
pub(crate) fn an_acknowledgement_leaves_a_drive_in_boot_and_repairs_it_after_the_transfer() {
    let mut rig = operational_drives();
    open(&mut rig);
    write_pieces(&mut rig, 0..5);
    rig.recover();
    for _ in 0..2_000 {
        rig.millisecond();
        assert_eq!(state(&rig), AlState::Bootstrap);
        assert!(OTHERS.iter().all(|axis| rig.inputs[*axis].is_some()));
    }
    assert_eq!(refusals(&rig), 1, "{:#?}", rig.log);
    write_pieces(&mut rig, 5..10);
    close(&mut rig);
    assert_eq!(state(&rig), AlState::Init);
    assert!(has_file(&rig));
    acknowledge(&mut rig);
    assert_eq!(refusals(&rig), 1);
}

#[test]
pub(crate) fn another_drive_is_repaired_while_one_is_in_boot() {
    let mut rig = operational_drives();
    open(&mut rig);
    write_pieces(&mut rig, 0..5);
    rig.cell.inject(Fault::Retreat(3, 0x001D));
    rig.wait_for(200, |event| matches!(event, BusEvent::SlaveLeft { position: 2, .. }));
    rig.recover();
    rig.wait_for(2_000, |event| *event == BusEvent::Repaired { position: 2 });
    write_pieces(&mut rig, 5..10);
    close(&mut rig);
    assert!(has_file(&rig));
    acknowledge(&mut rig);
}

#[test]
pub(crate) fn a_file_that_nobody_asks_for_in_10_s_protects_its_drive_no_more() {
    let mut rig = operational_drives();
    open(&mut rig);
    write_pieces(&mut rig, 0..5);
    rig.run_ms(9_900);
    rig.recover();
    rig.run_ms(50);
    assert_eq!((refusals(&rig), state(&rig)), (1, AlState::Bootstrap));
    rig.run_ms(100);
    acknowledge(&mut rig);
    // What is left of the file is no longer taken, and closing it leaves the drive in operation.
    assert_eq!(write(&mut rig, 5, false), Err(ServiceError::Interrupted));
    assert!(!has_file(&rig));
    close(&mut rig);
    rig.run_ms(50);
    assert_eq!(state(&rig), AlState::Operational);
}

#[test]
pub(crate) fn a_new_configuration_leaves_a_drive_in_boot_and_takes_the_others_out_of_operation() {
    let mut rig = operational_drives();
    open(&mut rig);
    write_pieces(&mut rig, 0..5);
    // It arrives while a packet is on its way.
    let piece = Piece::from_slice(&[5; 100]).expect("a short piece");
    let request = ServiceRequest::WriteFile {
        slave: SLAVE,
        piece,
        last: false,
    };
    assert!(rig.services.enqueue(request).is_ok());
    rig.millisecond();
    rig.start();
    rig.wait_for(2_000, |event| *event == REFUSED);
    assert_eq!(rig.answers.dequeue(), Some(Ok(ServiceReply::Done)));
    assert_eq!(state(&rig), AlState::Bootstrap);
    let states = rig.cell.state().slaves;
    assert!(OTHERS.iter().all(|axis| states[*axis].al_state == AlState::Init));
    write_pieces(&mut rig, 6..10);
    close(&mut rig);
    assert!(has_file(&rig));
    acknowledge(&mut rig);
}

#[test]
pub(crate) fn a_failed_bus_is_brought_up_after_the_transfer_whatever_is_plugged_meanwhile() {
    let mut rig = drives();
    rig.cell.inject(Fault::Remove(4));
    rig.start();
    rig.wait_for(5_000, |event| matches!(event, BusEvent::Refused { .. }));
    open(&mut rig);
    write_pieces(&mut rig, 0..5);
    rig.recover();
    rig.wait_for(100, |event| *event == REFUSED);
    // With the missing drive the bus would be brought up unasked.
    rig.cell.inject(Fault::Insert(4));
    for _ in 0..2_000 {
        rig.millisecond();
        assert_eq!(state(&rig), AlState::Bootstrap);
    }
    write_pieces(&mut rig, 5..10);
    close(&mut rig);
    assert!(has_file(&rig));
    rig.operational();
    rig.run_ms(20);
    assert!(rig.inputs.iter().all(Option::is_some));
}

#[test]
pub(crate) fn a_stop_leaves_a_drive_in_boot() {
    let mut rig = operational_drives();
    open(&mut rig);
    write_pieces(&mut rig, 0..5);
    assert!(rig.commands.enqueue(BusCommand::Stop).is_ok());
    rig.wait_for(1_000, |event| *event == BusEvent::Stopped);
    assert_eq!(state(&rig), AlState::Bootstrap);
    write_pieces(&mut rig, 5..10);
    close(&mut rig);
    assert!(has_file(&rig));
}

#[test]
pub(crate) fn a_file_left_open_in_boot_is_closed_by_the_next_request_that_needs_the_mailbox() {
    let mut rig = operational_drives();
    open(&mut rig);
    write_pieces(&mut rig, 0..5);
    let up = ServiceRequest::SetState {
        slave: SLAVE,
        state: Asked::Operational,
    };
    assert!(matches!(rig.ask(up), Ok(ServiceReply::State(_))));
    rig.run_ms(20);
    assert_eq!(state(&rig), AlState::Operational);
    assert!(!has_file(&rig));
    // Nothing is left that could take the drive out of operation.
    close(&mut rig);
    rig.run_ms(20);
    assert_eq!(state(&rig), AlState::Operational);
}

#[test]
pub(crate) fn a_new_configuration_waits_for_a_packet_over_which_the_drive_takes_longer_than_a_file_may_lie_idle() {
    let mut rig = operational_drives();
    open(&mut rig);
    // Some twenty seconds in which the drive erases its memory.
    rig.cell
        .inject(Fault::File(usize::from(SLAVE) + 1, FileFault::Busy(1_500)));
    let piece = Piece::from_slice(&[7; 100]).expect("a short piece");
    let request = ServiceRequest::WriteFile {
        slave: SLAVE,
        piece,
        last: true,
    };
    assert!(rig.services.enqueue(request).is_ok());
    let (mut answer, began_ms) = (None, rig.now_ms);
    while answer.is_none() {
        rig.millisecond();
        assert_eq!(state(&rig), AlState::Bootstrap, "{} ms", rig.now_ms);
        if rig.now_ms == began_ms + 12_000 {
            rig.start();
        }
        answer = rig.answers.dequeue();
    }
    assert!(rig.now_ms > began_ms + 12_500, "{} ms", rig.now_ms - began_ms);
    assert_eq!(answer, Some(Ok(ServiceReply::Done)));
    rig.run_ms(500);
    assert_eq!((state(&rig), refusals(&rig)), (AlState::Bootstrap, 1), "{:#?}", rig.log);
    close(&mut rig);
    let file = rig.cell.file(usize::from(SLAVE) + 1, "fw.bin");
    assert_eq!(file, Some([7; 100].as_slice()));
    rig.start();
    rig.operational();
}
