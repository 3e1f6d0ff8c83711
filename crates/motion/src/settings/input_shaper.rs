//! Input shaping: setpoints that do not make a resonance of the mechanics ring.
//!
//! The setpoints are summed with delayed copies of themselves, half a damped period apart. Two leave no vibration of that
//! frequency behind (ZV, zero vibration; Smith 1957), three almost none of the neighbouring ones either (ZVD, zero vibration
//! and derivative; Singer and Seering 1990).
//!
//! A sum of copies lies inside of a curve by half of the copies' variance times the acceleration. A resonant tool swings
//! outward by the acceleration over the square of its angular frequency w. What is left at the tool is 0.234 times the
//! acceleration over w^2 with ZV, which keeps it, and 1.467 times with ZVD, which takes it off beforehand: each place gives way
//! to its second difference over the distance of the copies. There are five copies then, the outer two negative, so speeds and
//! accelerations grow by 15 % at most, and the planner plans with so much less. The height keeps its three: it would
//! pass the paper otherwise, and turn round there. All have the same mean delay.
//!
//! The pen rests on the paper until all copies have come, or dots and the ends of strokes would be drawn above it.

use super::{InputShaper, MotionLimits, TICK_S};
use core::f64::consts::{PI, TAU};

/// Lowest and highest frequency of a resonance, Hz.
pub const RESONANCE_HZ: [f64; 2] = [20.0, 200.0];
/// Highest damping ratio of a resonance.
pub(crate) const DAMPING_MAX: f64 = 0.2;
/// Most copies of the setpoints.
pub(crate) const COPIES: usize = 5;
/// Half of the variance that a copy has which is split between two milliseconds, s2, at most.
const SPLIT_S2: f64 = 1.0e-6 / 8.0;
/// What the second difference leaves of what it takes off where it comes and goes quicker than the copies, say on a wave of the
/// resonance's own frequency: the integral of the magnitude of the tool's answer to its planned acceleration, which is 1.14
/// over w^2, as a part of 1.467.
const LEFT_OF_COMPENSATED: f64 = 0.78;

/// The copies: weights with the sum 1, evenly apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Copies {
    pub(crate) weights: [f64; COPIES],
    /// Weights of the copies of the height and of the fourth axis, which nothing is taken off.
    pub(crate) plain: [f64; COPIES],
    pub(crate) apart_s: f64,
    /// Part of the second difference over `apart_s` that is taken off beforehand.
    taken_off: f64,
    /// Half of the variance of the copies without what is taken off, s2.
    inside_s2: f64,
    /// What the copies and the resonance leave of it at the tool, s2.
    left_s2: f64,
}

impl Copies {
    /// The copies for the limits; `None` without a shaper.
    pub(crate) fn new(motion: &MotionLimits) -> Option<Self> {
        let damping = motion.resonance_damping.clamp(0.0, DAMPING_MAX);
        let hz = motion.resonance_hz.clamp(RESONANCE_HZ[0], RESONANCE_HZ[1]);
        let root = libm::sqrt(1.0 - damping * damping);
        // How far the vibration decays in half a damped period.
        let decay = libm::exp(-PI * damping / root);
        let [first, second, third] = match motion.input_shaper {
            InputShaper::None => return None,
            InputShaper::Zv => [1.0, decay, 0.0],
            InputShaper::Zvd => [1.0, 2.0 * decay, decay * decay],
        };
        let sum = first + second + third;
        let apart_s = 0.5 / (hz * root);
        let weights = [first / sum, second / sum, third / sum, 0.0, 0.0];
        let inside_s2 = 0.5 * variance(&weights) * apart_s * apart_s;
        let rate = TAU * hz;
        // A damped oscillator gives back a little less than 1 / w^2.
        let left_s2 = inside_s2 - (1.0 - 2.0 * damping * damping) / (rate * rate);
        let plain = Self {
            weights,
            plain: weights,
            apart_s,
            taken_off: 0.0,
            inside_s2,
            left_s2,
        };
        if motion.input_shaper == InputShaper::Zv {
            return Some(plain);
        }
        Some(Self {
            left_s2: LEFT_OF_COMPENSATED * left_s2,
            ..plain.compensated(left_s2 / (apart_s * apart_s))
        })
    }

    /// The copies of p - c p'', with p'' as the second difference over their distance: later by this distance.
    fn compensated(&self, taken_off: f64) -> Self {
        let mut weights = [0.0; COPIES];
        for (at, weight) in self.weights.iter().enumerate() {
            for (later, part) in [-taken_off, 1.0 + 2.0 * taken_off, -taken_off].into_iter().enumerate() {
                if let Some(sum) = weights.get_mut(at + later) {
                    *sum += weight * part;
                }
            }
        }
        let [first, second, third, ..] = self.plain;
        Self {
            weights,
            plain: [0.0, first, second, third, 0.0],
            taken_off,
            ..*self
        }
    }

    /// Time from the first copy to the last one, s.
    pub(crate) fn length_s(&self) -> f64 {
        let last = self.weights.iter().rposition(|weight| *weight != 0.0);
        self.apart_s * last.unwrap_or_default() as f64
    }

    /// Mean delay of the copies, s.
    pub(crate) fn mean_s(&self) -> f64 {
        self.apart_s * mean(&self.weights)
    }

    /// Bound on how far the tool may be from its place with this acceleration, mm/s2, if the resonance is as it is stated, mm.
    pub(crate) fn at_tool_mm(&self, acceleration: f64) -> f64 {
        (self.left_s2 + SPLIT_S2) * acceleration
    }

    /// Lowest frequency at which [`Self::at_tool_mm`] is at most this for the limits, Hz: the lower it is, the farther apart are
    /// the copies.
    pub(crate) fn lowest_hz(motion: &MotionLimits, at_tool_mm: f64) -> f64 {
        let [lowest_hz, highest_hz] = RESONANCE_HZ;
        let highest = MotionLimits {
            resonance_hz: highest_hz,
            ..*motion
        };
        let acceleration = motion.acceleration_mm_s2;
        Self::new(&highest).map_or(lowest_hz, |copies| {
            let room_mm = (at_tool_mm - SPLIT_S2 * acceleration).max(0.0);
            (highest_hz * libm::sqrt(copies.left_s2 * acceleration / room_mm)).max(lowest_hz)
        })
    }

    /// Bound on how far the setpoints themselves may be from their places with this acceleration, mm/s2, mm.
    pub(crate) fn at_setpoints_mm(&self, acceleration: f64) -> f64 {
        (self.inside_s2 + self.taken_off * self.apart_s * self.apart_s) * acceleration
    }

    /// The acceleration to plan with for setpoints that keep this one.
    pub(crate) fn planned_acceleration(&self, acceleration: f64) -> f64 {
        acceleration / self.growth()
    }

    /// The speed to plan with for setpoints that keep this one, if what is planned keeps the acceleration: the second
    /// difference of the speed is at most twice what the acceleration brings over the distance of the copies.
    pub(crate) fn planned_speed(&self, speed: f64, acceleration: f64) -> f64 {
        let by_ramps = speed - 2.0 * self.taken_off * self.apart_s * acceleration;
        by_ramps.max(speed / self.growth())
    }

    /// By how much a value grows at most.
    fn growth(&self) -> f64 {
        self.weights.iter().map(|weight| weight.abs()).sum()
    }
}

/// Rest until all copies have come, ms; 0 without an input shaper.
pub(crate) fn shaper_rest_ms(motion: &MotionLimits) -> u16 {
    Copies::new(motion).map_or(0, |copies| (copies.length_s() / TICK_S) as u16 + 2)
}

/// Time at rest where the pen meets the paper and where it leaves it, s: the configured one, at least that of all copies.
pub(crate) fn pen_dwell_s(motion: &MotionLimits) -> f64 {
    let copies_s = f64::from(shaper_rest_ms(motion)) * TICK_S;
    copies_s.max(f64::from(motion.pen_dwell_ms) * TICK_S)
}

fn mean(weights: &[f64; COPIES]) -> f64 {
    weights
        .iter()
        .zip(0_u8..)
        .map(|(weight, at)| weight * f64::from(at))
        .sum()
}

/// Variance of the copies, in squares of their distance.
fn variance(weights: &[f64; COPIES]) -> f64 {
    let mean = mean(weights);
    let squares = weights.iter().zip(0_u8..).map(|(weight, at)| {
        let off = f64::from(at) - mean;
        weight * off * off
    });
    squares.sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn copies(input_shaper: InputShaper, resonance_hz: f64, resonance_damping: f64) -> Copies {
        let motion = MotionLimits {
            input_shaper,
            resonance_hz,
            resonance_damping,
            ..MotionLimits::default()
        };
        Copies::new(&motion).expect("a shaper")
    }

    /// What is left of a vibration of this frequency after a blow that the weights divide, as a part of the whole: the length of
    /// the sum of their phasors when the last one has come (Singer and Seering 1990, equation 3).
    fn residue(weights: &[f64], apart_s: f64, hz: f64, damping: f64) -> f64 {
        let rate = TAU * hz;
        let damped = rate * libm::sqrt(1.0 - damping * damping);
        let last_s = apart_s * (weights.len() - 1) as f64;
        let sum = weights.iter().enumerate().fold([0.0_f64; 2], |[x, y], (at, weight)| {
            let late_s = apart_s * at as f64;
            let left = weight * libm::exp(-damping * rate * (last_s - late_s));
            [
                x + left * libm::cos(damped * late_s),
                y + left * libm::sin(damped * late_s),
            ]
        });
        libm::hypot(sum[0], sum[1])
    }

    #[test]
    fn copies_leave_no_vibration_of_their_frequency_and_little_beside_it() {
        for (hz, damping) in [(20.0, 0.0), (45.0, 0.03), (38.0, 0.1), (200.0, 0.2)] {
            for (shaper, off, most) in [(InputShaper::Zv, 0.05, 0.08), (InputShaper::Zvd, 0.1, 0.04)] {
                let copies = copies(shaper, hz, damping);
                for weights in [copies.weights, copies.plain] {
                    assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1.0e-12);
                    assert!(
                        residue(&weights, copies.apart_s, hz, damping) < 1.0e-12,
                        "{shaper:?}, {hz} Hz"
                    );
                    for hz in [hz * (1.0 - off), hz * (1.0 + off)] {
                        let residue = residue(&weights, copies.apart_s, hz, damping);
                        assert!(residue < most, "{shaper:?}, {hz} Hz: {residue}");
                    }
                }
                let later = mean(&copies.plain) - mean(&copies.weights);
                assert!(later.abs() < 1.0e-12, "{shaper:?}: {later}");
            }
        }
    }

    #[test]
    fn what_is_left_at_the_tool_is_as_published() {
        // var/2 less 1: 0.234 for ZV and 1.467 for ZVD, over the square of the angular frequency.
        let rate = TAU * 45.0;
        let zv = copies(InputShaper::Zv, 45.0, 0.0);
        assert!((zv.left_s2 * rate * rate - (PI * PI / 8.0 - 1.0)).abs() < 1.0e-9);
        let zvd = copies(InputShaper::Zvd, 45.0, 0.0);
        let taken_off = zvd.taken_off * zvd.apart_s * zvd.apart_s * rate * rate;
        assert!((taken_off - (PI * PI / 4.0 - 1.0)).abs() < 1.0e-9);
        assert!((zvd.growth() - 1.149).abs() < 1.0e-3, "{}", zvd.growth());
    }
}
