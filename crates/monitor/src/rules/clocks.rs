//! Clocks: no distributed clock of a slave in OP jumps, and where nothing is disturbed they agree.
//!
//! A slave in OP takes its outputs by its clock, and its neighbours theirs: 1 us apart is what drives that share a load
//! tolerate. A crystal drifts by some ten parts per million and its control adds as much, some ten nanoseconds a
//! millisecond; what goes beyond [`JUMP_NS`] where nothing is disturbed was set, and moves the moment at which the drive acts.
//! After a loss of frames a clock follows the others at up to a tenth of its speed ([`CATCH_UP_NS`]). While a fault is
//! reported, also during its stop, and slaves or frames were disturbed, clocks need not agree: a slave that has returned in
//! front of the one that distributes its time waits for its repair, and until then it gets the time before its own. Its
//! repair takes that away ([`WAITED_NS`]). Whether a fault is latched is not known before a mode is heard again.

use crate::moment::{Mode, Moment, Report};
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// Farthest that two clocks may be apart, ns.
const APART_NS: u32 = 1_000;
/// Most that a clock may gain or lose on the true time from one moment to the next, ns.
const JUMP_NS: u32 = 1_000;
/// Most that a clock may gain or lose in a millisecond while something is disturbed, or was a moment ago, ns: what its control
/// loop corrects at most, and a tenth more.
const CATCH_UP_NS: u32 = 110_000;
/// Most that a clock may gain or lose by repairs while a fault is latched and nothing is disturbed, ns: the way of a frame to
/// the slave that distributes its time, and as much again.
const WAITED_NS: u32 = 10_000;
/// Time for which nothing must have been disturbed before clocks have to agree, ms.
const QUIET_MS: u32 = 1_000;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Clocks {
    quiet_ms: u32,
    before: Vec<Option<u64>>,
    before_ns: u64,
    /// Whether slaves or frames were disturbed since the clocks last had to agree, and did.
    may_wait: bool,
    /// Whether a mode was heard since, once what was disturbed had been quiet for half of [`QUIET_MS`].
    is_told: bool,
    /// What each clock has gained or lost by repairs since something was disturbed, ns.
    repaired_ns: Vec<u32>,
}

impl Clocks {
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let moment = scene.moment;
        self.quiet_ms = if scene.is_sound() {
            self.quiet_ms.saturating_add(1)
        } else {
            0
        };
        if scene.disturbances.machine_disturbed() {
            (self.may_wait, self.is_told) = (true, false);
        }
        let has_mode = moment.reports.iter().any(|report| matches!(report, Report::Mode(_)));
        self.is_told |= has_mode && self.quiet_ms > QUIET_MS / 2;
        let is_fault = scene.orders.fault_reported || scene.orders.mode == Some(Mode::Fault);
        let waits = self.may_wait && (is_fault || !self.is_told);
        let agreement = if waits { Ok(()) } else { self.agree(moment) };
        if !waits && self.quiet_ms > QUIET_MS && agreement.is_ok() {
            self.may_wait = false;
        }
        let finding = self.jumps(moment, waits).and(agreement);
        self.before.clear();
        self.before.extend_from_slice(moment.clocks.system_ns);
        self.before_ns = moment.clocks.time_ns;
        finding
    }

    fn jumps(&mut self, moment: &Moment<'_>, waits: bool) -> Finding {
        let passed_ns = moment.clocks.time_ns.wrapping_sub(self.before_ns);
        let is_quiet = self.quiet_ms > QUIET_MS;
        if !(is_quiet && waits) {
            self.repaired_ns.clear();
        }
        self.repaired_ns.resize(moment.clocks.system_ns.len(), 0);
        let clocks = moment.clocks.system_ns.iter().zip(&self.before);
        for (slave, ((now, before), repaired_ns)) in clocks.zip(&mut self.repaired_ns).enumerate() {
            let (Some(now), Some(before)) = (now, before) else {
                continue;
            };
            let gained_ns = difference_ns(now.wrapping_sub(*before), passed_ns);
            let most_ns = match is_quiet {
                true if waits && gained_ns.unsigned_abs() > JUMP_NS => {
                    *repaired_ns = repaired_ns.saturating_add(gained_ns.unsigned_abs());
                    match *repaired_ns <= WAITED_NS {
                        true => WAITED_NS,
                        false => JUMP_NS,
                    }
                }
                true => JUMP_NS,
                false => CATCH_UP_NS,
            };
            if gained_ns.unsigned_abs() > most_ns {
                let text = format!("the clock of slave {} in OP jumped by {gained_ns} ns", slave + 1);
                return Err((Rule::Clocks, text));
            }
        }
        Ok(())
    }

    fn agree(&self, moment: &Moment<'_>) -> Finding {
        let mut clocks = (1..)
            .zip(moment.clocks.system_ns)
            .filter_map(|(slave, clock)| Some((slave, (*clock)?)));
        let Some((first, first_ns)) = clocks.next().filter(|_| self.quiet_ms > QUIET_MS) else {
            return Ok(());
        };
        let (mut least, mut most) = ((first, 0_i32), (first, 0));
        for (slave, ns) in clocks {
            let ahead_ns = difference_ns(ns, first_ns);
            if ahead_ns < least.1 {
                least = (slave, ahead_ns);
            }
            if ahead_ns > most.1 {
                most = (slave, ahead_ns);
            }
        }
        let apart_ns = most.1.abs_diff(least.1);
        match apart_ns > APART_NS {
            true => {
                let text = format!(
                    "the clock of slave {} is {apart_ns} ns ahead of that of slave {}",
                    most.0, least.0
                );
                Err((Rule::Clocks, text))
            }
            false => Ok(()),
        }
    }
}

/// Difference of two times by their lower 32 bits, ns.
fn difference_ns(one: u64, other: u64) -> i32 {
    one.wrapping_sub(other) as u32 as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Rig, broken};

    /// Three slaves whose clocks go right from now on, two of them by so many nanoseconds wrong, for some milliseconds.
    fn run(apart_ns: i64, ms: u64) -> Result<(), crate::violation::Violation> {
        let mut rig = Rig::idle();
        let start_ns = u64::from(u32::MAX) - 2_000_000;
        for passed in 1..=ms {
            let right_ns = start_ns + passed * 1_000_000;
            // The second slave's clock has 32 bits.
            let wrong_ns = right_ns.wrapping_add_signed(apart_ns);
            rig.clocks_ns = vec![
                None,
                Some(right_ns),
                Some(wrong_ns & u64::from(u32::MAX)),
                Some(wrong_ns),
            ];
            rig.step()?;
        }
        Ok(())
    }

    #[test]
    fn clocks_that_stay_apart_are_noticed_once_nothing_was_disturbed_for_a_second() {
        assert_eq!(run(900, 1_200), Ok(()));
        assert_eq!(run(-900, 1_200), Ok(()));
        for apart_ns in [1_100, -1_100] {
            assert!(broken(&run(apart_ns, 1_200), Rule::Clocks));
        }
    }

    #[test]
    fn clocks_that_wait_for_a_repair_agree_again_once_the_fault_is_acknowledged() {
        // Slaves were disturbed before the fault, in it, or never.
        for disturbed in [Some(0), Some(1), None] {
            let mut rig = Rig::idle();
            rig.power(false);
            let mut run = |mode: Mode, fault: Option<&str>, ms: core::ops::Range<u64>, ahead_ns: u64| {
                rig.report(Report::Mode(mode));
                rig.report(Report::Fault(fault.map(str::to_owned)));
                ms.into_iter().try_for_each(|ms| {
                    let right_ns = 1_000_000_000 + ms * 1_000_000;
                    rig.clocks_ns = vec![Some(right_ns + ahead_ns), Some(right_ns)];
                    if ms < 3 {
                        rig.disturb_machine(disturbed == Some(ms));
                    }
                    rig.step()
                })
            };
            let fault = Some("a slave is lost");
            assert_eq!(run(Mode::DrivesOff, None, 0..1, 0), Ok(()));
            let stops = run(Mode::Stopping, fault, 1..1_500, 2_300);
            let waits = stops.and_then(|()| run(Mode::Fault, fault, 1_500..2_500, 2_300));
            if disturbed.is_none() {
                assert!(broken(&waits, Rule::Clocks), "{waits:?}");
                continue;
            }
            assert_eq!(waits, Ok(()));
            assert_eq!(run(Mode::Fault, fault, 2_500..2_600, 0), Ok(()), "its repair");
            assert_eq!(run(Mode::Fault, fault, 2_600..2_700, 2_300), Ok(()));
            assert!(broken(&run(Mode::DrivesOff, None, 2_700..4_700, 2_300), Rule::Clocks));
        }
    }

    #[test]
    fn a_fault_whose_report_is_lost_on_the_line_may_let_a_clock_wait_until_the_line_is_heard_again() {
        for mode in [Mode::Fault, Mode::Idle] {
            let mut rig = Rig::idle();
            rig.disturb_machine(true);
            let mut run = |ms: core::ops::Range<u64>| {
                ms.into_iter().try_for_each(|ms| {
                    let right_ns = 1_000_000_000 + ms * 1_000_000;
                    rig.clocks_ns = vec![Some(right_ns + 2_300), Some(right_ns)];
                    match ms {
                        1 => rig.disturb_machine(false),
                        4_000 => rig.report(Report::Mode(mode)),
                        _ => {}
                    }
                    rig.step()
                })
            };
            assert_eq!(run(0..4_000), Ok(()));
            assert_eq!(run(4_000..4_100).is_ok(), mode == Mode::Fault);
        }
    }

    #[test]
    fn a_stop_without_a_fault_lets_no_clock_wait() {
        let mut rig = Rig::idle();
        rig.disturb_machine(true);
        let stops = (0..1_500_u64).try_for_each(|ms| {
            let right_ns = 1_000_000_000 + ms * 1_000_000;
            rig.clocks_ns = vec![Some(right_ns + 2_300), Some(right_ns)];
            match ms {
                1 => rig.disturb_machine(false),
                // A drawing is cancelled, or the drives are switched off.
                900 => rig.report(Report::Mode(Mode::Stopping)),
                _ => {}
            }
            rig.step()
        });
        assert!(broken(&stops, Rule::Clocks), "{stops:?}");
    }

    #[test]
    fn a_clock_that_is_set_again_and_again_while_a_fault_is_latched_is_noticed() {
        let mut rig = Rig::idle();
        rig.report(Report::Mode(Mode::Fault));
        rig.disturb_machine(true);
        let set = (0..3_000_u64).try_for_each(|ms| {
            let right_ns = 1_000_000_000 + ms * 1_000_000;
            let ahead_ns = if ms > 2_000 { 2_300 * (ms % 2) } else { 0 };
            rig.clocks_ns = vec![Some(right_ns + ahead_ns), Some(right_ns)];
            if ms == 1 {
                rig.disturb_machine(false);
            }
            rig.step()
        });
        assert!(broken(&set, Rule::Clocks), "{set:?}");
    }

    #[test]
    fn every_two_clocks_are_compared() {
        let run = |ahead_ns: [i64; 3]| {
            let mut rig = Rig::idle();
            (1..=1_200_u64).try_for_each(|ms| {
                let right_ns = 1_000_000_000 + ms * 1_000_000;
                rig.clocks_ns = ahead_ns.map(|ns| Some(right_ns.wrapping_add_signed(ns))).to_vec();
                rig.step()
            })
        };
        assert_eq!(run([0, 450, -450]), Ok(()));
        for ahead_ns in [[0, 600, -600], [0, -600, 600], [600, -600, 0], [-600, 0, 600]] {
            assert!(broken(&run(ahead_ns), Rule::Clocks), "{ahead_ns:?}");
        }
    }

    #[test]
    fn a_clock_that_jumps_in_op_is_noticed_at_once_and_one_that_was_out_of_op_may_be_set() {
        for (quiet_ms, little_ns, much_ns) in [(1_200, 900, 1_100), (0, 90_000, 120_000)] {
            let mut rig = Rig::idle();
            rig.clocks_ns = vec![None];
            for _ in 0..quiet_ms {
                assert_eq!(rig.step(), Ok(()));
            }
            let mut step = |clock_ns: Option<u64>| {
                rig.clocks_ns = vec![clock_ns];
                // Something is disturbed, or nothing for long.
                rig.disturb_machine(quiet_ms == 0);
                rig.step()
            };
            assert_eq!(step(Some(1_000_000)), Ok(()));
            assert_eq!(step(Some(2_000_000 + little_ns)), Ok(()));
            assert_eq!(step(None), Ok(()));
            assert_eq!(step(Some(500_000_000)), Ok(()));
            assert!(broken(&step(Some(501_000_000 + much_ns)), Rule::Clocks));
        }
    }
}
