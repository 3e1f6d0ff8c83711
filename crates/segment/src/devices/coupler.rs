//! A bus coupler like Beckhoff's EK1100, or a junction like its EK1122: no mailbox, no process data, only a place in the
//! chain and a clock. A junction has two ports for branches, 2 and 3.
//!
//! The controller emulates the device: it answers state requests itself.

use crate::controller::silicon::Silicon;
use crate::devices::{Device, ProcessManagers};
use crate::drive::servo::Servo;
use crate::eeprom::sii::{self, Description};
use crate::eeprom::windows::Windows;
use crate::mailbox::dictionary::Dictionary;
use crate::mailbox::live_objects::LiveObjects;
use crate::mailbox::process_data::ProcessData;
use etherpen_ethercat::wire::sii::Identity;

const NAME: &str = "EK1100 EtherCAT Coupler";
const ORDER: &str = "EK1100";
/// No process interface; device emulation, and the units of the clock powered.
const CONFIGURATION: u16 = 0x0D00;
const JUNCTION_NAME: &str = "EK1122 2 port EtherCAT junction";
const JUNCTION_ORDER: &str = "EK1122";
/// Current that a junction takes from the E-bus.
const JUNCTION_MA: i16 = 220;
/// Current for the E-bus, which a coupler supplies.
const SUPPLIED_MA: i16 = -2000;

/// The device behind one slave controller. It may replace a drive, whose motor then rests on its brake.
#[derive(Clone, Debug)]
pub(crate) struct Coupler {
    parked: Option<Servo>,
    is_junction: bool,
}

impl Coupler {
    /// A coupler, with the motor of the replaced drive.
    pub(crate) fn new(parked: Option<Servo>) -> Self {
        Self {
            parked,
            is_junction: false,
        }
    }

    /// A junction.
    pub(crate) fn junction() -> Self {
        Self {
            parked: None,
            is_junction: true,
        }
    }
}

impl LiveObjects for Coupler {}

impl Device for Coupler {
    fn image(&self) -> Vec<u8> {
        let (product, name, order, current_ma) = match self.is_junction {
            false => (0x044C_2C52, NAME, ORDER, SUPPLIED_MA),
            true => (0x0462_2C52, JUNCTION_NAME, JUNCTION_ORDER, JUNCTION_MA),
        };
        sii::image(&Description {
            identity: Identity {
                vendor: 0x0000_0002,
                product,
                revision: 0x0012_0000,
                serial: 0,
            },
            name,
            order,
            configuration: CONFIGURATION,
            current_ma,
            ports: self.silicon().ports,
            ..Description::default()
        })
    }

    fn silicon(&self) -> Silicon {
        match self.is_junction {
            false => Silicon::COUPLER,
            true => Silicon::JUNCTION,
        }
    }

    fn has_processor(&self) -> bool {
        false
    }

    fn process_managers(&self) -> ProcessManagers {
        ProcessManagers::default()
    }

    fn windows(&self) -> Windows {
        Windows::default()
    }

    fn process_data(&self) -> ProcessData {
        ProcessData::default()
    }

    fn dictionary(&self) -> Dictionary {
        Dictionary::default()
    }

    fn step(&mut self, _operational: bool) {
        self.parked.iter_mut().for_each(|servo| servo.step(false));
    }

    fn servo(&self) -> Option<&Servo> {
        self.parked.as_ref()
    }

    fn servo_mut(&mut self) -> Option<&mut Servo> {
        self.parked.as_mut()
    }

    fn boxed_clone(&self) -> Box<dyn Device> {
        Box::new(self.clone())
    }
}
