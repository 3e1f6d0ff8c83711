//! An application without drivers: its slaves take part with their own process data only.
//!
//! Enough for terminals, and for any slave that needs no object written in PREOP, see
//! [`BusSetup::terminals`](super::event::BusSetup::terminals).
//!
//! Invariant: no slave becomes a member.

use crate::configure::PreOperational;
use crate::driver::{DeviceDescription, ProcessData, SlaveFactory};
use crate::error::BusError;
use crate::wire::sii::Identity;

/// Knows no device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoDrivers;

impl SlaveFactory for NoDrivers {
    type Device = ();
    type Layout = ();
    type Settings = ();

    fn by_identity(_: &Identity) -> Option<()> {
        None
    }

    fn by_device_type(_: u32) -> Option<()> {
        None
    }

    fn describe((): ()) -> DeviceDescription {
        DeviceDescription::default()
    }

    async fn configure<const MESSAGE: usize>(
        (): &(),
        (): (),
        _: Option<u8>,
        _: &mut PreOperational<'_, '_, MESSAGE>,
        _: Option<&ProcessData<Self>>,
    ) -> Result<Option<ProcessData<Self>>, BusError> {
        Ok(None)
    }
}
