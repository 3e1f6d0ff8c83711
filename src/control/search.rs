//! Homing by switches: setpoints that lead each axis to its switch, and the position at which the switch opened.
//!
//! An axis goes towards its switch, stops, goes back off it, and comes again slowly: the position at which the switch then
//! opens is the axis's zero. It ends off the switch. A switch that is open at the start is left first. Axes of the same order
//! go together, each by itself; other axes stand. Where two axes move the tool together, two slides are led to the switches
//! ([`Kind::slides`]): the sum and the difference of the axes at one switch each give the zeros of both.
//!
//! A switch is closed in operation and opens when it is reached, so that a broken wire is like a switch that is reached: it
//! never closes, which ends the search.
//!
//! Invariant: every phase has a longest travel, after which the search fails; no axis and no slide is led faster than its search
//! speed; two axes that move together have the sum of both, or the difference.

use crate::config::{Axis, HomeSwitch};
use crate::motion::Setpoint;
use crate::robots::{AXES, Kind};
use serde::{Deserialize, Serialize};

/// Milliseconds for which a switch must keep a new state.
const STEADY_MS: u8 = 3;
/// Part of the quick stop's deceleration that the search uses.
const ACCELERATION_PART: f64 = 0.5;
/// Longest way on which a switch is left, in lengths of the way kept off it.
const LEAVING_MAX: f64 = 8.0;
/// Time after which a change of the switch is seen at the latest, s: filter of the terminal, exchange, and lag of the drive.
const INPUT_S: f64 = 0.02;
/// How far apart the two approaches may find the switch besides, in lengths of the way kept off it.
const AGREED_PART: f64 = 0.25;
/// Length of a cycle, s.
const CYCLE_S: f64 = 1.0e-3;
/// Time at rest before the positions are taken, ms: longer than the setpoints are made ahead.
const REST_MS: u16 = 40;
/// Longest time at rest in which the positions have to arrive, ms.
const REST_MAX_MS: u16 = 500;

/// Why a search has ended without a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SearchFailure {
    /// The switch has not opened on the longest way.
    NeverOpens,
    /// The switch has not closed again when it was left: it is stuck, or its wire is broken.
    StaysOpen,
    /// The input, or the axis's position, does not arrive.
    Missing,
    /// The two approaches found the switch at different places: a contact or a wire is loose, or the axis slips.
    Differs,
}

/// How what is led to a switch comes to rest behind it: an axis, or a slide that two axes move together.
#[derive(Clone, Copy, Debug)]
pub struct Approach {
    speed_rad_s: f64,
    /// Speed of the other slide at the same time, rad/s; 0 for an axis that moves alone.
    beside_rad_s: f64,
    /// The quick stop of the weaker drive that moves it, rad/s2.
    quick_stop_rad_s2: f64,
    /// Part of it that this search uses.
    part: f64,
}

impl Approach {
    /// What is led to the switch of `axis`, from 0, in a robot of this kind.
    pub fn of(kind: Kind, axes: &[Axis; AXES], axis: usize) -> Self {
        let [first, second, ..] = axes;
        let settings = axes.get(axis).unwrap_or(first);
        let alone = Self {
            speed_rad_s: settings.home.speed_rad_s.abs(),
            beside_rad_s: 0.0,
            quick_stop_rad_s2: settings.quick_stop_rad_s2.abs(),
            part: ACCELERATION_PART,
        };
        if axis >= kind.coupled_axes() {
            return alone;
        }
        let other = if axis == 0 { second } else { first };
        let is_at_once = other.home.io.is_some() && other.home.order == settings.home.order;
        let quick_stop_rad_s2 = alone.quick_stop_rad_s2.min(other.quick_stop_rad_s2.abs());
        match is_at_once {
            false => Self {
                quick_stop_rad_s2,
                ..alone
            },
            // A drive may have to brake for both at once.
            true => Self {
                beside_rad_s: other.home.speed_rad_s.abs(),
                quick_stop_rad_s2,
                part: 0.5 * ACCELERATION_PART,
                ..alone
            },
        }
    }

    /// Deceleration with which it comes to rest, rad/s2.
    const fn deceleration_rad_s2(&self) -> f64 {
        self.quick_stop_rad_s2 * self.part
    }

    /// Longest way that it goes on behind its switch at the search speed, rad: until the switch is noticed, and to rest. In a
    /// quick stop each drive brakes for itself: as long as the other slide is the faster one, this one goes on at its speed, for
    /// `speed * beside / quick_stop` in all.
    pub fn way_behind_switch_rad(&self) -> f64 {
        let speed_rad_s = self.speed_rad_s;
        let braking_rad = 0.5 * speed_rad_s * speed_rad_s / self.deceleration_rad_s2();
        let beside_rad = speed_rad_s * self.beside_rad_s / self.quick_stop_rad_s2;
        speed_rad_s * INPUT_S + braking_rad.max(beside_rad)
    }

    /// Fastest search that goes no farther than this behind its switch, rad/s.
    pub fn speed_max_rad_s(&self, way_rad: f64) -> f64 {
        let (way_rad, deceleration_rad_s2) = (way_rad.max(0.0), self.deceleration_rad_s2());
        let root_s = libm::sqrt(INPUT_S * INPUT_S + 2.0 * way_rad / deceleration_rad_s2);
        let alone_rad_s = deceleration_rad_s2 * (root_s - INPUT_S);
        alone_rad_s.min(way_rad / (INPUT_S + self.beside_rad_s / self.quick_stop_rad_s2))
    }

    /// Weakest quick stop with which the search goes no farther than this behind its switch, rad/s2; `None` if it is farther
    /// before the switch is noticed.
    pub fn quick_stop_min_rad_s2(&self, way_rad: f64) -> Option<f64> {
        let speed_rad_s = self.speed_rad_s;
        let braking_rad = way_rad - speed_rad_s * INPUT_S;
        let alone = 0.5 * speed_rad_s / self.part;
        (braking_rad > 0.0).then(|| speed_rad_s * alone.max(self.beside_rad_s) / braking_rad)
    }
}

/// What an axis does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// It has no switch, or its turn has not come.
    Waiting,
    /// Off a switch that was open at the start.
    Clear,
    /// Towards the switch at the search speed.
    Seek,
    /// Off the switch.
    PullOff,
    /// Towards the switch at the latch speed.
    Latch,
    /// Off the switch again.
    Leave,
    /// Off the switch; its position is known.
    Done,
}

/// The state of a switch, freed from bouncing.
#[derive(Clone, Copy, Debug, Default)]
struct Switch {
    is_open: bool,
    /// Milliseconds for which the input has had the other state.
    other_ms: u8,
    /// The axis's position when it changed, increments, and its setpoint, rad.
    changed_at: i64,
    changed_rad: f64,
}

impl Switch {
    fn step(&mut self, is_open: bool, increments: i64, setpoint_rad: f64) {
        if is_open == self.is_open {
            self.other_ms = 0;
            return;
        }
        if self.other_ms == 0 {
            (self.changed_at, self.changed_rad) = (increments, setpoint_rad);
        }
        self.other_ms += 1;
        if self.other_ms >= STEADY_MS {
            (self.is_open, self.other_ms) = (is_open, 0);
        }
    }
}

/// The search of one axis, or of a slide that two axes move together.
#[derive(Clone, Copy, Debug)]
struct AxisSearch {
    home: HomeSwitch,
    acceleration_rad_s2: f64,
    phase: Phase,
    switch: Switch,
    is_known: bool,
    position_rad: f64,
    velocity_rad_s: f64,
    /// Where the phase began.
    begun_rad: f64,
    /// Where the switch closed in this phase.
    closed_rad: Option<f64>,
    /// Whether the axis is to stop, which ends the phase.
    stops: bool,
    /// Where the first approach found the switch, by the setpoint, rad.
    first_rad: f64,
    /// Position of the switch, increments.
    edge: Option<i64>,
}

impl AxisSearch {
    fn new(axis: &Axis, acceleration_rad_s2: f64, position_rad: f64) -> Self {
        Self {
            home: axis.home,
            acceleration_rad_s2,
            phase: Phase::Waiting,
            switch: Switch::default(),
            is_known: false,
            position_rad,
            velocity_rad_s: 0.0,
            begun_rad: position_rad,
            closed_rad: None,
            stops: false,
            first_rad: position_rad,
            edge: None,
        }
    }

    fn is_over(&self) -> bool {
        self.home.io.is_none() || self.phase == Phase::Done
    }

    fn enter(&mut self, phase: Phase) {
        self.phase = phase;
        (self.begun_rad, self.closed_rad, self.stops) = (self.position_rad, None, false);
    }

    /// Advances by a millisecond. `is_open` is the switch's input; `increments` the axis's position.
    fn step(&mut self, is_open: Option<bool>, increments: i64) -> Result<(), SearchFailure> {
        let is_open = is_open.ok_or(SearchFailure::Missing)?;
        if !self.is_known {
            self.is_known = true;
            self.switch.is_open = is_open;
        }
        self.switch.step(is_open, increments, self.position_rad);
        match self.phase {
            Phase::Waiting => {
                let first = if self.switch.is_open { Phase::Clear } else { Phase::Seek };
                self.enter(first);
            }
            Phase::Clear | Phase::PullOff | Phase::Leave => self.leave()?,
            Phase::Seek => {
                self.seek(self.home.travel_max_rad)?;
                if self.stops {
                    self.first_rad = self.switch.changed_rad;
                }
            }
            Phase::Latch => self.latch()?,
            Phase::Done => {}
        }
        self.advance();
        Ok(())
    }

    /// Decides where an approach ends.
    fn seek(&mut self, travel_max_rad: f64) -> Result<(), SearchFailure> {
        self.stops |= self.switch.is_open;
        let travelled_rad = (self.position_rad - self.begun_rad).abs();
        match self.stops || travelled_rad <= travel_max_rad {
            true => Ok(()),
            false => Err(SearchFailure::NeverOpens),
        }
    }

    /// Takes the place where the slow approach finds the switch. One that is open at its start has not been left, and one
    /// that was found elsewhere at the first approach cannot be relied on.
    fn latch(&mut self) -> Result<(), SearchFailure> {
        if self.switch.is_open && self.position_rad == self.begun_rad {
            return Err(SearchFailure::StaysOpen);
        }
        self.seek(self.leaving_max_rad())?;
        if self.stops && self.edge.is_none() {
            let apart_rad = (self.switch.changed_rad - self.first_rad).abs();
            if apart_rad > self.home.speed_rad_s.abs() * INPUT_S + AGREED_PART * self.home.pull_off_rad {
                return Err(SearchFailure::Differs);
            }
            self.edge = Some(self.switch.changed_at);
        }
        Ok(())
    }

    /// Decides where the way off the switch ends.
    fn leave(&mut self) -> Result<(), SearchFailure> {
        match self.switch.is_open {
            true if !self.stops => self.closed_rad = None,
            true => {}
            false => _ = self.closed_rad.get_or_insert(self.position_rad),
        }
        let travelled_rad = |from_rad: f64| (self.position_rad - from_rad).abs();
        match self.closed_rad {
            Some(closed_rad) => self.stops |= travelled_rad(closed_rad) >= self.home.pull_off_rad,
            None if travelled_rad(self.begun_rad) > self.leaving_max_rad() => return Err(SearchFailure::StaysOpen),
            None => {}
        }
        Ok(())
    }

    /// Longest way until the switch closes: a multiple of the way kept off it, and what the axis needs to stop.
    fn leaving_max_rad(&self) -> f64 {
        let speed = self.home.speed_rad_s;
        LEAVING_MAX * self.home.pull_off_rad + speed * speed / self.acceleration_rad_s2
    }

    /// Moves the setpoint by a millisecond; at rest at its end, the next phase begins.
    fn advance(&mut self) {
        let towards = self.home.speed_rad_s;
        let wanted_rad_s = match self.phase {
            _ if self.stops => 0.0,
            Phase::Waiting | Phase::Done => 0.0,
            Phase::Seek => towards,
            Phase::Latch => self.home.latch_rad_s.abs().copysign(towards),
            Phase::Clear | Phase::PullOff | Phase::Leave => -towards,
        };
        let most = self.acceleration_rad_s2 * CYCLE_S;
        self.velocity_rad_s += (wanted_rad_s - self.velocity_rad_s).max(-most).min(most);
        self.position_rad += self.velocity_rad_s * CYCLE_S;
        if self.stops && self.velocity_rad_s == 0.0 {
            let next = match self.phase {
                Phase::Clear => Phase::Seek,
                Phase::Seek => Phase::PullOff,
                Phase::PullOff => Phase::Latch,
                Phase::Latch => Phase::Leave,
                Phase::Waiting | Phase::Leave | Phase::Done => Phase::Done,
            };
            self.enter(next);
        }
    }
}

/// A search of all axes that have a switch.
#[derive(Clone, Debug)]
pub(super) struct Search {
    kind: Kind,
    axes: [AxisSearch; AXES],
    rest_ms: u16,
    /// Whether the search was ended early: the axes stop.
    is_cancelled: bool,
}

/// Increments of the first axis for one of the second, where they move together.
fn ratio([first, second, ..]: &[Axis; AXES]) -> f64 {
    let per_turn = |axis: &Axis| axis.gear * f64::from(axis.increments_per_revolution);
    per_turn(first) / per_turn(second)
}

/// What a millisecond of a search gives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Found {
    /// The next setpoint.
    Setpoint(Setpoint),
    /// The search is over and the axes are at rest: positions of the switches, increments. `None` if it was cancelled.
    End(Option<[Option<i64>; AXES]>),
}

impl Search {
    /// A search of the first `used` axes that begins at this pose, at rest.
    pub(super) fn new(kind: Kind, axes: &[Axis; AXES], used: usize, pose_rad: &[f64; AXES]) -> Self {
        let slides_rad = kind.slides(*pose_rad);
        let mut searches = core::array::from_fn(|axis| {
            let acceleration_rad_s2 = Approach::of(kind, axes, axis).deceleration_rad_s2();
            AxisSearch::new(&axes[axis], acceleration_rad_s2, slides_rad[axis])
        });
        searches.iter_mut().skip(used).for_each(|axis| axis.home.io = None);
        Self {
            kind,
            axes: searches,
            rest_ms: 0,
            is_cancelled: false,
        }
    }

    /// Whether a search that has ended may wait for positions.
    pub(super) fn may_wait(&self) -> bool {
        self.rest_ms < REST_MAX_MS
    }

    /// Ends the search early.
    pub(super) fn cancel(&mut self) {
        self.is_cancelled = true;
    }

    /// The axes' pose at present, as a setpoint.
    pub(super) fn setpoint(&self) -> Setpoint {
        Setpoint {
            position_rad: self.kind.joints(self.axes.each_ref().map(|axis| axis.position_rad)),
            velocity_rad_s: self.kind.joints(self.axes.each_ref().map(|axis| axis.velocity_rad_s)),
            ..Setpoint::default()
        }
    }

    /// Positions of what is led to the switches, from those of the axes, increments. Two axes that move together have their
    /// sum and their difference, in increments of the first.
    fn slides(&self, axes: &[Axis; AXES], increments: &[i64; AXES]) -> [i64; AXES] {
        let [first, second, third, fourth] = *increments;
        match self.kind.coupled_axes() {
            0 => *increments,
            _ => {
                let second = libm::round(second as f64 * ratio(axes)) as i64;
                [first + second, first - second, third, fourth]
            }
        }
    }

    /// The position of each axis at its place in the configuration, increments; `None` for one without a switch. Two axes that
    /// move together are at theirs where both switches open.
    fn edges(&self, axes: &[Axis; AXES]) -> [Option<i64>; AXES] {
        let edges = self.axes.each_ref().map(|axis| axis.edge);
        match (self.kind.coupled_axes(), edges) {
            (1.., [Some(sum), Some(difference), third, fourth]) => {
                let second = (sum - difference) as f64 / (2.0 * ratio(axes));
                let [first, second] = [0.5 * (sum + difference) as f64, second].map(|place| libm::round(place) as i64);
                [Some(first), Some(second), third, fourth]
            }
            _ => edges,
        }
    }

    /// Advances by a millisecond. `axes` are those of the start; `is_open` tells the state of an input of the configuration,
    /// `None` for one that does not arrive.
    ///
    /// # Errors
    /// The axis, from 0, whose search has failed.
    pub(super) fn step(
        &mut self,
        axes: &[Axis; AXES],
        is_open: impl Fn(u8) -> Option<bool>,
        increments: &[i64; AXES],
    ) -> Result<Found, (u8, SearchFailure)> {
        let order = self
            .axes
            .iter()
            .filter(|axis| !axis.is_over())
            .map(|axis| axis.home.order)
            .min();
        let slides = self.slides(axes, increments);
        for (number, (axis, increments)) in (0..).zip(self.axes.iter_mut().zip(slides)) {
            let Some(io) = axis.home.io.filter(|_| Some(axis.home.order) == order) else {
                continue;
            };
            if self.is_cancelled {
                axis.stops = true;
                axis.phase = if axis.velocity_rad_s == 0.0 {
                    Phase::Done
                } else {
                    axis.phase
                };
                axis.advance();
            } else if !axis.is_over() {
                axis.step(is_open(io), increments)
                    .map_err(|failure| (number, failure))?;
            }
        }
        if order.is_some() && !(self.is_cancelled && self.axes.iter().all(|axis| axis.velocity_rad_s == 0.0)) {
            return Ok(Found::Setpoint(self.setpoint()));
        }
        self.rest_ms += 1;
        if self.rest_ms < REST_MS {
            return Ok(Found::Setpoint(self.setpoint()));
        }
        Ok(Found::End((!self.is_cancelled).then(|| self.edges(axes))))
    }
}

#[cfg(test)]
mod tests;
