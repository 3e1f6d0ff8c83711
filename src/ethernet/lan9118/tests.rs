//! The driver against a model of the controller's registers.

use super::*;
use core::task::Waker;
use embassy_net_driver::{RxToken as _, TxToken as _};
use std::collections::VecDeque;
use std::vec;
use std::vec::Vec;

const ADDRESS: [u8; 6] = [0x02, 0, 0, 0, 0, 0x01];
const TX_FIFO_BYTES: u32 = 4608;

/// The chip as far as the driver uses it. A frame leaves when its last word is written, unless the wire is held.
struct Model {
    byte_test: u32,
    chip: u32,
    reset_ends: bool,
    mac_busy: bool,
    mac: [u32; 4],
    interrupt: u32,
    rx_status: VecDeque<u32>,
    rx_data: VecDeque<u32>,
    tx_words: Vec<u32>,
    tx_status: VecDeque<u32>,
    tx_error: bool,
    tx_free: u32,
    sent: Vec<Vec<u8>>,
    hw_cfg: u32,
    mac_data: u32,
}

impl Model {
    fn new() -> Self {
        Self {
            byte_test: BYTE_TEST,
            chip: CHIP << 16 | 1,
            reset_ends: true,
            mac_busy: false,
            mac: [0; 4],
            interrupt: 0,
            rx_status: VecDeque::new(),
            rx_data: VecDeque::new(),
            tx_words: Vec::new(),
            tx_status: VecDeque::new(),
            tx_error: false,
            tx_free: TX_FIFO_BYTES,
            sent: Vec::new(),
            hw_cfg: 0,
            mac_data: 0,
        }
    }

    /// A frame arrives with its check sequence; `status` holds more bits for its status word.
    fn receive(&mut self, frame: &[u8], status: u32) {
        let mut bytes = frame.to_vec();
        bytes.extend([0xfc; CHECK_SEQUENCE_BYTES]);
        self.rx_status
            .push_back((bytes.len() as u32) << RX_LENGTH_SHIFT | status);
        bytes.resize(bytes.len().next_multiple_of(WORD_BYTES), 0xee);
        self.rx_data
            .extend(bytes.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word)));
        self.interrupt |= INT_RX_STATUS_LEVEL;
    }

    fn transmit_word(&mut self, word: u32) {
        self.tx_words.push(word);
        let [first, second, data @ ..] = self.tx_words.as_slice() else {
            return;
        };
        let length = (first & TX_LENGTH_MASK) as usize;
        assert_eq!(second & TX_LENGTH_MASK, first & TX_LENGTH_MASK);
        assert_eq!(first & !TX_LENGTH_MASK, TX_FIRST_SEGMENT | TX_LAST_SEGMENT);
        if data.len() * WORD_BYTES >= length {
            let mut frame: Vec<u8> = data.iter().flat_map(|word| word.to_le_bytes()).collect();
            frame.truncate(length);
            self.sent.push(frame);
            self.tx_words.clear();
            self.tx_status.push_back(if self.tx_error { STATUS_ERROR } else { 0 });
        }
    }
}

impl Registers for &mut Model {
    fn read(&mut self, register: Register) -> u32 {
        match register {
            Register::ByteTest => self.byte_test,
            Register::IdRev => self.chip,
            Register::HwCfg => self.hw_cfg,
            Register::MacCsrCmd => u32::from(self.mac_busy) << 31,
            Register::RxFifoInf => {
                (self.rx_status.len() as u32) << FIFO_STATUS_SHIFT | (self.rx_data.len() * WORD_BYTES) as u32
            }
            Register::RxStatus => self.rx_status.pop_front().expect("a status to take"),
            Register::RxData => self.rx_data.pop_front().expect("a word to take"),
            Register::TxFifoInf => (self.tx_status.len() as u32) << FIFO_STATUS_SHIFT | self.tx_free,
            Register::TxStatus => self.tx_status.pop_front().expect("a status to take"),
            other => panic!("the driver has no reason to read {other:?}"),
        }
    }

    fn write(&mut self, register: Register, value: u32) {
        match register {
            Register::HwCfg if self.reset_ends => self.hw_cfg = value & !HW_SOFT_RESET,
            Register::HwCfg => self.hw_cfg = value,
            Register::IntSts => self.interrupt &= !value,
            Register::RxCfg if value & RX_DUMP != 0 => {
                self.rx_status.clear();
                self.rx_data.clear();
            }
            Register::TxData => self.transmit_word(value),
            Register::MacCsrData => self.mac_data = value,
            Register::MacCsrCmd => {
                let data = self.mac_data;
                let register = (value & !MAC_BUSY) as usize;
                self.mac[register] = data;
            }
            _ => {}
        }
    }
}

fn started(model: &mut Model) -> Lan9118<&mut Model> {
    Lan9118::start(model, ADDRESS).expect("the model starts")
}

fn model<'a>(driver: &'a mut Lan9118<&mut Model>) -> &'a mut Model {
    driver.port.registers
}

fn receive(driver: &mut Lan9118<&mut Model>) -> Option<Vec<u8>> {
    let mut context = Context::from_waker(Waker::noop());
    let (frame, _) = driver.receive(&mut context)?;
    Some(frame.consume(|bytes| bytes.to_vec()))
}

fn transmit(driver: &mut Lan9118<&mut Model>, frame: &[u8]) -> bool {
    let mut context = Context::from_waker(Waker::noop());
    let Some(token) = driver.transmit(&mut context) else {
        return false;
    };
    token.consume(frame.len(), |bytes| {
        let length = bytes.len();
        bytes.copy_from_slice(&frame[..length]);
    });
    true
}

fn numbered(length: usize) -> Vec<u8> {
    (0..length).map(|byte| byte as u8).collect()
}

#[test]
fn a_start_switches_both_directions_on_and_sets_the_address() {
    let mut chip = Model::new();
    started(&mut chip);
    assert_eq!(
        chip.mac[1] & (MAC_TX_ENABLE | MAC_RX_ENABLE),
        MAC_TX_ENABLE | MAC_RX_ENABLE
    );
    assert_eq!(chip.mac[3].to_le_bytes(), [0x02, 0, 0, 0]);
    assert_eq!(chip.mac[2], 0x0100);
}

#[test]
fn a_chip_that_is_absent_other_or_stuck_is_named() {
    let mut absent = Model::new();
    absent.byte_test = 0x2143_6587;
    let mut other = Model::new();
    other.chip = 0x0117 << 16;
    let mut stuck = Model::new();
    stuck.reset_ends = false;
    let mut busy = Model::new();
    busy.mac_busy = true;
    let errors = [&mut absent, &mut other, &mut stuck, &mut busy].map(|chip| Lan9118::start(chip, ADDRESS).err());
    assert_eq!(
        errors,
        [
            Some(StartError::ByteTest {
                expected: BYTE_TEST,
                actual: 0x2143_6587
            }),
            Some(StartError::Chip {
                expected: CHIP,
                actual: 0x0117
            }),
            Some(StartError::ResetTimeout),
            Some(StartError::MacTimeout { register: MAC_ADDRL }),
        ]
    );
}

#[test]
fn frames_of_all_lengths_come_through_whole_and_without_their_check_sequence() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    for length in HEADER_BYTES..=FRAME_BYTES_MAX {
        model(&mut driver).receive(&numbered(length), 0);
        assert_eq!(receive(&mut driver), Some(numbered(length)));
    }
    assert_eq!(receive(&mut driver), None);
    assert_eq!(driver.counters(), Counters::default());
}

#[test]
fn a_frame_of_wrong_length_or_with_an_error_costs_itself_only() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    let good = numbered(61);
    for (length, status) in [(9, 0), (FRAME_BYTES_MAX + 1, 0), (60, STATUS_ERROR), (4000, 0)] {
        model(&mut driver).receive(&numbered(length), status);
        model(&mut driver).receive(&good, 0);
    }
    for _ in 0..4 {
        assert_eq!(receive(&mut driver).as_ref(), Some(&good));
    }
    assert_eq!(receive(&mut driver), None);
    let counters = driver.counters();
    assert_eq!((counters.rx_lengths, counters.rx_errors), (3, 1));
}

#[test]
fn a_status_without_its_data_empties_the_fifo_and_is_counted() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    model(&mut driver)
        .rx_status
        .push_back(RX_LENGTH_MASK << RX_LENGTH_SHIFT);
    assert_eq!(receive(&mut driver), None);
    assert_eq!(driver.counters().rx_inconsistent, 1);
    model(&mut driver).receive(&numbered(60), 0);
    assert_eq!(receive(&mut driver), Some(numbered(60)));
}

#[test]
fn a_short_frame_is_padded_with_zeros_and_not_with_the_frame_before() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    assert!(transmit(&mut driver, &[0xff; 200]));
    assert!(transmit(&mut driver, &[0x55; 21]));
    let mut padded = vec![0x55; 21];
    padded.resize(FRAME_BYTES_MIN, 0);
    assert_eq!(model(&mut driver).sent, [vec![0xff; 200], padded]);
}

#[test]
fn frames_of_all_lengths_leave_whole() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    for length in FRAME_BYTES_MIN..=FRAME_BYTES_MAX {
        assert!(transmit(&mut driver, &numbered(length)));
        assert_eq!(model(&mut driver).sent.pop(), Some(numbered(length)));
    }
    assert_eq!(model(&mut driver).tx_status.len(), 0);
    assert_eq!(driver.counters().failures(), 0);
}

#[test]
fn a_frame_that_is_too_long_is_counted_and_not_sent() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    assert!(transmit(&mut driver, &numbered(FRAME_BYTES_MAX + 1)));
    assert_eq!(model(&mut driver).sent.len(), 0);
    assert_eq!(driver.counters().tx_too_long, 1);
}

#[test]
fn without_room_no_frame_is_started() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    model(&mut driver).tx_free = 256;
    assert!(!transmit(&mut driver, &numbered(60)));
    // The token of a received frame exists without room, too.
    model(&mut driver).receive(&numbered(60), 0);
    let mut context = Context::from_waker(Waker::noop());
    let (_, token) = driver.receive(&mut context).expect("a frame");
    token.consume(400, |bytes| bytes.fill(1));
    assert_eq!(driver.counters().tx_no_room, 2);
    assert!(model(&mut driver).tx_words.is_empty() && model(&mut driver).sent.is_empty());
}

#[test]
fn an_error_in_a_transmit_status_is_counted_and_the_status_taken() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    model(&mut driver).tx_error = true;
    assert!(transmit(&mut driver, &numbered(60)));
    assert_eq!(driver.counters().tx_errors, 1);
    assert_eq!(model(&mut driver).tx_status.len(), 0);
}

#[test]
fn an_arrival_after_the_acknowledgement_interrupts_again() {
    let mut chip = Model::new();
    let mut driver = started(&mut chip);
    model(&mut driver).receive(&numbered(60), 0);
    driver.acknowledge();
    assert_eq!(model(&mut driver).interrupt & INT_RX_STATUS_LEVEL, 0);
    model(&mut driver).receive(&numbered(60), 0);
    assert_eq!(model(&mut driver).interrupt & INT_RX_STATUS_LEVEL, INT_RX_STATUS_LEVEL);
}
