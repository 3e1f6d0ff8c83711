//! What is disturbed: feedback, machine, drives, references.
//!
//! A disturbance lasts until its end and for [`SETTLE_MS`] more.

use crate::bounds::SETTLE_MS;
use crate::cell::{AXES_MAX, Cell};
use crate::moment::{Command, Input, Mode, Report};
use crate::motion::Motion;
use crate::robot::MAIN_AXES;

/// Part of half a motor turn up to which a reference is certain: near the middle between two turns either may be taken.
const CERTAIN_PART: f64 = 0.98;

/// Longest time from the order of a search to the report that the joints are not known, ms: the order is answered within
/// a second, or its answer was lost.
const SEARCH_MAX_MS: u64 = 1_500;

/// How long the emergency-stop input has to be open to be a disturbance, ms: one less than the shortest stop.
const OPEN_MS: u64 = 2;

/// How far a search for the home switches is, which shows where the joints are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Search {
    /// There is none.
    #[default]
    None,
    /// It was ordered at this time, ms; the joints may still count as known.
    Ordered(u64),
    /// It began at this time, ms; the joints may still count as known.
    Accepted(u64),
    /// The joints do not count as known.
    UnderWay,
}

/// What is disturbed.
#[derive(Clone, Debug, Default)]
pub(crate) struct Disturbances {
    feedback: [bool; AXES_MAX],
    deaf: [bool; AXES_MAX],
    machine: bool,
    open_since_ms: Option<u64>,
    is_clock_failed: bool,
    /// Whether the reference is not the true one: it was taken on a wrong motor turn.
    misreferenced: bool,
    /// The value before the last command to home, while that is not answered.
    before_homing: Option<bool>,
    search: Search,
    /// Whether a feedback was not true in the search, and since the last order to search.
    is_search_false: bool,
    is_order_false: bool,
    /// Whether an order to search is not answered.
    is_search_asked: bool,
    feedback_ms: Option<u64>,
    machine_ms: Option<u64>,
    opened_ms: Option<u64>,
    deaf_ms: [Option<u64>; AXES_MAX],
    now_ms: u64,
    // What the methods below tell: many rules ask.
    has_false_feedback: bool,
    has_deaf_drive: bool,
    is_disturbed: bool,
    may_be_stopped: bool,
}

impl Disturbances {
    pub(crate) fn step(&mut self, now_ms: u64) {
        self.now_ms = now_ms;
        if self.feedback.contains(&true) {
            self.feedback_ms = Some(now_ms);
            self.search_by_untrue_feedback();
        }
        if let Search::Ordered(since_ms) | Search::Accepted(since_ms) = self.search
            && now_ms.saturating_sub(since_ms) > SEARCH_MAX_MS
        {
            self.search = Search::None;
        }
        if self.machine {
            self.machine_ms = Some(now_ms);
        }
        let is_long = |since_ms: u64| now_ms.saturating_sub(since_ms) >= OPEN_MS;
        if self.is_clock_failed || self.open_since_ms.is_some_and(is_long) {
            self.opened_ms = Some(now_ms);
        }
        for (since, deaf) in self.deaf_ms.iter_mut().zip(self.deaf) {
            if deaf {
                *since = Some(now_ms);
            }
        }
        self.has_false_feedback = self.recent(self.feedback_ms);
        self.may_be_stopped = self.recent(self.opened_ms);
        self.has_deaf_drive = self.deaf_ms.iter().any(|since_ms| self.recent(*since_ms));
        self.is_disturbed = self.recent(self.machine_ms) || self.has_deaf_drive;
    }

    pub(crate) fn take(&mut self, cell: &Cell, motion: &Motion, input: &Input) {
        match *input {
            Input::Feedback { axis, disturbed } => {
                if let Some(flag) = self.feedback.get_mut(axis) {
                    *flag = disturbed;
                    self.feedback_ms = if disturbed {
                        Some(motion.now_ms)
                    } else {
                        self.feedback_ms
                    };
                }
            }
            Input::Mounted { axis } => {
                if let Some(flag) = self.feedback.get_mut(axis) {
                    (*flag, self.misreferenced) = (false, true);
                    self.before_homing = self.before_homing.map(|_| true);
                    self.search_by_untrue_feedback();
                }
            }
            Input::Drive { axis, deaf } => {
                if let (Some(flag), Some(since_ms)) = (self.deaf.get_mut(axis), self.deaf_ms.get_mut(axis)) {
                    *flag = deaf;
                    *since_ms = if deaf { Some(motion.now_ms) } else { *since_ms };
                }
            }
            Input::Machine { disturbed } => {
                self.machine = disturbed;
                if disturbed {
                    // It counts even if it ends in the same millisecond.
                    self.machine_ms = Some(motion.now_ms);
                }
            }
            Input::StopInput(true) => _ = self.open_since_ms.get_or_insert(motion.now_ms),
            Input::StopInput(false) => self.open_since_ms = None,
            Input::ClockFailed(is_failed) => {
                self.is_clock_failed = is_failed;
                if is_failed {
                    self.opened_ms = Some(motion.now_ms);
                }
            }
            Input::Commanded(Command::Home) => self.home(is_off(cell, motion, |axis| cell.joints[axis].mark_rad)),
            Input::Commanded(Command::HomeAt { pose_rad }) => {
                self.home(is_off(cell, motion, |axis| {
                    pose_rad.get(axis).copied().unwrap_or(f64::NAN)
                }));
            }
            Input::Commanded(Command::Search) => {
                let begins = self.search == Search::None;
                self.search = match self.search {
                    Search::None => Search::Ordered(motion.now_ms),
                    search => search,
                };
                // One that goes on is refused when it is ordered again, and stays what it was.
                let asked = std::mem::replace(&mut self.is_search_asked, true);
                self.is_order_false = self.feedback.contains(&true) || asked && self.is_order_false;
                self.is_search_false = self.is_order_false || !begins && self.is_search_false;
            }
            Input::Restarted => {
                (self.misreferenced, self.before_homing) = (false, None);
                (self.search, self.is_search_asked) = (Search::None, false);
            }
            _ => {}
        }
    }

    pub(crate) fn hear(&mut self, report: &Report) {
        match report {
            Report::Refused(Command::Search) => {
                self.is_search_asked = false;
                if matches!(self.search, Search::Ordered(_)) {
                    self.search = Search::None;
                }
            }
            // It is a new search: an order that is repeated in one is refused. A stop may have ended the one before.
            Report::Accepted(Command::Search) => {
                if self.search != Search::UnderWay {
                    self.search = Search::Accepted(self.now_ms);
                }
                (self.is_search_false, self.is_search_asked) = (self.is_order_false, false);
            }
            Report::Mode(Mode::Homing) if self.search != Search::UnderWay => {
                self.search = Search::Accepted(self.now_ms);
            }
            Report::Homed(false) if self.search != Search::None => self.search = Search::UnderWay,
            Report::Homed(true) if self.search == Search::UnderWay => {
                self.search = Search::None;
                (self.misreferenced, self.before_homing) = (self.is_search_false, None);
            }
            Report::Accepted(Command::Home | Command::HomeAt { .. }) => {
                (self.before_homing, self.search) = (None, Search::None);
            }
            Report::Refused(Command::Home | Command::HomeAt { .. }) => {
                if let Some(before) = self.before_homing.take() {
                    self.misreferenced = before;
                }
            }
            _ => {}
        }
    }

    fn search_by_untrue_feedback(&mut self) {
        self.is_search_false |= self.search != Search::None;
        self.is_order_false = true;
    }

    fn home(&mut self, is_off: bool) {
        self.before_homing.get_or_insert(self.misreferenced);
        // What is not true when the reference is taken makes the reference untrue.
        self.misreferenced = is_off || self.feedback.contains(&true);
    }

    fn recent(&self, since_ms: Option<u64>) -> bool {
        since_ms.is_some_and(|since_ms| self.now_ms.saturating_sub(since_ms) <= SETTLE_MS)
    }

    /// Whether an axis shows a position that is not true, or did a moment ago.
    pub(crate) fn feedback(&self) -> bool {
        self.has_false_feedback
    }

    /// Whether frames, slaves or drives are disturbed, or were a moment ago.
    pub(crate) fn machine_disturbed(&self) -> bool {
        self.is_disturbed
    }

    /// Whether the drive of an axis cannot obey, or could not a moment ago.
    pub(crate) fn deaf(&self, axis: usize) -> bool {
        self.deaf_ms.get(axis).is_some_and(|since_ms| self.recent(*since_ms))
    }

    /// Whether the axes may be on their way to their home switches, from wherever they are.
    pub(crate) fn searches(&self) -> bool {
        self.search != Search::None
    }

    /// Whether the controller cannot know where the joints are.
    pub(crate) fn misreferenced(&self) -> bool {
        self.misreferenced || self.before_homing == Some(true)
    }

    /// Whether the controller may believe the joints to be where they are not.
    pub(crate) fn is_misled(&self) -> bool {
        self.feedback() || self.misreferenced()
    }

    /// Whether motors may move otherwise than the controller believes.
    pub(crate) fn moves_astray(&self) -> bool {
        self.is_misled() || self.has_deaf_drive
    }

    /// Whether the emergency-stop input was open so long, or the board's clock source failed, that the controller may be
    /// stopping without having told it.
    pub(crate) fn may_be_stopped(&self) -> bool {
        self.may_be_stopped
    }

    /// Whether joints may be faster than ordered.
    pub(crate) fn may_race(&self) -> bool {
        self.feedback() || self.machine_disturbed() || self.misreferenced()
    }

    /// Whether nothing is disturbed, now and a moment ago.
    pub(crate) fn none(&self) -> bool {
        !self.may_race() && !self.may_be_stopped()
    }
}

/// Whether homing near these angles takes a wrong motor turn of a main axis.
fn is_off(cell: &Cell, motion: &Motion, near: impl Fn(usize) -> f64) -> bool {
    motion.each_axis().take(MAIN_AXES).any(|axis| {
        let sure = 0.5 * CERTAIN_PART * cell.joints[axis].turn_rad.abs();
        let away = (motion.angles_rad[axis] - near(axis)).abs();
        away.is_nan() || away >= sure
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disturbance_settles_after_its_end() {
        let (cell, motion) = (Cell::default(), Motion::default());
        let mut disturbances = Disturbances::default();
        assert!(disturbances.none());
        disturbances.take(
            &cell,
            &motion,
            &Input::Feedback {
                axis: 1,
                disturbed: true,
            },
        );
        disturbances.take(
            &cell,
            &motion,
            &Input::Feedback {
                axis: 99,
                disturbed: true,
            },
        );
        disturbances.step(5);
        assert!(disturbances.feedback() && !disturbances.machine_disturbed());
        disturbances.take(
            &cell,
            &motion,
            &Input::Feedback {
                axis: 1,
                disturbed: false,
            },
        );
        disturbances.step(5 + SETTLE_MS);
        assert!(disturbances.feedback());
        disturbances.step(6 + SETTLE_MS);
        assert!(disturbances.none());
    }

    #[test]
    fn a_disturbance_that_ends_in_its_millisecond_counts() {
        let (cell, motion) = (Cell::default(), Motion::default());
        let mut disturbances = Disturbances::default();
        for disturbed in [true, false] {
            disturbances.take(&cell, &motion, &Input::Machine { disturbed });
        }
        disturbances.step(0);
        assert!(disturbances.machine_disturbed() && disturbances.may_race());
    }

    #[test]
    fn a_robot_whose_encoder_was_mounted_again_is_misled_until_it_is_homed_and_no_longer() {
        let (cell, motion) = (Cell::default(), Motion::default());
        let (home, search) = (Input::Commanded(Command::Home), Input::Commanded(Command::Search));
        let mut disturbances = Disturbances::default();
        let untrue = |disturbances: &mut Disturbances, mounted: bool| {
            let disturbed = Input::Feedback {
                axis: 1,
                disturbed: true,
            };
            disturbances.take(&cell, &motion, &disturbed);
            disturbances.step(10);
            if mounted {
                disturbances.take(&cell, &motion, &Input::Mounted { axis: 1 });
                disturbances.step(11 + SETTLE_MS);
                assert!(!disturbances.feedback() && disturbances.is_misled());
            }
        };
        untrue(&mut disturbances, true);
        disturbances.take(&cell, &motion, &home);
        disturbances.hear(&Report::Refused(Command::Home));
        assert!(disturbances.is_misled(), "refused");
        disturbances.take(&cell, &motion, &home);
        disturbances.hear(&Report::Accepted(Command::Home));
        assert!(disturbances.none(), "homed");
        for mounted_in_search in [true, false] {
            untrue(&mut disturbances, !mounted_in_search);
            disturbances.take(&cell, &motion, &search);
            disturbances.hear(&Report::Accepted(Command::Search));
            disturbances.hear(&Report::Homed(false));
            if mounted_in_search {
                disturbances.take(&cell, &motion, &Input::Mounted { axis: 1 });
            }
            disturbances.take(&cell, &motion, &search);
            disturbances.hear(&Report::Refused(Command::Search));
            disturbances.step(100 + 2 * SETTLE_MS);
            disturbances.hear(&Report::Homed(true));
            assert_eq!(disturbances.none(), !mounted_in_search);
        }
    }

    #[test]
    fn a_search_that_a_stop_ended_makes_the_next_one_no_less_true() {
        let (cell, motion) = (Cell::default(), Motion::default());
        let order = Input::Commanded(Command::Search);
        let feedback = |disturbed| Input::Feedback { axis: 1, disturbed };
        for ends in [Command::Search, Command::Home] {
            for is_untrue_again in [false, true] {
                let mut disturbances = Disturbances::default();
                let begin = |disturbances: &mut Disturbances, ended: Command| {
                    disturbances.take(&cell, &motion, &Input::Commanded(ended));
                    disturbances.hear(&Report::Accepted(ended));
                    disturbances.hear(&Report::Homed(false));
                };
                disturbances.take(&cell, &motion, &order);
                begin(&mut disturbances, Command::Search);
                disturbances.take(&cell, &motion, &feedback(true));
                disturbances.step(10);
                for report in [Mode::Fault, Mode::DrivesOff, Mode::Unreferenced].map(Report::Mode) {
                    disturbances.hear(&report);
                }
                disturbances.take(&cell, &motion, &feedback(false));
                disturbances.step(100 + SETTLE_MS);
                begin(&mut disturbances, ends);
                let in_search = is_untrue_again && ends == Command::Search;
                if in_search {
                    disturbances.take(&cell, &motion, &feedback(true));
                    disturbances.step(200 + SETTLE_MS);
                    disturbances.take(&cell, &motion, &feedback(false));
                }
                disturbances.step(300 + 2 * SETTLE_MS);
                disturbances.hear(&Report::Homed(true));
                assert_eq!(disturbances.none(), !in_search, "{ends:?}");
            }
        }
    }

    #[test]
    fn a_search_goes_on_whatever_is_refused_beside_it() {
        let (cell, motion) = (Cell::default(), Motion::default());
        let order = Input::Commanded(Command::Search);
        let (accepted, refused) = (Report::Accepted(Command::Search), Report::Refused(Command::Search));
        let mut accepted_first = Disturbances::default();
        accepted_first.take(&cell, &motion, &order);
        accepted_first.hear(&accepted);
        accepted_first.take(&cell, &motion, &order);
        accepted_first.hear(&refused);
        assert!(accepted_first.searches());
        let mut answer_lost = Disturbances::default();
        answer_lost.take(&cell, &motion, &order);
        answer_lost.take(&cell, &motion, &order);
        answer_lost.hear(&refused);
        answer_lost.hear(&Report::Mode(Mode::Homing));
        answer_lost.hear(&Report::Homed(false));
        assert!(answer_lost.searches());
        let mut still_known = Disturbances::default();
        still_known.take(&cell, &motion, &order);
        for report in [
            &accepted,
            &Report::Mode(Mode::Homing),
            &Report::Homed(true),
            &Report::Homed(false),
        ] {
            still_known.hear(report);
            assert!(still_known.searches(), "{report:?}");
        }
        for mut disturbances in [accepted_first, answer_lost, still_known] {
            disturbances.hear(&Report::Homed(false));
            disturbances.step(2 * SEARCH_MAX_MS);
            assert!(disturbances.searches(), "it takes its time");
            disturbances.hear(&Report::Homed(true));
            assert!(!disturbances.searches());
        }
        let mut refused_alone = Disturbances::default();
        refused_alone.take(&cell, &motion, &order);
        refused_alone.hear(&refused);
        refused_alone.hear(&Report::Homed(false));
        assert!(!refused_alone.searches());
    }

    #[test]
    fn homing_on_a_wrong_turn_is_known_until_homed_where_the_joints_are() {
        let cell = Cell::default();
        let mut motion = Motion {
            axes: 4,
            ..Motion::default()
        };
        motion.angles_rad[0] = 0.3 + 0.27;
        (motion.angles_rad[1], motion.angles_rad[2]) = (0.3, 0.3);
        let mut disturbances = Disturbances::default();
        disturbances.take(&cell, &motion, &Input::Commanded(Command::Home));
        assert!(disturbances.misreferenced(), "0.27 rad are more than half of a turn");
        disturbances.hear(&Report::Refused(Command::Home));
        assert!(!disturbances.misreferenced(), "a refused command changes nothing");
        disturbances.take(&cell, &motion, &Input::Commanded(Command::Home));
        disturbances.hear(&Report::Accepted(Command::Home));
        let pose_rad = [0.57, 0.3, 0.3, 0.0];
        disturbances.take(&cell, &motion, &Input::Commanded(Command::HomeAt { pose_rad }));
        assert!(disturbances.misreferenced(), "not answered yet");
        disturbances.hear(&Report::Accepted(Command::HomeAt { pose_rad }));
        assert!(!disturbances.misreferenced());
    }
}
