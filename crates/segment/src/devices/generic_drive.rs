//! A generic CiA 402 servo drive with variable process-data mapping.
//!
//! Vendor and product number belong to this project, not to a manufacturer. Modes: homing (6), cyclic synchronous
//! position (8),
//! velocity (9) and torque (10). Velocity is in the drive's velocity digits, torque in 1/1000 of the rated torque,
//! position in increments over all turns. In position mode the drive interpolates between the targets and trips on too
//! great a following error. It keeps files, which are written in BOOT, where its mailboxes have other places and
//! lengths. Objects: CiA 402; mapping: CiA 301, and 0x1C12, 0x1C13.

use crate::controller::silicon::Silicon;
use crate::devices::servo_device::{HISTORY, Model};
use crate::drive::history;
use crate::drive::homing::is_method;
use crate::drive::servo::Servo;
use crate::drive::{
    MODE_CYCLIC_POSITION, MODE_CYCLIC_TORQUE, MODE_CYCLIC_VELOCITY, MODE_HOMING, Profile, RATED_TORQUE_MNM,
};
use crate::eeprom::sii;
use crate::eeprom::windows::Windows;
use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::{DataType, ObjectRow, Value, access, record, variable};
use crate::mailbox::process_data::{Pdo, PdoEntry, ProcessData};
use DataType::{
    Boolean, Integer8, Integer16, Integer32, OctetString, Unsigned8, Unsigned16, Unsigned32, VisibleString,
};
use Value::{Live, Number, Stored, Text};
use access::{READ, READ_WRITE, RX, TX};
use etherpen_ethercat::wire::sii::{Identity, MailboxWindow, PROTOCOL_COE, PROTOCOL_FOE};

const NAME: &str = "etherpen CiA 402 drive";
const ORDER: &str = "EP-402";
const IDENTITY: Identity = Identity {
    vendor: 0x0000_0E7E,
    product: 0x0000_0402,
    revision: 0x0001_0000,
    serial: 0,
};
const WINDOWS: Windows = Windows {
    mailbox_out: MailboxWindow {
        start: 0x1000,
        length: 256,
    },
    mailbox_in: MailboxWindow {
        start: 0x1200,
        length: 256,
    },
    outputs: 0x1400,
    inputs: 0x1600,
    protocols: PROTOCOL_COE | PROTOCOL_FOE,
    bootstrap_out: MailboxWindow {
        start: 0x1800,
        length: 400,
    },
    bootstrap_in: MailboxWindow {
        start: 0x1A00,
        length: 300,
    },
};
/// Modes 6, 8, 9 and 10: bits 5 and 7 to 9 of object 0x6502.
const SUPPORTED_MODES: i64 = 0x03A0;

const OBJECTS: &[ObjectRow] = &[
    variable(
        0x1008,
        "Device name",
        &[(0, "Device name", VisibleString, READ, Text(NAME))],
    ),
    variable(
        0x1009,
        "Hardware version",
        &[(0, "Hardware version", VisibleString, READ, Text("1"))],
    ),
    variable(
        0x100A,
        "Software version",
        &[(0, "Software version", VisibleString, READ, Text("1"))],
    ),
    record(
        HISTORY,
        "Diagnosis history",
        &[
            (1, "Maximum messages", Unsigned8, READ, Number(history::ROOM as i64)),
            (2, "Newest message", Unsigned8, READ, Live),
            (3, "Newest acknowledged message", Unsigned8, READ_WRITE, Live),
            (4, "New messages available", Boolean, READ | TX, Live),
            (5, "Flags", Unsigned16, READ, Number(0)),
            (6, "Diagnosis message 1", OctetString, READ, Live),
            (7, "Diagnosis message 2", OctetString, READ, Live),
            (8, "Diagnosis message 3", OctetString, READ, Live),
            (9, "Diagnosis message 4", OctetString, READ, Live),
            (10, "Diagnosis message 5", OctetString, READ, Live),
            (11, "Diagnosis message 6", OctetString, READ, Live),
            (12, "Diagnosis message 7", OctetString, READ, Live),
            (13, "Diagnosis message 8", OctetString, READ, Live),
        ],
    ),
    variable(0x603F, "Error code", &[(0, "Error code", Unsigned16, READ | TX, Live)]),
    variable(
        0x6040,
        "Control word",
        &[(0, "Control word", Unsigned16, READ_WRITE | RX, Live)],
    ),
    variable(
        0x605A,
        "Quick stop option code",
        &[(
            0,
            "Quick stop option code",
            Integer16,
            READ_WRITE,
            Stored {
                first: 2,
                low: 2,
                high: 2,
            },
        )],
    ),
    variable(
        0x6060,
        "Modes of operation",
        &[(0, "Modes of operation", Integer8, READ_WRITE | RX, Live)],
    ),
    variable(
        0x6061,
        "Modes of operation display",
        &[(0, "Modes of operation display", Integer8, READ | TX, Live)],
    ),
    variable(
        0x606C,
        "Velocity actual value",
        &[(0, "Velocity actual value", Integer32, READ | TX, Live)],
    ),
    variable(
        0x6071,
        "Target torque",
        &[(0, "Target torque", Integer16, READ_WRITE | RX, Live)],
    ),
    variable(
        0x6076,
        "Motor rated torque",
        &[(
            0,
            "Motor rated torque",
            Unsigned32,
            READ,
            Number(RATED_TORQUE_MNM as i64),
        )],
    ),
    variable(
        0x607A,
        "Target position",
        &[(0, "Target position", Integer32, READ_WRITE | RX, Live)],
    ),
    variable(
        0x6062,
        "Position demand value",
        &[(0, "Position demand value", Integer32, READ | TX, Live)],
    ),
    variable(
        0x6065,
        "Following error window",
        &[(0, "Following error window", Unsigned32, READ_WRITE, Live)],
    ),
    variable(
        0x6066,
        "Following error time out",
        &[(0, "Following error time out", Unsigned16, READ_WRITE, Live)],
    ),
    record(
        0x607B,
        "Position range limit",
        &[
            (1, "Min position range limit", Integer32, READ, Live),
            (2, "Max position range limit", Integer32, READ, Live),
        ],
    ),
    variable(
        0x607C,
        "Home offset",
        &[(0, "Home offset", Integer32, READ_WRITE, Live)],
    ),
    variable(
        0x6098,
        "Homing method",
        &[(0, "Homing method", Integer8, READ_WRITE, Live)],
    ),
    record(
        0x6099,
        "Homing speeds",
        &[
            (1, "Speed during search for switch", Unsigned32, READ_WRITE, Live),
            (2, "Speed during search for zero", Unsigned32, READ_WRITE, Live),
        ],
    ),
    variable(
        0x609A,
        "Homing acceleration",
        &[(0, "Homing acceleration", Unsigned32, READ_WRITE, Live)],
    ),
    variable(
        0x60B1,
        "Velocity offset",
        &[(0, "Velocity offset", Integer32, READ_WRITE | RX, Live)],
    ),
    variable(
        0x60B8,
        "Touch probe function",
        &[(0, "Touch probe function", Unsigned16, READ_WRITE | RX, Live)],
    ),
    variable(
        0x60B9,
        "Touch probe status",
        &[(0, "Touch probe status", Unsigned16, READ | TX, Live)],
    ),
    variable(
        0x60BA,
        "Touch probe 1 positive edge",
        &[(0, "Touch probe 1 positive edge", Integer32, READ | TX, Live)],
    ),
    variable(
        0x60BB,
        "Touch probe 1 negative edge",
        &[(0, "Touch probe 1 negative edge", Integer32, READ | TX, Live)],
    ),
    variable(
        0x60BC,
        "Touch probe 2 positive edge",
        &[(0, "Touch probe 2 positive edge", Integer32, READ | TX, Live)],
    ),
    variable(
        0x60BD,
        "Touch probe 2 negative edge",
        &[(0, "Touch probe 2 negative edge", Integer32, READ | TX, Live)],
    ),
    record(
        0x60C2,
        "Interpolation time period",
        &[
            (1, "Interpolation time period value", Unsigned8, READ_WRITE, Live),
            (2, "Interpolation time index", Integer8, READ_WRITE, Live),
        ],
    ),
    variable(
        0x60F4,
        "Following error actual value",
        &[(0, "Following error actual value", Integer32, READ | TX, Live)],
    ),
    variable(
        0x60FD,
        "Digital inputs",
        &[(0, "Digital inputs", Unsigned32, READ | TX, Live)],
    ),
    variable(
        0x60FF,
        "Target velocity",
        &[(0, "Target velocity", Integer32, READ_WRITE | RX, Live)],
    ),
    variable(
        0x6502,
        "Supported drive modes",
        &[(0, "Supported drive modes", Unsigned32, READ, Number(SUPPORTED_MODES))],
    ),
];

/// Model data of the drive.
pub(crate) static MODEL: Model = Model {
    silicon: Silicon::ET1100,
    maps_once: false,
    name: NAME,
    order: ORDER,
    identity: IDENTITY,
    windows: WINDOWS,
    details: sii::DETAILS_MAPPABLE_PDO,
    objects: OBJECTS,
    profile: Profile::Cia402,
    process_data,
    get,
    set,
    set_output,
};

fn process_data() -> ProcessData {
    let word = |index| PdoEntry::new(index, 16);
    let long = |index| PdoEntry::new(index, 32);
    let byte = |index| PdoEntry::new(index, 8);
    let (control, status) = (word(0x6040), word(0x6041));
    let pdos = vec![
        Pdo::new(0x1600, "Velocity", false, &[control, long(0x60FF)]),
        Pdo::new(0x1601, "Torque", false, &[control, word(0x6071)]),
        Pdo::new(
            0x1602,
            "All",
            false,
            &[control, long(0x607A), long(0x60FF), byte(0x6060)],
        ),
        Pdo::new(0x1A00, "Position", false, &[status, long(0x6064)]),
        Pdo::new(
            0x1A01,
            "Position and torque",
            false,
            &[status, long(0x6064), word(0x6077)],
        ),
        Pdo::new(
            0x1A02,
            "All",
            false,
            &[status, long(0x6064), long(0x606C), byte(0x6061)],
        ),
    ];
    ProcessData::new(pdos, &[0x1600], &[0x1A00], 3)
}

/// Reads a live object of a CiA 402 drive.
pub(crate) fn get(servo: &Servo, index: u16, sub: u8) -> Option<i64> {
    let drive = &servo.drive;
    let demand = &servo.demand;
    let shown = servo.shown();
    Some(match index {
        0x1001 => servo.error_register().into(),
        HISTORY => servo.history.get(sub)?,
        0x603F => drive.error_code().into(),
        0x6040 => demand.control.into(),
        0x6041 => shown.status.into(),
        0x6060 => drive.mode.into(),
        0x6061 => drive.mode_display.into(),
        0x6062 => drive.position_loop.demanded().unwrap_or(shown.position).into(),
        0x6064 => shown.position.into(),
        0x6065 => drive.position_loop.window.into(),
        0x6066 => drive.position_loop.time_out_ms.into(),
        0x606C => shown.velocity.into(),
        0x6071 => demand.torque_digits.into(),
        0x6077 => shown.torque.into(),
        0x607A => demand.position.unwrap_or(shown.position).into(),
        0x607B if sub == 1 => drive.position_range()?.0.into(),
        0x607B => drive.position_range()?.1.into(),
        0x607C => drive.homing.offset.into(),
        0x6085 => drive.quick_stop_increments_s2.into(),
        0x6098 => drive.homing.method.into(),
        0x6099 if sub == 1 => drive.homing.switch_speed.into(),
        0x6099 => drive.homing.zero_speed.into(),
        0x609A => drive.homing.acceleration.into(),
        0x60B1 => demand.velocity_offset.unwrap_or(0).into(),
        0x60B8 => drive.probes.function.into(),
        0x60B9 => drive.probes.status.into(),
        0x60BA..=0x60BD => drive.probed(usize::from(index - 0x60BA)).into(),
        0x60C2 if sub == 1 => drive.position_loop.period_number.into(),
        0x60C2 => drive.position_loop.period_index.into(),
        0x60F4 => drive.position_loop.error(drive.position()).into(),
        0x60FD => drive.digital_inputs().into(),
        0x60FF => demand.velocity_digits.into(),
        _ => return None,
    })
}

/// Writes an object of a CiA 402 drive.
pub(crate) fn set(servo: &mut Servo, index: u16, sub: u8, value: i64) -> Result<(), Abort> {
    let position_loop = &mut servo.drive.position_loop;
    let homing = &mut servo.drive.homing;
    let unsigned = u32::try_from(value).map_err(|_| Abort::VALUE);
    match (index, value) {
        (HISTORY, message) if servo.history.acknowledge(message) => {}
        (HISTORY, _) => return Err(Abort::VALUE),
        (0x607C, _) => homing.offset = value as i32,
        (0x6098, method) if is_method(method) => homing.method = method as i8,
        (0x6098, _) => return Err(Abort::VALUE),
        (0x6099, _) if sub == 1 => homing.switch_speed = unsigned?,
        (0x6099, _) => homing.zero_speed = unsigned?,
        (0x609A, _) => homing.acceleration = unsigned?,
        (0x6060, mode) => match i8::try_from(mode) {
            Ok(mode @ (0 | MODE_HOMING | MODE_CYCLIC_POSITION | MODE_CYCLIC_VELOCITY | MODE_CYCLIC_TORQUE)) => {
                servo.drive.mode = mode;
            }
            _ => return Err(Abort::VALUE),
        },
        (0x6085, 1..) => {
            servo.drive.quick_stop_increments_s2 = u32::try_from(value).map_err(|_| Abort::VALUE)?;
        }
        (0x6085, _) => return Err(Abort::VALUE),
        (0x6065, _) => position_loop.window = u32::try_from(value).map_err(|_| Abort::VALUE)?,
        (0x6066, _) => position_loop.time_out_ms = u16::try_from(value).map_err(|_| Abort::VALUE)?,
        (0x60C2, 1..=255) if sub == 1 => position_loop.period_number = value as u8,
        (0x60C2, -6..=-3) if sub == 2 => position_loop.period_index = value as i8,
        (0x60C2, _) => return Err(Abort::VALUE),
        _ => set_output(servo, index, value),
    }
    Ok(())
}

/// Takes an object of a CiA 402 drive from the outputs.
pub(crate) fn set_output(servo: &mut Servo, index: u16, value: i64) {
    let demand = &mut servo.demand;
    match index {
        0x6040 => demand.control = value as u16,
        0x6060 => {
            // An unsupported mode in the process data leaves the present mode in effect.
            let _ = set(servo, index, 0, value);
        }
        0x6071 => demand.torque_digits = value as i16,
        0x607A => demand.position = Some(value as i32),
        0x60B1 => demand.velocity_offset = Some(value as i32),
        0x60B8 => servo.drive.probes.function = value as u16,
        0x60FF => demand.velocity_digits = value as i32,
        _ => {}
    }
}
