//! Bounds of a stretch: every limited quantity on boxes of the curve's parameter.
//!
//! A box whose bounds keep the limits is proved. Otherwise the quantity is evaluated at the box's middle. If even its
//! lower bound is over the limit there, this point is a violation. If not, the box is halved, until it is proved or
//! [`DEPTH_MAX`] is reached.

use crate::certificate::{Found, Kind};
use crate::interval::Interval;
use crate::limits::{Limits, Quantity};
use crate::motion::{Kinetics, Stretch};
use crate::robot::{Joint, MAIN_AXES, Robot};
use crate::series::{Series, Series3, range, squared_length};

/// Most halvings of a stretch.
const DEPTH_MAX: u32 = 18;
/// Most boxes of a stretch.
const BOXES_MAX: usize = 4_000;
/// Most quantities of a stretch.
const QUANTITIES: usize = 16;
/// Looseness of a bound over its limit, as a part of the limit, above which a box is halved.
const LOOSE: f64 = 1.0e-3;

/// A limited quantity on a stretch.
#[derive(Clone, Copy)]
struct Limited {
    quantity: Quantity,
    /// Whether series and limit are those of the square.
    squared: bool,
    /// Lowest and highest value allowed.
    allowed: [f64; 2],
    /// The configured limit.
    limit: f64,
}

/// Rates of motion on a stretch, as upper bounds, for what the average adds.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Rates {
    /// Speed of the tool, mm/s.
    pub(crate) speed: f64,
    /// Euclidean norms of the main axes' speeds and accelerations, rad/s and rad/s2.
    pub(crate) joint_speed: f64,
    pub(crate) joint_acceleration: f64,
    /// The tool's acceleration from the main axes' accelerations alone, mm/s2.
    pub(crate) lifted: f64,
    /// Norm of the inverse of the matrix of the links that hold the tool, 1/mm.
    pub(crate) inverse: f64,
}

impl Rates {
    /// The larger bounds of two.
    pub(crate) fn most(&self, other: &Self) -> Self {
        Self {
            speed: self.speed.max(other.speed),
            joint_speed: self.joint_speed.max(other.joint_speed),
            joint_acceleration: self.joint_acceleration.max(other.joint_acceleration),
            lifted: self.lifted.max(other.lifted),
            inverse: self.inverse.max(other.inverse),
        }
    }
}

/// The motion at one parameter or on a box.
struct Moment {
    kinetics: Kinetics,
    joints: [Joint; MAIN_AXES],
}

impl Moment {
    fn new(robot: &Robot, stretch: &Stretch, parameter: Interval) -> Self {
        let kinetics = stretch.kinetics(parameter);
        let joints = robot.joints(&kinetics.point, &kinetics.first);
        Self { kinetics, joints }
    }

    /// Accelerations of the main axes.
    fn joint_accelerations(&self) -> [Series; MAIN_AXES] {
        let kinetics = &self.kinetics;
        self.joints
            .map(|joint| joint.slope.derivative() * kinetics.rate_squared + joint.slope * kinetics.rate_change)
    }

    /// Acceleration of the tool.
    fn acceleration(&self) -> Series3 {
        let kinetics = &self.kinetics;
        let (squared, change) = (kinetics.rate_squared, kinetics.rate_change);
        [0, 1, 2].map(|axis| kinetics.second[axis] * squared + kinetics.first[axis] * change)
    }

    /// Series of the limited quantities, in the order of [`limited`].
    fn series(&self, stretch: &Stretch, acceleration: &Series3, angles: [Interval; MAIN_AXES]) -> [Series; QUANTITIES] {
        let kinetics = &self.kinetics;
        let squared = kinetics.rate_squared;
        let accelerations = self.joint_accelerations();
        let mut all = [Series::ZERO; QUANTITIES];
        for axis in 0..MAIN_AXES {
            let joint = &self.joints[axis];
            all[axis] = joint.slope.integral(angles[axis]);
            all[3 + axis] = joint.slope.square() * squared;
            all[6 + axis] = accelerations[axis];
        }
        all[9] = squared_length(&kinetics.first) * squared;
        all[10] = squared_length(acceleration);
        all[11] = kinetics.first[2].square() * squared;
        all[12] = acceleration[2];
        let turn = |half: f64| {
            let change = kinetics.length.times(Interval::point(stretch.turn_change_rad_mm2));
            Series::constant(stretch.turn_rad_mm) + change.times(Interval::point(half))
        };
        let slope = turn(1.0);
        all[13] = Series::constant(stretch.heading_rad) + kinetics.length * turn(0.5);
        all[14] = slope.square() * kinetics.squared;
        all[15] = kinetics.squared.times(Interval::point(stretch.turn_change_rad_mm2))
            + slope.times(Interval::point(stretch.acceleration_mm_s2));
        all
    }

    /// Bounds the joints' accelerations by the constraints of the links, and returns the rates on the box of this
    /// moment. `acceleration` is that of the tool on the box.
    fn rates(&self, values: &mut [Interval; QUANTITIES], acceleration: &[Interval; 3]) -> Rates {
        let kinetics = &self.kinetics;
        let rate = kinetics.rate_squared.value();
        let rate = Interval::between(rate.root_low(), rate.root_high());
        let velocity = kinetics.first.map(|first| first.value() * rate);
        let links = self.joints.map(|joint| joint.link);
        let [a, b, c] = &links;
        let sides = [cross(b, c), cross(c, a), cross(a, b)];
        let volume = dot(a, &sides[0]);
        // The tool's acceleration is that of the joints' accelerations less that of their speeds.
        let mut lifted = *acceleration;
        let mut inverse = Interval::ZERO;
        for axis in 0..MAIN_AXES {
            let joint = &self.joints[axis];
            let speed = joint.slope.value() * rate;
            let pull = joint.pull(&velocity, speed);
            let bound = (dot(&joint.link, acceleration) + pull) / joint.lever;
            values[6 + axis] = values[6 + axis].meet(&bound);
            for place in 0..3 {
                let side = sides[axis][place] / volume;
                lifted[place] = lifted[place] + side * pull;
                inverse = inverse + side.square();
            }
        }
        let [d, e, f] = [6, 7, 8].map(|index: usize| values[index].square());
        Rates {
            speed: values[9].root_high(),
            joint_speed: (values[3] + values[4] + values[5]).root_high(),
            joint_acceleration: (d + e + f).root_high(),
            lifted: dot(&lifted, &lifted).root_high(),
            inverse: inverse.root_high(),
        }
    }
}

pub(crate) fn dot(a: &[Interval; 3], b: &[Interval; 3]) -> Interval {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: &[Interval; 3], b: &[Interval; 3]) -> [Interval; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// The quantities of a stretch and their limits, in the order of [`Moment::series`]; `None` where no limit applies.
fn limited(limits: &Limits, stretch: &Stretch) -> [Option<Limited>; QUANTITIES] {
    let more = 1.0 + limits.excess;
    let range = |axis: usize| {
        let [low, high] = limits.range_rad[axis];
        Some(Limited {
            quantity: Quantity::Angle(axis as u8 + 1),
            squared: false,
            allowed: [low, high],
            limit: high,
        })
    };
    let speed = |quantity, limit: f64| {
        let most = limit * more;
        Some(Limited {
            quantity,
            squared: true,
            allowed: [f64::NEG_INFINITY, most * most],
            limit,
        })
    };
    let either = |quantity, limit: f64| {
        let most = limit * more;
        Some(Limited {
            quantity,
            squared: false,
            allowed: [-most, most],
            limit,
        })
    };
    let joint_speed = |axis: usize| speed(Quantity::JointSpeed(axis as u8 + 1), limits.joint_speed_rad_s[axis]);
    let joint_acceleration = |axis: usize| {
        let limit = limits.joint_acceleration_rad_s2[axis];
        either(Quantity::JointAcceleration(axis as u8 + 1), limit)
    };
    let tool = if stretch.drawn {
        limits.speed_mm_s
    } else {
        limits.travel_speed_mm_s
    };
    let pen = |limit: f64| stretch.lifts && limit > 0.0;
    let turns = stretch.turn_rad_mm != 0.0 || stretch.turn_change_rad_mm2 != 0.0;
    [
        range(0),
        range(1),
        range(2),
        joint_speed(0),
        joint_speed(1),
        joint_speed(2),
        joint_acceleration(0),
        joint_acceleration(1),
        joint_acceleration(2),
        speed(Quantity::Speed, tool),
        speed(Quantity::Acceleration, limits.acceleration_mm_s2),
        speed(Quantity::PenSpeed, limits.pen_speed_mm_s).filter(|_| pen(limits.pen_speed_mm_s)),
        either(Quantity::PenAcceleration, limits.pen_acceleration_mm_s2).filter(|_| pen(limits.pen_acceleration_mm_s2)),
        range(3),
        joint_speed(3).filter(|_| turns),
        joint_acceleration(3).filter(|_| turns),
    ]
}

impl Limited {
    fn holds(&self, value: &Interval) -> bool {
        let [low, high] = self.allowed;
        low <= value.low() && value.high() <= high
    }

    fn is_violated(&self, value: &Interval) -> bool {
        let [low, high] = self.allowed;
        value.low() > high || value.high() < low
    }

    /// The quantity itself.
    fn shown(&self, value: &Interval) -> Interval {
        if self.squared {
            Interval::between(value.root_low(), value.root_high())
        } else {
            *value
        }
    }

    /// Lower and upper bound of the largest part of the limit, from values at a point and on its box.
    fn part(&self, point: &Interval, on_box: &Interval) -> [f64; 2] {
        let (point, on_box) = (self.shown(point), self.shown(on_box));
        if let Quantity::Angle(_) = self.quantity {
            let [low, high] = self.allowed;
            let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
            let part = |value: f64| (value - middle).abs() / half;
            return [part(point.middle()), part(on_box.low()).max(part(on_box.high()))];
        }
        [point.mignitude() / self.limit, on_box.magnitude() / self.limit]
    }
}

/// What is known about a stretch after its check.
pub(crate) struct Checked {
    pub(crate) rates: Rates,
    pub(crate) boxes: usize,
    /// The worst witness of each quantity whose limit is not proved.
    pub(crate) refused: Vec<Found>,
}

/// Checks the limits of a stretch. `note` gets the quantities' parts of their limits.
pub(crate) fn check(
    robot: &Robot,
    limits: &Limits,
    stretch: &Stretch,
    mut note: impl FnMut(Quantity, [f64; 2]),
) -> Checked {
    let open = limited(limits, stretch);
    let mut refused: [Option<Found>; QUANTITIES] = [None; QUANTITIES];
    let [from, to] = stretch.parameters();
    let mut boxes = vec![(from, to, 0)];
    let (mut rates, mut count) = (Rates::default(), 0);
    while let Some((from, to, depth)) = boxes.pop() {
        count += 1;
        let at = 0.5 * from + 0.5 * to;
        let (points, values, of_box) = bounds(robot, stretch, [from, at, to]);
        let last = depth >= DEPTH_MAX || count + boxes.len() >= BOXES_MAX;
        let mut complete = true;
        for (index, limited) in open.iter().enumerate() {
            let Some(limited) = limited.filter(|limited| !limited.holds(&values[index])) else {
                continue;
            };
            let (place, point) = (&mut refused[index], &points[index]);
            if limited.is_violated(point) {
                limited.witness(place, Kind::Violated, at, point);
            }
            let [least, most] = limited.part(point, &values[index]);
            let known = place.is_some_and(|found| found.kind == Kind::Violated);
            // Smaller boxes would not help.
            let last = last || !point.is_bounded() || limited.allowed[1].is_nan();
            if last && !known {
                limited.witness(place, Kind::NotProved, at, &values[index]);
            }
            complete &= last || known && most - least <= LOOSE;
        }
        if complete {
            for (index, limited) in open.iter().enumerate() {
                if let Some(limited) = limited {
                    note(limited.quantity, limited.part(&points[index], &values[index]));
                }
            }
            rates = rates.most(&of_box);
        } else {
            boxes.push((from, at, depth + 1));
            boxes.push((at, to, depth + 1));
        }
    }
    Checked {
        rates,
        boxes: count,
        refused: refused.into_iter().flatten().collect(),
    }
}

/// The quantities at the middle of a box and on the whole box, and the rates there.
fn bounds(
    robot: &Robot,
    stretch: &Stretch,
    [from, at, to]: [f64; 3],
) -> ([Interval; QUANTITIES], [Interval; QUANTITIES], Rates) {
    let half = (to - at).max(at - from).next_up();
    let middle = Moment::new(robot, stretch, Interval::point(at));
    let whole = Moment::new(robot, stretch, Interval::between(from, to));
    let (here, there) = (middle.acceleration(), whole.acceleration());
    let angles = middle.joints.map(|joint| joint.place.angle());
    let middles = middle.series(stretch, &here, angles);
    let wholes = whole.series(stretch, &there, [Interval::ENTIRE; MAIN_AXES]);
    let mut values = std::array::from_fn(|index| range(&middles[index], &wholes[index], half));
    let acceleration = [0, 1, 2].map(|axis: usize| range(&here[axis], &there[axis], half));
    let rates = whole.rates(&mut values, &acceleration);
    (middles.map(|series| series.value()), values, rates)
}

impl Limited {
    /// Keeps the worse one of two witnesses.
    fn witness(&self, place: &mut Option<Found>, kind: Kind, parameter: f64, value: &Interval) {
        let below = matches!(self.quantity, Quantity::Angle(_)) && value.low() < self.allowed[0];
        let found = Found {
            kind,
            quantity: self.quantity,
            parameter,
            value: self.shown(value),
            limit: if below { self.allowed[0] } else { self.limit },
        };
        let worse = place.is_none_or(|known| {
            known.kind != kind && kind == Kind::Violated
                || known.kind == kind && found.value.magnitude() > known.value.magnitude()
        });
        if worse {
            *place = Some(found);
        }
    }
}
