//! Motion on one interval of the grid, divided into stretches of constant acceleration.
//!
//! Invariant: a stretch begins at the present speed and keeps the interval's limits, and the motion can continue from
//! its end as planned, or slower.

use super::grid::ARRIVED_MM;
use super::micro_interpolator::Stretch;
use super::scan::Interval;

/// Longest duration of one choice of acceleration, s.
pub(super) const STRETCH_MAX_S: f64 = 0.12;
/// Part of the squared speed that an interval allows in its middle. Where both ends are slower than this, the motion
/// accelerates to the middle first: a constant acceleration from end to end would take more than five times as long,
/// and would never finish from rest to rest.
const SLOW_PART: f64 = 0.01;

/// Lowest and highest acceleration from a squared speed. The present acceleration was chosen for the whole interval and
/// stays allowed: where the limits are used up, rounding could leave an empty range.
fn allowed(interval: &Interval<'_>, x: f64, under_way: Option<f64>) -> (f64, f64) {
    let range = interval.range(x);
    let planned = (interval.end_squared - x) / (2.0 * interval.length_mm);
    match under_way.map(|acceleration| acceleration.min(planned)) {
        Some(kept) => (range.low.min(kept), range.high.max(kept)),
        None => (range.low, range.high),
    }
}

/// The stretch that decelerates from a squared speed as the limits allow, to rest if the interval is long enough.
pub(super) fn braking(interval: &Interval<'_>, offset_mm: f64, x: f64, under_way: Option<f64>) -> Stretch {
    let braking = interval.braking(x);
    if x + 2.0 * interval.length_mm * braking <= 0.0 {
        Stretch::new(offset_mm, -x / (2.0 * braking), x, 0.0)
    } else {
        let (low, high) = allowed(interval, x, under_way);
        Stretch::to(offset_mm, interval.length_mm, x, low.min(high))
    }
}

/// The stretch to the end of the interval, with `part` of the squared speed that is planned there.
pub(super) fn going(interval: &Interval<'_>, offset_mm: f64, x: f64, part: f64, under_way: Option<f64>) -> Stretch {
    let (low, high) = allowed(interval, x, under_way);
    let target_squared = part * interval.end_squared;
    let acceleration = |end_squared: f64| (end_squared - x) / (2.0 * interval.length_mm);
    let target = acceleration(target_squared);
    // A speed below the planned one is reached as fast as the limits allow; the planned one is always reached.
    let lowest = low.min(acceleration(interval.end_squared));
    let even = if target >= lowest && target <= high {
        Stretch::new(offset_mm, interval.length_mm, x, target_squared)
    } else {
        Stretch::to(offset_mm, interval.length_mm, x, target.max(lowest).min(high))
    };
    if even.duration_s() <= STRETCH_MAX_S {
        return even;
    }
    soon(interval, offset_mm, x, target_squared).unwrap_or(even)
}

/// The stretch that changes to a squared speed as fast as the limits allow, after which the speed is kept to the end of
/// the interval. `None` if the change needs the whole interval, or if the fourth axis turns, because its slope changes
/// from end to end.
fn soon(interval: &Interval<'_>, offset_mm: f64, x: f64, target_squared: f64) -> Option<Stretch> {
    if interval.turns() {
        return None;
    }
    let acceleration = if target_squared < x {
        interval.braking(x)
    } else {
        let keeping = interval.range(target_squared);
        if keeping.low > 0.0 || keeping.high < 0.0 {
            return None;
        }
        let free = Interval {
            end_squared: f64::MAX,
            ..*interval
        };
        free.range(x).high
    };
    let length_mm = (target_squared - x) / (2.0 * acceleration);
    let within = length_mm > ARRIVED_MM && length_mm < interval.length_mm;
    within.then(|| Stretch::new(offset_mm, length_mm, x, target_squared))
}

/// The stretch to the middle of an interval whose ends are passed at rest or nearly so; otherwise `None`.
pub(super) fn over_the_middle(interval: &Interval<'_>, offset_mm: f64, x: f64, cap: f64) -> Option<Stretch> {
    let (length_mm, end_squared) = (interval.length_mm, interval.end_squared);
    // Most intervals lead to a speed that only the whole interval can reach.
    if x.max(end_squared) > SLOW_PART * length_mm * interval.limits.acceleration {
        return None;
    }
    let half_mm = 0.5 * length_mm;
    let acceleration = acceleration_to_middle(interval, half_mm, x).min(cap / length_mm);
    let slow = x.max(end_squared) <= SLOW_PART * length_mm * acceleration;
    // The second half loses the speed gained in the first half, and the speed at the beginning.
    slow.then(|| Stretch::to(offset_mm, half_mm, x, acceleration - x / length_mm))
}

/// Acceleration towards the middle of an interval that ends at rest or nearly so: allowed in both directions.
fn acceleration_to_middle(interval: &Interval<'_>, half_mm: f64, x: f64) -> f64 {
    let range = Interval {
        length_mm: half_mm,
        end_squared: f64::MAX,
        ..*interval
    }
    .range(x);
    let braking = -interval.braking(x);
    // In the middle the fourth axis's slope and its change add up to less than three times the larger slope.
    let slope = interval.start.turn.abs().max(interval.end.turn.abs());
    let turning = if slope > 0.0 {
        interval.limits.turn_acceleration / (3.0 * slope)
    } else {
        f64::MAX
    };
    range.high.min(braking).min(turning)
}
