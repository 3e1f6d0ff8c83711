//! Noticed: a fault that the controller can notice is reported in time.
//!
//! Whoever injects faults tells which ones the controller can notice, how, and by when: only those of a machine that nothing
//! else disturbs. A command that may end the fault, or take a new reference, ends the demand, and so does anything that
//! may hide the fault before the time for its report. Angles that are not known may be told late, but before the controller
//! reports a mode without a fault. Only a report tells that the controller has missed one: a line that carries none is no failure.

use crate::moment::{Command, Input, Mode, Notice, Report};
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// What has to be reported.
#[derive(Clone, Copy, Debug)]
struct Demand {
    what: &'static str,
    by_ms: u64,
    notice: Notice,
    /// Whether the time for the report is over.
    is_due: bool,
}

impl Demand {
    /// Whether a command may change what is reported of the fault.
    fn ends_with(&self, command: Command) -> bool {
        match self.notice {
            Notice::Fault => matches!(
                command,
                Command::Stop | Command::Acknowledge | Command::Enable | Command::Disable
            ),
            Notice::Unhomed => matches!(command, Command::Home | Command::HomeAt { .. } | Command::Search),
        }
    }

    /// Whether something else may hide the fault: what has made the joint angles unknown stays so.
    fn can_be_hidden(&self) -> bool {
        self.notice == Notice::Fault || !self.is_due
    }

    /// Whether a report shows the fault; `None` if it tells nothing about it.
    fn is_shown(&self, report: &Report) -> Option<bool> {
        match (self.notice, report) {
            (Notice::Fault, Report::Fault(fault)) => Some(fault.is_some()),
            (Notice::Unhomed, Report::Homed(is_homed)) => Some(!is_homed),
            _ => None,
        }
    }
}

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Noticed {
    demand: Option<Demand>,
}

impl Noticed {
    pub(crate) fn take(&mut self, input: &Input) {
        match *input {
            Input::Noticeable { what, by_ms, notice } => {
                self.demand = Some(Demand {
                    what,
                    by_ms,
                    notice,
                    is_due: false,
                });
            }
            Input::Hidden => _ = self.demand.take_if(|demand| demand.can_be_hidden()),
            Input::Configured | Input::Restarted => self.demand = None,
            Input::Commanded(command) => _ = self.demand.take_if(|demand| demand.ends_with(command)),
            _ => {}
        }
    }

    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        if let Some(demand) = &mut self.demand {
            demand.is_due = scene.now_ms() > demand.by_ms;
        }
        let counts_angles = scene.orders.mode.is_some_and(|mode| {
            !matches!(
                mode,
                Mode::Fault | Mode::Stopping | Mode::Startup | Mode::BusConfiguring
            )
        });
        for report in scene.moment.reports {
            let Some(demand) = self.demand else { return Ok(()) };
            let counts = demand.notice == Notice::Fault || counts_angles;
            match demand.is_shown(report) {
                Some(true) => self.demand = None,
                Some(false) if demand.is_due && counts => {
                    let (what, late_ms) = (demand.what, scene.now_ms().saturating_sub(demand.by_ms));
                    let how = match demand.notice {
                        Notice::Fault => "no fault is reported",
                        Notice::Unhomed => "the joint angles are reported as known",
                    };
                    let text = format!("{what}, and {how} {late_ms} ms after the time for it");
                    return Err((Rule::Noticed, text));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Command, Input, Mode, Notice, Report};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    /// A robot at rest with a fault that has to be reported within 100 ms, after 200 ms with these inputs and reports.
    fn faulted(notice: Notice, inputs: &[Input], reports: &[Report]) -> Rig {
        let mut rig = Rig::idle();
        rig.input(Input::Noticeable {
            what: "a fault",
            by_ms: rig.time_ms() + 100,
            notice,
        });
        assert_eq!(rig.step(), Ok(()));
        inputs.iter().for_each(|input| rig.input(*input));
        reports.iter().for_each(|report| rig.report(report.clone()));
        assert_eq!(rig.run(200), Ok(()), "nothing is reported");
        rig
    }

    #[test]
    fn a_fault_that_is_not_reported_in_time_breaks_the_rule() {
        for (notice, report) in [
            (Notice::Fault, Report::Fault(None)),
            (Notice::Unhomed, Report::Homed(true)),
        ] {
            let mut rig = faulted(notice, &[], &[]);
            rig.report(report.clone());
            let found = rig.step();
            assert!(broken(&found, Rule::Noticed), "{notice:?}: {found:?}");
            let mut rig = faulted(notice, &[], &[report]);
            assert_eq!(
                rig.run(500),
                Ok(()),
                "{notice:?}: the report came before the time for it"
            );
        }
    }

    #[test]
    fn a_fault_that_is_reported_once_has_been_noticed() {
        let mut rig = faulted(Notice::Unhomed, &[], &[Report::Homed(false)]);
        rig.report(Report::Homed(true));
        assert_eq!(rig.step(), Ok(()));
        let mut rig = faulted(Notice::Fault, &[], &[Report::Fault(Some("lost".into()))]);
        rig.report(Report::Fault(None));
        assert_eq!(rig.step(), Ok(()));
    }

    #[test]
    fn what_may_hide_a_fault_or_end_it_ends_the_demand() {
        let excuses = [
            (Notice::Fault, Input::Hidden),
            (Notice::Unhomed, Input::Hidden),
            (Notice::Fault, Input::Commanded(Command::Acknowledge)),
            (Notice::Unhomed, Input::Commanded(Command::Home)),
        ];
        for (notice, input) in excuses {
            let mut rig = faulted(notice, &[input], &[]);
            rig.report(Report::Fault(None));
            rig.report(Report::Homed(true));
            assert_eq!(rig.step(), Ok(()), "{notice:?}: {input:?}");
        }
        let mut rig = faulted(Notice::Unhomed, &[Input::Commanded(Command::Acknowledge)], &[]);
        rig.report(Report::Homed(true));
        assert!(
            broken(&rig.step(), Rule::Noticed),
            "an acknowledgement takes no reference"
        );
    }

    #[test]
    fn unknown_angles_may_be_told_until_the_fault_is_over_whatever_happens_meanwhile() {
        let lost = [Report::Mode(Mode::Fault), Report::Fault(Some("lost".into()))];
        for is_told in [false, true] {
            let mut rig = faulted(Notice::Unhomed, &[], &lost);
            rig.input(Input::Hidden);
            rig.report(Report::Homed(true));
            assert_eq!(rig.run(100), Ok(()), "in the fault");
            if is_told {
                rig.report(Report::Homed(false));
            }
            rig.report(Report::Mode(Mode::DrivesOff));
            rig.report(Report::Homed(!is_told));
            let found = rig.step();
            assert_eq!(broken(&found, Rule::Noticed), !is_told, "{found:?}");
        }
    }
}
