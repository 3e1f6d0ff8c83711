//! The 1 kHz side: sampler, position and velocity controllers, supervision.

pub mod position;
pub mod sampler;
pub mod supervision;
pub mod velocity;
