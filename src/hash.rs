//! FNV-1a with 64 bits, the hash of everything that is compared or named by a hash.

/// Start value.
const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
/// Factor of a step.
const PRIME: u64 = 0x0000_0100_0000_01b3;

/// FNV-1a of bytes, 64 bits (Fowler, Noll and Vo).
#[must_use]
pub fn fnv1a(bytes: impl IntoIterator<Item = u8>) -> u64 {
    let step = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(PRIME);
    bytes.into_iter().fold(OFFSET, step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_definition() {
        assert_eq!(fnv1a([]), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv1a(*b"a"), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv1a(*b"foobar"), 0x8594_4171_f739_67e8);
    }
}
