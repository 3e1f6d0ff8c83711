//! FNV-1a with 64 bits, the hash of everything that is compared or named by a hash.

pub use etherpen::hash::fnv1a;
