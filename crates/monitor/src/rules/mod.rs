//! The rules: one file each, with the bound that it checks and where that bound comes from.
//!
//! A rule is a small type with a `check` of one millisecond. It keeps what it needs of earlier milliseconds, and knows
//! of no other rule.

mod acceleration;
mod area;
mod clocks;
mod counters;
mod finished;
mod following;
mod mode;
mod noticed;
mod pen;
mod permission;
mod power;
mod speed;
mod stop;
mod tolerance;
mod tool_acceleration;
mod wire;

use crate::moment::Input;
use crate::scene::{Finding, Scene};

/// All rules.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rules {
    speed: speed::Speed,
    acceleration: acceleration::Acceleration,
    area: area::Area,
    power: power::Power,
    stop: stop::StopRule,
    permission: permission::Permission,
    pen: pen::Pen,
    following: following::Following,
    tolerance: tolerance::Tolerance,
    tool_acceleration: tool_acceleration::ToolAcceleration,
    clocks: clocks::Clocks,
    mode: mode::ReportedMode,
    finished: finished::Finished,
    counters: counters::Counters,
    wire: wire::Wire,
    noticed: noticed::Noticed,
}

impl Rules {
    /// Takes an input.
    pub(crate) fn take(&mut self, input: &Input) {
        self.counters.take(input);
        self.noticed.take(input);
        if *input == Input::Configured {
            self.area = area::Area::default();
        }
    }

    /// Checks one millisecond; the first broken rule is told. The stop comes first, since it is the reason for the
    /// others.
    pub(crate) fn check(&mut self, scene: &Scene<'_>) -> Finding {
        let findings = [
            self.stop.check(scene),
            self.speed.check(scene),
            self.acceleration.check(scene),
            self.area.check(scene),
            self.power.check(scene),
            self.permission.check(scene),
            self.pen.check(scene),
            self.following.check(scene),
            self.tolerance.check(scene),
            self.tool_acceleration.check(scene),
            self.clocks.check(scene),
            self.mode.check(scene),
            self.finished.check(scene),
            self.counters.check(scene),
            self.wire.check(scene),
            self.noticed.check(scene),
        ];
        findings.into_iter().find(Result::is_err).unwrap_or(Ok(()))
    }

    /// Checks what can be told only at the end.
    pub(crate) fn end(&mut self) -> Finding {
        self.counters.end()
    }
}
