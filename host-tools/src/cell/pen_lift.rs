//! The pen lift of a machine whose pen an output lowers: a solenoid that answers late and then travels.

use etherpen::config::{Config, IoDirection, IoRole, PenLiftKind};

/// Part of the stated times after which the pen has arrived: a machine's owner states a little more than was measured.
const TIME_PART: f64 = 0.9;
/// Part of its time in which the pen does not move yet.
const WAIT_PART: f64 = 0.5;

/// A terminal's output that lowers the pen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PenOutput {
    /// The terminal's place in the chain, from 1.
    pub(super) slave: usize,
    /// The bit among its outputs.
    pub(super) bit: usize,
}

impl PenOutput {
    /// The output with the role `pen`.
    pub(super) fn new(config: &Config) -> Option<Self> {
        let is_pen =
            |point: &&etherpen::config::IoPoint| point.role == IoRole::Pen && point.direction == IoDirection::Out;
        let point = config.io.iter().find(is_pen)?;
        // The entry of channel n is object 0x7000 + 0x10 n.
        let by_object = point.object.map(|object| object.index.wrapping_sub(0x7000) / 0x10);
        Some(Self {
            slave: usize::from(point.slave) + 1,
            bit: usize::from(point.bit.or(by_object)?),
        })
    }

    /// Whether it is on among a terminal's outputs.
    pub(super) fn is_on(self, outputs: &[u8]) -> bool {
        let byte = outputs.get(self.bit / 8).copied().unwrap_or(0);
        byte >> (self.bit % 8) & 1 != 0
    }
}

/// The solenoid.
#[derive(Clone, Copy, Debug)]
pub(super) struct PenLift {
    lift_mm: f64,
    /// Times down and up, ms.
    times_ms: [f64; 2],
    /// Where the pen is: 0 down, 1 up.
    share: f64,
    is_on: bool,
    /// Milliseconds since the output changed.
    since_ms: f64,
}

impl PenLift {
    /// The pen lift of a configuration; `None` if the pen is lifted by an axis, or by nothing.
    pub(super) fn new(config: &Config) -> Option<Self> {
        (config.pen.kind == PenLiftKind::Output).then(|| Self {
            lift_mm: config.paper.pen_lift_mm,
            times_ms: [config.pen.down_ms, config.pen.up_ms].map(|time_ms| TIME_PART * f64::from(time_ms)),
            share: 1.0,
            is_on: false,
            since_ms: f64::MAX,
        })
    }

    /// Switches the solenoid.
    pub(super) fn switch(&mut self, on: bool) {
        if on != self.is_on {
            (self.is_on, self.since_ms) = (on, 0.0);
        }
    }

    /// Moves the pen for a millisecond; returns how far it is above its lowest position, mm.
    pub(super) fn step(&mut self) -> f64 {
        let [down_ms, up_ms] = self.times_ms;
        let (time_ms, direction) = if self.is_on { (down_ms, -1.0) } else { (up_ms, 1.0) };
        self.since_ms += 1.0;
        if self.since_ms > WAIT_PART * time_ms {
            let travel_ms = ((1.0 - WAIT_PART) * time_ms).max(1.0);
            self.share = (self.share + direction / travel_ms).clamp(0.0, 1.0);
        }
        self.share * self.lift_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pen_answers_late_and_arrives_within_the_stated_time() {
        let mut config = Config::default();
        config.pen.kind = PenLiftKind::Output;
        (config.pen.down_ms, config.pen.up_ms) = (50, 20);
        let mut lift = PenLift::new(&config).expect("an output");
        assert_eq!(lift.step(), config.paper.pen_lift_mm);
        lift.switch(true);
        let heights: Vec<f64> = (0..50).map(|_| lift.step()).collect();
        assert_eq!((heights[20], heights[49]), (config.paper.pen_lift_mm, 0.0));
        assert!(heights[40] > 0.0);
        lift.switch(false);
        let heights: Vec<f64> = (0..20).map(|_| lift.step()).collect();
        assert_eq!((heights[5], heights[19]), (0.0, config.paper.pen_lift_mm));
        assert!(PenLift::new(&Config::default()).is_none());
    }
}
