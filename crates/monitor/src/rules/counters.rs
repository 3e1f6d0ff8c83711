//! Counters: they never go backwards without a restart, and count what happened.
//!
//! Each counter that is expected to show a number shows it in the last report.

use crate::moment::{Count, Input, Report};
use crate::scene::{Finding, Scene};
use crate::violation::Rule;

/// The rule.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counters {
    shown: Vec<Count>,
    expected: Vec<Count>,
}

fn set(counts: &mut Vec<Count>, count: Count) -> Option<u64> {
    match counts.iter_mut().find(|other| other.name == count.name) {
        Some(other) => Some(std::mem::replace(&mut other.count, count.count)),
        None => {
            counts.push(count);
            None
        }
    }
}

impl Counters {
    pub(crate) fn take(&mut self, input: &Input) {
        match *input {
            Input::Restarted => self.shown.clear(),
            Input::Expected { name, count } => _ = set(&mut self.expected, Count { name, count }),
            _ => {}
        }
    }

    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        for report in scene.moment.reports {
            let Report::Counters(counts) = report else { continue };
            for count in counts {
                if let Some(before) = set(&mut self.shown, *count).filter(|before| *before > count.count) {
                    let text = format!("{} went from {before} to {}", count.name, count.count);
                    return Err((Rule::Counters, text));
                }
            }
        }
        Ok(())
    }

    pub(crate) fn end(&self) -> Finding {
        for expected in &self.expected {
            let shown = self.shown.iter().find(|count| count.name == expected.name);
            let shown = shown.map_or(0, |count| count.count);
            if shown != expected.count {
                let text = format!("{} shows {shown}, {} happened", expected.name, expected.count);
                return Err((Rule::Counters, text));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::moment::{Count, Input, Report};
    use crate::rig::{Rig, broken};
    use crate::violation::Rule;

    fn shows(count: u64) -> Report {
        Report::Counters(vec![
            Count {
                name: "frames_lost",
                count,
            },
            Count {
                name: "cycles",
                count: 9,
            },
        ])
    }

    #[test]
    fn a_counter_goes_backwards_only_after_a_restart() {
        let mut rig = Rig::new();
        rig.report(shows(3));
        rig.report(shows(4));
        assert_eq!(rig.step(), Ok(()));
        rig.input(Input::Restarted);
        rig.report(shows(0));
        assert_eq!(rig.step(), Ok(()));
        rig.report(shows(2));
        assert_eq!(rig.step(), Ok(()));
        rig.report(shows(1));
        assert!(broken(&rig.step(), Rule::Counters));
    }

    #[test]
    fn at_the_end_a_counter_shows_what_happened() {
        for (happened, shown) in [(3, 3), (3, 2), (3, 4), (0, 0)] {
            let mut rig = Rig::new();
            rig.input(Input::Expected {
                name: "frames_lost",
                count: 1,
            });
            rig.input(Input::Expected {
                name: "frames_lost",
                count: happened,
            });
            rig.report(shows(shown));
            assert_eq!(rig.step(), Ok(()));
            assert_eq!(broken(&rig.end(), Rule::Counters), happened != shown);
        }
        let mut rig = Rig::new();
        rig.input(Input::Expected {
            name: "frames_lost",
            count: 1,
        });
        assert_eq!(rig.step(), Ok(()));
        assert!(broken(&rig.end(), Rule::Counters), "never shown");
    }
}
