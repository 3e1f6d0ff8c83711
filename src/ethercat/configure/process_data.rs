//! Process data of a drive: objects, layout, and the sync managers and FMMUs that move them.
//!
//! The process data of the drive type are assigned and mapped; a drive that refuses keeps its own. Then the lists are
//! read back (CiA 301: 0x1C12 and 0x1C13 name the objects assigned to sync managers 2 and 3, each of which lists its
//! entries). Where such an object is missing, the SII's lists are used, or else those of the drive type. The layout
//! follows the actual lists of the drive.
//!
//! Invariants: a refused assignment or mapping is not an error, but a missing value is; a share of the image never
//! exceeds [`PROCESS_BYTES_MAX`](crate::ethercat::cyclic::PROCESS_BYTES_MAX); a wrong mode is always detected.

use super::{mailbox_managers, read_sii, write_managers};
use crate::config::{Axis, AxisMode};
use crate::drives::layout::LayoutBuilder;
use crate::drives::{
    DriveKind, Entry, ModeDescription, OPERATION_MODE, OPERATION_MODE_DISPLAY, PdoChoice, QUICK_STOP_DECELERATION,
    Setting, Windows,
};
use crate::ethercat::acyclic::{AcyclicPort, Request};
use crate::ethercat::coe::{DEVICE_TYPE, ObjectDictionary};
use crate::ethercat::cyclic::{CyclicSlave, DriveRole, SPAN_BYTES_MAX};
use crate::ethercat::error::BusError;
use crate::ethercat::factory;
use crate::ethercat::mailbox::Mailbox;
use crate::ethercat::slave::{ProcessData, Slave};
use crate::ethercat::state::{self, AlState};
use crate::ethercat::wire::coe::Object;
use crate::ethercat::wire::register::{self, FMMU_LEN, FmmuRepr, SyncManagerRepr};
use crate::ethercat::wire::sii::{
    self, CategoryHeader, CategoryWalker, PdoEntryRecord, PdoRecord, Record, SyncManagerRecord, SyncManagerUse,
};
use crate::ethercat::wire::{Address, Command, read_u16, write_bytes};
use heapless::Vec;

/// Start of the slaves' process data in the logical memory. Each slave has [`SPAN_BYTES_MAX`] bytes: its outputs, and
/// directly behind them its inputs, so that one datagram may carry both.
pub const LOGICAL_START: u32 = 0x0001_0000;

/// Object that lists the process data objects of the outputs.
const ASSIGNMENT_OUTPUTS: u16 = 0x1C12;
/// Object that lists the process data objects of the inputs.
const ASSIGNMENT_INPUTS: u16 = 0x1C13;
/// Most process data objects of one direction.
const PDOS_MAX: usize = 8;
/// Most entries of one process data object.
const ENTRIES_MAX: u8 = 32;
/// Most read-backs of a setting until the drive shows the value; one read-back takes some milliseconds.
const VERIFY_TRIES_MAX: u8 = 10;
/// Watchdog units (100 us) in a millisecond.
const WATCHDOG_UNITS_PER_MS: u16 = 10;
/// Watchdog of the slave's own processor: 100 ms, the slave controllers' default.
const WATCHDOG_PDI_UNITS: u16 = 1_000;
/// Lowest address of process memory.
const PROCESS_MEMORY: u16 = register::PROCESS_MEMORY;
/// Words of the SII in a KiBit.
const SII_WORDS_PER_KIBIT: u16 = 64;

/// Outputs or inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Direction {
    Outputs,
    Inputs,
}

impl Direction {
    const fn assignment(self) -> u16 {
        match self {
            Self::Outputs => ASSIGNMENT_OUTPUTS,
            Self::Inputs => ASSIGNMENT_INPUTS,
        }
    }

    /// The SII's category of process data objects.
    const fn category(self) -> u16 {
        match self {
            Self::Outputs => sii::CATEGORY_RX_PDO,
            Self::Inputs => sii::CATEGORY_TX_PDO,
        }
    }

    const fn sync_manager(self) -> u8 {
        match self {
            Self::Outputs => 2,
            Self::Inputs => 3,
        }
    }
}

/// Asks a slave with an unknown product for its device type, and leaves the slave in INIT; `None` if it is not a drive
/// or does not answer.
pub async fn ask_device_type<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave,
) -> Option<DriveKind> {
    if !factory::is_to_be_asked(&slave.fixed) {
        return None;
    }
    let station = slave.station();
    let mut mailbox = Mailbox::new::<MESSAGE>(station, slave.fixed.mailbox_out, slave.fixed.mailbox_in).ok()?;
    mailbox_managers(port, slave).await.ok()?;
    let device_type = match state::change(port, station, AlState::PreOperational).await {
        Ok(()) => ObjectDictionary::new(port, &mut mailbox)
            .read(DEVICE_TYPE, 4)
            .await
            .ok(),
        Err(_) => None,
    };
    // A slave that does not return to INIT is detected when it is used.
    let _ = state::change(port, station, AlState::Init).await;
    factory::drive_kind_by_type(device_type?)
}

/// Chooses a drive's process data, writes its mode and its settings through CoE, in PREOP, and makes the layout.
///
/// `twin` are the process data of a slave with equal product and revision: if the drive accepts the choice that its
/// twin accepted, it has the lists of its twin.
///
/// # Errors
/// [`BusError::Range`] when the drive lacks the axis's mode or an object cannot take a value, [`BusError::Mapping`],
/// [`BusError::Alignment`] or [`BusError::ProcessLength`] when its process data cannot be used, [`BusError::SdoAbort`],
/// [`BusError::ReadBack`], or errors of the mailbox.
pub async fn objects<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &mut Slave,
    axis: &Axis,
    twin: Option<ProcessData>,
) -> Result<(), BusError> {
    let Some(kind) = slave.kind else { return Ok(()) };
    let object = OPERATION_MODE;
    let mode = kind.mode(axis.mode).ok_or(BusError::Range { object })?;
    let object = QUICK_STOP_DECELERATION;
    let settings = (kind.settings)(axis).ok_or(BusError::Range { object })?;

    let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
    let outputs_taken = choose(&mut dictionary, Direction::Outputs, &mode.outputs).await?;
    let inputs_taken = choose(&mut dictionary, Direction::Inputs, &mode.inputs).await?;
    let operation_mode = Setting::of(OPERATION_MODE, i32::from(mode.operation_mode).cast_unsigned(), 1);
    apply(&mut dictionary, &operation_mode.shown_by(OPERATION_MODE_DISPLAY)).await?;
    for setting in &settings {
        apply(&mut dictionary, setting).await?;
    }

    let taken = outputs_taken && inputs_taken;
    slave.process_data = match twin {
        Some(twin) if taken && twin.layout.mode == axis.mode => Some(twin),
        _ => Some(lay_out(port, slave, kind, axis.mode, mode).await?),
    };
    Ok(())
}

/// Chooses the process data of a drive that no axis uses, in its first mode, and makes their layout, in PREOP. Mode and
/// settings of the drive are not written; a slave without a description gets no process data.
///
/// # Errors
/// As [`objects`], except errors of mode and settings.
pub async fn unused_objects<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &mut Slave,
) -> Result<(), BusError> {
    let Some(kind) = slave.kind else { return Ok(()) };
    let mut modes = [AxisMode::Velocity, AxisMode::Torque].into_iter();
    let Some((axis_mode, mode)) = modes.find_map(|mode| Some((mode, kind.mode(mode)?))) else {
        return Ok(());
    };
    let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
    choose(&mut dictionary, Direction::Outputs, &mode.outputs).await?;
    choose(&mut dictionary, Direction::Inputs, &mode.inputs).await?;
    slave.process_data = Some(lay_out(port, slave, kind, axis_mode, mode).await?);
    Ok(())
}

/// Makes the layout from the drive's actual process data.
async fn lay_out<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &mut Slave,
    kind: DriveKind,
    axis_mode: AxisMode,
    mode: &ModeDescription,
) -> Result<ProcessData, BusError> {
    let mut builder = LayoutBuilder::new(axis_mode, mode);
    let outputs = read_lists(port, slave, Direction::Outputs, &mode.outputs, |entry| {
        builder.output(entry)
    });
    outputs.await?;
    let inputs = read_lists(port, slave, Direction::Inputs, &mode.inputs, |entry| {
        builder.input(entry)
    });
    inputs.await?;
    Ok(ProcessData {
        windows: windows(port, slave.station(), kind.windows).await?,
        layout: builder.finish()?,
    })
}

/// Writes a value; false when the drive refuses it.
async fn offer<const MESSAGE: usize>(
    dictionary: &mut ObjectDictionary<'_, '_, MESSAGE>,
    object: Object,
    value: u32,
    length: u8,
) -> Result<bool, BusError> {
    match dictionary.write(object, value, length).await {
        Ok(()) => Ok(true),
        Err(BusError::SdoAbort { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Assigns a process data object, and writes its entries unless they are fixed; false when the drive refused any of it.
async fn choose<const MESSAGE: usize>(
    dictionary: &mut ObjectDictionary<'_, '_, MESSAGE>,
    direction: Direction,
    choice: &PdoChoice,
) -> Result<bool, BusError> {
    let assignment = |sub| Object::new(direction.assignment(), sub);
    if !offer(dictionary, assignment(0), 0, 1).await? {
        return Ok(false);
    }
    let mut taken = true;
    let count = Object::new(choice.pdo, 0);
    if choice.written && offer(dictionary, count, 0, 1).await? {
        for (sub, entry) in (1..).zip(choice.entries) {
            let object = Object::new(choice.pdo, sub);
            taken &= offer(dictionary, object, entry.mapping(), 4).await?;
        }
        taken &= offer(dictionary, count, choice.entries.len() as u32, 1).await?;
    } else if choice.written {
        taken = false;
    }
    taken &= offer(dictionary, assignment(1), choice.pdo.into(), 2).await?;
    taken &= offer(dictionary, assignment(0), 1, 1).await?;
    Ok(taken)
}

async fn apply<const MESSAGE: usize>(
    dictionary: &mut ObjectDictionary<'_, '_, MESSAGE>,
    setting: &Setting,
) -> Result<(), BusError> {
    let mask = u32::MAX >> (32 - 8 * u32::from(setting.length.clamp(1, 4)));
    let expected = setting.value & mask;
    match dictionary.write(setting.object, setting.value, setting.length).await {
        Err(BusError::SdoAbort { .. }) if setting.optional => return Ok(()),
        other => other?,
    }
    let Some(object) = setting.verify else { return Ok(()) };
    let mut actual = 0;
    for _ in 0..VERIFY_TRIES_MAX {
        actual = dictionary.read(object, setting.length).await?;
        if actual == expected {
            return Ok(());
        }
    }
    Err(BusError::ReadBack {
        object,
        expected,
        actual,
    })
}

/// Passes the entries of one direction's process data to `take`, in their order.
async fn read_lists<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &mut Slave,
    direction: Direction,
    choice: &PdoChoice,
    mut take: impl FnMut(Entry) -> Result<(), BusError>,
) -> Result<(), BusError> {
    let station = slave.station();
    let mut pdos: Vec<u16, PDOS_MAX> = Vec::new();
    let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
    let assigned = read_list(&mut dictionary, direction.assignment(), PDOS_MAX as u8, 2, |pdo| {
        // The list has room for as many.
        let _ = pdos.push(pdo as u16);
        Ok(())
    });
    match assigned.await {
        Err(BusError::SdoAbort { .. }) => {
            let here = |pdo: &PdoRecord| pdo.sync_manager == direction.sync_manager();
            if sii_entries(port, station, direction, here, &mut take).await? == 0 {
                choice.entries.iter().try_for_each(|entry| take(*entry))?;
            }
            return Ok(());
        }
        other => other?,
    }
    for pdo in pdos {
        let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
        let entries = read_list(&mut dictionary, pdo, ENTRIES_MAX, 4, |value| {
            take(Entry::from_mapping(value))
        });
        let error = match entries.await {
            // An object with unreadable entries, none of which was passed on yet.
            Err(error @ BusError::SdoAbort { object, .. }) if object.sub == 0 => error,
            other => {
                other?;
                continue;
            }
        };
        let here = |record: &PdoRecord| record.index == pdo;
        if sii_entries(port, station, direction, here, &mut take).await? > 0 {
            continue;
        }
        if pdo != choice.pdo {
            return Err(error);
        }
        choice.entries.iter().try_for_each(|entry| take(*entry))?;
    }
    Ok(())
}

/// Reads an object whose sub-index 0 counts its values of `length` bytes, and passes the values to `take`.
///
/// # Errors
/// [`BusError::SdoAbort`] with sub-index 0 when there is no such object; then no value was passed on.
async fn read_list<const MESSAGE: usize>(
    dictionary: &mut ObjectDictionary<'_, '_, MESSAGE>,
    index: u16,
    most: u8,
    length: u8,
    mut take: impl FnMut(u32) -> Result<(), BusError>,
) -> Result<(), BusError> {
    let object = Object::new(index, 0);
    let count = dictionary.read(object, 1).await?;
    if count > most.into() {
        return Err(BusError::Range { object });
    }
    for sub in 1..=count as u8 {
        take(dictionary.read(Object::new(index, sub), length).await?)?;
    }
    Ok(())
}

/// Passes the entries of the SII's process data objects that `chosen` selects to `take`; returns the number of objects.
async fn sii_entries<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    direction: Direction,
    chosen: impl Fn(&PdoRecord) -> bool,
    take: &mut impl FnMut(Entry) -> Result<(), BusError>,
) -> Result<u8, BusError> {
    let Some(category) = find_category(port, station, direction.category()).await? else {
        return Ok(0);
    };
    let (mut word, end) = (category.word, category.word.saturating_add(category.words));
    let mut found = 0_u8;
    while word < end {
        let Ok(pdo) = PdoRecord::parse(&sii_record(port, station, word).await?) else {
            break;
        };
        word = word.saturating_add(RECORD_WORDS);
        if chosen(&pdo) && pdo.entries > 0 {
            found = found.saturating_add(1);
            for number in 0..u16::from(pdo.entries) {
                let at = word.saturating_add(number.saturating_mul(RECORD_WORDS));
                if at >= end {
                    break;
                }
                if let Ok(entry) = PdoEntryRecord::parse(&sii_record(port, station, at).await?) {
                    take(Entry::new(Object::new(entry.index, entry.sub), entry.bits))?;
                }
            }
        }
        word = word.saturating_add(u16::from(pdo.entries).saturating_mul(RECORD_WORDS));
    }
    Ok(found)
}

/// Words of a sync manager, a process data object or an entry in the SII.
const RECORD_WORDS: u16 = 4;

/// Reads a record of eight bytes from the SII.
async fn sii_record<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    word: u16,
) -> Result<[u8; 8], BusError> {
    let mut record = [0; 2 * RECORD_WORDS as usize];
    let mut at = 0;
    while at < record.len() {
        let part = read_sii(port, station, word.saturating_add(at as u16 / 2)).await?;
        let room = record.len() - at;
        write_bytes(&mut record, at, part.get(..part.len().min(room)).unwrap_or(&[]));
        at += part.len().max(2);
    }
    Ok(record)
}

/// Looks for a category in the SII.
async fn find_category<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    kind: u16,
) -> Result<Option<CategoryHeader>, BusError> {
    let size = read_u16(&read_sii(port, station, sii::WORD_SIZE).await?, 0);
    let words = size.saturating_add(1).saturating_mul(SII_WORDS_PER_KIBIT);
    let mut walker = CategoryWalker::new(words);
    while let Some(word) = walker.next_word() {
        let header = read_sii(port, station, word).await?;
        match walker.feed(read_u16(&header, 0), read_u16(&header, 2)) {
            Some(category) if category.kind == kind => return Ok(Some(category)),
            _ => {}
        }
    }
    Ok(None)
}

/// Addresses of the process data according to the SII, or `otherwise`.
async fn windows<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    otherwise: Windows,
) -> Result<Windows, BusError> {
    let mut windows = otherwise;
    let Some(category) = find_category(port, station, sii::CATEGORY_SYNC_MANAGER).await? else {
        return Ok(windows);
    };
    for number in [Direction::Outputs, Direction::Inputs].map(Direction::sync_manager) {
        let offset = u16::from(number) * RECORD_WORDS;
        if offset + RECORD_WORDS > category.words {
            break;
        }
        let bytes = sii_record(port, station, category.word.saturating_add(offset)).await?;
        match SyncManagerRecord::parse(&bytes) {
            Ok(manager) if manager.start < PROCESS_MEMORY => {}
            Ok(manager) if manager.usage == SyncManagerUse::Outputs => windows.outputs = manager.start,
            Ok(manager) if manager.usage == SyncManagerUse::Inputs => windows.inputs = manager.start,
            _ => {}
        }
    }
    Ok(windows)
}

/// A slave's share of the logical memory: empty for slaves that are not configured yet, without a role for slaves that
/// no axis uses. Outputs without a role stay 0.
pub fn cyclic_slave(slave: &Slave) -> CyclicSlave {
    let (Some(kind), Some(ProcessData { layout, .. })) = (slave.kind, slave.process_data) else {
        return CyclicSlave::default();
    };
    let start = LOGICAL_START + u32::from(slave.position) * SPAN_BYTES_MAX as u32;
    CyclicSlave {
        input_address: start + u32::from(layout.output_length),
        input_length: layout.input_length.into(),
        output_address: start,
        output_length: layout.output_length.into(),
        watched: false,
        role: slave.axis.map(|axis| DriveRole { axis, kind, layout }),
        generation: slave.generation,
    }
}

/// Sets up process-data sync managers, FMMUs and watchdogs, in PREOP.
///
/// `watchdog_ms` is the sync managers' watchdog; 0 switches it off.
///
/// # Errors
/// As [`AcyclicPort::insist`].
pub async fn process_data<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    slave: &Slave,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let Some(ProcessData { windows, layout }) = slave.process_data else {
        return Ok(());
    };
    let station = slave.station();
    watchdogs(port, station, watchdog_ms).await?;
    let (outputs, inputs) = (layout.output_length.into(), layout.input_length.into());
    let manager = |start, length, control| SyncManagerRepr {
        start,
        length,
        control,
        activate: register::SYNC_MANAGER_ENABLE,
        ..SyncManagerRepr::default()
    };
    let managers = [
        manager(windows.outputs, outputs, register::CONTROL_OUTPUTS),
        manager(windows.inputs, inputs, register::CONTROL_INPUTS),
    ];
    write_managers(port, station, Direction::Outputs.sync_manager(), &managers).await?;
    let share = cyclic_slave(slave);
    let mappings = [
        FmmuRepr::bytes(share.output_address, outputs, windows.outputs, false),
        FmmuRepr::bytes(share.input_address, inputs, windows.inputs, true),
    ];
    let mut registers = [0; 2 * FMMU_LEN];
    for (mapping, bytes) in mappings.iter().zip(registers.chunks_exact_mut(FMMU_LEN)) {
        // Each part has the length of the structure.
        let _ = mapping.emit(bytes);
    }
    port.write(station, register::FMMU, &registers).await
}

async fn watchdogs<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    watchdog_ms: u16,
) -> Result<(), BusError> {
    let units = watchdog_ms.saturating_mul(WATCHDOG_UNITS_PER_MS);
    let requests = [
        (register::WATCHDOG_DIVIDER, register::WATCHDOG_DIVIDER_100_US),
        (register::WATCHDOG_PDI, WATCHDOG_PDI_UNITS),
        (register::WATCHDOG_SYNC_MANAGER, units),
    ]
    .map(|(at, value)| Request::write(Command::Fpwr, Address::station(station, at), &value.to_le_bytes()));
    port.insist_all(&requests, 1, |_, _| {}).await
}
