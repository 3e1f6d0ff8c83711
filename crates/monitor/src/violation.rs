//! The rules by name, and the violation of one.

use std::fmt;

/// A rule that the controller has to keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Rule {
    /// No joint and no tool moves faster than its limit and what its controller may add.
    Speed,
    /// Neither a joint nor the tool changes its speed faster than its limit, a stop or its brake can.
    Acceleration,
    /// Joints stay in their ranges, and the tool in the work area.
    Area,
    /// Drives have power only after an order for it, and lose it soon after the order ends.
    Power,
    /// Nothing moves without configuration, homing, power and an order to move.
    Permission,
    /// After a stop or a fault every joint decelerates, stands, and stays until enabled again.
    Stop,
    /// A jog ends when its messages end.
    DeadMan,
    /// A drawing is held when its host falls silent.
    Silence,
    /// The pen touches the paper only where it was ordered to.
    Pen,
    /// While drawing, the tool is never far from the path.
    Following,
    /// Where nothing is disturbed, a pen that draws keeps the tolerance of its line.
    Tolerance,
    /// Clocks of slaves in operation agree where nothing is disturbed, and never jump.
    Clocks,
    /// A reported standstill is a standstill.
    Mode,
    /// A drawing that is reported as finished has all of its ink.
    Finished,
    /// Counters never go backwards, and count what happened.
    Counters,
    /// Every frame of the master is well-formed EtherCAT.
    Wire,
    /// A fault that the controller can notice is reported in time.
    Noticed,
}

impl Rule {
    /// All rules.
    pub const ALL: [Self; 17] = [
        Self::Speed,
        Self::Acceleration,
        Self::Area,
        Self::Power,
        Self::Permission,
        Self::Stop,
        Self::DeadMan,
        Self::Silence,
        Self::Pen,
        Self::Following,
        Self::Tolerance,
        Self::Clocks,
        Self::Mode,
        Self::Finished,
        Self::Counters,
        Self::Wire,
        Self::Noticed,
    ];

    /// Its name, one word.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Speed => "speed",
            Self::Acceleration => "acceleration",
            Self::Area => "area",
            Self::Power => "power",
            Self::Permission => "permission",
            Self::Stop => "stop",
            Self::DeadMan => "deadman",
            Self::Silence => "silence",
            Self::Pen => "pen",
            Self::Following => "following",
            Self::Tolerance => "tolerance",
            Self::Clocks => "clocks",
            Self::Mode => "mode",
            Self::Finished => "finished",
            Self::Counters => "counters",
            Self::Wire => "wire",
            Self::Noticed => "noticed",
        }
    }

    /// The rule as a sentence.
    #[must_use]
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::Speed => "No joint and no tool moves faster than its limit and what its controller may add.",
            Self::Acceleration => {
                "Neither a joint nor the tool changes its speed faster than its limit, a stop or its brake can."
            }
            Self::Area => "Joints stay in their ranges, and the tool in the work area.",
            Self::Power => "Drives have power only after an order for it, and lose it soon after the order ends.",
            Self::Permission => "Nothing moves without configuration, homing, power and an order to move.",
            Self::Stop => "After a stop or a fault every joint decelerates, stands, and stays until enabled again.",
            Self::DeadMan => "A jog ends when its messages end.",
            Self::Silence => "A drawing is held when its host falls silent.",
            Self::Pen => "The pen touches the paper only where it was ordered to.",
            Self::Following => "While drawing, the tool is never far from the path.",
            Self::Tolerance => "Where nothing is disturbed, a pen that draws keeps the tolerance of its line.",
            Self::Clocks => "Clocks of slaves in operation agree where nothing is disturbed, and never jump.",
            Self::Mode => "A reported standstill is a standstill.",
            Self::Finished => "A drawing that is reported as finished has all of its ink.",
            Self::Counters => "Counters never go backwards, and count what happened.",
            Self::Wire => "Every frame of the master is well-formed EtherCAT.",
            Self::Noticed => "A fault that the controller can notice is reported in time.",
        }
    }
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A rule that was broken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// When, ms.
    pub time_ms: u64,
    /// The rule.
    pub rule: Rule,
    /// What happened, with values and bounds.
    pub text: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ms, {}: {}", self.time_ms, self.rule, self.text)
    }
}

impl std::error::Error for Violation {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rule_has_a_name_of_one_word_and_a_sentence() {
        for (number, rule) in Rule::ALL.iter().enumerate() {
            assert!(rule.name().chars().all(|letter| letter.is_ascii_lowercase()), "{rule}");
            assert!(rule.sentence().ends_with('.'), "{rule}");
            let is_twice = Rule::ALL[..number].iter().any(|other| other.name() == rule.name());
            assert!(!is_twice, "{rule}");
        }
    }
}
