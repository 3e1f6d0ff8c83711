//! The pen lift of a machine whose pen an output lowers: a solenoid that answers late and then travels, or a servo that takes a
//! new position every 20 ms and goes there at its speed.

use etherpen::config::{Config, IoDirection, IoRole, IoType, PenLiftKind, ToolFollows};

/// Part of the stated times after which the pen has arrived: a machine's owner states a little more than was measured.
const TIME_PART: f64 = 0.9;
/// Part of its time in which a solenoid does not move yet.
const WAIT_PART: f64 = 0.5;
/// Time between two positions that a servo takes, ms: the period of its pulses.
const FRAME_MS: u32 = 20;

/// A terminal's output that lowers the pen, or the tool's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PenOutput {
    /// The terminal's place in the chain, from 1.
    pub(super) slave: usize,
    /// The first bit among its outputs.
    bit: usize,
    kind: IoType,
    /// Values with the pen down and up.
    ends: [f64; 2],
}

impl PenOutput {
    /// The output with the role `pen`.
    pub(super) fn new(config: &Config) -> Option<Self> {
        Self::with_role(config, IoRole::Pen)
    }

    /// The output of a tool that follows the speed: it leaves ink where it is not 0.
    pub(super) fn of_tool(config: &Config) -> Option<Self> {
        let follows_speed = config.tool.follows == ToolFollows::Speed;
        follows_speed.then(|| Self::with_role(config, IoRole::Tool)).flatten()
    }

    fn with_role(config: &Config, role: IoRole) -> Option<Self> {
        let is_it = |point: &&etherpen::config::IoPoint| point.role == role && point.direction == IoDirection::Out;
        let point = config.io.iter().find(is_it)?;
        // The entry of channel n is object 0x7000 + 0x10 n.
        let channel = |index: u16| index.wrapping_sub(0x7000) / 0x10 * u16::from(point.kind.bits());
        let by_object = point.object.map(|object| channel(object.index));
        Some(Self {
            slave: usize::from(point.slave) + 1,
            bit: usize::from(point.bit.or(by_object)?),
            kind: point.kind,
            ends: match config.pen.kind {
                PenLiftKind::Servo => [config.pen.down, config.pen.up].map(f64::from),
                _ => [1.0, 0.0],
            },
        })
    }

    /// Its bits among a terminal's outputs.
    pub(super) fn raw(self, outputs: &[u8]) -> u32 {
        let bit = |at: usize| outputs.get(at / 8).map_or(0, |byte| u32::from(byte >> (at % 8) & 1));
        let bits = usize::from(self.kind.bits());
        (0..bits).fold(0, |raw, number| raw | bit(self.bit + number) << number)
    }

    /// The height that it asks for among a terminal's outputs: 0 down, 1 up.
    pub(super) fn height(self, outputs: &[u8]) -> f64 {
        let raw = self.raw(outputs);
        let [down, up] = self.ends;
        ((self.kind.value(raw) as f64 - down) / (up - down)).clamp(0.0, 1.0)
    }
}

/// What moves the pen.
#[derive(Clone, Copy, Debug)]
enum Drive {
    /// It waits before it travels.
    Solenoid {
        /// Milliseconds since the output changed.
        since_ms: f64,
    },
    /// It takes a position at the start of each frame.
    Servo {
        /// Milliseconds of the present frame.
        frame_ms: u32,
        /// The position that it goes to.
        taken: f64,
    },
}

/// The pen lift.
#[derive(Clone, Copy, Debug)]
pub(super) struct PenLift {
    lift_mm: f64,
    /// Times down and up, ms.
    times_ms: [f64; 2],
    /// Where the pen is: 0 down, 1 up.
    share: f64,
    /// Where the output wants it.
    aim: f64,
    drive: Drive,
}

impl PenLift {
    /// The pen lift of a configuration; `None` if the pen is lifted by an axis, or by nothing.
    pub(super) fn new(config: &Config) -> Option<Self> {
        let drive = match config.pen.kind {
            PenLiftKind::Output => Drive::Solenoid { since_ms: f64::MAX },
            PenLiftKind::Servo => Drive::Servo {
                frame_ms: 0,
                taken: 1.0,
            },
            PenLiftKind::Axis | PenLiftKind::None => return None,
        };
        Some(Self {
            lift_mm: config.paper.pen_lift_mm,
            times_ms: [config.pen.down_ms, config.pen.up_ms].map(|time_ms| TIME_PART * f64::from(time_ms)),
            share: 1.0,
            aim: 1.0,
            drive,
        })
    }

    /// Takes the height that the output asks for: 0 down, 1 up.
    pub(super) fn aim(&mut self, height: f64) {
        if let Drive::Solenoid { since_ms } = &mut self.drive
            && height != self.aim
        {
            *since_ms = 0.0;
        }
        self.aim = height;
    }

    /// Moves the pen for a millisecond; returns how far it is above its lowest position, mm.
    pub(super) fn step(&mut self) -> f64 {
        let [down_ms, up_ms] = self.times_ms;
        let time_ms = |to: f64, from: f64| if to < from { down_ms } else { up_ms };
        let (to, travel_ms) = match &mut self.drive {
            Drive::Solenoid { since_ms } => {
                let time_ms = time_ms(self.aim, 0.5);
                *since_ms += 1.0;
                let waits = *since_ms <= WAIT_PART * time_ms;
                (if waits { self.share } else { self.aim }, (1.0 - WAIT_PART) * time_ms)
            }
            Drive::Servo { frame_ms, taken } => {
                if *frame_ms == 0 {
                    *taken = self.aim;
                }
                *frame_ms = (*frame_ms + 1) % FRAME_MS;
                (*taken, time_ms(*taken, self.share) - f64::from(FRAME_MS))
            }
        };
        let most = 1.0 / travel_ms.max(1.0);
        self.share += (to - self.share).clamp(-most, most);
        self.share * self.lift_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use etherpen::config::IoPoint;

    fn lift(kind: PenLiftKind) -> (PenLift, f64) {
        let mut config = Config::default();
        config.pen.kind = kind;
        (config.pen.down_ms, config.pen.up_ms) = (50, 30);
        (PenLift::new(&config).expect("an output"), config.paper.pen_lift_mm)
    }

    #[test]
    fn a_solenoid_answers_late_and_arrives_within_the_stated_time() {
        let (mut lift, lift_mm) = lift(PenLiftKind::Output);
        assert_eq!(lift.step(), lift_mm);
        lift.aim(0.0);
        let heights: Vec<f64> = (0..50).map(|_| lift.step()).collect();
        assert_eq!((heights[20], heights[49]), (lift_mm, 0.0));
        assert!(heights[40] > 0.0);
        lift.aim(1.0);
        let heights: Vec<f64> = (0..30).map(|_| lift.step()).collect();
        assert_eq!((heights[5], heights[29]), (0.0, lift_mm));
        assert!(PenLift::new(&Config::default()).is_none());
    }

    #[test]
    fn a_servo_goes_at_its_speed_and_arrives_within_the_stated_time_wherever_its_frame_begins() {
        for before_ms in 0..FRAME_MS {
            let (mut lift, lift_mm) = lift(PenLiftKind::Servo);
            for _ in 0..before_ms {
                assert_eq!(lift.step(), lift_mm);
            }
            lift.aim(0.0);
            let heights: Vec<f64> = (0..50).map(|_| lift.step()).collect();
            let steepest_mm = heights.windows(2).map(|pair| pair[0] - pair[1]).fold(0.0, f64::max);
            assert_eq!(heights[49], 0.0, "{before_ms} ms");
            assert!(
                (steepest_mm - lift_mm / 25.0).abs() < 1e-9,
                "{steepest_mm} mm in a millisecond"
            );
            lift.aim(1.0);
            assert_eq!((0..30).map(|_| lift.step()).last(), Some(lift_mm), "{before_ms} ms");
        }
    }

    #[test]
    fn a_word_is_read_at_its_place_and_beyond_its_ends_the_pen_stands_at_them() {
        let mut config = Config::default();
        config.pen.kind = PenLiftKind::Servo;
        (config.pen.down, config.pen.up) = (2_000, -1_000);
        let point = IoPoint {
            direction: IoDirection::Out,
            bit: Some(16),
            kind: IoType::I16,
            role: IoRole::Pen,
            ..IoPoint::default()
        };
        config.io.push(point).expect("room");
        let output = PenOutput::new(&config).expect("an output");
        for (value, height) in [
            (2_000_i16, 0.0),
            (-1_000, 1.0),
            (500, 0.5),
            (-30_000, 1.0),
            (9_000, 0.0),
        ] {
            let [low, high] = value.to_le_bytes();
            assert_eq!(output.height(&[0xFF, 0xFF, low, high]), height, "{value}");
        }
    }
}
