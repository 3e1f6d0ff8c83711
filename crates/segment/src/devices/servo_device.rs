//! A servo drive behind a slave controller: the part common to all drive types.
//!
//! A drive type is a [`Model`]: its identity, objects and process data, and the behaviour of its objects. A further
//! type needs a file with a `MODEL`, and a line in `kind.rs`.

use crate::controller::silicon::Silicon;
use crate::devices::Device;
use crate::drive::Profile;
use crate::drive::servo::{Emergency, Servo};
use crate::eeprom::sii::{self, Description};
use crate::eeprom::windows::Windows;
use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::{DataType, Dictionary, ObjectRow, Value, access, variable};
use crate::mailbox::live_objects::LiveObjects;
use crate::mailbox::process_data::{DataManagers, ProcessData};
use DataType::{Integer16, Integer32, Unsigned8, Unsigned16, Unsigned32};
use Value::{Live, Number};
use access::{READ, READ_WRITE, TX};
use etherpen_ethercat::wire::sii::Identity;

/// Diagnosis history, in the drives that have one.
pub(crate) const HISTORY: u16 = 0x10F3;

/// Objects of every drive.
const COMMON_OBJECTS: &[ObjectRow] = &[
    variable(
        0x1000,
        "Device type",
        &[(0, "Device type", Unsigned32, READ, Number(0x0002_0192))],
    ),
    variable(
        0x1001,
        "Error register",
        &[(0, "Error register", Unsigned8, READ, Live)],
    ),
    variable(
        0x6041,
        "Status word",
        &[(0, "Status word", Unsigned16, READ | TX, Live)],
    ),
    variable(
        0x6064,
        "Position actual value",
        &[(0, "Position actual value", Integer32, READ | TX, Live)],
    ),
    variable(
        0x6077,
        "Torque actual value",
        &[(0, "Torque actual value", Integer16, READ | TX, Live)],
    ),
    variable(
        0x6085,
        "Quick stop deceleration",
        &[(0, "Quick stop deceleration", Unsigned32, READ_WRITE, Live)],
    ),
];

/// Description of a drive type.
#[derive(Debug)]
pub(crate) struct Model {
    /// Name in the information image.
    pub(crate) name: &'static str,
    /// Order number in the information image.
    pub(crate) order: &'static str,
    /// Identity; each drive has its own serial number.
    pub(crate) identity: Identity,
    pub(crate) silicon: Silicon,
    pub(crate) windows: Windows,
    /// Whether outputs that map one object twice are refused.
    pub(crate) maps_once: bool,
    /// Details of the mailbox protocol in the information image.
    pub(crate) details: u8,
    /// Objects in addition to those of every drive.
    pub(crate) objects: &'static [ObjectRow],
    pub(crate) profile: Profile,
    pub(crate) process_data: fn() -> ProcessData,
    /// Reads a live object.
    pub(crate) get: fn(&Servo, u16, u8) -> Option<i64>,
    /// Writes an object through the mailbox.
    pub(crate) set: fn(&mut Servo, u16, u8, i64) -> Result<(), Abort>,
    /// Takes an object from the outputs.
    pub(crate) set_output: fn(&mut Servo, u16, i64),
}

/// The device behind one slave controller.
#[derive(Clone, Debug)]
pub(crate) struct ServoDevice {
    model: &'static Model,
    servo: Servo,
    serial: u32,
    managers: DataManagers,
}

impl ServoDevice {
    /// A drive of this type with this serial number.
    pub(crate) fn new(model: &'static Model, mut servo: Servo, serial: u32) -> Self {
        servo.drive = servo.drive.with_profile(model.profile);
        Self {
            model,
            servo,
            serial,
            managers: DataManagers::default(),
        }
    }

    fn identity(&self) -> Identity {
        Identity {
            serial: self.serial,
            ..self.model.identity
        }
    }
}

impl LiveObjects for ServoDevice {
    fn get(&self, index: u16, sub: u8) -> Option<i64> {
        (self.model.get)(&self.servo, index, sub)
    }

    fn bytes(&self, index: u16, sub: u8) -> Option<Vec<u8>> {
        let history = &self.servo.history;
        (index == HISTORY).then(|| history.message(sub).map(<[u8]>::to_vec))?
    }

    fn set(&mut self, index: u16, sub: u8, value: i64) -> Result<(), Abort> {
        (self.model.set)(&mut self.servo, index, sub, value)
    }

    fn set_output(&mut self, index: u16, _sub: u8, value: i64) {
        (self.model.set_output)(&mut self.servo, index, value);
    }
}

impl Device for ServoDevice {
    fn image(&self) -> Vec<u8> {
        let description = Description {
            identity: self.identity(),
            name: self.model.name,
            order: self.model.order,
            details: self.model.details,
            ports: self.silicon().ports,
            ..Description::default()
        };
        sii::image(&description.with_mailbox(self.model.windows, &self.process_data()))
    }

    fn silicon(&self) -> Silicon {
        let silicon = self.model.silicon;
        Silicon {
            sync_managers: silicon.sync_managers.max(self.managers.count()),
            ..silicon
        }
    }

    fn accepts(&self, process_data: &ProcessData) -> bool {
        !(self.model.maps_once && process_data.maps_output_twice())
    }

    fn windows(&self) -> Windows {
        self.model.windows
    }

    fn process_data(&self) -> ProcessData {
        (self.model.process_data)().carried_by(self.managers)
    }

    fn dictionary(&self) -> Dictionary {
        let mut dictionary = Dictionary::default();
        dictionary.add_table(COMMON_OBJECTS);
        dictionary.add_table(self.model.objects);
        dictionary.add_identity(&self.identity());
        dictionary.add_sync_manager_types(&self.managers.types());
        self.process_data().describe(&mut dictionary);
        dictionary
    }

    fn set_managers(&mut self, managers: DataManagers) {
        self.managers = managers;
    }

    fn set_serial(&mut self, serial: u32) {
        self.serial = serial;
    }

    fn power_up(&mut self) {
        self.servo.power_up();
    }

    fn step(&mut self, operational: bool) {
        self.servo.step(operational);
    }

    fn coast(&mut self) {
        self.servo.coast();
    }

    fn sample(&mut self) {
        self.servo.sample();
    }

    fn set_outputs_missed(&mut self, missed: bool) {
        self.servo.demand.is_missed = missed;
    }

    fn cyclic_data_lost(&mut self) {
        self.servo.drive.cyclic_data_lost();
    }

    fn take_emergency(&mut self) -> Option<Emergency> {
        self.servo.take_emergency()
    }

    fn servo(&self) -> Option<&Servo> {
        Some(&self.servo)
    }

    fn servo_mut(&mut self) -> Option<&mut Servo> {
        Some(&mut self.servo)
    }

    fn boxed_clone(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }
}
