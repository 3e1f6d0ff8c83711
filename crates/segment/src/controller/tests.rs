//! The controller alone: what passing datagrams read, write and count.

use super::*;
use crate::controller::datagram::Datagrams;
use crate::rig::*;

/// Passes one datagram; returns its data and working counter.
fn pass(controller: &mut Controller, command: u8, device: u16, register: u16, data: &[u8]) -> (Vec<u8>, u16) {
    let mut frame = frame_of(&[(command, device, register, data)]);
    let mut datagrams = Datagrams::of_frame(&mut frame).expect("a frame");
    controller.pass(&mut datagrams.next().expect("a datagram"));
    content(&frame, data.len())
}

fn controller() -> Controller {
    Controller::new(Silicon::ET1100, vec![0; 128], Nature::default())
}

#[test]
fn registers_of_the_controller_itself_are_not_written() {
    let mut controller = controller();
    for register in [0x0000, 0x0004, 0x0110, 0x0130, 0x0134, 0x0440, 0x0805, 0x0807] {
        let before = pass(&mut controller, APRD, 0, register, &[0]).0;
        assert_eq!(pass(&mut controller, APWR, 0, register, &[0xAA]).1, 0, "{register:#x}");
        assert_eq!(
            pass(&mut controller, APRD, 0, register, &[0]).0,
            before,
            "{register:#x}"
        );
    }
}

#[test]
fn a_state_request_is_not_overwritten_before_the_application_has_read_it() {
    let mut controller = controller();
    assert_eq!(pass(&mut controller, APWR, 0, 0x0120, &[2, 0]).1, 1);
    assert_eq!(pass(&mut controller, APWR, 0, 0x0120, &[1, 0]).1, 0);
    assert_eq!(controller.take_al_request(), Some(2));
    assert_eq!(pass(&mut controller, APWR, 0, 0x0120, &[1, 0]).1, 1);
}

#[test]
fn error_counters_are_cleared_by_writing() {
    let mut controller = controller();
    for links in [3, 1, 3, 1] {
        controller.set_links(links);
    }
    assert_eq!(pass(&mut controller, APRD, 0, 0x0310, &[0; 4]).0, [0, 2, 0, 0]);
    assert_eq!(pass(&mut controller, APWR, 0, 0x0310, &[9; 4]).1, 1);
    assert_eq!(pass(&mut controller, APRD, 0, 0x0310, &[7; 4]).0, [0; 4]);
}

#[test]
fn memory_ends_and_nothing_is_there_behind_it() {
    let mut controller = controller();
    assert_eq!(pass(&mut controller, APRD, 0, 0x3000, &[7; 4]), (vec![7; 4], 0));
    assert_eq!(pass(&mut controller, APWR, 0, 0xFFFE, &[7; 4]).1, 0);
    assert_eq!(
        pass(&mut controller, APWR, 0, 0x2FFE, &[7; 4]).1,
        1,
        "the part that exists"
    );
}

#[test]
fn the_alias_answers_only_when_it_is_switched_on() {
    let mut image = vec![0; 128];
    image[8] = 0x55;
    image[14] = etherpen_ethercat::wire::sii::checksum(&image);
    let mut controller = Controller::new(Silicon::ET1100, image, Nature::default());
    pass(&mut controller, APWR, 0, 0x0010, &[0x01, 0x10]);
    assert_eq!(pass(&mut controller, FPRD, 0x1001, 0x0012, &[0; 2]), (vec![0x55, 0], 1));
    assert_eq!(pass(&mut controller, FPRD, 0x0055, 0x0012, &[0; 2]).1, 0);
    pass(&mut controller, APWR, 0, 0x0103, &[1]);
    assert_eq!(pass(&mut controller, FPRD, 0x0055, 0x0012, &[0; 2]).1, 1);
}

#[test]
fn a_read_and_write_counts_three_and_gives_the_old_content() {
    let mut controller = controller();
    assert_eq!(pass(&mut controller, APRW, 0, 0x1000, &[5, 6]), (vec![0, 0], 3));
    assert_eq!(pass(&mut controller, APRW, 0, 0x1000, &[7, 8]), (vec![5, 6], 3));
    assert_eq!(
        pass(&mut controller, BRW, 9, 0x1000, &[0x10, 0]),
        (vec![0x17, 8], 3),
        "or-ed"
    );
    assert_eq!(pass(&mut controller, APRD, 0, 0x1000, &[0; 2]).0, [0x10, 0]);
}

#[test]
fn the_others_write_what_one_reads() {
    let mut controller = controller();
    pass(&mut controller, APWR, 0, 0x1000, &[5]);
    assert_eq!(pass(&mut controller, ARMW, 0, 0x1000, &[9]), (vec![5], 1));
    assert_eq!(pass(&mut controller, ARMW, 1, 0x1000, &[9]), (vec![9], 1));
    assert_eq!(pass(&mut controller, APRD, 0, 0x1000, &[0]).0, [9]);
}

#[test]
fn single_bits_pass_through_a_mapping_and_leave_their_neighbours() {
    let mut controller = controller();
    pass(&mut controller, APWR, 0, 0x1000, &[0xF0, 0x0F]);
    let write = [0, 0, 0, 0, 1, 0, 2, 4, 0x00, 0x10, 3, 2, 1, 0, 0, 0];
    pass(&mut controller, APWR, 0, 0x0600, &write);
    let read = [1, 0, 0, 0, 1, 0, 0, 3, 0x01, 0x10, 2, 1, 1, 0, 0, 0];
    pass(&mut controller, APWR, 0, 0x0610, &read);
    let (data, count) = pass(&mut controller, LRW, 0, 0, &[0b0000_0100, 0xA0]);
    assert_eq!((data, count), (vec![0b0000_0100, 0xA3], 3));
    assert_eq!(pass(&mut controller, APRD, 0, 0x1000, &[0; 2]).0, [0b1100_1000, 0x0F]);
}

#[test]
fn a_mailbox_that_is_written_short_stays_empty() {
    let mut controller = controller();
    pass(&mut controller, APWR, 0, 0x0800, &[0x00, 0x18, 8, 0, 0x26, 0, 1, 0]);
    assert_eq!(pass(&mut controller, APWR, 0, 0x1800, &[1; 7]).1, 1);
    assert_eq!(pass(&mut controller, APRD, 0, 0x0805, &[0]).0[0] & 0x08, 0);
    assert_eq!(pass(&mut controller, APWR, 0, 0x1800, &[1; 8]).1, 1);
    assert_eq!(pass(&mut controller, APRD, 0, 0x0805, &[0]).0[0] & 0x08, 0x08);
    assert_eq!(pass(&mut controller, APWR, 0, 0x1800, &[2; 8]).1, 0);
}

#[test]
fn the_last_mail_stays_in_the_memory_of_a_sync_manager_that_is_switched_off() {
    let mut controller = controller();
    pass(&mut controller, APWR, 0, 0x0800, &[0x00, 0x18, 4, 0, 0x26, 0, 1, 0]);
    assert_eq!(pass(&mut controller, APWR, 0, 0x1800, &[1, 2, 3, 4]).1, 1);
    assert_eq!(pass(&mut controller, APRD, 0, 0x1800, &[0; 4]).1, 0);
    pass(&mut controller, APWR, 0, 0x0800, &[0; 8]);
    assert_eq!(pass(&mut controller, APRD, 0, 0x1800, &[0; 4]), (vec![1, 2, 3, 4], 1));
}
