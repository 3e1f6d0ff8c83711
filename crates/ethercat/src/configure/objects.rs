//! What a driver configures in a slave: objects, and the process data of each direction.

use crate::wire::coe::Object;

/// Most sync managers that a slave controller has.
pub(super) const MANAGERS_MAX: u16 = 16;
/// Object that lists the process data objects of sync manager 0; those of the others follow.
pub(super) const ASSIGNMENT: u16 = 0x1C10;

/// Outputs or inputs, as seen from the master.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the master to the slave (RxPDO).
    Outputs,
    /// From the slave to the master (TxPDO).
    Inputs,
}

/// Sync manager that carries a slave's process data of one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    /// Its number.
    pub(crate) manager: u8,
    /// Its first byte in the slave's memory.
    pub(crate) start: u16,
}

/// Where a slave's process data are: one sync manager for each direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Windows {
    pub(crate) outputs: Window,
    pub(crate) inputs: Window,
}

impl Windows {
    /// What a driver gives [`PreOperational::windows`](super::PreOperational::windows) for slaves whose SII tells no first bytes;
    /// process data have the windows that it returns.
    ///
    /// Sync managers 2 for the outputs and 3 for the inputs, as ETG.1000.6 numbers them behind those of the mailbox, with these
    /// first bytes in the slave's memory.
    pub const fn standard(outputs: u16, inputs: u16) -> Self {
        Self {
            outputs: Window {
                manager: 2,
                start: outputs,
            },
            inputs: Window {
                manager: 3,
                start: inputs,
            },
        }
    }

    /// Listed sync managers, and standard ones for those that are not listed; no number stands for both directions.
    pub(crate) fn listed(outputs: Option<Window>, inputs: Option<Window>) -> Self {
        let mut windows = Self::standard(0, 0);
        if outputs.is_some_and(|outputs| outputs.manager == windows.inputs.manager)
            || inputs.is_some_and(|inputs| inputs.manager == windows.outputs.manager)
        {
            core::mem::swap(&mut windows.outputs, &mut windows.inputs);
        }
        Self {
            outputs: outputs.unwrap_or(windows.outputs),
            inputs: inputs.unwrap_or(windows.inputs),
        }
    }

    /// The sync manager of one direction.
    pub(crate) const fn of(&self, direction: Direction) -> Window {
        match direction {
            Direction::Outputs => self.outputs,
            Direction::Inputs => self.inputs,
        }
    }
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
    /// Whether the device may round the value: then it reads back within 2 %.
    pub rounded: bool,
    /// Whether the device may refuse the object.
    pub optional: bool,
    /// Whether the bits of the value are set among those of the object, which keeps its others.
    pub adds: bool,
}

/// Largest difference of a rounded value from the one that was written, as a part of it: devices calculate in units of
/// their own.
pub(crate) const ROUNDING_SHARE: u32 = 50;

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
            rounded: false,
            optional: false,
            adds: false,
        }
    }

    /// This setting, read back from the object itself.
    pub const fn verified(self) -> Self {
        Self {
            verify: Some(self.object),
            ..self
        }
    }

    /// This setting, read back from the object itself, where the device may have rounded it.
    pub const fn rounded(self) -> Self {
        Self {
            rounded: true,
            ..self.verified()
        }
    }

    /// This setting for an object whose other bits stay as they are: it is read before it is written.
    pub const fn added(self) -> Self {
        Self { adds: true, ..self }
    }

    /// Whether what was read back is what was written.
    pub const fn is_shown_by(&self, expected: u32, actual: u32) -> bool {
        let off = expected.abs_diff(actual);
        off == 0 || self.rounded && off <= expected / ROUNDING_SHARE
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
