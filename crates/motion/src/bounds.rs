//! Bounds of values in settings.

/// A value and its bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bound {
    /// Name of the value as configuration files write it.
    pub name: &'static str,
    /// The value.
    pub value: f64,
    /// The lowest value allowed.
    pub low: f64,
    /// The highest value allowed.
    pub high: f64,
}

/// A row of a table of bounds.
#[must_use]
pub const fn bound(name: &'static str, value: f64, low: f64, high: f64) -> Bound {
    Bound { name, value, low, high }
}

/// A value that is not finite or outside its bounds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Violation {
    /// Row of the table, from 0.
    pub row: u8,
    /// The value and its bounds.
    pub bound: Bound,
}

/// Finds the first row whose value is not finite or outside its bounds.
///
/// # Errors
/// That row.
pub fn first_violation(rows: &[Bound]) -> Result<(), Violation> {
    let within = |bound: &Bound| bound.value.is_finite() && bound.value >= bound.low && bound.value <= bound.high;
    match (0_u8..).zip(rows).find(|(_, bound)| !within(bound)) {
        Some((row, bound)) => Err(Violation { row, bound: *bound }),
        None => Ok(()),
    }
}
