//! The servo drive AX2000-B110: identity, objects and process data around a CiA 402 drive.
//!
//! Process data take fixed objects: RxPDO 0x1702 (velocity demand) or 0x1703 (current demand), TxPDO 0x1B01 (position,
//! status word) or 0x1B03 (position, current, status word), one of each assigned through 0x1C12 and 0x1C13 in PREOP.
//! The default assignment of the real drive is not known; here it is 0x1702 and 0x1B01. Quick-stop deceleration
//! 0x6085 counts position increments per second squared.

use crate::controller::silicon::Silicon;
use crate::devices::servo_device::Model;
use crate::drive::servo::Servo;
use crate::drive::{MODE_DIGITAL_CURRENT, MODE_DIGITAL_SPEED, Profile};
use crate::eeprom::sii;
use crate::eeprom::windows::Windows;
use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::{DataType, ObjectRow, Value, access, record, variable};
use crate::mailbox::process_data::{Pdo, PdoEntry, ProcessData};
use DataType::{Integer8, Integer16, Integer32, OctetString, Unsigned8, Unsigned16, VisibleString};
use Value::{Bytes, Live, Stored, Text};
use access::{READ, READ_WRITE, RX};
use etherpen_ethercat::wire::sii::{Identity, MailboxWindow, PROTOCOL_COE};

/// Name in the information image and in object 0x1008.
pub const NAME: &str = "AX2000-B110 EtherCAT Drive";

const ORDER: &str = "AX2000-B110";
const IDENTITY: Identity = Identity {
    vendor: 0x0000_0002,
    product: 0x07D0_6014,
    revision: 0x0000_110A,
    serial: 0,
};
const MODE_POSITION: i64 = -1;
const WINDOWS: Windows = Windows {
    mailbox_out: MailboxWindow {
        start: 0x1800,
        length: 512,
    },
    mailbox_in: MailboxWindow {
        start: 0x1C00,
        length: 512,
    },
    outputs: 0x1100,
    inputs: 0x1140,
    protocols: PROTOCOL_COE,
    ..Windows::NONE
};
const COMMENT_BYTES_MAX: usize = 4096;

const OBJECTS: &[ObjectRow] = &[
    variable(
        0x1008,
        "Device name",
        &[(0, "Device name", VisibleString, READ, Text(NAME))],
    ),
    variable(
        0x100A,
        "Software version",
        &[(0, "Software version", VisibleString, READ, Text("cell 1"))],
    ),
    variable(
        0x2FFE,
        "Comment",
        &[(
            0,
            "Comment",
            OctetString,
            READ_WRITE,
            Bytes {
                longest: COMMENT_BYTES_MAX,
            },
        )],
    ),
    variable(0x603F, "Error code", &[(0, "Error code", Unsigned16, READ, Live)]),
    variable(
        0x6040,
        "Control word",
        &[(0, "Control word", Unsigned16, READ | RX, Live)],
    ),
    variable(
        0x6060,
        "Modes of operation",
        &[(0, "Modes of operation", Integer8, READ_WRITE, Live)],
    ),
    variable(
        0x6061,
        "Modes of operation display",
        &[(0, "Modes of operation display", Integer8, READ, Live)],
    ),
    variable(
        0x606B,
        "Velocity demand value",
        &[(0, "Velocity demand value", Integer32, READ | RX, Live)],
    ),
    variable(
        0x6074,
        "Torque demand value",
        &[(0, "Torque demand value", Integer16, READ | RX, Live)],
    ),
    record(
        0x60C2,
        "Interpolation time period",
        &[
            (
                1,
                "Interpolation time units",
                Unsigned8,
                READ_WRITE,
                Stored {
                    first: 1,
                    low: 1,
                    high: 16,
                },
            ),
            (
                2,
                "Interpolation time index",
                Integer8,
                READ_WRITE,
                Stored {
                    first: -3,
                    low: -3,
                    high: -3,
                },
            ),
        ],
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
    details: sii::DETAILS_FIXED_PDO,
    objects: OBJECTS,
    profile: Profile::Ax2000,
    process_data,
    get,
    set,
    set_output,
};

fn process_data() -> ProcessData {
    let [control, status] = [0x6040, 0x6041].map(|index| PdoEntry::new(index, 16));
    let [velocity, position] = [0x606B, 0x6064].map(|index| PdoEntry::new(index, 32));
    let [demand, torque] = [0x6074, 0x6077].map(|index| PdoEntry::new(index, 16));
    let pdos = vec![
        Pdo::new(0x1702, "Digital speed", true, &[velocity, control]),
        Pdo::new(0x1703, "Digital current", true, &[demand, control]),
        Pdo::new(0x1B01, "Position and status", true, &[position, status]),
        Pdo::new(
            0x1B03,
            "Position, current and status",
            true,
            &[position, torque, status],
        ),
    ];
    ProcessData::new(pdos, &[0x1702], &[0x1B01], 1)
}

fn get(servo: &Servo, index: u16, _sub: u8) -> Option<i64> {
    let drive = &servo.drive;
    let shown = servo.shown();
    Some(match index {
        0x1001 => servo.error_register().into(),
        0x603F => drive.error_code().into(),
        0x6040 => drive.control().into(),
        0x6041 => shown.status.into(),
        0x6060 => drive.mode.into(),
        0x6061 => drive.mode_display.into(),
        0x6064 => shown.position.into(),
        0x606B => drive.velocity_digits().into(),
        0x6074 => servo.demand.torque_digits.into(),
        0x6077 => shown.torque.into(),
        0x6085 => drive.quick_stop_increments_s2.into(),
        _ => return None,
    })
}

fn set(servo: &mut Servo, index: u16, _sub: u8, value: i64) -> Result<(), Abort> {
    let drive = &mut servo.drive;
    match (index, value) {
        (0x6060, MODE_POSITION) => drive.mode = MODE_POSITION as i8,
        (0x6060, mode) => match i8::try_from(mode) {
            Ok(mode @ (MODE_DIGITAL_SPEED | MODE_DIGITAL_CURRENT)) => drive.mode = mode,
            _ => return Err(Abort::VALUE),
        },
        (0x6085, 1..) => drive.quick_stop_increments_s2 = u32::try_from(value).map_err(|_| Abort::VALUE)?,
        (0x6085, _) => return Err(Abort::VALUE),
        _ => return Err(Abort::READ_ONLY),
    }
    Ok(())
}

fn set_output(servo: &mut Servo, index: u16, value: i64) {
    let demand = &mut servo.demand;
    match index {
        0x6040 => demand.control = value as u16,
        0x606B => demand.velocity_digits = value as i32,
        0x6074 => demand.torque_digits = value as i16,
        _ => {}
    }
}
