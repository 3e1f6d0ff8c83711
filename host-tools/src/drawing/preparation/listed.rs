//! Paths that a file lists vertex by vertex, planned exactly as listed.

use super::compose::unusable;
use super::prepare::prepare_with;
use super::source::SourceArguments;
use crate::drawing::{Input, Path3d, load};
use crate::error::{ProgramError, code};
use crate::link::text;
use crate::planning::PlanningError;
use etherpen::config::Config;
use etherpen::messages::ConfigRefusal;
use etherpen::motion::{Admission, RefusalReason, Vertex};
use std::path::Path;

/// Reads a file: a listed path as it is, any other file as it would be drawn. Returns the path, with every vertex
/// admitted, and the number of vertices of a listed path that were left out because they coincided with the previous
/// one.
///
/// # Errors
/// The file or the configuration cannot be used, or a vertex is refused.
pub fn read_path(file: &Path, config: &Config, source: &SourceArguments) -> Result<(Vec<Vertex>, usize), ProgramError> {
    match load(file).map_err(|cause| unusable(file, &cause))? {
        Input::Path(path) => admit(&path, config).map_err(|cause| match cause {
            PathRefusal::Geometry(refusal) => ProgramError::new(code::USAGE, text::config_refusal(&refusal)),
            PathRefusal::Path(cause) => unusable(file, &cause),
        }),
        Input::Photograph(_) | Input::Drawing(_) | Input::Artwork(_) => {
            Ok((prepare_with(file, config, source)?.path, 0))
        }
    }
}

/// Why a listed path is not admitted.
#[derive(Debug)]
enum PathRefusal {
    /// The configured dimensions do not form a valid robot.
    Geometry(ConfigRefusal),
    /// A vertex was refused, or there are too few.
    Path(String),
}

/// Checks the vertices of a listed path; leaves out those that coincide with the previous one.
fn admit(path: &Path3d, config: &Config) -> Result<(Vec<Vertex>, usize), PathRefusal> {
    let mut admission = Admission::new(&config.motion_settings())
        .map_err(|cause| PathRefusal::Geometry(ConfigRefusal::Geometry(cause)))?;
    let mut admitted = Vec::with_capacity(path.vertices.len());
    for (index, (vertex, line)) in (0u32..).zip(path.vertices.iter().zip(&path.lines)) {
        match admission.check(index, vertex) {
            Ok(()) => admitted.push(*vertex),
            Err(refusal) if matches!(refusal.reason, RefusalReason::Repeated { .. }) => {}
            Err(refusal) => return Err(PathRefusal::Path(format!("line {line}: {}", text::vertex(&refusal)))),
        }
    }
    if admitted.len() < 2 {
        let vertices = admitted.len();
        return Err(PathRefusal::Path(PlanningError::TooShort { vertices }.to_string()));
    }
    let merged = path.vertices.len() - admitted.len();
    Ok((admitted, merged))
}
