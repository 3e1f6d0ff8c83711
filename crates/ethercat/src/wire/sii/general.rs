//! The general category: names, capabilities, ports.
//!
//! Layout: IEC 61158-6-12 (slave information interface), ETG.2010 for flags and identification.
//!
//! Invariant: in a category that is too short, missing fields are 0; the names are always present.

use crate::wire::{Error, check_len, check_room, read_u8, read_u16, write_bytes};

/// [`General::coe`]: SDO.
pub const COE_SDO: u8 = 1 << 0;
/// [`General::coe`]: SDO information.
pub const COE_SDO_INFORMATION: u8 = 1 << 1;
/// [`General::coe`]: the assignment of PDOs can be changed.
pub const COE_PDO_ASSIGN: u8 = 1 << 2;
/// [`General::coe`]: the entries of PDOs can be changed.
pub const COE_PDO_CONFIGURE: u8 = 1 << 3;
/// [`General::coe`]: PDOs are to be read at start-up.
pub const COE_UPLOAD_AT_START: u8 = 1 << 4;
/// [`General::coe`]: SDO with complete access.
pub const COE_COMPLETE_ACCESS: u8 = 1 << 5;

/// [`General::flags`]: SAFEOP is supported.
pub const FLAG_SAFE_OPERATIONAL: u8 = 1 << 0;
/// [`General::flags`]: LRW is not supported.
pub const FLAG_NO_LRW: u8 = 1 << 1;
/// [`General::flags`]: the mailbox's repeat mechanism is supported.
pub const FLAG_MAILBOX_REPEAT: u8 = 1 << 2;
/// [`General::flags`]: the explicit identification is in the AL status code.
pub const FLAG_IDENTITY_IN_AL_STATUS: u8 = 1 << 3;
/// [`General::flags`]: the explicit identification is at [`General::identification_address`].
pub const FLAG_IDENTITY_IN_MEMORY: u8 = 1 << 4;

/// Type of a port of the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PortKind {
    /// The port does not exist.
    #[default]
    Unused,
    /// Ethernet by MII.
    Mii,
    /// The bus between terminals.
    Ebus,
    /// Ethernet by MII with fast hot connect.
    FastHotConnect,
    /// An unknown type.
    Other(u8),
}

impl PortKind {
    const fn from_number(number: u8) -> Self {
        match number {
            0 => Self::Unused,
            1 => Self::Mii,
            3 => Self::Ebus,
            4 => Self::FastHotConnect,
            other => Self::Other(other),
        }
    }

    const fn number(self) -> u8 {
        match self {
            Self::Unused => 0,
            Self::Mii => 1,
            Self::Ebus => 3,
            Self::FastHotConnect => 4,
            Self::Other(other) => other & 0x0F,
        }
    }
}

/// The general category in host form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct General {
    /// String number of the device group.
    pub group: u8,
    /// String number of a picture's name.
    pub image: u8,
    /// String number of the order number.
    pub order: u8,
    /// String number of the device's name.
    pub name: u8,
    /// CoE capabilities, see the `COE_` constants.
    pub coe: u8,
    /// Whether file access over EtherCAT is supported.
    pub foe: bool,
    /// Whether Ethernet over EtherCAT is supported.
    pub eoe: bool,
    /// Flags, see the `FLAG_` constants.
    pub flags: u8,
    /// Current taken from the bus between terminals, mA; negative where it is fed in.
    pub current_ma: i16,
    /// The four ports.
    pub ports: [PortKind; 4],
    /// Register with the explicit identification, if the flags announce it.
    pub identification_address: u16,
}

impl General {
    /// Bytes of the category.
    pub const LEN: usize = 32;
    /// Place of [`Self::flags`] in the category, bytes.
    pub const FLAGS_AT: usize = 11;
    /// Shortest valid category, bytes: the names.
    pub const LEN_MIN: usize = 4;

    /// Reads the category.
    ///
    /// # Errors
    /// [`Error::Truncated`] below [`Self::LEN_MIN`] bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, Self::LEN_MIN)?;
        let ports = read_u16(bytes, 16);
        let nibble = |port: u16| PortKind::from_number((ports >> (4 * port)) as u8 & 0x0F);
        Ok(Self {
            group: read_u8(bytes, 0),
            image: read_u8(bytes, 1),
            order: read_u8(bytes, 2),
            name: read_u8(bytes, 3),
            coe: read_u8(bytes, 5),
            foe: read_u8(bytes, 6) & 1 != 0,
            eoe: read_u8(bytes, 7) & 1 != 0,
            flags: read_u8(bytes, 11),
            current_ma: read_u16(bytes, 12).cast_signed(),
            ports: [nibble(0), nibble(1), nibble(2), nibble(3)],
            identification_address: read_u16(bytes, 18),
        })
    }

    /// Writes the category; reserved bytes become 0.
    ///
    /// # Errors
    /// [`Error::Room`] below [`Self::LEN`] bytes.
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, Self::LEN)?;
        bytes.iter_mut().take(Self::LEN).for_each(|byte| *byte = 0);
        write_bytes(bytes, 0, &[self.group, self.image, self.order, self.name]);
        write_bytes(bytes, 5, &[self.coe, u8::from(self.foe), u8::from(self.eoe)]);
        write_bytes(bytes, 11, &[self.flags]);
        write_bytes(bytes, 12, &self.current_ma.to_le_bytes());
        let ports = self
            .ports
            .iter()
            .rev()
            .fold(0_u16, |ports, port| ports << 4 | u16::from(port.number()));
        write_bytes(bytes, 16, &ports.to_le_bytes());
        write_bytes(bytes, 18, &self.identification_address.to_le_bytes());
        Ok(())
    }
}
