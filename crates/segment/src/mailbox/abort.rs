//! SDO abort codes: why an object was not read or written.
//!
//! Numbers: CiA 301, abort transfer protocol, and IEC 61158-6-12 for complete access.

/// Why an SDO was refused: the number of CiA 301.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Abort(pub(crate) u32);

impl Abort {
    pub(crate) const TOGGLE: Self = Self(0x0503_0000);
    pub(crate) const COMMAND: Self = Self(0x0504_0001);
    pub(crate) const MEMORY: Self = Self(0x0504_0005);
    pub(crate) const UNSUPPORTED_ACCESS: Self = Self(0x0601_0000);
    pub(crate) const WRITE_ONLY: Self = Self(0x0601_0001);
    pub(crate) const READ_ONLY: Self = Self(0x0601_0002);
    pub(crate) const SUB_INDEX_ZERO_FIRST: Self = Self(0x0601_0003);
    pub(crate) const VARIABLE_LENGTH: Self = Self(0x0601_0004);
    pub(crate) const NO_OBJECT: Self = Self(0x0602_0000);
    pub(crate) const NOT_MAPPABLE: Self = Self(0x0604_0041);
    pub(crate) const MAPPING_LENGTH: Self = Self(0x0604_0042);
    pub(crate) const LENGTH: Self = Self(0x0607_0010);
    pub(crate) const TOO_LONG: Self = Self(0x0607_0012);
    pub(crate) const TOO_SHORT: Self = Self(0x0607_0013);
    pub(crate) const NO_SUB_INDEX: Self = Self(0x0609_0011);
    pub(crate) const VALUE: Self = Self(0x0609_0030);
    pub(crate) const STATE: Self = Self(0x0800_0022);
}
