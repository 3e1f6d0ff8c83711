//! Ethernet controllers: the part of their drivers that does not access hardware.
//!
//! A driver uses a small register trait, so that its logic is safe code and is tested on the host against a model of
//! the chip; a board provides the volatile accesses.

pub mod descriptors;
pub mod lan9118;
pub mod phy;
