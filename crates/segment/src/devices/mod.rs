//! Devices behind slave controllers: the interface between bus and device.
//!
//! A device describes itself (identity, information image, silicon, mailbox, process data, objects), holds the values
//! of its live objects and mapped process data, and is stepped every millisecond. All access by a master goes through
//! the controller, the mailbox server and the object tables; no device knows the bus.

pub(crate) mod ax2000;
mod coupler;
mod generic_drive;
mod image_device;
pub(crate) mod kind;
mod servo_device;

use crate::controller::silicon::Silicon;
use crate::drive::servo::{Emergency, Servo};
use crate::eeprom::windows::Windows;
use crate::mailbox::dictionary::Dictionary;
use crate::mailbox::live_objects::LiveObjects;
use crate::mailbox::process_data::ProcessData;
use std::fmt;

/// A device behind a slave controller.
pub(crate) trait Device: LiveObjects + fmt::Debug + Send {
    /// The slave information image.
    fn image(&self) -> Vec<u8>;
    /// The controller's silicon.
    fn silicon(&self) -> Silicon {
        Silicon::ET1100
    }
    /// Windows of mailboxes and process data.
    fn windows(&self) -> Windows;
    /// PDOs and their assignment after power-up.
    fn process_data(&self) -> ProcessData;
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
    /// Handles the loss of cyclic data.
    fn cyclic_data_lost(&mut self) {}
    /// The next emergency.
    fn take_emergency(&mut self) -> Option<Emergency> {
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
    /// A copy of the device.
    fn boxed_clone(&self) -> Box<dyn Device>;
}

impl Clone for Box<dyn Device> {
    fn clone(&self) -> Self {
        self.as_ref().boxed_clone()
    }
}
