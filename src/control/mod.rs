//! The 1 kHz side: sampler, position controller and supervision.

pub mod position;
pub mod sampler;
pub mod supervision;
