//! Takes the stretches of a motion in the order of time and proves its limits.

use crate::average::{Jumps, addition_mm};
use crate::certificate::{Certificate, Found, Kind, Refusal};
use crate::distance::{Distance, distance};
use crate::interval::Interval;
use crate::limits::{Limits, Quantity, TICK_S};
use crate::motion::{State, Stretch};
use crate::robot::{MAIN_AXES, Robot};
use crate::stretches::{Rates, check, dot};

/// Time between two stretches that counts as none, s.
const NO_TIME_S: f64 = 1.0e-9;
/// Distance between the end of a stretch and the beginning of the next one that counts as none, mm: a thousand times the
/// length that the planner counts as none.
const GAP_MAX_MM: f64 = 1.0e-6;
/// Rounding of the sums of times, s.
const TIME_ROUNDING_S: f64 = 1.0e-6;

/// What is kept of a stretch until the end.
#[derive(Clone, Copy, Debug)]
struct Record {
    begins_s: f64,
    ends_s: f64,
    /// Lower and upper bound of the largest distance from the path, mm.
    distance: [f64; 2],
    drawn: bool,
    vertex: u32,
    rates: Rates,
    /// Jumps at the beginning.
    jumps: Jumps,
}

/// Proves the limits of one motion.
#[derive(Clone, Debug)]
pub struct Certifier {
    robot: Robot,
    limits: Limits,
    path: Vec<[f64; 3]>,
    pending: Option<Stretch>,
    /// When the last checked stretch ended, and its state there.
    end: Option<(f64, State)>,
    /// The last interval of a curve whose distance was bounded.
    near: Option<(Stretch, [f64; 2])>,
    records: Vec<Record>,
    certificate: Certificate,
}

impl Certifier {
    /// A certifier for a motion along a polyline, mm.
    #[must_use]
    pub fn new(robot: Robot, limits: Limits, path: Vec<[f64; 3]>) -> Self {
        Self {
            robot,
            limits,
            path,
            pending: None,
            end: None,
            near: None,
            records: Vec::new(),
            certificate: Certificate::default(),
        }
    }

    /// Takes the next part of the motion. Parts of one stretch are joined.
    pub fn take(&mut self, stretch: &Stretch) {
        match &mut self.pending {
            Some(pending) if pending.goes_on_as(stretch) => {
                pending.time_s[1] = stretch.time_s[1];
                pending.ends_s = stretch.ends_s;
            }
            pending => {
                if let Some(complete) = pending.replace(*stretch) {
                    self.check(&complete);
                }
            }
        }
    }

    /// Ends the motion.
    #[must_use]
    pub fn finish(mut self) -> Certificate {
        if let Some(complete) = self.pending.take() {
            self.check(&complete);
        }
        if let Some((_, state)) = self.end {
            self.jumps(None, &still(&state), &state, 0.0, &Stretch::default());
        }
        self.average();
        self.certificate.stretches = self.records.len();
        self.certificate
    }

    fn check(&mut self, stretch: &Stretch) {
        let number = self.records.len();
        let found = |kind, quantity, parameter, value, limit| Found {
            kind,
            quantity,
            parameter,
            value,
            limit,
        };
        let mut record = Record {
            begins_s: stretch.begins_s(),
            ends_s: stretch.ends_s,
            distance: [f64::INFINITY; 2],
            drawn: stretch.drawn,
            vertex: stretch.vertex,
            rates: Rates::default(),
            jumps: Jumps::default(),
        };
        self.certificate.duration_s = stretch.ends_s;
        let ordered = self.end.is_none_or(|(end_s, _)| record.begins_s >= end_s - NO_TIME_S);
        if !(stretch.is_sound() && ordered) {
            let none = found(Kind::NotProved, Quantity::Numbers, 0.0, Interval::ENTIRE, 0.0);
            self.refuse(number, stretch, &none);
            self.records.push(record);
            return;
        }
        let certificate = &mut self.certificate;
        let note = |quantity, part| certificate.note(quantity, part);
        let checked = check(&self.robot, &self.limits, stretch, note);
        self.certificate.boxes += checked.boxes;
        for found in &checked.refused {
            self.refuse(number, stretch, found);
        }
        record.rates = checked.rates;
        record.distance = self.distance(number, stretch);
        let [begin_s, end_s] = stretch.time_s;
        let (begin, end) = (stretch.state(begin_s), stretch.state(end_s));
        record.jumps = match self.end {
            Some((time_s, before)) if record.begins_s - time_s < NO_TIME_S => {
                self.jumps(Some(&before), &before, &begin, record.begins_s, stretch)
            }
            // At rest in between.
            Some((time_s, before)) => {
                let stop = self.jumps(None, &still(&before), &before, time_s, stretch);
                let start = self.jumps(Some(&before), &still(&begin), &begin, record.begins_s, stretch);
                Jumps {
                    velocity: stop.velocity + start.velocity,
                    joints: stop.joints + start.joints,
                    gap: start.gap,
                }
            }
            None => self.jumps(None, &still(&begin), &begin, record.begins_s, stretch),
        };
        self.end = Some((stretch.ends_s, end));
        self.records.push(record);
    }

    fn refuse(&mut self, number: usize, stretch: &Stretch, found: &Found) {
        let time_s = if found.quantity == Quantity::Numbers {
            stretch.begins_s()
        } else {
            stretch.time_at(found.parameter)
        };
        self.certificate.refuse(Refusal {
            kind: found.kind,
            quantity: found.quantity,
            stretch: number,
            vertex: stretch.vertex,
            time_s,
            parameter: found.parameter,
            value: [found.value.low(), found.value.high()],
            limit: found.limit,
        });
    }

    /// Bounds of the distance from the path of a stretch's interval, mm.
    fn distance(&mut self, number: usize, stretch: &Stretch) -> [f64; 2] {
        let same = |known: &Stretch| {
            known.coefficients == stretch.coefficients
                && known.parameter == stretch.parameter
                && known.vertex == stretch.vertex
                && known.drawn == stretch.drawn
        };
        if let Some((_, bounds)) = self.near.filter(|(known, _)| same(known)) {
            return bounds;
        }
        let limit = self.tolerance_mm(stretch.drawn);
        let Distance { bounds, refused, boxes } = distance(stretch, &self.path, limit * (1.0 + self.limits.excess));
        self.certificate.boxes += boxes;
        self.certificate
            .note(Quantity::Tolerance, bounds.map(|bound| bound / limit));
        if let Some((parameter, kind, value)) = refused {
            let found = Found {
                kind,
                quantity: Quantity::Tolerance,
                parameter,
                value,
                limit,
            };
            self.refuse(number, stretch, &found);
        }
        self.near = Some((*stretch, bounds));
        bounds
    }

    fn tolerance_mm(&self, drawn: bool) -> f64 {
        if drawn {
            self.limits.tolerance_mm
        } else {
            self.limits.travel_tolerance_mm
        }
    }

    /// Jump from the velocity of one state to that of another, and the gap from a place to the other state's, checked
    /// against their limits.
    fn jumps(&mut self, place: Option<&State>, from: &State, to: &State, time_s: f64, stretch: &Stretch) -> Jumps {
        let number = self.records.len();
        let jump = [0, 1, 2].map(|axis| to.velocity[axis] - from.velocity[axis]);
        let velocity = length(&jump);
        let tick = Interval::point(TICK_S);
        let part = self.limits.jump_part;
        let mut checks = vec![(
            Quantity::Jump,
            velocity / tick,
            part * self.limits.acceleration_mm_s2,
            self.limits.acceleration_mm_s2,
        )];
        let joints = self.robot.joints(&to.point, &to.first);
        let mut squares = Interval::ZERO;
        for (axis, joint) in joints.iter().enumerate().take(MAIN_AXES) {
            let speed = dot(&joint.link, &jump) / joint.lever;
            squares = squares + speed.square();
            let limit = self.limits.joint_acceleration_rad_s2[axis];
            checks.push((Quantity::JointJump(axis as u8 + 1), speed / tick, part * limit, limit));
        }
        let way = place.map(|place| [0, 1, 2].map(|axis| to.point[axis].value() - place.point[axis].value()));
        let gap = way.map_or(Interval::ZERO, |way| length(&way));
        checks.push((Quantity::Gap, gap, GAP_MAX_MM, GAP_MAX_MM));
        for (quantity, value, most, limit) in checks {
            self.certificate
                .note(quantity, [value.mignitude() / limit, value.magnitude() / limit]);
            let keeps = value.magnitude() <= most;
            if !keeps {
                let kind = if value.mignitude() > most {
                    Kind::Violated
                } else {
                    Kind::NotProved
                };
                self.certificate.refuse(Refusal {
                    kind,
                    quantity,
                    stretch: number,
                    vertex: stretch.vertex,
                    time_s,
                    parameter: stretch.parameter[0],
                    value: [value.low(), value.high()],
                    limit: most,
                });
            }
        }
        Jumps {
            velocity: velocity.magnitude(),
            joints: squares.root_high(),
            gap: gap.magnitude(),
        }
    }

    /// Bounds the distance from the path after the average.
    fn average(&mut self) {
        let half_s = 0.5 * f64::from(self.limits.window_ms) * TICK_S + TIME_ROUNDING_S;
        let links = self.robot.links_mm();
        let (mut first, mut end) = (0, 0);
        for number in 0..self.records.len() {
            let record = self.records[number];
            while first < number && self.records[first].ends_s < record.begins_s - half_s {
                first += 1;
            }
            while end < self.records.len() && self.records[end].begins_s <= record.ends_s + half_s {
                end += 1;
            }
            let (mut rates, mut jumps) = (Rates::default(), Jumps::default());
            for near in self.records.get(first..end).unwrap_or_default() {
                rates = rates.most(&near.rates);
                jumps.velocity += near.jumps.velocity;
                jumps.joints += near.jumps.joints;
                jumps.gap += near.jumps.gap;
            }
            let added = addition_mm(self.limits.window_ms, &rates, &jumps, links);
            let [least, most] = record.distance;
            let limit = self.tolerance_mm(record.drawn);
            let certificate = &mut self.certificate;
            certificate.average_mm = certificate.average_mm.max(added);
            certificate.note(
                Quantity::AveragedTolerance,
                [(least - added).max(0.0) / limit, (most + added) / limit],
            );
            let keeps = most + added <= limit * (1.0 + self.limits.excess);
            if !keeps {
                certificate.refuse(Refusal {
                    kind: Kind::NotProved,
                    quantity: Quantity::AveragedTolerance,
                    stretch: number,
                    vertex: record.vertex,
                    time_s: record.begins_s,
                    parameter: 0.0,
                    value: [(least - added).max(0.0), most + added],
                    limit,
                });
            }
        }
    }
}

/// A state at rest at the place of another.
fn still(state: &State) -> State {
    State {
        velocity: [Interval::ZERO; 3],
        ..*state
    }
}

fn length(vector: &[Interval; 3]) -> Interval {
    let squared = dot(vector, vector);
    Interval::between(squared.root_low(), squared.root_high())
}
