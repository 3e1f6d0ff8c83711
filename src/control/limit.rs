//! Limits that cannot panic.

/// `value` limited to between `-limit` and `limit`; a NaN stays NaN. Unlike `clamp` it cannot panic.
pub(super) fn limited<T: PartialOrd + core::ops::Neg<Output = T> + Copy>(value: T, limit: T) -> T {
    if value > limit {
        limit
    } else if value < -limit {
        -limit
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::limited;

    #[test]
    fn a_value_is_limited_both_ways_and_no_number_stays_none() {
        assert_eq!(
            [-3.0, -1.0, 0.5, 3.0].map(|value| limited(value, 2.0)),
            [-2.0, -1.0, 0.5, 2.0]
        );
        assert!(limited(f64::NAN, 2.0).is_nan());
        assert_eq!(limited(1.0, f64::NAN), 1.0);
    }
}
