//! The value of the tool's output, each millisecond: a laser's power or a dispenser's flow.
//!
//! The trajectory gives each setpoint the speed that leads to it. Only a multiplication and a comparison are left for the critical
//! task, and without a tool nothing.
//!
//! Invariant: the value that is written is 0 in every millisecond in which the tool may not be on; what was counted before is
//! forgotten. Without frames the terminal keeps the last value until its own watchdog expires.

use crate::config::{Config, IoRole, IoType, ToolFollows, command_delay_ms};
use crate::ethercat::cyclic::ExchangeKind;

/// Speed below which the tool counts as at rest, mm/s: a laser that stands still burns a hole.
pub const REST_MM_S: f32 = 0.1;
/// How many milliseconds the next setpoint is ahead: its speed is that of the millisecond which now begins.
const NEXT: usize = 1;

/// Values of the tool's outputs in a millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ToolValue {
    /// Of an output that is a bit.
    pub bit: u32,
    /// Of an output that is a word.
    pub word: u32,
}

/// The tool's output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToolOutput {
    follows: ToolFollows,
    /// Time by which the output is ahead, ms, without the exchange's own.
    lead_ms: usize,
    minimum: f32,
    maximum: f32,
    /// Value for each mm/s.
    per_mm_s: f32,
    /// Pulses in a millisecond for each mm/s.
    pulses_per_mm_s: f32,
    /// Greatest count of the narrowest word.
    count_max: u32,
    /// Part of the way to the next pulse, 0 to 1.
    part: f32,
    /// Pulses since the output was switched on, from 1 again after `count_max`.
    count: u32,
    /// Pulses that a bit has not shown yet.
    owed: u32,
    /// Whether the bit is on.
    is_high: bool,
    /// Whether the operating mode is one in which the tool may be on.
    pub(super) draws: bool,
    /// Whether an input that holds drawings switches the tool off.
    pub(super) is_off_at_hold: bool,
}

impl ToolOutput {
    /// The output of a configuration; off until the operating mode allows it.
    pub fn new(config: &Config) -> Self {
        let tool = &config.tool;
        let outputs = config.io.iter().filter(|point| point.role == IoRole::Tool);
        let words = outputs.filter(|point| point.kind != IoType::Bool);
        let [minimum, maximum] = [tool.minimum, tool.maximum].map(f32::from);
        // Configured within bounds; a value that is not used may be 0.
        let nominal_mm_s = tool.nominal_mm_s.max(1.0);
        let pitch_um = f32::from(tool.pitch_um.max(1));
        Self {
            follows: tool.follows,
            lead_ms: NEXT + usize::from(tool.lead_ms),
            minimum,
            maximum,
            per_mm_s: (maximum - minimum) / nominal_mm_s,
            // A millisecond at 1 mm/s is 1 um.
            pulses_per_mm_s: 1.0 / pitch_um,
            count_max: words.map(|point| point.kind.most().into()).min().unwrap_or(1),
            is_off_at_hold: tool.off_at_hold,
            ..Self::default()
        }
    }

    /// Whether there is such an output.
    #[inline]
    pub(super) const fn is_used(&self) -> bool {
        !matches!(self.follows, ToolFollows::Nothing)
    }

    /// Setpoint to which the value belongs, ms from this millisecond's on.
    pub(super) fn ahead(&self, exchange: ExchangeKind) -> usize {
        self.lead_ms + usize::from(command_delay_ms(exchange) > 0.0)
    }

    /// Advances by a millisecond with this speed along the stroke, mm/s; 0 where the tool may not be on.
    pub(super) fn step(&mut self, speed_mm_s: f32) -> ToolValue {
        match self.follows {
            ToolFollows::Nothing => ToolValue::default(),
            ToolFollows::Speed => self.power(speed_mm_s),
            ToolFollows::Distance => self.pulses(speed_mm_s),
        }
    }

    fn power(&self, speed_mm_s: f32) -> ToolValue {
        // What is no number is no speed.
        let moves = speed_mm_s >= REST_MM_S;
        if !moves {
            return ToolValue::default();
        }
        let value = self.minimum + self.per_mm_s * speed_mm_s;
        // Rounded; a conversion ends at the bounds of its type.
        let word = (value.min(self.maximum) + 0.5) as u32;
        ToolValue { bit: 1, word }
    }

    fn pulses(&mut self, speed_mm_s: f32) -> ToolValue {
        self.part += speed_mm_s * self.pulses_per_mm_s;
        let passed = (self.part as u32).min(self.count_max.max(u8::MAX.into()));
        self.part -= passed as f32;
        self.count = self.count.saturating_add(passed);
        if self.count > self.count_max {
            self.count = self.count.saturating_sub(self.count_max).min(self.count_max);
        }
        self.owed = self.owed.saturating_add(passed);
        self.is_high = !self.is_high && self.owed > 0;
        self.owed = self.owed.saturating_sub(self.is_high.into());
        ToolValue {
            bit: self.is_high.into(),
            word: self.count,
        }
    }

    /// Switches the tool off: the next stroke counts from 0.
    pub(super) fn off(&mut self) -> ToolValue {
        (self.part, self.count, self.owed, self.is_high) = (0.0, 0, 0, false);
        ToolValue::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{IoDirection, IoPoint, Tool};

    fn output(tool: Tool, kind: IoType) -> ToolOutput {
        let mut config = Config {
            tool,
            ..Config::default()
        };
        let point = IoPoint {
            name: "tool".try_into().unwrap(),
            slave: 5,
            direction: IoDirection::Out,
            bit: Some(0),
            kind,
            role: IoRole::Tool,
            ..IoPoint::default()
        };
        config.io.push(point).unwrap();
        assert_eq!((config.check(), config.check_io()), (Ok(()), Ok(())));
        ToolOutput::new(&config)
    }

    #[test]
    fn the_word_goes_from_the_minimum_to_the_maximum_at_the_nominal_speed_and_is_0_at_rest() {
        let tool = Tool {
            follows: ToolFollows::Speed,
            nominal_mm_s: 200.0,
            minimum: 100,
            maximum: 1_100,
            ..Tool::default()
        };
        let mut output = output(tool, IoType::U16);
        for (speed_mm_s, word) in [
            (0.0, 0),
            (0.09, 0),
            (0.2, 101),
            (100.0, 600),
            (200.0, 1_100),
            (1e9, 1_100),
        ] {
            let bit = u32::from(word > 0);
            assert_eq!(output.step(speed_mm_s), ToolValue { bit, word }, "{speed_mm_s} mm/s");
        }
        assert_eq!(output.step(-1.0).word, 0);
        assert_eq!(output.step(f32::NAN).word, 0);
        assert_eq!(output.off(), ToolValue::default());
        assert_eq!(
            [ExchangeKind::Split, ExchangeKind::Combined].map(|kind| output.ahead(kind)),
            [1, 2]
        );
    }

    #[test]
    fn a_word_counts_pitches_from_1_again_after_its_greatest_value_and_a_bit_shows_each() {
        let tool = Tool {
            follows: ToolFollows::Distance,
            pitch_um: 1_000,
            ..Tool::default()
        };
        let mut counter = output(tool, IoType::U8);
        // Half a pitch in each millisecond.
        let (mut highs, mut last) = (0, ToolValue::default());
        for ms in 1..=1_000_u32 {
            let value = counter.step(500.0);
            assert_eq!(value.word, if ms < 2 { 0 } else { (ms / 2 - 1) % 255 + 1 }, "{ms} ms");
            highs += u32::from(value.bit > last.bit);
            last = value;
        }
        assert_eq!(highs, 500);
        assert_eq!(counter.off(), ToolValue::default());
        assert_eq!(counter.step(999.0).word, 0, "a new stroke");
        // Faster than a bit can show, none is lost.
        let mut bit = output(tool, IoType::Bool);
        let values: [u32; 10] = core::array::from_fn(|ms| bit.step(if ms < 2 { 2_000.0 } else { 0.0 }).bit);
        assert_eq!(values, [1, 0, 1, 0, 1, 0, 1, 0, 0, 0]);
        for speed_mm_s in [f32::NAN, f32::INFINITY, -5.0, 1e30] {
            bit.step(speed_mm_s);
        }
        bit.off();
        assert_eq!(bit.step(1_000.0), ToolValue { bit: 1, word: 1 });
    }
}
