//! The part common to all servo drives: a drive, and the delays of its inputs and outputs.
//!
//! A command takes effect `output_delay` milliseconds after it arrived on the bus, or one later in a random share of the
//! cycles. A position appears on the bus `input_delay` milliseconds after it was measured.

use crate::drive::history::History;
use crate::drive::{Demand, Drive, DriveOptions};
use crate::random::Random;
use std::collections::VecDeque;

/// Longest delay between bus and motor, ms.
const DELAY_MAX_MS: usize = 100;
const ERROR_REGISTER_GENERIC: u8 = 0x01;

/// An emergency message: error code, error register, five manufacturer-specific bytes.
pub(crate) type Emergency = (u16, u8, [u8; 5]);

/// Values of the drive at one time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct DriveValues {
    /// Position, increments.
    pub(crate) position: i32,
    /// Speed in digits of the velocity demand.
    pub(crate) velocity: i32,
    /// Torque in digits of the torque demand.
    pub(crate) torque: i16,
    /// Status word.
    pub(crate) status: u16,
}

/// A drive with its delays.
#[derive(Clone, Debug)]
pub(crate) struct Servo {
    /// The drive and its motor.
    pub(crate) drive: Drive,
    /// Last demand from the bus.
    pub(crate) demand: Demand,
    shown: DriveValues,
    demands: VecDeque<Demand>,
    samples: VecDeque<DriveValues>,
    output_delay: usize,
    input_delay: usize,
    /// Share of the cycles in which a command is one millisecond late.
    late_share: f64,
    /// The command before the one in effect.
    previous: Demand,
    random: Random,
    /// Messages about its faults.
    pub(crate) history: History,
}

/// Gives late commands random numbers of their own.
const LATE_SEED: u64 = 0x1A7E;

impl Servo {
    /// A drive behind delays of whole milliseconds; the seed is that of its resolver's noise.
    pub(crate) fn new(options: &DriveOptions, noise_seed: u64) -> Self {
        let output_delay = options.output_delay_ms.min(DELAY_MAX_MS);
        let input_delay = options.input_delay_ms.min(DELAY_MAX_MS);
        let servo = Self::of(Drive::new(options, noise_seed), output_delay, input_delay);
        Self {
            late_share: options.late_share,
            random: Random::new(noise_seed ^ LATE_SEED),
            ..servo
        }
    }

    fn of(drive: Drive, output_delay: usize, input_delay: usize) -> Self {
        Self {
            drive,
            demand: Demand::default(),
            shown: DriveValues::default(),
            demands: VecDeque::new(),
            samples: VecDeque::new(),
            output_delay,
            input_delay,
            late_share: 0.0,
            previous: Demand::default(),
            random: Random::new(0),
            history: History::default(),
        }
    }

    /// Resets everything but the motor to its state after power-up.
    pub(crate) fn power_up(&mut self) {
        let mut drive = self.drive.clone();
        drive.power_up();
        *self = Self {
            late_share: self.late_share,
            random: self.random.clone(),
            ..Self::of(drive, self.output_delay, self.input_delay)
        };
    }

    /// Advances by one millisecond; `operational` if the outputs are valid.
    pub(crate) fn step(&mut self, operational: bool) {
        let demand = if operational {
            self.demands.push_back(self.demand);
            let demand = if self.demands.len() > self.output_delay {
                self.demands.pop_front().unwrap_or_default()
            } else {
                Demand::default()
            };
            Some(self.delayed(demand))
        } else {
            self.demands.clear();
            None
        };
        self.drive.step(demand);
    }

    /// The demand in effect: this one, or the previous one if this one is late.
    fn delayed(&mut self, demand: Demand) -> Demand {
        if self.late_share <= 0.0 {
            return demand;
        }
        let previous = core::mem::replace(&mut self.previous, demand);
        match self.random.unit() < self.late_share {
            true => previous,
            false => demand,
        }
    }

    /// Advances by one millisecond with the processor stopped.
    pub(crate) fn coast(&mut self) {
        let demand = self.demands.front().copied().unwrap_or_default();
        self.drive.coast(Demand {
            is_missed: true,
            ..demand
        });
    }

    /// Takes a sample, and shows the one taken `input_delay` milliseconds ago.
    pub(crate) fn sample(&mut self) {
        self.history.step();
        self.samples.push_back(DriveValues {
            position: self.drive.position(),
            velocity: self.drive.velocity_digits(),
            torque: self.drive.torque_digits(),
            status: self.drive.status(),
        });
        let shown = match self.samples.len() > self.input_delay {
            true => self.samples.pop_front(),
            false => self.samples.front().copied(),
        };
        self.shown = shown.unwrap_or_default();
    }

    /// The sample visible on the bus.
    pub(crate) fn shown(&self) -> DriveValues {
        self.shown
    }

    /// Content of the error register, object 0x1001.
    pub(crate) fn error_register(&self) -> u8 {
        if self.drive.error_code() == 0 {
            0
        } else {
            ERROR_REGISTER_GENERIC
        }
    }

    /// The next emergency.
    pub(crate) fn take_emergency(&mut self) -> Option<Emergency> {
        let code = self.drive.take_emergency()?;
        if code != 0 {
            self.history.add(code);
        }
        Some((code, self.error_register(), [0; 5]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_of_the_commands_is_one_millisecond_late_and_the_seed_repeats_which() {
        let delayed = |late_share: f64, seed: u64| -> Vec<i32> {
            let options = DriveOptions {
                late_share,
                ..DriveOptions::default()
            };
            let mut servo = Servo::new(&options, seed);
            let demands = (1..=10_000).map(|velocity_digits| {
                let demand = Demand {
                    velocity_digits,
                    ..Demand::default()
                };
                velocity_digits - servo.delayed(demand).velocity_digits
            });
            demands.collect()
        };
        assert!(delayed(0.0, 1).iter().all(|late| *late == 0));
        let late = delayed(0.05, 1);
        assert!(late.iter().all(|late| *late == 0 || *late == 1));
        let count: i32 = late.iter().sum();
        // Three standard deviations of a binomial distribution are 65.
        assert!((count - 500).abs() < 66, "{count}");
        assert_eq!(late, delayed(0.05, 1));
        assert_ne!(late, delayed(0.05, 2));
    }
}
