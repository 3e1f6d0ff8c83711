//! A place in the sources, and what a mutant does there.

use serde::{Deserialize, Serialize};
use std::ops::Range;

/// What a mutant does to the code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Operator {
    /// A comparison becomes its opposite: `<` becomes `>=`, `==` becomes `!=`.
    Turned,
    /// A comparison of whole numbers treats its border differently: `<` becomes `<=`.
    Boundary,
    /// A flag, value or state is not set; a fault is not latched.
    Latch,
    /// `.min(x)`, `.max(x)`, `.clamp(a, b)` or `limited(a, b)` is left out.
    Limit,
    /// One side of `&&` or `||` is left out.
    Side,
    /// A flag, counter or state is not set back.
    Reset,
    /// A counter does not count.
    Count,
    /// `!` is left out.
    Not,
    /// An `if` that ends the function or the turn of a loop is left out.
    Guard,
}

impl Operator {
    /// All operators.
    pub const ALL: [Self; 9] = [
        Self::Turned,
        Self::Boundary,
        Self::Latch,
        Self::Limit,
        Self::Side,
        Self::Reset,
        Self::Count,
        Self::Not,
        Self::Guard,
    ];

    /// The operator in words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Turned => "comparison turned round",
            Self::Boundary => "boundary moved",
            Self::Latch => "latch forgotten",
            Self::Limit => "limit dropped",
            Self::Side => "condition dropped",
            Self::Reset => "not reset",
            Self::Count => "not counted",
            Self::Not => "`!` left out",
            Self::Guard => "guard dropped",
        }
    }
}

/// Stands in [`Site::replacement`] for the condition that the mutant is on.
pub(crate) const SWITCH: &str = "$on";
/// Stands in [`Site::replacement`] for the function that takes values with a total order only.
pub(crate) const ORDERED: &str = "$ordered";

/// A place where a mutant can be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Site {
    /// File, from the root of the sources.
    pub file: String,
    /// Type and function that contain the place.
    pub function: String,
    /// What the mutant does.
    pub operator: Operator,
    /// Bytes of the file that are replaced.
    pub range: Range<usize>,
    /// The code for these bytes, with [`SWITCH`]: what they were while the mutant is off, the mutant while it is on.
    pub replacement: String,
    /// The change in words: `a < b` becomes `a >= b`.
    pub change: String,
    /// Number of this change, from 1, among equal changes in the same function; `None` if there is only one.
    pub occurrence: Option<u32>,
}

impl Site {
    /// Whether both sites change the same code.
    #[must_use]
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.file == other.file && self.range.start < other.range.end && other.range.start < self.range.end
    }
}
