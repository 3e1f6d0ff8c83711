//! The host's end of the link: session, ports and texts.
//!
//! [`Session`](session::Session) and [`Job`](crate::job::Job) are state machines without clock, input or output. The
//! emulator's lockstep loop and a real [`port`] drive this code, and a run in virtual time repeats exactly.

pub mod measurement;
pub mod ownership;
pub mod port;
pub mod port_name;
#[cfg(test)]
pub(crate) mod rig;
pub mod session;
pub mod text;
