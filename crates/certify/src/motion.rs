//! A committed motion as numbers: a polynomial curve, and on it a distance that is a quadratic function of time.
//!
//! The planner measures lengths along a curve by three-point Gauss quadrature from the beginning of an interval. Here
//! that rule is the definition of the length, not an approximation: the parameter u(t) is the one whose Gauss length
//! G(u) is the distance at the time t. So nothing of the planner's motion is neglected.

use crate::interval::Interval;
use crate::series::{Series, Series3, squared_length};

/// Coefficients of a curve.
pub const COEFFICIENTS: usize = 6;
/// Binomial coefficients: row j, column k.
const BINOMIAL: [[f64; COEFFICIENTS]; COEFFICIENTS] = [
    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 2.0, 1.0, 0.0, 0.0, 0.0],
    [1.0, 3.0, 3.0, 1.0, 0.0, 0.0],
    [1.0, 4.0, 6.0, 4.0, 1.0, 0.0],
    [1.0, 5.0, 10.0, 10.0, 5.0, 1.0],
];
/// Newton steps to the parameter of a length; a good start needs three.
const NEWTON_STEPS: usize = 8;
/// Doublings of the distance to a parameter that is proven to lie on one side.
const WIDENINGS: usize = 60;

/// A motion with one acceleration along one interval of a curve.
///
/// The point at the parameter u is the sum of `coefficients[k] * u^k`. At the time t the motion is at `start_mm +
/// speed_mm_s * t + acceleration_mm_s2 * t^2 / 2`, measured from the interval's first parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stretch {
    /// Coefficients of the curve, mm.
    pub coefficients: [[f64; 3]; COEFFICIENTS],
    /// First and last parameter of the interval.
    pub parameter: [f64; 2],
    /// Place at the time 0, mm from the beginning of the interval.
    pub start_mm: f64,
    /// Speed at the time 0, mm/s.
    pub speed_mm_s: f64,
    /// Acceleration along the curve, mm/s2.
    pub acceleration_mm_s2: f64,
    /// First and last time t of the motion, s.
    pub time_s: [f64; 2],
    /// When the motion ends, s from the beginning of the path.
    pub ends_s: f64,
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
    /// Vertices of the path executed where the piece of the path begins.
    pub vertex: u32,
}

/// Motion at one parameter, or on a box of parameters.
pub(crate) struct Kinetics {
    pub(crate) point: Series3,
    /// First and second derivative of the point with respect to the parameter.
    pub(crate) first: Series3,
    pub(crate) second: Series3,
    /// Distance from the beginning of the interval, mm.
    pub(crate) length: Series,
    /// Squared speed along the path, mm2/s2.
    pub(crate) squared: Series,
    /// Squared first and second derivative of the parameter with respect to time.
    pub(crate) rate_squared: Series,
    pub(crate) rate_change: Series,
}

/// Point and first derivative of a curve as series at a parameter.
pub(crate) fn curve(coefficients: &[[f64; 3]; COEFFICIENTS], parameter: Interval) -> (Series3, Series3) {
    let mut point = [Series::ZERO; 3];
    for (axis, series) in point.iter_mut().enumerate() {
        for (order, place) in series.0.iter_mut().enumerate().take(COEFFICIENTS) {
            *place = shifted(coefficients, axis, order, parameter);
        }
    }
    (point, first(coefficients, parameter))
}

/// First derivative of a curve as series at a parameter.
fn first(coefficients: &[[f64; 3]; COEFFICIENTS], parameter: Interval) -> Series3 {
    [0, 1, 2].map(|axis| {
        let mut first = Series::ZERO;
        for order in 1..COEFFICIENTS {
            let coefficient = shifted(coefficients, axis, order, parameter);
            first.0[order - 1] = coefficient * Interval::point(order as f64);
        }
        first
    })
}

/// Taylor coefficient of one axis at a parameter.
fn shifted(coefficients: &[[f64; 3]; COEFFICIENTS], axis: usize, order: usize, parameter: Interval) -> Interval {
    let mut sum = Interval::ZERO;
    for power in (order..COEFFICIENTS).rev() {
        let coefficient = Interval::point(coefficients[power][axis]);
        sum = sum * parameter + coefficient * Interval::point(BINOMIAL[power][order]);
    }
    sum
}

impl Stretch {
    /// Whether all numbers are finite, the interval and the time have a direction, and the motion goes forward.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let numbers = [
            self.start_mm,
            self.speed_mm_s,
            self.acceleration_mm_s2,
            self.ends_s,
            self.heading_rad,
            self.turn_rad_mm,
            self.turn_change_rad_mm2,
        ];
        let rest = self
            .coefficients
            .iter()
            .flatten()
            .chain(&self.parameter)
            .chain(&self.time_s);
        let [from, to] = self.parameter;
        let [begin_s, end_s] = self.time_s;
        numbers.iter().chain(rest).all(|number| number.is_finite())
            && from < to
            && begin_s <= end_s
            && self.speed_mm_s >= 0.0
            && self.start_mm >= 0.0
    }

    /// Whether another motion is the continuation of this one with the same numbers.
    #[must_use]
    pub fn goes_on_as(&self, next: &Self) -> bool {
        let renamed = Self {
            time_s: self.time_s,
            ends_s: self.ends_s,
            ..*next
        };
        renamed == *self && self.time_s[1] == next.time_s[0]
    }

    /// When the motion begins, s.
    pub(crate) fn begins_s(&self) -> f64 {
        self.ends_s - (self.time_s[1] - self.time_s[0])
    }

    fn is_straight(&self) -> bool {
        self.coefficients[2..]
            .iter()
            .all(|coefficient| *coefficient == [0.0; 3])
    }

    /// Derivative of the arc length with respect to the parameter.
    fn pace(&self, parameter: Interval) -> Series {
        squared_length(&first(&self.coefficients, parameter)).root()
    }

    /// Gauss length from the beginning of the interval to a parameter.
    pub(crate) fn length(&self, parameter: Interval) -> Series {
        let from = Interval::point(self.parameter[0]);
        let way = parameter - from;
        let half = Interval::point(0.5);
        let mut half_way = Series::constant(way * half);
        half_way.0[1] = half;
        if self.is_straight() {
            return half_way * self.pace(parameter).times(Interval::point(2.0));
        }
        let offset = Interval::quotient(3.0, 5.0).root();
        let (outer, inner) = (Interval::quotient(5.0, 9.0), Interval::quotient(8.0, 9.0));
        let nodes = [
            ((Interval::ONE - offset) * half, outer),
            (half, inner),
            ((Interval::ONE + offset) * half, outer),
        ];
        let mut sum = Series::ZERO;
        for (part, weight) in nodes {
            sum = sum + self.pace(from + way * part).stretched(part).times(weight);
        }
        half_way * sum
    }

    /// Distance from the beginning of the interval at a time.
    fn place(&self, time_s: f64) -> Interval {
        let time = Interval::point(time_s);
        let speed = Interval::point(self.speed_mm_s);
        let acceleration = Interval::point(self.acceleration_mm_s2);
        Interval::point(self.start_mm) + time * (speed + Interval::point(0.5) * acceleration * time)
    }

    /// Speed along the path at a time.
    fn speed(&self, time_s: f64) -> Interval {
        Interval::point(self.speed_mm_s) + Interval::point(self.acceleration_mm_s2) * Interval::point(time_s)
    }

    /// Parameters between which the motion stays from its first to its last time.
    pub(crate) fn parameters(&self) -> [f64; 2] {
        let [begin_s, end_s] = self.time_s;
        [self.below(self.place(begin_s).low()), self.above(self.farthest(end_s))]
    }

    /// Parameters between which the motion is at a time.
    fn parameters_at(&self, time_s: f64) -> Interval {
        let place = self.place(time_s);
        Interval::between(self.below(place.low()), self.above(place.high()))
    }

    /// Largest distance up to a time: rounding may let the speed end a little below 0.
    fn farthest(&self, time_s: f64) -> f64 {
        let end = self.speed(time_s);
        let back = if end.low() < 0.0 && self.acceleration_mm_s2 < 0.0 {
            end.square() / Interval::point(-2.0 * self.acceleration_mm_s2)
        } else {
            Interval::ZERO
        };
        (self.place(time_s) + back).high()
    }

    /// Time at which the motion passes a parameter, s, without proof.
    pub(crate) fn time_at(&self, parameter: f64) -> f64 {
        let way = self.length(Interval::point(parameter)).value().middle() - self.start_mm;
        let squared = self.speed_mm_s * self.speed_mm_s + 2.0 * self.acceleration_mm_s2 * way;
        let mean = 0.5 * (self.speed_mm_s + squared.max(0.0).sqrt());
        let time_s = if mean > 0.0 { way / mean } else { 0.0 };
        self.begins_s() + time_s.clamp(self.time_s[0], self.time_s[1]) - self.time_s[0]
    }

    /// A parameter near the one with a length, without proof.
    fn near(&self, length_mm: f64) -> f64 {
        let [from, to] = self.parameter;
        let pace = |parameter: f64| {
            let slope = |axis: usize| {
                let powers = (1..COEFFICIENTS).rev();
                powers.fold(0.0, |sum, power| {
                    sum * parameter + power as f64 * self.coefficients[power][axis]
                })
            };
            (slope(0) * slope(0) + slope(1) * slope(1) + slope(2) * slope(2)).sqrt()
        };
        let offset = 0.6_f64.sqrt();
        let length = |parameter: f64| {
            let (half, middle) = (0.5 * (parameter - from), 0.5 * (parameter + from));
            let outer = pace(middle - half * offset) + pace(middle + half * offset);
            half * (5.0 * outer + 8.0 * pace(middle)) / 9.0
        };
        let mut parameter = from;
        for _ in 0..NEWTON_STEPS {
            let step = (length_mm - length(parameter)) / pace(parameter);
            if !step.is_finite() || step == 0.0 {
                break;
            }
            parameter = (parameter + step).clamp(from, to);
        }
        parameter
    }

    /// A parameter of the interval that the motion has certainly reached at a length.
    fn below(&self, length_mm: f64) -> f64 {
        let [from, to] = self.parameter;
        let near = self.near(length_mm);
        let mut distance = (to - from) * f64::EPSILON;
        for _ in 0..WIDENINGS {
            let parameter = near - distance;
            if parameter <= from {
                break;
            }
            if self.length(Interval::point(parameter)).value().high() <= length_mm {
                return parameter;
            }
            distance *= 4.0;
        }
        from
    }

    /// A parameter of the interval that the motion has certainly not passed at a length.
    fn above(&self, length_mm: f64) -> f64 {
        let [from, to] = self.parameter;
        let near = self.near(length_mm);
        let mut distance = (to - from) * f64::EPSILON;
        for _ in 0..WIDENINGS {
            let parameter = near + distance;
            if parameter >= to {
                break;
            }
            if self.length(Interval::point(parameter)).value().low() >= length_mm {
                return parameter;
            }
            distance *= 4.0;
        }
        to
    }

    /// The motion as series at a parameter or on a box.
    pub(crate) fn kinetics(&self, parameter: Interval) -> Kinetics {
        let (point, first) = curve(&self.coefficients, parameter);
        let second = first.map(|first| first.derivative());
        let length = self.length(parameter);
        let pace = length.derivative();
        let bend = pace.derivative();
        let (speed, acceleration) = (
            Interval::point(self.speed_mm_s),
            Interval::point(self.acceleration_mm_s2),
        );
        let passed = length - Series::constant(self.start_mm);
        let squared = Series::constant(speed.square()) + passed.times(Interval::point(2.0) * acceleration);
        let rate_squared = squared.over(&pace.square());
        let rate_change = (Series::constant(acceleration) - bend * rate_squared).over(&pace);
        Kinetics {
            point,
            first,
            second,
            length,
            squared,
            rate_squared,
            rate_change,
        }
    }

    /// Point and velocity at a time of the motion, with the derivative of the point by the parameter.
    pub(crate) fn state(&self, time_s: f64) -> State {
        let parameter = self.parameters_at(time_s);
        let (point, first) = curve(&self.coefficients, parameter);
        let rate = self.speed(time_s) / self.length(parameter).derivative().value();
        State {
            velocity: first.map(|first| first.value() * rate),
            point,
            first,
        }
    }
}

/// Where a motion is and how fast it is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct State {
    pub(crate) point: Series3,
    pub(crate) first: Series3,
    /// Velocity, mm/s.
    pub(crate) velocity: [Interval; 3],
}
