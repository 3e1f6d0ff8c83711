//! Preparation of a file: from its content to an admitted path, without a machine.
//!
//! [`prepare`] reads the file, [`compose`] converts it into strokes, [`choose_order`] selects their order by the
//! firmware's planner, and `time_budget` fits a photograph into a drawing time. [`confined`] does that in a separate
//! process. `variants` draws a photograph in several ways, `stages` shows what is found in it, [`overview`] which part of it is
//! drawn. [`listed`] reads paths that
//! are planned exactly as listed. [`source`] has the options of all commands that draw or show a file.

pub mod choose_order;
pub mod compose;
pub mod confined;
pub(crate) mod grid;
pub mod listed;
pub mod outline;
pub mod overview;
pub mod prepare;
pub mod preview;
pub mod source;
pub(crate) mod stages;
mod time_budget;
pub(crate) mod variants;
pub mod wire;
