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
mod tests {
    use super::*;
    use core::f64::consts::TAU;
    use proptest::prelude::*;

    const PER_RAD: f64 = 100_000.0;

    fn axis(io: u8, order: u8, speed_rad_s: f64) -> Axis {
        Axis {
            home: HomeSwitch {
                io: Some(io),
                order,
                speed_rad_s,
                ..HomeSwitch::default()
            },
            ..Axis::default()
        }
    }

    /// Steps a search whose motors follow exactly; switches are open beyond their places, rad, in the search's direction.
    fn run(axes: &[Axis; AXES], switches_rad: [f64; AXES]) -> (Result<Found, (u8, SearchFailure)>, [f64; AXES], u32) {
        let mut search = Search::new(Kind::Delta, axes, AXES, &[0.0; AXES]);
        let mut fastest = [0.0_f64; AXES];
        for ms in 0..600_000 {
            let pose = search.setpoint().position_rad;
            let is_open = |io: u8| {
                let axis = usize::from(io);
                let towards = axes[axis].home.speed_rad_s.signum();
                Some((pose[axis] - switches_rad[axis]) * towards >= 0.0)
            };
            let increments = pose.map(|rad| (rad * PER_RAD) as i64);
            let found = search.step(axes, is_open, &increments);
            match found {
                Ok(Found::Setpoint(setpoint)) => {
                    for (fastest, speed) in fastest.iter_mut().zip(setpoint.velocity_rad_s) {
                        *fastest = fastest.max(speed.abs());
                    }
                }
                end => return (end, fastest, ms),
            }
        }
        panic!("the search does not end");
    }

    fn edges(found: Result<Found, (u8, SearchFailure)>) -> [Option<f64>; AXES] {
        match found {
            Ok(Found::End(Some(edges))) => edges.map(|edge| edge.map(|increments| increments as f64 / PER_RAD)),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn each_switch_is_found_where_it_is_from_either_side_and_no_axis_is_faster_than_its_search() {
        let axes = [axis(0, 1, -0.5), axis(1, 0, 0.8), axis(2, 1, -0.3), Axis::default()];
        for switches_rad in [[-1.0, 2.0, -0.2, 0.0], [0.02, -0.04, 0.03, 0.0], [-3.0, 0.0, 0.0, 0.0]] {
            let (found, fastest, _) = run(&axes, switches_rad);
            let found = edges(found);
            for axis in 0..3 {
                let edge_rad = found[axis].expect("an edge");
                assert!(
                    (edge_rad - switches_rad[axis]).abs() < 2e-4,
                    "{edge_rad} for {switches_rad:?}"
                );
                assert!(fastest[axis] <= axes[axis].home.speed_rad_s.abs() + 1e-12);
            }
            assert_eq!((found[3], fastest[3]), (None, 0.0));
        }
    }

    #[test]
    fn a_switch_that_never_opens_stays_open_or_is_missing_ends_the_search_with_its_axis() {
        let axes = [axis(0, 0, -0.5), axis(1, 1, 0.8), Axis::default(), Axis::default()];
        let far = axes[0].home.travel_max_rad + 1.0;
        assert_eq!(run(&axes, [-far, 1.0, 0.0, 0.0]).0, Err((0, SearchFailure::NeverOpens)));
        // Open wherever the axis is: a broken wire.
        assert_eq!(run(&axes, [-0.1, -1e9, 0.0, 0.0]).0, Err((1, SearchFailure::StaysOpen)));
        let mut search = Search::new(Kind::Delta, &axes, AXES, &[0.0; AXES]);
        assert_eq!(
            search.step(&axes, |_| None, &[0; AXES]),
            Err((0, SearchFailure::Missing))
        );
    }

    #[test]
    fn a_loose_contact_and_a_flag_that_is_too_narrow_end_the_search_instead_of_giving_a_wrong_place() {
        let only = |is_open: &dyn Fn(u32, f64) -> bool| {
            let axes = [axis(0, 0, -0.5), Axis::default(), Axis::default(), Axis::default()];
            let mut search = Search::new(Kind::Delta, &axes, AXES, &[0.0; AXES]);
            for ms in 0..60_000 {
                let pose = search.setpoint().position_rad;
                let increments = pose.map(|rad| (rad * PER_RAD) as i64);
                match search.step(&axes, |_| Some(is_open(ms, pose[0])), &increments) {
                    Ok(Found::Setpoint(_)) => {}
                    end => return end,
                }
            }
            panic!("the search does not end");
        };
        // The way from the first place of the switch to the slow approach is 3 mm: a contact that opens there for 5 ms.
        let mut wrong = 0;
        for opens_ms in 0..9_000 {
            let found = only(&|ms, rad| rad <= -0.8 || (opens_ms..opens_ms + 5).contains(&ms));
            match found {
                Ok(Found::End(Some([Some(edge), ..]))) => {
                    let apart_rad = (edge as f64 / PER_RAD + 0.8).abs();
                    assert!(apart_rad < 0.018, "{opens_ms} ms: {apart_rad} rad");
                }
                Err((0, SearchFailure::Differs | SearchFailure::StaysOpen | SearchFailure::NeverOpens)) => wrong += 1,
                other => panic!("{opens_ms} ms: {other:?}"),
            }
        }
        assert!(wrong > 100, "{wrong}");
        // A flag that the first approach passes over: beyond it the contact is closed again.
        for width_rad in [0.001, 0.005, 0.01] {
            let found = only(&|_, rad| (-0.8 - width_rad..=-0.8).contains(&rad));
            assert!(
                matches!(
                    found,
                    Err((
                        0,
                        SearchFailure::Differs | SearchFailure::StaysOpen | SearchFailure::NeverOpens
                    ))
                ) || matches!(found, Ok(Found::End(Some([Some(edge), ..]))) if (edge as f64 / PER_RAD + 0.8).abs() < 0.018),
                "{width_rad} rad: {found:?}"
            );
        }
    }

    proptest! {
        /// Two belts that move two slides: the switches see the slides, and the drives count from anywhere, in units
        /// and directions of their own.
        #[test]
        fn two_switches_give_the_places_of_two_axes_that_move_together(
            places_rad in prop::array::uniform2(-4.0..4.0_f64),
            away_rad in prop::array::uniform2(-0.1..6.0_f64),
            counted_from in prop::array::uniform2(-1_000_000..1_000_000_i64),
            gears in prop::array::uniform2((0.5..20.0_f64, any::<bool>())),
            orders in prop::array::uniform2(0..2_u8),
            quick_stops in prop::array::uniform2(5.0..100.0_f64),
        ) {
            let gears = gears.map(|(gear, turned)| if turned { -gear } else { gear });
            let drive = |number: u8| Axis {
                gear: gears[usize::from(number)],
                increments_per_revolution: 100_000,
                quick_stop_rad_s2: quick_stops[usize::from(number)],
                ..axis(number, orders[usize::from(number)], if number == 0 { -0.5 } else { 0.4 })
            };
            let axes = [drive(0), drive(1), axis(2, 1, 0.2), Axis::default()];
            let per_rad = gears.map(|gear| gear * 100_000.0 / TAU);
            let mut search = Search::new(Kind::CoreXy, &axes, 3, &[0.7, -0.3, 0.0, 0.0]);
            let begun = search.setpoint().position_rad;
            let starts_rad = [places_rad[0] + away_rad[0], places_rad[1] - away_rad[1]];
            let first = Kind::CoreXy.joints([starts_rad[0], starts_rad[1], 0.0, 0.0]);
            let (mut edges, mut speeds_before) = (None, [0.0; AXES]);
            for _ in 0..100_000 {
                let commanded = search.setpoint();
                let speeds = commanded.velocity_rad_s;
                prop_assert!(speeds[0].abs() <= 0.9 + 1e-9 && speeds[1].abs() <= 0.9 + 1e-9, "{speeds:?}");
                for axis in 0..2 {
                    let acceleration = (speeds[axis] - speeds_before[axis]).abs() / CYCLE_S;
                    prop_assert!(acceleration <= 0.5 * quick_stops[axis] + 1e-6, "axis {axis}: {acceleration} rad/s2");
                }
                speeds_before = speeds;
                let joints: [f64; AXES] =
                    core::array::from_fn(|axis| first[axis] + commanded.position_rad[axis] - begun[axis]);
                let slides = [0.5 * (joints[0] + joints[1]), 0.5 * (joints[0] - joints[1])];
                let is_open = |io: u8| {
                    match usize::from(io) {
                        2 => Some(commanded.position_rad[2] >= 0.5),
                        axis => Some((slides[axis] - places_rad[axis]) * axes[axis].home.speed_rad_s >= 0.0),
                    }
                };
                let mut increments = [0; AXES];
                for axis in 0..2 {
                    increments[axis] = counted_from[axis] + (joints[axis] * per_rad[axis]) as i64;
                }
                increments[2] = (commanded.position_rad[2] * PER_RAD) as i64;
                if let Found::End(found) = search.step(&axes, is_open, &increments).expect("no switch fails") {
                    edges = found;
                    break;
                }
            }
            let edges = edges.expect("the search ends");
            let at_both = [places_rad[0] + places_rad[1], places_rad[0] - places_rad[1]];
            for axis in 0..2 {
                let edge = edges[axis].expect("a place") - counted_from[axis];
                let apart_rad = edge as f64 / per_rad[axis] - at_both[axis];
                // Each approach is seen a millisecond late at most, at 0.05 rad/s.
                prop_assert!(apart_rad.abs() < 3e-4, "axis {axis}: {apart_rad} rad");
            }
            let third = edges[2].expect("the height has a switch of its own");
            prop_assert!((third as f64 / PER_RAD - 0.5).abs() < 1e-3, "{}", third);
        }
    }

    #[test]
    fn a_cancelled_search_stops_all_axes_and_gives_no_position() {
        let axes = [axis(0, 0, -0.5), axis(1, 0, 0.8), Axis::default(), Axis::default()];
        for cancelled_ms in [0, 5, 400] {
            let mut search = Search::new(Kind::Delta, &axes, AXES, &[0.0; AXES]);
            for _ in 0..cancelled_ms {
                search.step(&axes, |_| Some(false), &[0; AXES]).unwrap();
            }
            search.cancel();
            let mut end = None;
            for _ in 0..200 {
                if let Found::End(found) = search.step(&axes, |_| Some(false), &[0; AXES]).unwrap() {
                    end = Some(found);
                    break;
                }
            }
            assert_eq!(end, Some(None));
            assert_eq!(search.setpoint().velocity_rad_s, [0.0; AXES]);
        }
    }

    #[test]
    fn a_bouncing_switch_gives_the_place_of_its_first_contact() {
        let mut switch = Switch::default();
        for (ms, is_open) in [true, false, true, true, true].into_iter().enumerate() {
            switch.step(is_open, ms as i64, 0.0);
        }
        assert_eq!((switch.is_open, switch.changed_at), (true, 2));
    }
}
