//! The seam between the master and the application's drivers: which devices it knows, and how it uses them.
//!
//! The master finds, addresses and watches slaves of any kind. A [`SlaveFactory`] reports which of them have a driver,
//! and configures such a slave in PREOP: objects, process data and the layout of the values in them. The master moves
//! the process data, and passes the layout unchanged to the critical side with the plan.
//!
//! Slaves that the application uses are its *members*, numbered from 0.
//!
//! Invariant: a factory is data and functions of its arguments; it has no state of its own.

use super::configure::PreOperational;
pub use super::configure::identification::ExpectedIdentity;
pub use super::configure::{Direction, Entry, PdoChoice, Setting, Windows};
use super::error::BusError;
use super::wire::coe::Object;
use super::wire::sii::{FixedPart, Identity, PROTOCOL_COE};
use core::fmt::Debug;

/// The application's drivers.
pub trait SlaveFactory: Copy + Default + Eq + Debug + 'static {
    /// A device type with a driver.
    type Device: Copy + Eq + Debug + 'static;
    /// Where a slave's values are in its process data; for the critical side.
    type Layout: Copy + Eq + Debug + 'static;
    /// Settings that the application requires of its members.
    type Settings: Clone + Default + PartialEq + Debug;

    /// The device type of a product; `None` if no driver knows the product.
    fn by_identity(identity: &Identity) -> Option<Self::Device>;

    /// The device type of a slave that reports this in object 0x1000 (CiA 301); `None` if it has no driver. Only asked
    /// for products that [`Self::by_identity`] does not know.
    fn by_device_type(device_type: u32) -> Option<Self::Device>;

    /// Properties of a device type that the master needs.
    fn describe(device: Self::Device) -> DeviceDescription;

    /// The identity that the application requires of a member; any slave with a driver by default.
    fn expected_identity(_settings: &Self::Settings, _member: u8) -> ExpectedIdentity {
        ExpectedIdentity::ANY
    }

    /// Configures a slave in PREOP, and returns its process data; `None` for a slave that exchanges none.
    ///
    /// `member` is the slave's number among the application's members, `None` if it is not used: then its process data
    /// are found, and nothing else is changed. `twin` are the process data of a slave of equal product and revision
    /// that has already been configured.
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

    /// Checks a member in OP, with the process data that it exchanges, before the application may use it: what a slave
    /// shows only then. Does nothing by default.
    ///
    /// # Errors
    /// Any error; the member then counts as one that did not reach OP.
    fn confirm<const MESSAGE: usize>(
        _settings: &Self::Settings,
        _device: Self::Device,
        _member: u8,
        _slave: &mut PreOperational<'_, '_, MESSAGE>,
        _data: &ProcessData<Self>,
    ) -> impl Future<Output = Result<(), BusError>> {
        async { Ok(()) }
    }
}

/// Whether a slave has to be asked for its device type to find its driver: no driver knows its product, and it supports
/// CoE.
pub fn is_asked_for_device_type<F: SlaveFactory>(fixed: &FixedPart) -> bool {
    F::by_identity(&fixed.identity).is_none() && fixed.protocols & PROTOCOL_COE != 0
}

/// Properties of a device type that the master needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeviceDescription {
    /// Name for messages.
    pub name: &'static str,
    /// AssignActivate, the use of the distributed clocks: the value of registers 0x0980 (low byte) and 0x0981 (high
    /// byte); 0 for none.
    pub assign_activate: u16,
    /// Time from SYNC0 to SYNC1, ns, for a device whose AssignActivate turns SYNC1 on.
    pub sync1_ns: u32,
    /// Object with a status word of 16 bits that a diagnosis shows.
    pub status: Option<Object>,
}

/// A slave's process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessData<F: SlaveFactory> {
    /// Sync managers of outputs and inputs: what [`PreOperational::windows`] returns.
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
