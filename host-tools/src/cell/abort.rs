//! SDO abort codes: why an object was not read or written.
//!
//! Numbers: CiA 301, abort transfer protocol, and IEC 61158-6-12 for complete access.

/// Why an SDO was refused: the number of CiA 301.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Abort(pub(super) u32);

impl Abort {
    pub(super) const TOGGLE: Self = Self(0x0503_0000);
    pub(super) const COMMAND: Self = Self(0x0504_0001);
    pub(super) const MEMORY: Self = Self(0x0504_0005);
    pub(super) const UNSUPPORTED_ACCESS: Self = Self(0x0601_0000);
    pub(super) const WRITE_ONLY: Self = Self(0x0601_0001);
    pub(super) const READ_ONLY: Self = Self(0x0601_0002);
    pub(super) const SUB_INDEX_ZERO_FIRST: Self = Self(0x0601_0003);
    pub(super) const VARIABLE_LENGTH: Self = Self(0x0601_0004);
    pub(super) const NO_OBJECT: Self = Self(0x0602_0000);
    pub(super) const NOT_MAPPABLE: Self = Self(0x0604_0041);
    pub(super) const MAPPING_LENGTH: Self = Self(0x0604_0042);
    pub(super) const LENGTH: Self = Self(0x0607_0010);
    pub(super) const TOO_LONG: Self = Self(0x0607_0012);
    pub(super) const TOO_SHORT: Self = Self(0x0607_0013);
    pub(super) const NO_SUB_INDEX: Self = Self(0x0609_0011);
    pub(super) const VALUE: Self = Self(0x0609_0030);
    pub(super) const STATE: Self = Self(0x0800_0022);
}
