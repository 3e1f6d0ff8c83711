//! Plausibility of the position feedback of an axis in torque mode: torque and setpoints against measured motion.
//!
//! In torque mode the firmware closes the velocity loop, so a wrong feedback makes a joint run away with the square of
//! time and faster. Four comparisons, each quick where the others are slow:
//!
//! - **Observer.** A disturbance observer with a triple pole at `OBSERVER_PER_S` predicts the position from torque and
//!   inertia; the load is part of its state. An acceleration `d` that is not in the model causes a position error of
//!   `s / (s + w)^3 d`. The impulse response `(t - w t^2 / 2) e^(-w t)` never exceeds `t e^(-0.86 w t)`, so a filter
//!   with a double pole at `0.86 w` turns a bound of `|d|` into a bound of the error: the *unrest*. The bound of `|d|`
//!   is proportional to what the setpoints demand now, not to the most that they may demand.
//! - **Sudden.** The motion of two milliseconds may differ from that of the two before only by what the motor can do,
//!   or by one position that is repeated or skipped.
//! - **Stuck.** While the setpoint moves, the position must follow in the same direction.
//! - **Torque against a position at rest.** The load is the torque minus the part that accelerates the axis as its
//!   setpoint demands. While the position is at rest, the load may change only by friction, by the changing weight, and
//!   by the *doubt*: what inertia, coupling and speed may add to the load without being in the model. The load is
//!   compared with the load at the moment at which the position came to rest. Both loads are in doubt, so both doubts
//!   count.
//!
//! Sources of the figures: those derived in a constant's comment follow from the axis's inertia, gains, delays and 0.3
//! N m of dry friction, and from the mass matrix and the weight of the virtual robot over a paper of 320 mm; the other
//! shares were found by trial on that cell. The shares of *observer*, *sudden* and *stuck* were chosen with seeds 0 to
//! 7 of `tests/reactions/feedback_scan.rs`; the load's with seeds 0 to 5 of its sound motions, 1 to 20 of its frozen,
//! reversed and exchanged feedback, and 0 to 4 of `feedback_soak.rs`.
//!
//! Measured with other seeds: 400 to 513, 700 to 725 and 730 to 770 of `feedback_soak.rs`, 30 robot hours, used at most
//! 0.75 of any limit. With a smaller `ENABLED_SHARE`, seeds 200 to 205, one robot hour, used at most 0.66 of *pushed*
//! and 0.90 of *stuck* (seed 203, 0.1 s after enabling), and sound motions of seeds 100 to 104 of the scan at most 0.72
//! of any limit.
//!
//! Invariants: bounded work; all values stay finite; what the setpoints demand comes from the plan, never from the
//! axis's own feedback.

use super::limit::limited;
use crate::config::Axis;
use crate::robots::AXES;

/// Poles of the observer, 1/s and per millisecond.
const OBSERVER_PER_S: f32 = 30.0;
const OBSERVER_PER_MS: f32 = OBSERVER_PER_S / 1_000.0;
/// Poles of the filter that bounds the observer's error, per millisecond.
const BOUND_PER_MS: f32 = 0.86 * OBSERVER_PER_MS;
/// Acceleration that the model lacks for one of the axis's own setpoint: the inertia may be wrong by this share.
const OWN_SHARE: f32 = 0.3;
/// Acceleration that the model lacks for one of the other axes' setpoints: coupling.
const OTHERS_SHARE: f32 = 0.2;
/// Acceleration that the model lacks for a speed of 1 rad/s, rad/s2: the weight changes with the pose.
const WEIGHT_PER_S: f32 = 0.4;
/// Load that is not known when a drive takes its power, rad/s2: 9 N m at 0.3 kg m2 that the opening brake leaves to the
/// motor.
const ENABLING_RAD_S2: f32 = 30.0;
/// Speed that represents [`ENABLING_RAD_S2`] in the observer's bound, rad a millisecond.
const ENABLING_RAD: f32 = 2.0e-3;

/// Change of the speed in two milliseconds that is never sudden, rad/s2, and the part of the setpoints' greatest
/// acceleration that adds to it.
const SUDDEN_RAD_S2: f32 = 125.0;
const SUDDEN_SHARE: f32 = 0.75;

/// Motion within which a position counts as at rest, rad.
const AT_REST_RAD: f32 = 2.0e-4;
/// Motion of the setpoint beyond which a position that moves the other way counts as not following, rad.
const LED_RAD: f32 = 0.5 * AT_REST_RAD;
/// How far the setpoint may move while the position is at rest, in addition to what follows from the controllers, as a
/// part of the deviation limit.
const STUCK_LIMIT_SHARE: f32 = 0.15;
/// Share of the greatest acceleration of any setpoint that the feed-forward may lack: inertia and coupling.
const LACKING_SHARE: f64 = 0.55;
/// Weight of [`ENABLING_RAD_S2`] for an axis at rest: it has sunk, returns against its setpoint, and then moves with
/// it.
const ENABLED_SHARE: f32 = 3.0;
/// Upper limit of what follows from accelerations, in deviation limits: above 1 m/s a frozen feedback has to be
/// detected soon.
const STUCK_MOST_SHARE: f32 = 1.25;
/// Torque that friction may take up while the position is at rest, as an acceleration, rad/s2: 0.6 N m at 0.3 kg m2,
/// the dry friction of 0.3 N m from one direction to the other, is four fifths of it.
const FRICTION_RAD_S2: f32 = 2.5;
/// Doubt of the load as a share of the axis's own acceleration: the inertia at the joint is 0.28 to 0.38 kg m2 where
/// the feed-forward has 0.3.
const INERTIA_SHARE: f32 = 0.3;
/// Doubt of the load as a share of the other axes' accelerations: an element of the mass matrix off the diagonal is at
/// most 0.13 kg m2, of 0.3.
const COUPLING_SHARE: f32 = 0.44;
/// Doubt of the load for the square of the greatest speed: the platform's path is curved even at constant joint speeds,
/// which puts at most 0.27 N m at 1 rad/s on an axis at rest, of 0.3 kg m2. Half of that: the curvature does not change
/// sign with the direction, and the doubt counts now and at the mark.
const BENT_SHARE: f32 = 0.45;
/// Change of the load for each radian that any axis moves, 1/s2: the weight on an axis at rest, at most 2.5 N m/rad, of
/// 0.3 kg m2.
const LOAD_PER_RAD_S2: f32 = 9.0;
/// Share of a new torque in the one that is compared with a position at rest: the mean of 16 ms.
const TORQUE_SHARE: f32 = 1.0 / 16.0;
/// Share by which the load of a position at rest is learned in each millisecond while no setpoint moves: 20 ms.
const REST_SHARE: f32 = 0.05;
/// Share of a past speed that remains after a millisecond: the motion lags behind the setpoint.
const HELD_SHARE: f32 = 0.95;

/// Length of a step, s.
const STEP_S: f64 = 1.0e-3;
const STEP_S2: f32 = (STEP_S * STEP_S) as f32;
/// Replaces an inertia of 0, which switches the torque feed-forward off.
const INERTIA_MIN_KG_M2: f64 = 1.0e-3;

/// What the setpoints demand in this millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Demanded {
    /// Speed of the axis's own setpoint, rad/s.
    pub own_rad_s: f32,
    /// Acceleration of the axis's own setpoint, rad/s2.
    pub own_rad_s2: f32,
    /// Accelerations of the other axes' setpoints, rad/s2: the sum of their amounts.
    pub others_rad_s2: f32,
    /// Greatest speed of any axis's setpoint, rad/s.
    pub greatest_rad_s: f32,
    /// Greatest acceleration of any axis's setpoint, rad/s2.
    pub greatest_rad_s2: f32,
}

impl Demanded {
    /// What the setpoints demand of each axis, from the velocities of this millisecond and of the next, rad/s.
    pub fn between([now, next]: [&[f64; AXES]; 2]) -> [Self; AXES] {
        let mut demanded = [Self::default(); AXES];
        let (mut sum_rad_s2, mut most_rad_s2, mut most_rad_s) = (0.0_f32, 0.0_f32, 0.0_f32);
        for (axis, (now, next)) in demanded.iter_mut().zip(now.iter().zip(next)) {
            axis.own_rad_s = *now as f32;
            axis.own_rad_s2 = ((next - now) / STEP_S) as f32;
            sum_rad_s2 += axis.own_rad_s2.abs();
            most_rad_s2 = most_rad_s2.max(axis.own_rad_s2.abs());
            most_rad_s = most_rad_s.max(axis.own_rad_s.abs());
        }
        for axis in &mut demanded {
            axis.others_rad_s2 = sum_rad_s2 - axis.own_rad_s2.abs();
            (axis.greatest_rad_s, axis.greatest_rad_s2) = (most_rad_s, most_rad_s2);
        }
        demanded
    }
}

/// A value with its limit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Margin {
    value: f32,
    limit: f32,
}

impl Margin {
    const NONE: Self = Self { value: 0.0, limit: 1.0 };

    #[inline]
    fn is_kept(self) -> bool {
        self.value <= self.limit
    }
}

/// How far a sound axis stays behind its setpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Following {
    /// In any case, rad.
    base_rad: f32,
    /// For each rad/s of the setpoint: the delays, s.
    per_rad_s: f32,
    /// For each rad/s2 of the setpoints, s2.
    per_rad_s2: f32,
    /// Upper limit of the part that follows from accelerations, rad.
    most_rad: f32,
    /// Share of a past acceleration that remains after a millisecond.
    kept: f32,
    /// Share by which a doubt approaches a smaller one in a millisecond: the torque settles with the slower of the
    /// poles i and f.
    settling: f32,
}

impl Following {
    /// The lag that an axis's controllers leave. With k the velocity controller's gain for the inertia, i its integral
    ///  gain and f the position controller's gain, a load of the acceleration d causes a following error of d / (s^3 +
    ///  k s^2 + k (i + f) s + k i f). At first the integral does nothing: the error is d / (k (i + f)) at most; then it
    ///  decays with i f / (i + f). From an error on one side to one on the other, the setpoint moves by twice that
    ///  while the position is at rest.
    fn of(axis: &Axis, inertia_kg_m2: f64) -> Self {
        let stiffness_per_s = (axis.velocity_gain_nm_s / inertia_kg_m2).max(1.0);
        let (integral, gain) = (axis.velocity_integral_per_s, axis.feedback_gain_per_s);
        let both = (integral + gain).max(1.0);
        Self {
            base_rad: STUCK_LIMIT_SHARE * axis.feedback_deviation_max_rad as f32,
            most_rad: STUCK_MOST_SHARE * axis.feedback_deviation_max_rad as f32,
            per_rad_s: ((axis.torque_lead_ms + axis.measurement_age_ms + 0.5) * STEP_S) as f32,
            per_rad_s2: (2.0 * LACKING_SHARE / (stiffness_per_s * both)) as f32,
            kept: (1.0 - integral * gain / both * STEP_S).clamp(0.0, 1.0) as f32,
            settling: (integral.min(gain) * STEP_S).clamp(0.0, 1.0) as f32,
        }
    }
}

/// Prediction from a torque command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TorqueModel {
    /// Change of speed in a millisecond, rad a millisecond, for a digit, times the share of a new command.
    rad_per_digit: f32,
    /// Share of the filtered command that stays.
    kept: f32,
    following: Following,
    demanded: Demanded,
    /// Fading peak of the demanded speed, rad/s, and of the demanded acceleration, rad/s2.
    held_rad_s: f32,
    lasting_rad_s2: f32,
    /// Filtered command, change of speed in a millisecond.
    push_rad: f32,
    /// Speed, rad a millisecond.
    speed_rad: f32,
    /// Change of speed in a millisecond by the load.
    load_rad: f32,
    /// The bound of the observer's error: its speed, rad a millisecond, and itself, rad.
    unrest_speed_rad: f32,
    unrest_rad: f32,
    /// Motion measured in the last milliseconds, the newest first, rad.
    recent_rad: [f32; 3],
    /// Since the position last left its place: motion of the setpoint, of the position, and the longest path of any
    /// axis, rad.
    setpoint_rad: f32,
    position_rad: f32,
    way_rad: f32,
    /// Mean load, and mean load when the position last left its place; changes of speed in a millisecond.
    mean_load_rad: f32,
    mark_load_rad: f32,
    /// Doubt of each of the two loads.
    doubt_rad: f32,
    mark_doubt_rad: f32,
    sudden: Margin,
    stuck: Margin,
    pushed: Margin,
}

impl TorqueModel {
    /// A model of an axis whose drive takes `digits_per_unit` for an N m at the joint.
    pub(super) fn new(axis: &Axis, digits_per_unit: f64) -> Self {
        let delay_ms = axis.torque_lead_ms + axis.measurement_age_ms - 0.5;
        let share = 1.0 / (1.0 + delay_ms.max(0.0));
        let inertia_kg_m2 = axis.inertia_kg_m2.max(INERTIA_MIN_KG_M2);
        let rad_per_digit = (share * STEP_S * STEP_S / (digits_per_unit * inertia_kg_m2)) as f32;
        Self::at_rest(rad_per_digit, (1.0 - share) as f32, Following::of(axis, inertia_kg_m2))
    }

    /// A model without commands and measurements.
    fn at_rest(rad_per_digit: f32, kept: f32, following: Following) -> Self {
        Self {
            rad_per_digit,
            kept,
            following,
            demanded: Demanded::default(),
            held_rad_s: 0.0,
            lasting_rad_s2: ENABLED_SHARE * ENABLING_RAD_S2,
            push_rad: 0.0,
            speed_rad: 0.0,
            load_rad: 0.0,
            unrest_speed_rad: ENABLING_RAD,
            unrest_rad: 0.0,
            recent_rad: [0.0; 3],
            setpoint_rad: 0.0,
            position_rad: 0.0,
            way_rad: 0.0,
            mean_load_rad: 0.0,
            mark_load_rad: 0.0,
            doubt_rad: ENABLING_RAD_S2 * STEP_S2,
            mark_doubt_rad: ENABLING_RAD_S2 * STEP_S2,
            sudden: Margin::NONE,
            stuck: Margin::NONE,
            pushed: Margin::NONE,
        }
    }

    /// Discards all commands and measurements.
    pub(super) fn reset(&mut self) {
        *self = Self::at_rest(self.rad_per_digit, self.kept, self.following);
    }

    /// Sets what the setpoints demand from now on.
    pub(super) fn set_demanded(&mut self, demanded: &Demanded) {
        self.demanded = *demanded;
    }

    /// Speed that the model expects, rad a millisecond.
    #[inline]
    pub(super) fn speed_rad(&self) -> f32 {
        self.speed_rad.abs()
    }

    /// Bound of the observer's error that differences between model and robot cause, rad.
    #[inline]
    pub(super) fn unrest_rad(&self) -> f32 {
        self.unrest_rad
    }

    /// Advances the model by one millisecond under this command; returns the motion.
    #[inline]
    pub(super) fn expect(&mut self, sent_digits: f32) -> f32 {
        let demanded = &self.demanded;
        let own_rad_s2 = demanded.own_rad_s2.abs();
        let bound_rad_s2 =
            OWN_SHARE * own_rad_s2 + OTHERS_SHARE * demanded.others_rad_s2 + WEIGHT_PER_S * demanded.greatest_rad_s;
        self.unrest_speed_rad += bound_rad_s2 * STEP_S2 - self.unrest_speed_rad * BOUND_PER_MS;
        self.unrest_rad += self.unrest_speed_rad - self.unrest_rad * BOUND_PER_MS;
        self.held_rad_s = greater(demanded.own_rad_s.abs(), self.held_rad_s * HELD_SHARE);
        self.lasting_rad_s2 = greater(demanded.greatest_rad_s2, self.lasting_rad_s2 * self.following.kept);
        self.setpoint_rad += demanded.own_rad_s * STEP_S as f32;
        self.way_rad += demanded.greatest_rad_s * STEP_S as f32;
        self.push_rad = self.push_rad * self.kept + sent_digits * self.rad_per_digit;
        let load_rad = self.push_rad - demanded.own_rad_s2 * STEP_S2;
        self.mean_load_rad += (load_rad - self.mean_load_rad) * TORQUE_SHARE;
        let doubt_rad_s2 = INERTIA_SHARE * own_rad_s2
            + COUPLING_SHARE * demanded.others_rad_s2
            + BENT_SHARE * demanded.greatest_rad_s * demanded.greatest_rad_s;
        let more_rad = doubt_rad_s2 * STEP_S2 - self.doubt_rad;
        let share = if more_rad > 0.0 {
            TORQUE_SHARE
        } else {
            self.following.settling
        };
        self.doubt_rad += more_rad * share;
        self.speed_rad += self.push_rad + self.load_rad;
        self.speed_rad
    }

    /// Corrects the model by the observer's error; returns the remaining error.
    #[inline]
    pub(super) fn correct(&mut self, deviation_rad: f32) -> f32 {
        self.speed_rad -= 3.0 * OBSERVER_PER_MS * OBSERVER_PER_MS * deviation_rad;
        self.load_rad -= OBSERVER_PER_MS * OBSERVER_PER_MS * OBSERVER_PER_MS * deviation_rad;
        deviation_rad - 3.0 * OBSERVER_PER_MS * deviation_rad
    }

    /// Takes the motion of a millisecond, rad. Returns whether it agrees with the previous motion, the setpoints and
    /// the torque.
    #[inline]
    pub(super) fn follows(&mut self, moved_rad: f32) -> bool {
        self.look_for_sudden(moved_rad);
        self.look_for_stuck(moved_rad);
        self.sudden.is_kept() & self.stuck.is_kept() & self.pushed.is_kept()
    }

    /// The first comparison that failed: its value, and its limit.
    #[cold]
    pub(super) fn broken(&self) -> Option<[f32; 2]> {
        let all = [self.sudden, self.stuck, self.pushed];
        let broken = all.iter().find(|margin| !margin.is_kept());
        broken.map(|margin| [margin.value, margin.limit])
    }

    /// Values of sudden, stuck and pushed, relative to their limits.
    pub(super) fn used(&self) -> [f32; 3] {
        [self.sudden, self.stuck, self.pushed].map(|margin| margin.value / margin.limit)
    }

    /// Compares the motion of two milliseconds with that of the two before. One position may be repeated or skipped.
    #[inline]
    fn look_for_sudden(&mut self, moved_rad: f32) {
        let [newest, before, oldest] = self.recent_rad;
        self.recent_rad = [moved_rad, newest, before];
        let [low, high] = match before < oldest {
            true => [before, oldest],
            false => [oldest, before],
        };
        let least = if low > 0.0 { low } else { 3.0 * low };
        let most = if high > 0.0 { 3.0 * high } else { high };
        let sum = moved_rad + newest;
        self.sudden = Margin {
            value: greater(least - sum, sum - most),
            limit: 4.0 * STEP_S2 * (SUDDEN_RAD_S2 + SUDDEN_SHARE * self.demanded.greatest_rad_s2),
        };
    }

    /// Compares setpoint and torque with a position that has stayed at its place.
    #[inline]
    fn look_for_stuck(&mut self, moved_rad: f32) {
        self.position_rad += moved_rad;
        let is_left = self.position_rad.abs() > AT_REST_RAD;
        let is_led = self.setpoint_rad.abs() > LED_RAD;
        let against = self.position_rad * self.setpoint_rad < 0.0;
        if is_left & is_led & against {
            // A return counts as following.
            self.position_rad = limited(self.position_rad, AT_REST_RAD);
        } else if is_left {
            (self.setpoint_rad, self.position_rad, self.way_rad) = (0.0, 0.0, 0.0);
            (self.mark_load_rad, self.mark_doubt_rad) = (self.mean_load_rad, self.doubt_rad);
        }
        if self.demanded.greatest_rad_s == 0.0 {
            self.mark_load_rad += (self.mean_load_rad - self.mark_load_rad) * REST_SHARE;
            self.mark_doubt_rad += (self.doubt_rad - self.mark_doubt_rad) * REST_SHARE;
        }
        let following = &self.following;
        let lasting_rad = limited(following.per_rad_s2 * self.lasting_rad_s2, following.most_rad);
        self.stuck = Margin {
            // While the setpoint rests, the position controller corrects the remaining error.
            value: if self.demanded.own_rad_s == 0.0 {
                0.0
            } else {
                self.setpoint_rad.abs()
            },
            limit: following.base_rad + following.per_rad_s * self.held_rad_s + lasting_rad,
        };
        let explained_rad_s2 = FRICTION_RAD_S2 + LOAD_PER_RAD_S2 * self.way_rad;
        self.pushed = Margin {
            value: (self.mean_load_rad - self.mark_load_rad).abs(),
            limit: explained_rad_s2 * STEP_S2 + self.doubt_rad + self.mark_doubt_rad,
        };
    }
}

#[inline]
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests;
