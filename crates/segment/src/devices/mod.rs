//! Devices behind slave controllers: the interface between bus and device.
//!
//! A device describes itself (identity, information image, silicon, mailbox, process data, objects), holds the values
//! of its live objects and mapped process data, and is stepped every millisecond. All access by a master goes through
//! the controller, the mailbox server and the object tables; no device knows the bus.

mod akd;
pub(crate) mod ax2000;
mod coupler;
mod generic_drive;
mod image_device;
pub(crate) mod kind;
mod servo_device;
mod terminal;

use crate::controller::silicon::Silicon;
use crate::drive::servo::{Emergency, Servo};
use crate::eeprom::windows::Windows;
use crate::mailbox::dictionary::Dictionary;
use crate::mailbox::live_objects::LiveObjects;
use crate::mailbox::process_data::{DataManagers, ProcessData};
use std::fmt;

/// Sync manager of process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ProcessManager {
    /// Its number.
    pub(crate) number: usize,
    /// Start of its data according to the information image.
    pub(crate) start: usize,
    /// Length, bytes; `None` if the assigned PDOs determine it.
    pub(crate) bytes: Option<usize>,
}

/// Sync managers of process data, in the order of their numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct ProcessManagers {
    /// Those the master writes.
    pub(crate) outputs: Vec<ProcessManager>,
    /// Those the master reads.
    pub(crate) inputs: Vec<ProcessManager>,
}

impl ProcessManagers {
    /// One sync manager for each direction, with a length that follows the assigned PDOs.
    pub(crate) fn of(windows: &Windows, managers: DataManagers) -> Self {
        let manager = |number: u8, start: u16| ProcessManager {
            number: number.into(),
            start: start.into(),
            bytes: None,
        };
        Self {
            outputs: vec![manager(managers.outputs, windows.outputs)],
            inputs: vec![manager(managers.inputs, windows.inputs)],
        }
    }
}

/// Process data of a device that gives them no meaning: the bytes of its sync managers, one behind the other.
#[derive(Clone, Debug, Default)]
pub(crate) struct Io {
    /// What the master reads.
    pub(crate) inputs: Vec<u8>,
    /// What the master wrote last while the outputs were valid.
    pub(crate) outputs: Vec<u8>,
}

/// A device behind a slave controller.
pub(crate) trait Device: LiveObjects + fmt::Debug + Send {
    /// The slave information image.
    fn image(&self) -> Vec<u8>;
    /// The controller's silicon.
    fn silicon(&self) -> Silicon {
        Silicon::ET1100
    }
    /// Whether its information memory is from a file, so that its controller may be of any type.
    fn is_from_file(&self) -> bool {
        false
    }
    /// Whether a processor reads the state requests. Without one the controller emulates the device, or nobody answers.
    fn has_processor(&self) -> bool {
        true
    }
    /// Windows of mailboxes and process data.
    fn windows(&self) -> Windows;
    /// PDOs and their assignment after power-up.
    fn process_data(&self) -> ProcessData;
    /// Sync managers of the process data.
    fn process_managers(&self) -> ProcessManagers {
        ProcessManagers::of(&self.windows(), self.process_data().managers())
    }
    /// Whether the device works with these process data.
    fn accepts(&self, _process_data: &ProcessData) -> bool {
        true
    }
    /// Objects after power-up.
    fn dictionary(&self) -> Dictionary;
    /// Resets everything but the motor to its state after power-up.
    fn power_up(&mut self) {}
    /// Advances by one millisecond; `operational` if the outputs are valid.
    fn step(&mut self, _operational: bool) {}
    /// Advances by one millisecond in which the processor is stopped, too short for the power stage to notice.
    fn coast(&mut self) {}
    /// Samples the inputs of this millisecond, after every motor has moved.
    fn sample(&mut self) {}
    /// Tells whether no outputs arrived since the last millisecond.
    fn set_outputs_missed(&mut self, _missed: bool) {}
    /// Handles the loss of cyclic data.
    fn cyclic_data_lost(&mut self) {}
    /// The next emergency.
    fn take_emergency(&mut self) -> Option<Emergency> {
        None
    }
    /// Process data without a meaning of their own, if the device has such.
    fn io(&self) -> Option<&Io> {
        None
    }
    /// Process data without a meaning of their own, mutable.
    fn io_mut(&mut self) -> Option<&mut Io> {
        None
    }
    /// The drive inside, if there is one.
    fn servo(&self) -> Option<&Servo> {
        None
    }
    /// The drive inside, mutable, if there is one.
    fn servo_mut(&mut self) -> Option<&mut Servo> {
        None
    }
    /// Carries the process data in other sync managers. No effect on a device that is not a drive.
    fn set_managers(&mut self, _managers: DataManagers) {}
    /// Gives the device another serial number than that of its kind.
    fn set_serial(&mut self, _serial: u32) {}
    /// A copy of the device.
    fn boxed_clone(&self) -> Box<dyn Device>;
}

impl Clone for Box<dyn Device> {
    fn clone(&self) -> Self {
        self.as_ref().boxed_clone()
    }
}
