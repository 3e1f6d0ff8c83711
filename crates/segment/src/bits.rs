//! Single bits of byte strings, as mapping units and process data count them.

/// Bit `index` of a byte string, counted from the first byte's lowest bit.
#[inline]
pub(crate) fn bit(bytes: &[u8], index: usize) -> bool {
    bytes.get(index / 8).is_some_and(|byte| byte >> (index % 8) & 1 != 0)
}

/// Sets bit `index` of a byte string.
#[inline]
pub(crate) fn set_bit(bytes: &mut [u8], index: usize, value: bool) {
    if let Some(byte) = bytes.get_mut(index / 8) {
        let mask = 1u8 << (index % 8);
        *byte = if value { *byte | mask } else { *byte & !mask };
    }
}
