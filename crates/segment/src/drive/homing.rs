//! Homing by the drive (mode of operation 6): the methods of CiA 402 with limit switches, home switch and index pulse.
//!
//! Positions here are increments of the motor since its mark, whatever the drive shows. A switch is sought with the
//! switch speed; its edge, and the index pulse behind it, with the zero speed. A limit switch in the way of a search for
//! the home switch turns the search round, the second one ends it with an error. Edges and index pulses are latched where
//! they are, as by hardware.
//!
//! Invariant: whatever the settings are, the speed asked for is finite, and 0 before the start and after the end.

/// Where the switches of an axis are active, radians at the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switches {
    /// The negative limit switch is active below.
    pub negative_rad: f64,
    /// The positive limit switch is active above.
    pub positive_rad: f64,
    /// The home switch is active from the first to the second angle.
    pub home_rad: [f64; 2],
}

impl Default for Switches {
    /// Switches that are never active.
    fn default() -> Self {
        Self {
            negative_rad: f64::NEG_INFINITY,
            positive_rad: f64::INFINITY,
            home_rad: [f64::INFINITY; 2],
        }
    }
}

/// A switch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Switch {
    Negative,
    Positive,
    Home,
}

/// The switches of a drive in its increments, with the length of a turn between two index pulses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Marks {
    /// Increments of a radian at the motor.
    pub(crate) per_rad: f64,
    pub(crate) turn: f64,
    pub(crate) switches: Switches,
}

impl Marks {
    /// Whether a switch is active at a place.
    pub(crate) fn is_active(&self, switch: Switch, at: f64) -> bool {
        let rad = at / self.per_rad;
        match switch {
            Switch::Negative => rad < self.switches.negative_rad,
            Switch::Positive => rad > self.switches.positive_rad,
            Switch::Home => (self.switches.home_rad[0]..=self.switches.home_rad[1]).contains(&rad),
        }
    }

    /// The edge of a switch that a motion passes.
    pub(crate) fn edge(&self, switch: Switch, from: f64, to: f64) -> f64 {
        let edges = match switch {
            Switch::Negative => [self.switches.negative_rad; 2],
            Switch::Positive => [self.switches.positive_rad; 2],
            Switch::Home => self.switches.home_rad,
        };
        let between = |edge: &f64| (from.min(to)..=from.max(to)).contains(edge);
        edges
            .map(|rad| rad * self.per_rad)
            .into_iter()
            .find(between)
            .unwrap_or(to)
    }

    /// The first index pulse that a motion passes.
    pub(crate) fn index(&self, from: f64, to: f64) -> Option<f64> {
        let turn = self.turn.max(1.0);
        let next = match to > from {
            true => ((from / turn).floor() + 1.0) * turn,
            false => ((from / turn).ceil() - 1.0) * turn,
        };
        (from != to && (from.min(to)..=from.max(to)).contains(&next)).then_some(next)
    }
}

/// How a method searches.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Search {
    switch: Switch,
    /// First direction.
    first: f64,
    /// Whether the edge is where the switch becomes active, and the direction in which the edge is passed.
    enters: bool,
    passing: f64,
}

/// The search of a method with a switch, and whether it ends at an index pulse.
fn search(method: i8) -> Option<(Search, bool)> {
    let has_index = method < 15;
    let number = if has_index { method } else { method - 16 };
    let search = |switch, first, enters, passing| Search {
        switch,
        first,
        enters,
        passing,
    };
    let home = |first, enters, passing| search(Switch::Home, first, enters, passing);
    let found = match number {
        1 => search(Switch::Negative, -1.0, false, 1.0),
        2 => search(Switch::Positive, 1.0, false, -1.0),
        3 | 7 => home(1.0, false, -1.0),
        4 | 8 => home(1.0, true, 1.0),
        5 => home(-1.0, false, 1.0),
        6 => home(-1.0, true, -1.0),
        9 => home(1.0, true, -1.0),
        10 => home(1.0, false, 1.0),
        11 => home(-1.0, false, 1.0),
        12 => home(-1.0, true, -1.0),
        13 => home(-1.0, true, 1.0),
        14 => home(-1.0, false, -1.0),
        _ => return None,
    };
    (has_index || (17..=30).contains(&method)).then_some((found, has_index))
}

/// Whether a method exists.
pub(crate) fn is_method(method: i64) -> bool {
    matches!(method, 1..=14 | 17..=30 | 33..=35 | 37)
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Not started, or the start bit was taken back.
    Idle,
    /// Towards the switch; whether the search was turned round before.
    Seek(f64, bool),
    /// Out of the switch, to enter it again.
    Retreat(f64),
    /// Over its edge.
    Edge(f64),
    /// To the index pulse.
    Index(f64),
    /// To standstill after the home position was found.
    Stop(f64),
    Done,
    Failed,
}

/// Settings and state of a drive's homing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Homing {
    /// Objects 0x6098, 0x6099:1, 0x6099:2, 0x609A and 0x607C.
    pub(crate) method: i8,
    pub(crate) switch_speed: u32,
    pub(crate) zero_speed: u32,
    pub(crate) acceleration: u32,
    pub(crate) offset: i32,
    phase: Phase,
    start: bool,
    speed: f64,
    last: f64,
}

const REACHED: u16 = 1 << 10;
const ATTAINED: u16 = 1 << 12;
const ERROR: u16 = 1 << 13;
const CYCLE_S: f64 = 1e-3;

impl Homing {
    /// Settings after power-up, for an encoder with this resolution.
    pub(crate) fn new(increments_per_revolution: u32) -> Self {
        Self {
            method: 35,
            switch_speed: increments_per_revolution,
            zero_speed: increments_per_revolution / 10,
            acceleration: increments_per_revolution.saturating_mul(100),
            offset: 0,
            phase: Phase::Idle,
            start: false,
            speed: 0.0,
            last: 0.0,
        }
    }

    /// Ends a search: the drive is not in this mode, or has no torque. What was found before stays.
    pub(crate) fn leave(&mut self) {
        (self.start, self.speed) = (false, 0.0);
        if !matches!(self.phase, Phase::Done | Phase::Failed) {
            self.phase = Phase::Idle;
        }
    }

    /// Bits of the status word.
    pub(crate) fn status_bits(&self) -> u16 {
        match self.phase {
            Phase::Idle => REACHED,
            Phase::Done => ATTAINED | REACHED,
            Phase::Failed if self.speed == 0.0 => ERROR | REACHED,
            Phase::Failed => ERROR,
            Phase::Stop(_) => ATTAINED,
            _ => 0,
        }
    }

    /// Advances by one millisecond with the start bit and the motor's place. Returns the speed to go, increments/s, and
    /// the home position in the millisecond in which the search has ended.
    pub(crate) fn step(&mut self, start: bool, at: f64, marks: &Marks) -> (f64, Option<f64>) {
        let from = core::mem::replace(&mut self.last, at);
        if start && !self.start {
            self.begin(at, marks);
        } else if !start && !matches!(self.phase, Phase::Idle | Phase::Done | Phase::Failed) {
            self.phase = Phase::Idle;
        } else {
            self.proceed(from, at, marks);
        }
        self.start = start;
        let wanted = match self.phase {
            Phase::Seek(direction, _) | Phase::Retreat(direction) => direction * f64::from(self.switch_speed),
            Phase::Edge(direction) | Phase::Index(direction) => direction * f64::from(self.zero_speed),
            Phase::Idle | Phase::Stop(_) | Phase::Done | Phase::Failed => 0.0,
        };
        let change = f64::from(self.acceleration.max(1)) * CYCLE_S;
        self.speed += (wanted - self.speed).clamp(-change, change);
        match self.phase {
            Phase::Stop(home) if self.speed == 0.0 => {
                self.phase = Phase::Done;
                (0.0, Some(home))
            }
            _ => (self.speed, None),
        }
    }

    fn begin(&mut self, at: f64, marks: &Marks) {
        self.phase = match (self.method, search(self.method)) {
            (_, Some((search, _))) if marks.is_active(search.switch, at) => Self::at_switch(&search),
            (_, Some((search, _))) => Phase::Seek(search.first, false),
            (33, _) => Phase::Index(-1.0),
            (34, _) => Phase::Index(1.0),
            _ => Phase::Stop(at),
        };
    }

    /// What follows once the switch is active.
    fn at_switch(search: &Search) -> Phase {
        match search.enters {
            true => Phase::Retreat(-search.passing),
            false => Phase::Edge(search.passing),
        }
    }

    fn proceed(&mut self, from: f64, at: f64, marks: &Marks) {
        let found = search(self.method);
        let limit = |direction: f64| match direction > 0.0 {
            true => Switch::Positive,
            false => Switch::Negative,
        };
        let hits_limit = |direction: f64| marks.is_active(limit(direction), at);
        self.phase = match (self.phase, found) {
            (Phase::Seek(direction, turned), Some((search, _))) => {
                if marks.is_active(search.switch, at) {
                    Self::at_switch(&search)
                } else if !hits_limit(direction) {
                    Phase::Seek(direction, turned)
                } else if turned {
                    Phase::Failed
                } else {
                    Phase::Seek(-direction, true)
                }
            }
            (Phase::Retreat(direction), Some((search, _))) => match marks.is_active(search.switch, at) {
                _ if hits_limit(direction) => Phase::Failed,
                true => Phase::Retreat(direction),
                false => Phase::Edge(-direction),
            },
            (Phase::Edge(direction), Some((search, has_index))) => {
                let passed = marks.is_active(search.switch, at) == search.enters;
                match (passed, has_index) {
                    (false, _) if search.switch == Switch::Home && hits_limit(direction) => Phase::Failed,
                    (false, _) => Phase::Edge(direction),
                    (true, true) => Phase::Index(direction),
                    (true, false) => Phase::Stop(marks.edge(search.switch, from, at)),
                }
            }
            (Phase::Index(direction), _) => match marks.index(from, at) {
                Some(index) => Phase::Stop(index),
                None if hits_limit(direction) => Phase::Failed,
                None => Phase::Index(direction),
            },
            (phase, _) => phase,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    const TURN: f64 = 1_000.0;

    fn marks(negative: f64, positive: f64, home: [f64; 2]) -> Marks {
        Marks {
            per_rad: 1.0,
            turn: TURN,
            switches: Switches {
                negative_rad: negative,
                positive_rad: positive,
                home_rad: home,
            },
        }
    }

    /// Homes an ideal motor; returns the home position, or the status bits after a minute.
    fn home(method: i8, mut at: f64, marks: &Marks) -> Result<f64, u16> {
        let mut homing = Homing::new(TURN as u32);
        (homing.method, homing.switch_speed, homing.zero_speed) = (method, 2_000, 500);
        homing.acceleration = 50_000;
        for cycle in 0..60_000 {
            let (speed, found) = homing.step(cycle > 0, at, marks);
            assert!(speed.abs() <= 2_000.0);
            if let Some(home) = found {
                assert_eq!(homing.status_bits(), ATTAINED | REACHED);
                return Ok(home);
            }
            at += speed * CYCLE_S;
        }
        Err(homing.status_bits())
    }

    #[test]
    fn every_method_finds_its_place_from_anywhere() {
        // Ends of the cam at 2,100 and 4,700, limits at 50 and 9,950, an index each 1,000.
        let cam = marks(50.0, 9_950.0, [2_100.0, 4_700.0]);
        // Home switches that reach to an end.
        let above = marks(50.0, 9_950.0, [2_100.0, f64::INFINITY]);
        let below = marks(50.0, 9_950.0, [f64::NEG_INFINITY, 4_700.0]);
        let [low, high] = [2_100.0, 4_700.0];
        let cases = [
            (1, &cam, 1_000.0),
            (2, &cam, 9_000.0),
            (3, &above, 2_000.0),
            (4, &above, 3_000.0),
            (5, &below, 5_000.0),
            (6, &below, 4_000.0),
            (7, &cam, 2_000.0),
            (8, &cam, 3_000.0),
            (9, &cam, 4_000.0),
            (10, &cam, 5_000.0),
            (11, &cam, 5_000.0),
            (12, &cam, 4_000.0),
            (13, &cam, 3_000.0),
            (14, &cam, 2_000.0),
            (17, &cam, 50.0),
            (18, &cam, 9_950.0),
            (19, &above, low),
            (20, &above, low),
            (21, &below, high),
            (22, &below, high),
            (23, &cam, low),
            (24, &cam, low),
            (25, &cam, high),
            (26, &cam, high),
            (27, &cam, high),
            (28, &cam, high),
            (29, &cam, low),
            (30, &cam, low),
        ];
        let mut random = Random::new(402);
        for (method, marks, expected) in cases {
            for _ in 0..20 {
                let from = 60.0 + 9_800.0 * random.unit();
                assert_eq!(home(method, from, marks), Ok(expected), "method {method} from {from}");
            }
        }
        for _ in 0..100 {
            let from = 60.0 + 9_800.0 * random.unit();
            let below = Some((from / TURN).floor() * TURN).filter(|index| *index > 50.0);
            assert_eq!(home(33, from, &cam).ok(), below, "from {from}");
            assert_eq!(
                home(34, from, &cam).ok(),
                Some((from / TURN).ceil() * TURN).filter(|end| *end < 9_950.0)
            );
            assert_eq!((home(35, from, &cam), home(37, from, &cam)), (Ok(from), Ok(from)));
        }
    }

    #[test]
    fn a_switch_that_is_missing_is_an_error_at_the_second_limit_and_a_taken_back_start_ends_the_search() {
        let without = marks(50.0, 9_950.0, [f64::INFINITY; 2]);
        for method in 3..=14 {
            assert_eq!(home(method, 5_000.0, &without), Err(ERROR | REACHED), "method {method}");
        }
        let mut homing = Homing::new(TURN as u32);
        homing.method = 17;
        homing.step(false, 0.0, &without);
        homing.step(true, 5_000.0, &without);
        assert_eq!(homing.status_bits(), 0);
        homing.step(false, 4_990.0, &without);
        assert_eq!(homing.status_bits(), REACHED);
    }
}
