//! A servo drive like Kollmorgen's AKD: what captures show of one, around a CiA 402 drive.
//!
//! Its default assignment maps control and status word four times and is refused with AL status code 0x001D: a master
//! has to write 0x1C12 and 0x1C13. The PDOs 0x1600 to 0x1603 and 0x1A00 to 0x1A03 can be mapped, with at most eight bytes
//! each (Kollmorgen, flexible mapping); those from 0x1701 and 0x1B01 on are fixed. Cyclic synchronous position takes 0x607A;
//! 0x60C1 is the target of interpolated position (mode 7), which is not modelled. 0x607A and 0x6064 have the unit that
//! 0x36E9, 0x6091 and 0x6092 set, 0x6063 counts the encoder's increments. The drive's own window of the following error is
//! not an object of CiA 402. The clock has 32 bits, the processor emulates the information memory, the mailbox speaks
//! Ethernet too, and BOOT has the same mailboxes. What captures do not show is that of the generic drive.

use crate::controller::silicon::Silicon;
use crate::devices::generic_drive;
use crate::devices::servo_device::Model;
use crate::drive::Profile;
use crate::drive::servo::Servo;
use crate::eeprom::sii;
use crate::eeprom::windows::Windows;
use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::{DataType, ObjectRow, Value, access, record, variable};
use crate::mailbox::process_data::{Pdo, PdoEntry, ProcessData};
use DataType::{Integer8, Integer16, Integer32, Unsigned8, Unsigned16, Unsigned32, VisibleString};
use Value::{Live, Number, Stored, Text};
use access::{READ, READ_WRITE, RX, TX};
use etherpen_ethercat::wire::sii::{Identity, MailboxWindow, PROTOCOL_COE, PROTOCOL_EOE, PROTOCOL_FOE};

const NAME: &str = "AKD EtherCAT Drive (CoE)";
const ORDER: &str = "AKD";
const IDENTITY: Identity = Identity {
    vendor: 0x0000_006A,
    product: 0x0041_4B44,
    revision: 0x0000_0002,
    serial: 0,
};
const MAILBOX_OUT: MailboxWindow = MailboxWindow {
    start: 0x1800,
    length: 1024,
};
const MAILBOX_IN: MailboxWindow = MailboxWindow {
    start: 0x1C00,
    length: 1024,
};
const WINDOWS: Windows = Windows {
    mailbox_out: MAILBOX_OUT,
    mailbox_in: MAILBOX_IN,
    outputs: 0x1100,
    inputs: 0x1140,
    protocols: PROTOCOL_COE | PROTOCOL_EOE | PROTOCOL_FOE,
    bootstrap_out: MAILBOX_OUT,
    bootstrap_in: MAILBOX_IN,
};
/// Modes 8, 9 and 10: bits 7 to 9 of object 0x6502.
const SUPPORTED_MODES: i64 = 0x0380;
/// Interpolation data: the target of interpolated position.
const INTERPOLATION: u16 = 0x60C1;
/// FBUS.PARAM05: options of the fieldbus, the scale of positions among them.
const BUS_OPTIONS: u16 = 0x36E9;
/// Most bytes of a PDO whose mapping is written.
const MAPPED_BYTES_MAX: usize = 8;

const OBJECTS: &[ObjectRow] = &[
    variable(
        0x1008,
        "Device name",
        &[(0, "Device name", VisibleString, READ, Text("AKD"))],
    ),
    variable(
        BUS_OPTIONS,
        "FBUS.PARAM05",
        &[(0, "FBUS.PARAM05", Unsigned32, READ_WRITE, Live)],
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
        0x6063,
        "Position actual internal value",
        &[(0, "Position actual internal value", Integer32, READ | TX, Live)],
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
        0x607A,
        "Target position",
        &[(0, "Target position", Integer32, READ_WRITE | RX, Live)],
    ),
    record(
        0x6091,
        "Gear ratio",
        &[
            (1, "Motor revolutions", Unsigned32, READ_WRITE, Live),
            (2, "Shaft revolutions", Unsigned32, READ_WRITE, Live),
        ],
    ),
    record(
        0x6092,
        "Feed constant",
        &[
            (1, "Feed", Unsigned32, READ_WRITE, Live),
            (2, "Shaft revolutions", Unsigned32, READ_WRITE, Live),
        ],
    ),
    record(
        INTERPOLATION,
        "Interpolation data record",
        &[(1, "Interpolation target position", Integer32, READ_WRITE | RX, Live)],
    ),
    record(
        0x60C2,
        "Interpolation time period",
        &[
            (
                1,
                "Interpolation time period value",
                Unsigned8,
                READ_WRITE,
                Stored {
                    first: 1,
                    low: 1,
                    high: 255,
                },
            ),
            (
                2,
                "Interpolation time index",
                Integer8,
                READ_WRITE,
                Stored {
                    first: -3,
                    low: -6,
                    high: -3,
                },
            ),
        ],
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
    name: NAME,
    order: ORDER,
    identity: IDENTITY,
    silicon: Silicon::AKD,
    windows: WINDOWS,
    maps_once: true,
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
    let interpolation = PdoEntry {
        index: INTERPOLATION,
        sub: 1,
        bits: 32,
    };
    let free = |index, entries: &[PdoEntry]| Pdo::new(index, "Flexible", false, entries);
    let fixed = |index, entries: &[PdoEntry]| Pdo::new(index, "Fixed", true, entries);
    let pdos = vec![
        free(0x1600, &[control]),
        free(0x1601, &[control, byte(0x6060)]),
        free(0x1602, &[control, long(0x607A)]),
        free(0x1603, &[control, long(0x60FF)]),
        fixed(0x1701, &[interpolation, control]),
        fixed(0x1702, &[long(0x60FF), control]),
        fixed(0x1703, &[word(0x6071), control]),
        free(0x1A00, &[status]),
        free(0x1A01, &[status, byte(0x6061)]),
        free(0x1A02, &[status, long(0x6064)]),
        free(0x1A03, &[status, long(0x606C)]),
        fixed(0x1B01, &[long(0x6063), status]),
    ];
    let default = |first: u16| [first, first + 1, first + 2, first + 3];
    ProcessData::new(pdos, &default(0x1600), &default(0x1A00), 4).with_mapped_bytes_max(MAPPED_BYTES_MAX)
}

fn get(servo: &Servo, index: u16, sub: u8) -> Option<i64> {
    let drive = &servo.drive;
    let at = usize::from(sub).checked_sub(1);
    let entry = |pair: [u32; 2]| Some(pair.get(at?).copied()?.into());
    let number = generic_drive::get;
    match index {
        BUS_OPTIONS => Some(drive.units.options.into()),
        0x6063 => number(servo, 0x6064, 0),
        0x6064 | 0x607A => Some(drive.in_units(number(servo, index, 0)? as i32).into()),
        0x6091 => entry(drive.units.gear),
        0x6092 => entry(drive.units.feed),
        // Without its mode nothing takes it.
        INTERPOLATION => Some(0),
        index => number(servo, index, sub),
    }
}

fn set(servo: &mut Servo, index: u16, sub: u8, value: i64) -> Result<(), Abort> {
    let units = &mut servo.drive.units;
    let pair = match index {
        BUS_OPTIONS => {
            units.options = u32::try_from(value).map_err(|_| Abort::VALUE)?;
            return Ok(());
        }
        0x6091 => &mut units.gear,
        0x6092 => &mut units.feed,
        0x607A | INTERPOLATION => {
            set_output(servo, index, value);
            return Ok(());
        }
        index => return generic_drive::set(servo, index, sub, value),
    };
    let at = usize::from(sub).checked_sub(1);
    let entry = at.and_then(|at| pair.get_mut(at)).ok_or(Abort::NO_SUB_INDEX)?;
    *entry = u32::try_from(value)
        .ok()
        .filter(|value| *value > 0)
        .ok_or(Abort::VALUE)?;
    Ok(())
}

fn set_output(servo: &mut Servo, index: u16, value: i64) {
    match index {
        INTERPOLATION => {}
        0x607A => {
            let increments = servo.drive.increments_of(value as i32);
            generic_drive::set_output(servo, index, increments.into());
        }
        index => generic_drive::set_output(servo, index, value),
    }
}
