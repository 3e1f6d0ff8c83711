//! The host's end of the link: session, drawing job, ports and texts.
//!
//! [`Session`](session::Session) and [`Job`](job::Job) are state machines without clock, input or output. The
//! emulator's lockstep loop and a real [`port`] drive this code, and a run in virtual time repeats exactly.

#[cfg(test)]
pub(crate) mod bench;
pub mod error;
pub mod ink;
pub mod job;
pub mod measurement;
pub mod ownership;
mod path;
pub mod port;
pub mod progress;
pub mod reference;
pub mod remainder;
pub mod session;
pub mod terms;
pub mod text;
pub mod verification;
