//! The seam between the master and the application's drivers: which devices it knows, and how it uses them.
//!
//! The master finds, addresses and watches slaves of any kind. A [`SlaveFactory`] tells it for which of them there is a
//! driver, and configures such a slave in PREOP: objects, process data and the layout of the values in them. The master
//! moves the process data, and passes the layout unchanged to the critical side with the plan.
//!
//! Slaves that the application uses are its *members*, numbered from 0.
//!
//! Invariant: a factory is data and functions of its arguments; it has no state of its own.

use super::configure::PreOperational;
use super::error::BusError;
use super::wire::coe::Object;
use super::wire::sii::Identity;
use core::fmt::Debug;

/// The application's drivers.
pub trait SlaveFactory: Copy + Default + Eq + Debug + 'static {
    /// A device type with a driver.
    type Device: Copy + Eq + Debug + 'static;
    /// Where a slave's values are in its process data; for the critical side.
    type Layout: Copy + Eq + Debug + 'static;
    /// What the application asks of its members.
    type Settings: Clone + Default + PartialEq + Debug;

    /// The device type of a product; `None` if no driver knows the product.
    fn by_identity(identity: &Identity) -> Option<Self::Device>;

    /// The device type of a slave that reports this in object 0x1000 (CiA 301); `None` if it has no driver. Only asked
    /// for products that [`Self::by_identity`] does not know.
    fn by_device_type(device_type: u32) -> Option<Self::Device>;

    /// What the master needs to know of a device type.
    fn describe(device: Self::Device) -> DeviceDescription;

    /// Configures a slave in PREOP, and returns its process data; `None` for a slave that exchanges none.
    ///
    /// `member` is the slave's number among the application's members, `None` if it is not used: then its process data
    /// are found, and nothing else is changed. `twin` are the process data of a slave of equal product and revision that
    /// has already been configured.
    ///
    /// # Errors
    /// Any error; the slave then stays in PREOP, and the error is reported with the slave's place.
    fn configure<const MESSAGE: usize>(
        settings: &Self::Settings,
        device: Self::Device,
        member: Option<u8>,
        slave: &mut PreOperational<'_, '_, MESSAGE>,
        twin: Option<&ProcessData<Self>>,
    ) -> impl Future<Output = Result<Option<ProcessData<Self>>, BusError>>;
}

/// What the master needs to know of a device type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceDescription {
    /// Name for messages.
    pub name: &'static str,
    /// AssignActivate, the use of the distributed clocks: the value of registers 0x0980 (low byte) and 0x0981 (high
    /// byte); 0 for none.
    pub assign_activate: u16,
    /// Object with a status word of 16 bits that a diagnosis shows.
    pub status: Option<Object>,
}

/// A slave's process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessData<F: SlaveFactory> {
    /// Addresses of outputs and inputs in the slave's memory.
    pub windows: Windows,
    /// Bytes of the outputs.
    pub output_length: u16,
    /// Bytes of the inputs.
    pub input_length: u16,
    /// Layout of the values in outputs and inputs.
    pub layout: F::Layout,
}

/// A slave that the application uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Role<F: SlaveFactory> {
    /// Its number among the application's members, from 0.
    pub member: u8,
    /// Its device type.
    pub device: F::Device,
    /// Layout of the values in its process data.
    pub layout: F::Layout,
}

/// Outputs or inputs, as seen from the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the master to the slave (RxPDO).
    Outputs,
    /// From the slave to the master (TxPDO).
    Inputs,
}

/// Addresses of the process data in the slave's memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Windows {
    /// Start of the outputs: sync manager 2.
    pub outputs: u16,
    /// Start of the inputs: sync manager 3.
    pub inputs: u16,
}

/// An object in the process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The object; index 0 is a gap.
    pub object: Object,
    /// Bits it takes.
    pub bits: u8,
}

impl Entry {
    /// An entry for an object and its length in bits.
    pub const fn new(object: Object, bits: u8) -> Self {
        Self { object, bits }
    }

    /// The entry described by the value of a mapping object (0x16xx, 0x1Axx): index, sub-index and bits (CiA 301).
    pub const fn from_mapping(value: u32) -> Self {
        Self::new(Object::new((value >> 16) as u16, (value >> 8) as u8), value as u8)
    }

    /// The value of the mapping object for this entry.
    pub const fn mapping(&self) -> u32 {
        (self.object.index as u32) << 16 | (self.object.sub as u32) << 8 | self.bits as u32
    }
}

/// The process data object of one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoChoice {
    /// Its index: from 0x1600 for outputs, from 0x1A00 for inputs.
    pub pdo: u16,
    /// Its entries, fixed or to be written.
    pub entries: &'static [Entry],
    /// Whether the entries have to be written; otherwise they are fixed in the device.
    pub written: bool,
}

impl PdoChoice {
    /// A process data object whose entries are fixed in the device.
    pub const fn fixed(pdo: u16, entries: &'static [Entry]) -> Self {
        Self {
            pdo,
            entries,
            written: false,
        }
    }

    /// A process data object whose entries are written.
    pub const fn written(pdo: u16, entries: &'static [Entry]) -> Self {
        Self {
            pdo,
            entries,
            written: true,
        }
    }
}

/// One object to write before a device is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Setting {
    /// The object.
    pub object: Object,
    /// Its value, little-endian, signed values sign-extended.
    pub value: u32,
    /// Bytes of the object, 1 to 4.
    pub length: u8,
    /// The object that has to read back as this value afterwards, if any.
    pub verify: Option<Object>,
    /// Whether the device may refuse the object.
    pub optional: bool,
}

impl Setting {
    /// A setting that is written and not read back.
    pub const fn new(index: u16, sub: u8, value: u32, length: u8) -> Self {
        Self::of(Object::new(index, sub), value, length)
    }

    /// A setting of `object` that is written and not read back.
    pub const fn of(object: Object, value: u32, length: u8) -> Self {
        Self {
            object,
            value,
            length,
            verify: None,
            optional: false,
        }
    }

    /// This setting, read back from the object itself.
    pub const fn verified(self) -> Self {
        Self {
            verify: Some(self.object),
            ..self
        }
    }

    /// This setting, read back from another object.
    pub const fn shown_by(self, object: Object) -> Self {
        Self {
            verify: Some(object),
            ..self
        }
    }

    /// This setting for an object that not every device of the type has.
    pub const fn optional(self) -> Self {
        Self { optional: true, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mapping_value_and_its_entry_are_the_same_thing() {
        let entry = Entry::from_mapping(0x60C1_0120);
        assert_eq!(entry, Entry::new(Object::new(0x60C1, 1), 32));
        assert_eq!(entry.mapping(), 0x60C1_0120);
    }
}
