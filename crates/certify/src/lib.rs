#![doc = include_str!("../README.md")]
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `interval`, `limits`: intervals with outward rounding; limits and the quantities that they bound
//! 2. `series`, `angle`, `certificate`: Taylor series; sines and angles; what was found
//! 3. `robot`, `motion`: how the joints follow the tool; a committed motion as numbers
//! 4. `stretches`, `distance`: bounds of a stretch; distance of a curve from the polyline
//! 5. `average`: what the moving average adds
//! 6. `certifier`: takes the stretches of a motion
//!
//! # Invariants
//!
//! - No code is shared with the planner: this crate depends on nothing.
//! - A bound contains every exact value; what cannot be bounded is refused.
//! - No input panics.
#![forbid(unsafe_code)]

mod angle;
mod average;
mod certificate;
mod certifier;
mod distance;
pub mod interval;
mod limits;
mod motion;
pub mod robot;
mod series;
mod stretches;

pub use certificate::{Certificate, Kind, Refusal, Use};
pub use certifier::Certifier;
pub use limits::{AXES, Limits, Quantity};
pub use motion::{COEFFICIENTS, Stretch};
pub use robot::Robot;
