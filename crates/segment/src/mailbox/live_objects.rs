//! Objects whose values are in the device.

use crate::mailbox::abort::Abort;

/// The live objects of a device; by default there are none.
pub(crate) trait LiveObjects {
    /// The value of a live object; `None` if the device has none.
    fn get(&self, _index: u16, _sub: u8) -> Option<i64> {
        None
    }
    /// The bytes of a live object without a fixed length; `None` if the device has none.
    fn bytes(&self, _index: u16, _sub: u8) -> Option<Vec<u8>> {
        None
    }
    /// Writes a live object through the mailbox.
    ///
    /// # Errors
    /// An [`Abort`] for a value that the device refuses.
    fn set(&mut self, _index: u16, _sub: u8, _value: i64) -> Result<(), Abort> {
        Err(Abort::READ_ONLY)
    }
    /// Takes a value from the outputs.
    fn set_output(&mut self, _index: u16, _sub: u8, _value: i64) {}
}
