//! The servo drive AX2000-B110: identity, object dictionary and process data around a CiA 402 drive.
//!
//! Process data take fixed objects: RxPDO 0x1702 (velocity demand, control word) and TxPDO 0x1B01 (position, status
//! word), six bytes each, assigned through 0x1C12 and 0x1C13 in PREOP. The default assignment of the real drive is
//! not known; here it is these two. Quick-stop deceleration 0x6085 counts position increments per second squared.

use super::application::AlState;
use super::coe::{Abort, ObjectDictionary};
use super::drive::{Demand, Drive, MODE_DIGITAL_SPEED};
use super::sii::{self, Description, PdoEntry, SyncManagerDefault};
use etherpen::ethercat::wire::register::{CONTROL_INPUTS, CONTROL_MAILBOX_IN, CONTROL_MAILBOX_OUT, CONTROL_OUTPUTS};
use etherpen::ethercat::wire::sii::{Identity, MailboxWindow};
use std::collections::VecDeque;

/// Name in the information image and in object 0x1008.
pub const NAME: &str = "AX2000-B110 EtherCAT Drive";
/// Mailbox the master writes.
pub(super) const MAILBOX_OUT: MailboxWindow = MailboxWindow {
    start: 0x1800,
    length: 512,
};
/// Mailbox the master reads.
pub(super) const MAILBOX_IN: MailboxWindow = MailboxWindow {
    start: 0x1C00,
    length: 512,
};
/// Bytes of the process data in each direction.
pub(super) const PROCESS_DATA_BYTES: usize = 6;

const ORDER: &str = "AX2000-B110";
const VENDOR: u32 = 0x0000_0002;
const PRODUCT: u32 = 0x07D0_6014;
const REVISION: u32 = 0x0000_110A;
/// Servo drive of profile 402.
const DEVICE_TYPE: u32 = 0x0002_0192;
const SOFTWARE_VERSION: &str = "cell 1";
const RX_PDO: u16 = 0x1702;
const TX_PDO: u16 = 0x1B01;
const OUTPUT_START: u16 = 0x1100;
const INPUT_START: u16 = 0x1140;
/// Longest comment that object 0x2FFE takes, bytes.
const COMMENT_BYTES_MAX: usize = 4096;
const ERROR_REGISTER_GENERIC: u8 = 0x01;

const OUTPUT_ENTRIES: [PdoEntry; 2] = [
    PdoEntry {
        index: 0x606B,
        bits: 32,
    },
    PdoEntry {
        index: 0x6040,
        bits: 16,
    },
];
const INPUT_ENTRIES: [PdoEntry; 2] = [
    PdoEntry {
        index: 0x6064,
        bits: 32,
    },
    PdoEntry {
        index: 0x6041,
        bits: 16,
    },
];

const SYNC_MANAGERS: [SyncManagerDefault; 4] = [
    manager(MAILBOX_OUT.start, MAILBOX_OUT.length, CONTROL_MAILBOX_OUT, 1),
    manager(MAILBOX_IN.start, MAILBOX_IN.length, CONTROL_MAILBOX_IN, 2),
    manager(OUTPUT_START, PROCESS_DATA_BYTES as u16, CONTROL_OUTPUTS, 3),
    manager(INPUT_START, PROCESS_DATA_BYTES as u16, CONTROL_INPUTS, 4),
];

const fn manager(start: u16, length: u16, control: u8, kind: u8) -> SyncManagerDefault {
    SyncManagerDefault {
        start,
        length,
        control,
        activate: 1,
        kind,
    }
}

/// One PDO assignment object: how many of its entries count, and the entry.
#[derive(Clone, Copy, Debug)]
struct Assignment {
    count: u8,
    pdo: u16,
}

/// The device behind one slave controller.
#[derive(Clone, Debug)]
pub(super) struct Ax2000 {
    /// The drive and its motor.
    pub(super) drive: Drive,
    serial: u32,
    state: AlState,
    outputs: Assignment,
    inputs: Assignment,
    period_ms: u8,
    comment: Vec<u8>,
    demands: VecDeque<Demand>,
    samples: VecDeque<[u8; PROCESS_DATA_BYTES]>,
    output_delay: usize,
    input_delay: usize,
}

impl Ax2000 {
    /// A drive at a joint angle, with delays of whole milliseconds between bus and motor.
    pub(super) fn new(drive: Drive, serial: u32, output_delay: usize, input_delay: usize) -> Self {
        Self {
            drive,
            serial,
            state: AlState::Init,
            outputs: Assignment { count: 1, pdo: RX_PDO },
            inputs: Assignment { count: 1, pdo: TX_PDO },
            period_ms: 1,
            comment: Vec::new(),
            demands: VecDeque::new(),
            samples: VecDeque::new(),
            output_delay,
            input_delay,
        }
    }

    /// Everything but the motor back to its state after power-up.
    pub(super) fn power_up(&mut self) {
        let mut drive = self.drive.clone();
        drive.power_up();
        *self = Self::new(drive, self.serial, self.output_delay, self.input_delay);
    }

    /// The slave information image.
    pub(super) fn image(&self) -> Vec<u8> {
        sii::image(&Description {
            identity: self.identity(),
            name: NAME,
            order: ORDER,
            mailbox_out: MAILBOX_OUT,
            mailbox_in: MAILBOX_IN,
            sync_managers: &SYNC_MANAGERS,
            rx_pdo: (RX_PDO, &OUTPUT_ENTRIES),
            tx_pdo: (TX_PDO, &INPUT_ENTRIES),
        })
    }

    /// Bytes of outputs and inputs that the present assignment needs.
    pub(super) fn process_data_bytes(&self) -> (usize, usize) {
        let bytes = |assignment: Assignment| if assignment.count > 0 { PROCESS_DATA_BYTES } else { 0 };
        (bytes(self.outputs), bytes(self.inputs))
    }

    /// The application layer has another state.
    pub(super) fn set_state(&mut self, state: AlState) {
        self.state = state;
    }

    /// One millisecond: the newest outputs (none outside OP) go in, the inputs for the bus come out.
    pub(super) fn step(&mut self, outputs: Option<&[u8]>) -> [u8; PROCESS_DATA_BYTES] {
        let demand = match outputs.and_then(|outputs| outputs.first_chunk()) {
            Some(&[v0, v1, v2, v3, c0, c1]) => {
                self.demands.push_back(Demand {
                    velocity_digits: i32::from_le_bytes([v0, v1, v2, v3]),
                    control: u16::from_le_bytes([c0, c1]),
                });
                if self.demands.len() > self.output_delay {
                    Some(self.demands.pop_front().unwrap_or_default())
                } else {
                    Some(Demand::default())
                }
            }
            None => {
                self.demands.clear();
                None
            }
        };
        self.drive.step(demand);
        self.samples.push_back(self.sample());
        match self.samples.len() > self.input_delay {
            true => self.samples.pop_front(),
            false => self.samples.front().copied(),
        }
        .unwrap_or_default()
    }

    /// The next emergency: code, error register, manufacturer's bytes.
    pub(super) fn take_emergency(&mut self) -> Option<(u16, u8, [u8; 5])> {
        self.drive
            .take_emergency()
            .map(|code| (code, self.error_register(), [0; 5]))
    }

    fn identity(&self) -> Identity {
        Identity {
            vendor: VENDOR,
            product: PRODUCT,
            revision: REVISION,
            serial: self.serial,
        }
    }

    fn error_register(&self) -> u8 {
        if self.drive.error_code() == 0 {
            0
        } else {
            ERROR_REGISTER_GENERIC
        }
    }

    fn sample(&self) -> [u8; PROCESS_DATA_BYTES] {
        let [p0, p1, p2, p3] = self.drive.position().to_le_bytes();
        let [s0, s1] = self.drive.status().to_le_bytes();
        [p0, p1, p2, p3, s0, s1]
    }

    fn assign(&mut self, index: u16, sub: u8, value: &[u8]) -> Result<(), Abort> {
        if self.state != AlState::PreOperational {
            return Err(Abort::STATE);
        }
        let (assignment, only) = match index {
            0x1C12 => (&mut self.outputs, RX_PDO),
            _ => (&mut self.inputs, TX_PDO),
        };
        match sub {
            0 => {
                let [count] = exactly(value)?;
                if count > 1 {
                    return Err(Abort::VALUE);
                }
                assignment.count = count;
            }
            1 if assignment.count != 0 => return Err(Abort::SUB_INDEX_ZERO_FIRST),
            1 => {
                let pdo = u16::from_le_bytes(exactly(value)?);
                if pdo != only {
                    return Err(Abort::NOT_MAPPABLE);
                }
                assignment.pdo = pdo;
            }
            _ => return Err(Abort::NO_SUB_INDEX),
        }
        Ok(())
    }
}

impl ObjectDictionary for Ax2000 {
    fn upload(&self, index: u16, sub: u8) -> Result<Vec<u8>, Abort> {
        let identity = self.identity();
        let mapped = |entries: &[PdoEntry; 2]| match usize::from(sub).checked_sub(1) {
            None => Ok(vec![entries.len() as u8]),
            Some(at) => entries
                .get(at)
                .map(|entry| vec![entry.bits, 0, entry.index as u8, (entry.index >> 8) as u8])
                .ok_or(Abort::NO_SUB_INDEX),
        };
        let value = match (index, sub) {
            (0x1000, 0) => DEVICE_TYPE.to_le_bytes().into(),
            (0x1001, 0) => vec![self.error_register()],
            (0x1008, 0) => NAME.into(),
            (0x100A, 0) => SOFTWARE_VERSION.into(),
            (0x1018, 0) => vec![4],
            (0x1018, 1) => identity.vendor.to_le_bytes().into(),
            (0x1018, 2) => identity.product.to_le_bytes().into(),
            (0x1018, 3) => identity.revision.to_le_bytes().into(),
            (0x1018, 4) => identity.serial.to_le_bytes().into(),
            (RX_PDO, _) => return mapped(&OUTPUT_ENTRIES),
            (TX_PDO, _) => return mapped(&INPUT_ENTRIES),
            (0x1C00, 0) => vec![4],
            (0x1C00, 1..=4) => vec![sub],
            (0x1C12, 0) => vec![self.outputs.count],
            (0x1C12, 1) => self.outputs.pdo.to_le_bytes().into(),
            (0x1C13, 0) => vec![self.inputs.count],
            (0x1C13, 1) => self.inputs.pdo.to_le_bytes().into(),
            (0x2FFE, 0) => self.comment.clone(),
            (0x603F, 0) => self.drive.error_code().to_le_bytes().into(),
            (0x6040, 0) => self.drive.control().to_le_bytes().into(),
            (0x6041, 0) => self.drive.status().to_le_bytes().into(),
            (0x6060, 0) => self.drive.mode.to_le_bytes().into(),
            (0x6061, 0) => self.drive.mode_display.to_le_bytes().into(),
            (0x6064, 0) => self.drive.position().to_le_bytes().into(),
            (0x606B, 0) => self.drive.velocity_digits().to_le_bytes().into(),
            (0x6085, 0) => self.drive.quick_stop_increments_s2.to_le_bytes().into(),
            (0x60C2, 0) => vec![2],
            (0x60C2, 1) => vec![self.period_ms],
            (0x60C2, 2) => (-3i8).to_le_bytes().into(),
            _ => return Err(self.absent(index)),
        };
        Ok(value)
    }

    fn download(&mut self, index: u16, sub: u8, value: &[u8]) -> Result<(), Abort> {
        match (index, sub) {
            (0x1C12 | 0x1C13, _) => self.assign(index, sub, value),
            (0x2FFE, 0) if value.len() > COMMENT_BYTES_MAX => Err(Abort::TOO_LONG),
            (0x2FFE, 0) => {
                self.comment = value.to_vec();
                Ok(())
            }
            (0x6060, 0) => match i8::from_le_bytes(exactly(value)?) {
                mode @ (MODE_DIGITAL_SPEED | -3 | -1) => {
                    self.drive.mode = mode;
                    Ok(())
                }
                _ => Err(Abort::VALUE),
            },
            (0x6085, 0) => match u32::from_le_bytes(exactly(value)?) {
                0 => Err(Abort::VALUE),
                deceleration => {
                    self.drive.quick_stop_increments_s2 = deceleration;
                    Ok(())
                }
            },
            (0x60C2, 1) => match exactly(value)? {
                [period_ms @ 1..=16] => {
                    self.period_ms = period_ms;
                    Ok(())
                }
                _ => Err(Abort::VALUE),
            },
            (0x60C2, 2) => match i8::from_le_bytes(exactly(value)?) {
                -3 => Ok(()),
                _ => Err(Abort::VALUE),
            },
            _ => Err(match self.upload(index, sub) {
                Ok(_) => Abort::READ_ONLY,
                Err(abort) => abort,
            }),
        }
    }
}

impl Ax2000 {
    /// Why an entry cannot be found: its object is not there, or the sub-index is not.
    fn absent(&self, index: u16) -> Abort {
        let objects = [
            0x1000, 0x1001, 0x1008, 0x100A, 0x1018, 0x1C00, 0x1C12, 0x1C13, 0x2FFE, 0x603F, 0x6040, 0x6041, 0x6060,
            0x6061, 0x6064, 0x606B, 0x6085, 0x60C2,
        ];
        if objects.contains(&index) {
            Abort::NO_SUB_INDEX
        } else {
            Abort::NO_OBJECT
        }
    }
}

fn exactly<const N: usize>(value: &[u8]) -> Result<[u8; N], Abort> {
    match value.len() {
        length if length > N => Err(Abort::TOO_LONG),
        length if length < N => Err(Abort::TOO_SHORT),
        _ => value.first_chunk().copied().ok_or(Abort::LENGTH),
    }
}
