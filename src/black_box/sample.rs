//! One millisecond in 64 bytes.

use crate::board::Interlock;
use crate::control::sampler::CycleReport;
use crate::robots::AXES;

/// Words of a sample.
pub const SAMPLE_WORDS: usize = 16;

/// Stored for a phase that is not known.
const NO_CLOCK: i32 = i32::MIN;

/// Bits of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(pub u32);

impl Flags {
    const FOLLOWING: u32 = 1 << 0;
    const STANDSTILL: u32 = 1 << 1;
    const FAULT: u32 = 1 << 2;
    const STOP_OPEN: u32 = 1 << 3;
    const SUBSTITUTE_CLOCK: u32 = 1 << 4;
    const INPUT_OPEN: u32 = 1 << 5;
    const VALID_FROM: usize = 8;
    const HOMED_FROM: usize = 12;
    const INPUT_FROM: usize = 16;
    /// Above the flags a word of the memory has the late output telegrams.
    const LATE_FROM: u32 = 24;

    fn of(report: &CycleReport) -> Self {
        let interlock = match report.interlock {
            Some(Interlock::EmergencyStop) => Self::STOP_OPEN,
            Some(Interlock::Clock) => Self::SUBSTITUTE_CLOCK,
            Some(Interlock::Input { io }) => Self::INPUT_OPEN | u32::from(io & 0xF) << Self::INPUT_FROM,
            None => 0,
        };
        let mut bits = interlock;
        for (set, bit) in [
            (report.following, Self::FOLLOWING),
            (report.standstill, Self::STANDSTILL),
            (report.fault.is_some(), Self::FAULT),
        ] {
            bits |= if set { bit } else { 0 };
        }
        for (axis, (valid, homed)) in report.valid.iter().zip(&report.homed).enumerate() {
            bits |= u32::from(*valid) << (Self::VALID_FROM + axis) | u32::from(*homed) << (Self::HOMED_FROM + axis);
        }
        Self(bits)
    }

    /// Whether a setpoint was followed.
    pub const fn following(self) -> bool {
        self.0 & Self::FOLLOWING != 0
    }

    /// Whether all axes were at rest.
    pub const fn standstill(self) -> bool {
        self.0 & Self::STANDSTILL != 0
    }

    /// Whether a fault was latched.
    pub const fn fault(self) -> bool {
        self.0 & Self::FAULT != 0
    }

    /// The input that kept the drives in quick stop.
    pub const fn interlock(self) -> Option<Interlock> {
        if self.0 & Self::INPUT_OPEN != 0 {
            return Some(Interlock::Input {
                io: (self.0 >> Self::INPUT_FROM) as u8 & 0xF,
            });
        }
        Interlock::of(self.0 & Self::STOP_OPEN != 0, self.0 & Self::SUBSTITUTE_CLOCK != 0)
    }

    /// Whether an axis delivered a valid position.
    pub const fn valid(self, axis: usize) -> bool {
        axis < AXES && self.0 >> (Self::VALID_FROM + axis) & 1 != 0
    }

    /// Whether an axis was homed.
    pub const fn homed(self, axis: usize) -> bool {
        axis < AXES && self.0 >> (Self::HOMED_FROM + axis) & 1 != 0
    }
}

/// A millisecond as recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Number of the millisecond.
    pub cycle: u32,
    /// Joint positions demanded, rad.
    pub setpoint_rad: [f32; AXES],
    /// Joint positions measured or predicted, rad.
    pub measured_rad: [f32; AXES],
    /// Encoder positions, increments, their lower 16 bits: with `measured_rad` they give the position exactly.
    pub increments: [u16; AXES],
    /// Status words of the drives.
    pub status_word: [u16; AXES],
    /// Bits.
    pub flags: Flags,
    /// Phase of the sample relative to the bus clock, ns; `None` without a clock.
    pub clock_error_ns: Option<i32>,
    /// Telegrams without a reply since the start, lower 16 bits.
    pub frames_lost: u16,
    /// Late output telegrams since the start, lower 8 bits.
    pub cycles_late: u8,
    /// The named inputs and outputs whose value was not 0, a bit for each in the order of the configuration.
    pub io_set: u16,
}

impl Sample {
    /// What is recorded of a report.
    pub fn of(report: &CycleReport) -> Self {
        Self {
            cycle: report.cycle,
            setpoint_rad: report.setpoint.position_rad.map(|angle| angle as f32),
            measured_rad: report.measured_rad.map(|angle| angle as f32),
            increments: report.increments.map(|increments| increments as u16),
            status_word: report.status_word,
            flags: Flags::of(report),
            clock_error_ns: report.clock_error_ns,
            frames_lost: report.bus.frames_lost as u16,
            cycles_late: report.counters.cycles_late as u8,
            io_set: report.io.set,
        }
    }

    /// As words of the memory.
    pub fn to_words(&self) -> [u32; SAMPLE_WORDS] {
        let [s0, s1, s2, s3] = self.setpoint_rad.map(f32::to_bits);
        let [m0, m1, m2, m3] = self.measured_rad.map(f32::to_bits);
        let [i0, i1] = pairs(&self.increments);
        let [w0, w1] = pairs(&self.status_word);
        let clock = self.clock_error_ns.unwrap_or(NO_CLOCK) as u32;
        let lost = pair(self.frames_lost, self.io_set);
        let flags = self.flags.0 | u32::from(self.cycles_late) << Flags::LATE_FROM;
        [
            self.cycle, s0, s1, s2, s3, m0, m1, m2, m3, i0, i1, w0, w1, flags, clock, lost,
        ]
    }

    /// From words of the memory.
    pub fn from_words(words: &[u32; SAMPLE_WORDS]) -> Self {
        let [
            cycle,
            s0,
            s1,
            s2,
            s3,
            m0,
            m1,
            m2,
            m3,
            i0,
            i1,
            w0,
            w1,
            flags,
            clock,
            lost,
        ] = *words;
        let clock = clock as i32;
        Self {
            cycle,
            setpoint_rad: [s0, s1, s2, s3].map(f32::from_bits),
            measured_rad: [m0, m1, m2, m3].map(f32::from_bits),
            increments: halves([i0, i1]),
            status_word: halves([w0, w1]),
            flags: Flags(flags & !(u32::MAX << Flags::LATE_FROM)),
            clock_error_ns: (clock != NO_CLOCK).then_some(clock),
            frames_lost: lost as u16,
            cycles_late: (flags >> Flags::LATE_FROM) as u8,
            io_set: (lost >> 16) as u16,
        }
    }
}

fn pair(low: u16, high: u16) -> u32 {
    u32::from(low) | u32::from(high) << 16
}

fn pairs(values: &[u16; AXES]) -> [u32; AXES / 2] {
    let [a, b, c, d] = *values;
    [pair(a, b), pair(c, d)]
}

fn halves(words: [u32; AXES / 2]) -> [u16; AXES] {
    let [low, high] = words;
    [low as u16, (low >> 16) as u16, high as u16, (high >> 16) as u16]
}

const _: () = assert!(SAMPLE_WORDS * 4 <= 64);
const _: () = assert!(AXES <= Flags::HOMED_FROM - Flags::VALID_FROM && AXES <= Flags::INPUT_FROM - Flags::HOMED_FROM);
