//! Where the robot goes for a change of the pen.

use super::operate::position;
use crate::error::{ProgramError, code};
use crate::link::text;
use etherpen::config::Config;
use etherpen::messages::ConfigRefusal;
use etherpen::motion::{Admission, Pen, Vertex};
use etherpen::robots::Position;

/// Options of every command that pauses between layers.
#[derive(clap::Args, Debug)]
pub(super) struct PenChangeArguments {
    /// Where the robot goes between two layers, mm in the robot's frame, in a straight line from above the last stroke.
    /// Default: it stays there.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = position)]
    change_at: Option<Position>,
}

impl PenChangeArguments {
    /// The place, if one is given.
    ///
    /// # Errors
    /// The robot cannot go there.
    pub(super) fn place(&self, config: &Config) -> Result<Option<Position>, ProgramError> {
        let Some(position) = self.change_at else {
            return Ok(None);
        };
        let unusable = |cause: String| ProgramError::new(code::USAGE, format!("--change-at: {cause}"));
        let mut admission = Admission::new(&config.motion_settings())
            .map_err(|cause| unusable(text::config_refusal(&ConfigRefusal::Geometry(cause))))?;
        let vertex = Vertex {
            position,
            pen: Pen::Up,
            stroke: 0,
        };
        admission
            .check(0, &vertex)
            .map_err(|refusal| unusable(text::vertex(&refusal)))?;
        Ok(Some(position))
    }
}
