//! The position loop of a drive in cyclic synchronous position: interpolation, feed-forward, following error.
//!
//! A target that arrives in time is reached at the end of the interpolation period (object 0x60C2), in a straight line
//! from where the interpolation is. When a target is missing, the drive goes on at the last speed for one period and then
//! stands, until the next target or the watchdog of the process data. Where the position counts one motor turn only, every
//! difference is the shorter way round. An encoder that moves faster than any motor stops
//! the drive at once. Objects, and the action on too great a following error: CiA 402.
//!
//! Invariant: whatever the targets are, the demanded position is finite.

/// Window that switches the supervision of the following error off.
const WINDOW_OFF: u32 = u32::MAX;

/// Settings of the position loop, and the interpolation at work.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PositionLoop {
    /// Interpolation period: this number times ten to the power of the index, s; object 0x60C2.
    pub(crate) period_number: u8,
    pub(crate) period_index: i8,
    /// Following error above which the drive trips, increments; object 0x6065.
    pub(crate) window: u32,
    /// How long it may be above, ms; object 0x6066.
    pub(crate) time_out_ms: u16,
    /// Number of positions after which they repeat; `None` if they wrap at 32 bits.
    wrap: Option<i32>,
    at_work: Option<Interpolation>,
    /// Last actual position, increments.
    actual: i32,
    outside_ms: u32,
}

/// An interpolation between two targets; positions are in increments from the place where it began.
#[derive(Clone, Copy, Debug)]
struct Interpolation {
    origin: i32,
    at: f64,
    /// The last target, as received and from the origin.
    target: i32,
    to: f64,
    /// Change in a millisecond.
    rate: f64,
    /// Time for which the rate still holds, ms.
    left_ms: u32,
    /// Whether the rate is a guess, for want of a target.
    extrapolates: bool,
}

/// What the loop asks for in a millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PositionStep {
    /// Demanded less actual position at the beginning of the millisecond, increments.
    pub(crate) error: f64,
    /// Change of the demanded position in the millisecond, increments.
    pub(crate) rate: f64,
}

impl PositionLoop {
    /// A loop with the settings after power-up, for an encoder with this resolution.
    pub(crate) fn new(increments_per_revolution: u32) -> Self {
        Self {
            period_number: 1,
            period_index: -3,
            window: increments_per_revolution / 2,
            time_out_ms: 10,
            wrap: None,
            at_work: None,
            actual: 0,
            outside_ms: 0,
        }
    }

    /// Makes the positions repeat after this many; 0 counts as 1.
    pub(crate) fn wrap_at(&mut self, positions: u32) {
        self.wrap = Some(i32::try_from(positions.max(1)).unwrap_or(i32::MAX));
    }

    /// Ends the interpolation: the drive does not follow targets.
    pub(crate) fn stop(&mut self) {
        self.at_work = None;
        self.outside_ms = 0;
    }

    /// Whether the drive follows targets.
    pub(crate) fn follows(&self) -> bool {
        self.at_work.is_some()
    }

    /// Demanded position, increments; `None` while no target is followed.
    pub(crate) fn demanded(&self) -> Option<i32> {
        let at_work = self.at_work.as_ref()?;
        let demanded = at_work.origin.wrapping_add(at_work.at.round() as i64 as i32);
        Some(self.wrap.map_or(demanded, |wrap| demanded.rem_euclid(wrap)))
    }

    /// Demanded less actual position, increments; 0 while no target is followed.
    pub(crate) fn error(&self, actual: i32) -> i32 {
        self.demanded()
            .map_or(0, |demanded| nearest(demanded.wrapping_sub(actual), self.wrap))
    }

    /// Whether the following error is above its window.
    pub(crate) fn is_outside(&self) -> bool {
        self.outside_ms > 0
    }

    /// Interpolation period in milliseconds; at least 1, because the loop runs every millisecond.
    fn period_ms(&self) -> u32 {
        let seconds = f64::from(self.period_number) * 10f64.powi(self.period_index.into());
        (seconds * 1_000.0).round().max(1.0) as u32
    }

    /// Advances by one millisecond with a new target, or without one. Without one before the first, the present position
    /// is the target. `None` when the encoder moved by more than `moved_max` increments.
    pub(crate) fn step(&mut self, target: Option<i32>, actual: i32, moved_max: f64) -> Option<PositionStep> {
        let period_ms = self.period_ms();
        let wrap = self.wrap;
        let moved = nearest(actual.wrapping_sub(core::mem::replace(&mut self.actual, actual)), wrap);
        if self.at_work.is_some() && f64::from(moved).abs() > moved_max {
            return None;
        }
        let interpolation = self.at_work.get_or_insert(Interpolation {
            origin: actual,
            at: 0.0,
            target: actual,
            to: 0.0,
            rate: 0.0,
            left_ms: 0,
            extrapolates: false,
        });
        interpolation.aim(target, period_ms, wrap);
        let demanded = interpolation
            .origin
            .wrapping_add(interpolation.at.floor() as i64 as i32);
        let error = f64::from(nearest(demanded.wrapping_sub(actual), wrap)) + interpolation.at.rem_euclid(1.0);
        let rate = interpolation.advance();
        self.outside_ms = match self.window != WINDOW_OFF && error.abs() > f64::from(self.window) {
            true => self.outside_ms.saturating_add(1),
            false => 0,
        };
        Some(PositionStep { error, rate })
    }

    /// Whether the following error has been above its window for too long.
    pub(crate) fn has_tripped(&self) -> bool {
        self.outside_ms > self.time_out_ms.into()
    }
}

/// A difference of positions, the shorter way round.
fn nearest(difference: i32, wrap: Option<i32>) -> i32 {
    let Some(wrap) = wrap else { return difference };
    let ahead = difference.rem_euclid(wrap);
    if ahead > wrap / 2 { ahead - wrap } else { ahead }
}

impl Interpolation {
    fn aim(&mut self, target: Option<i32>, period_ms: u32, wrap: Option<i32>) {
        if let Some(target) = target {
            self.to += f64::from(nearest(target.wrapping_sub(self.target), wrap));
            self.target = target;
            self.rate = (self.to - self.at) / f64::from(period_ms);
            self.left_ms = period_ms;
            self.extrapolates = false;
        } else if self.left_ms == 0 && !self.extrapolates {
            self.left_ms = period_ms;
            self.extrapolates = true;
        }
    }

    fn advance(&mut self) -> f64 {
        if self.left_ms == 0 {
            self.rate = 0.0;
            return 0.0;
        }
        self.left_ms -= 1;
        self.at += self.rate;
        self.rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Demanded positions after each step.
    fn followed(position_loop: &mut PositionLoop, targets: &[Option<i32>]) -> Vec<i32> {
        let step = |target: &Option<i32>| {
            position_loop.step(*target, 0, 1e5);
            position_loop.demanded().unwrap_or_default()
        };
        targets.iter().map(step).collect()
    }

    #[test]
    fn a_target_is_reached_at_the_end_of_its_period() {
        let mut position_loop = PositionLoop::new(1 << 20);
        assert_eq!(
            followed(&mut position_loop, &[Some(100), Some(300), Some(300)]),
            [100, 300, 300]
        );
        position_loop.stop();
        (position_loop.period_number, position_loop.period_index) = (4, -3);
        let targets = [Some(400), None, None, None, Some(0), None, None, None];
        assert_eq!(
            followed(&mut position_loop, &targets),
            [100, 200, 300, 400, 300, 200, 100, 0]
        );
        position_loop.stop();
        // 250 us are less than the loop's own cycle.
        (position_loop.period_number, position_loop.period_index) = (250, -6);
        assert_eq!(followed(&mut position_loop, &[Some(400)]), [400]);
    }

    #[test]
    fn a_missing_target_is_extrapolated_for_one_period_and_then_the_drive_stands() {
        let mut position_loop = PositionLoop::new(1 << 20);
        let targets = [Some(100), Some(200), None, Some(400), None, None, None, Some(500)];
        assert_eq!(
            followed(&mut position_loop, &targets),
            [100, 200, 300, 400, 500, 500, 500, 500]
        );
    }

    #[test]
    fn targets_pass_the_end_of_the_range_and_any_targets_stay_finite() {
        let mut position_loop = PositionLoop::new(1 << 20);
        position_loop.step(Some(i32::MAX - 1), i32::MAX - 1, 1e5);
        position_loop.step(Some(i32::MIN + 1), i32::MAX - 1, 1e5);
        assert_eq!(position_loop.demanded(), Some(i32::MIN + 1));
        assert_eq!(position_loop.error(i32::MAX), 2);
        let mut random = Random::new(17);
        for _ in 0..10_000 {
            let target = (random.unit() < 0.7).then(|| (random.unit() * 4.3e9) as i64 as i32);
            let step = position_loop.step(target, (random.unit() * 4.3e9) as i64 as i32, f64::INFINITY);
            let step = step.expect("any motion is allowed");
            assert!(step.error.is_finite() && step.rate.is_finite(), "{step:?}");
        }
    }

    #[test]
    fn positions_that_repeat_are_approached_the_shorter_way() {
        let mut position_loop = PositionLoop::new(1_000);
        position_loop.wrap_at(1_000);
        let mut step = |target, actual| {
            let step = position_loop.step(Some(target), actual, 100.0).expect("no jump");
            (step.error, step.rate, position_loop.demanded())
        };
        assert_eq!(step(990, 990), (0.0, 0.0, Some(990)));
        assert_eq!(step(10, 995), (-5.0, 20.0, Some(10)));
        assert_eq!(step(10, 5), (5.0, 0.0, Some(10)));
        assert_eq!(step(980, 10), (0.0, -30.0, Some(980)));
        // A target outside the range is the one inside it.
        assert_eq!(step(1_970, 980), (0.0, -10.0, Some(970)));
    }

    #[test]
    fn an_encoder_that_jumps_is_not_followed_and_one_that_moved_before_is() {
        let mut position_loop = PositionLoop::new(1 << 20);
        assert!(position_loop.step(Some(5_000), 5_000, 100.0).is_some());
        assert!(position_loop.step(Some(5_000), 5_100, 100.0).is_some());
        assert_eq!(position_loop.step(Some(5_000), 4_999, 100.0), None);
    }

    #[test]
    fn a_following_error_above_the_window_trips_after_its_time_and_can_be_switched_off() {
        let mut position_loop = PositionLoop::new(1 << 20);
        (position_loop.window, position_loop.time_out_ms) = (50, 3);
        let mut tripped_after = |window: u32| {
            position_loop.stop();
            position_loop.window = window;
            position_loop.step(Some(0), 0, 1e5);
            (1..20).find(|_| {
                position_loop.step(Some(100), 0, 1e5);
                position_loop.has_tripped()
            })
        };
        // The first step moves the demand, the second one sees the error.
        assert_eq!(tripped_after(50), Some(5));
        assert_eq!(tripped_after(100), None);
        assert_eq!(tripped_after(WINDOW_OFF), None);
    }
}
