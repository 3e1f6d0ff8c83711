//! A slave made from an information memory image: the registers and lists of a real device, without function.
//!
//! Identity, mailboxes, sync managers and process-data objects follow the image, and so does the kind of slave: with
//! device emulation it is a terminal on a small controller, whose inputs and outputs are the bytes of its sync managers.
//! Otherwise a processor serves identity objects and process-data lists. Inputs are what a test or a machine sets,
//! outputs can be read by them. No image can cause a panic or an endless loop.

use crate::controller::silicon::Silicon;
use crate::devices::{Device, Io, ProcessManager, ProcessManagers};
use crate::eeprom::content::Content;
use crate::eeprom::windows::{SyncManagerDefault, Windows};
use crate::mailbox::dictionary::{DataType, Dictionary, Object, ObjectRow, Value, access, variable};
use crate::mailbox::live_objects::LiveObjects;
use crate::mailbox::process_data::{DataManagers, ProcessData};

/// Addresses of process data if the image has no sync managers for them.
const OUTPUTS_DEFAULT: u16 = 0x1100;
const INPUTS_DEFAULT: u16 = 0x1400;
/// Uses of sync managers.
const MAILBOX_OUT: u8 = 1;
const MAILBOX_IN: u8 = 2;
const OUTPUTS: u8 = 3;
const INPUTS: u8 = 4;
/// Sync manager without hardware.
const VIRTUAL: u8 = 0x04;
/// Most FMMUs or sync managers of a controller.
const UNITS_MAX: u8 = 8;
/// Size of a blank information memory.
const BLANK_BYTES: usize = 2048;

const OBJECTS: &[ObjectRow] = &[variable(
    0x1000,
    "Device type",
    &[(
        0,
        "Device type",
        DataType::Unsigned32,
        access::READ,
        Value::Number(0x0002_0192),
    )],
)];

/// The device behind one slave controller.
#[derive(Clone, Debug)]
pub(crate) struct ImageDevice {
    image: Vec<u8>,
    content: Content,
    silicon: Silicon,
    windows: Windows,
    process_data: ProcessData,
    managers: ProcessManagers,
    has_processor: bool,
    is_from_file: bool,
    io: Io,
    /// Objects beside those that follow from the image.
    objects: Vec<Object>,
}

impl ImageDevice {
    /// A slave with this information memory.
    pub(crate) fn new(image: Vec<u8>) -> Self {
        let content = Content::parse(&image);
        let windows = windows(&content);
        let managers = process_managers(&content, &windows);
        let bytes = |managers: &[ProcessManager]| managers.iter().filter_map(|manager| manager.bytes).sum();
        let silicon = silicon(&content);
        Self {
            silicon,
            windows,
            process_data: process_data(&content).carried_by(data_managers(&managers)),
            has_processor: !content.is_emulated,
            is_from_file: false,
            io: Io {
                inputs: vec![0; bytes(&managers.inputs)],
                outputs: vec![0; bytes(&managers.outputs)],
            },
            managers,
            content,
            image,
            objects: Vec::new(),
        }
    }

    /// The slave with these objects, which replace those that are the same for every slave.
    pub(crate) fn with_objects(self, objects: Vec<Object>) -> Self {
        Self { objects, ..self }
    }

    /// The slave whose information memory is from a file.
    pub(crate) fn from_file(image: Vec<u8>) -> Self {
        Self {
            is_from_file: true,
            ..Self::new(image)
        }
    }

    /// What each sync manager carries; the standard ones if the image lists none.
    fn sync_manager_types(&self) -> Vec<u8> {
        match self.content.sync_managers.as_slice() {
            [] => DataManagers::default().types(),
            listed => listed.iter().map(|manager| manager.kind).collect(),
        }
    }

    /// The slave on another controller.
    pub(crate) fn on(self, silicon: Silicon) -> Self {
        Self { silicon, ..self }
    }

    /// A board whose information memory was never written: no processor can start from it.
    pub(crate) fn blank() -> Self {
        let device = Self::new(vec![0xFF; BLANK_BYTES]).on(Silicon::LAN9252);
        Self {
            has_processor: false,
            ..device
        }
    }
}

/// The silicon for an image: it has the units that the image uses, and those of the smallest controllers at least.
fn silicon(content: &Content) -> Silicon {
    let units = |used: usize, least: u8| match used {
        0 => None,
        used => Some(u8::try_from(used).unwrap_or(UNITS_MAX).clamp(least, UNITS_MAX)),
    };
    let small = Silicon::TERMINAL;
    let fmmus = units(content.fmmus, small.fmmus);
    let sync_managers = units(content.sync_managers.len(), small.sync_managers);
    let is_coupler = content.sync_managers.is_empty();
    let base = match (content.is_emulated, content.has_clock) {
        (true, false) => small,
        (true, true) if is_coupler => Silicon::COUPLER,
        (true, true) => Silicon {
            clock: Silicon::COUPLER.clock,
            features: Silicon::COUPLER.features,
            sii_flags: Silicon::COUPLER.sii_flags,
            ..small
        },
        (false, _) => Silicon::ET1100,
    };
    Silicon {
        fmmus: fmmus.unwrap_or(base.fmmus),
        sync_managers: sync_managers.unwrap_or(base.sync_managers),
        ignores_lrw: content.ignores_lrw,
        ..base
    }
}

fn windows(content: &Content) -> Windows {
    let mut windows = Windows {
        mailbox_out: content.fixed.mailbox_out,
        mailbox_in: content.fixed.mailbox_in,
        outputs: OUTPUTS_DEFAULT,
        inputs: INPUTS_DEFAULT,
        protocols: content.fixed.protocols,
        bootstrap_out: content.bootstrap_out,
        bootstrap_in: content.bootstrap_in,
    };
    for manager in &content.sync_managers {
        let (start, length) = (manager.start, manager.length);
        match manager.kind {
            MAILBOX_OUT => (windows.mailbox_out.start, windows.mailbox_out.length) = (start, length),
            MAILBOX_IN => (windows.mailbox_in.start, windows.mailbox_in.length) = (start, length),
            OUTPUTS => windows.outputs = start,
            INPUTS => windows.inputs = start,
            _ => {}
        }
    }
    windows
}

/// The sync managers of the process data. With a mailbox, the length of the only one of a direction follows the
/// assignment if the image lists PDOs; all others have the length in the image, or that of their PDOs.
fn process_managers(content: &Content, windows: &Windows) -> ProcessManagers {
    let of_kind = |kind: u8| -> Vec<ProcessManager> {
        let is_real = |manager: &SyncManagerDefault| manager.kind == kind && manager.activate & VIRTUAL == 0;
        let list = content.sync_managers.iter().enumerate();
        let managers = list.filter(|(_, manager)| is_real(manager)).map(|(number, manager)| {
            let bytes = match manager.length {
                0 => content.pdo_bytes(number),
                length => usize::from(length),
            };
            ProcessManager {
                number,
                start: manager.start.into(),
                bytes: Some(bytes),
            }
        });
        managers.collect()
    };
    let mut managers = ProcessManagers {
        outputs: of_kind(OUTPUTS),
        inputs: of_kind(INPUTS),
    };
    if windows.has_mailbox() {
        let has_pdos = |number| content.pdo_bytes(number) > 0;
        let standard = ProcessManagers::of(windows, DataManagers::default());
        for (list, standard) in [
            (&mut managers.outputs, standard.outputs),
            (&mut managers.inputs, standard.inputs),
        ] {
            match list.as_mut_slice() {
                [] => *list = standard,
                [only] if only.bytes == Some(0) || has_pdos(only.number) => only.bytes = None,
                _ => {}
            }
        }
    }
    managers
}

/// The first sync manager of each direction: those to which process data objects are assigned.
fn data_managers(managers: &ProcessManagers) -> DataManagers {
    let first = |list: &[ProcessManager]| list.first().and_then(|manager| u8::try_from(manager.number).ok());
    let standard = DataManagers::default();
    let (outputs, inputs) = (first(&managers.outputs), first(&managers.inputs));
    DataManagers {
        outputs: outputs.unwrap_or(standard.outputs),
        inputs: inputs.unwrap_or(standard.inputs),
    }
}

fn process_data(content: &Content) -> ProcessData {
    let assigned = |is_output: bool| -> Vec<u16> {
        let pdos = content.pdos.iter();
        let assigned = pdos.filter(|entry| entry.pdo.is_output() == is_output && entry.manager != 0xFF);
        let indices = assigned.map(|entry| entry.pdo.index);
        indices.take(ProcessData::ASSIGNED_MAX.into()).collect()
    };
    let pdos = content.pdos.iter().map(|entry| entry.pdo.clone()).collect();
    let most = usize::from(ProcessData::ASSIGNED_MAX);
    ProcessData::new(pdos, &assigned(true), &assigned(false), most)
}

impl LiveObjects for ImageDevice {}

impl Device for ImageDevice {
    fn image(&self) -> Vec<u8> {
        self.image.clone()
    }

    fn silicon(&self) -> Silicon {
        self.silicon
    }

    fn is_from_file(&self) -> bool {
        self.is_from_file
    }

    fn has_processor(&self) -> bool {
        self.has_processor
    }

    fn windows(&self) -> Windows {
        self.windows
    }

    fn process_data(&self) -> ProcessData {
        self.process_data.clone()
    }

    fn process_managers(&self) -> ProcessManagers {
        self.managers.clone()
    }

    fn dictionary(&self) -> Dictionary {
        let mut dictionary = Dictionary::default();
        dictionary.add_table(OBJECTS);
        dictionary.add_text(0x1008, "Device name", &self.content.name);
        self.objects.iter().for_each(|object| dictionary.put(object.clone()));
        let mut derived = Dictionary::default();
        derived.add_identity(&self.content.fixed.identity);
        derived.add_sync_manager_types(&self.sync_manager_types());
        self.process_data.describe(&mut derived);
        derived.into_objects().for_each(|object| dictionary.put(object));
        dictionary
    }

    fn set_serial(&mut self, serial: u32) {
        self.content.fixed.identity.serial = serial;
    }

    fn io(&self) -> Option<&Io> {
        Some(&self.io)
    }

    fn io_mut(&mut self) -> Option<&mut Io> {
        Some(&mut self.io)
    }

    fn step(&mut self, operational: bool) {
        if !operational {
            self.io.outputs.fill(0);
        }
    }

    fn boxed_clone(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }
}
