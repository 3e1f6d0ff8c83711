//! What the plan commits, as plain numbers for programs on a host that check it in continuous time.
//!
//! Between two setpoints the motion is still exact: a polynomial curve, and on it a distance that is a quadratic
//! function of time. [`crate::Trajectory::step_observed`] shows an [`Observer`] each part of both as it is executed. The
//! firmware uses the observer `()`, which does nothing and costs nothing.

/// Takes what the plan executes, in the order of time.
pub trait Observer {
    /// The next millisecond begins.
    fn millisecond(&mut self) {}

    /// A part of a stretch has been executed.
    fn moved(&mut self, _: &Passage) {}
}

impl Observer for () {}

/// A part of a stretch, executed within one millisecond.
///
/// The point at the parameter u of the curve is the sum of `coefficients[k] * u^k`. At the time t of the stretch the
/// motion is at `start_mm + speed_mm_s * t + acceleration_mm_s2 * t^2 / 2` from the beginning of the interval. Its
/// parameter is the one up to which three-point Gauss quadrature, from the beginning of the interval, finds that length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Passage {
    /// Coefficients of the curve, mm.
    pub coefficients: [[f64; 3]; 6],
    /// Parameters at both ends of the interval of the grid.
    pub parameter: [f64; 2],
    /// Length of the interval, mm.
    pub length_mm: f64,
    /// Place at which the stretch begins, mm from the beginning of the interval.
    pub start_mm: f64,
    /// Speed at the beginning of the stretch, mm/s.
    pub speed_mm_s: f64,
    /// Acceleration along the path, mm/s2.
    pub acceleration_mm_s2: f64,
    /// Time of the stretch at which this part begins and at which it ends, s.
    pub time_s: [f64; 2],
    /// Time from the end of this part to the end of the millisecond, s.
    pub left_s: f64,
    /// Angle of the fourth axis at the beginning of the interval, rad.
    pub heading_rad: f64,
    /// Slope of the fourth axis at the beginning of the interval, rad/mm.
    pub turn_rad_mm: f64,
    /// Derivative of that slope with respect to length, rad/mm2.
    pub turn_change_rad_mm2: f64,
    /// Whether the limits with the pen down apply.
    pub drawn: bool,
    /// Whether the pen's vertical limits apply.
    pub lifts: bool,
    /// Vertices executed where the piece of the path begins.
    pub vertex: u32,
}
