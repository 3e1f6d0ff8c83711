//! FNV-1a with 64 bits, the hash of paths, firmware images and port names.

pub use etherpen::hash::fnv1a;
