//! The part common to all servo drives: a drive, and the delays of its inputs and outputs.
//!
//! A command takes effect `output_delay` milliseconds after it arrived on the bus. A position appears on the bus
//! `input_delay` milliseconds after it was measured.

use crate::drive::{Demand, Drive, DriveOptions};
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
}

impl Servo {
    /// A drive behind delays of whole milliseconds; the seed is that of its resolver's noise.
    pub(crate) fn new(options: &DriveOptions, noise_seed: u64) -> Self {
        let output_delay = options.output_delay_ms.min(DELAY_MAX_MS);
        let input_delay = options.input_delay_ms.min(DELAY_MAX_MS);
        Self::of(Drive::new(options, noise_seed), output_delay, input_delay)
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
        }
    }

    /// Resets everything but the motor to its state after power-up.
    pub(crate) fn power_up(&mut self) {
        let mut drive = self.drive.clone();
        drive.power_up();
        *self = Self::of(drive, self.output_delay, self.input_delay);
    }

    /// Advances by one millisecond; `operational` if the outputs are valid.
    pub(crate) fn step(&mut self, operational: bool) {
        let demand = if operational {
            self.demands.push_back(self.demand);
            if self.demands.len() > self.output_delay {
                Some(self.demands.pop_front().unwrap_or_default())
            } else {
                Some(Demand::default())
            }
        } else {
            self.demands.clear();
            None
        };
        self.drive.step(demand);
    }

    /// Advances by one millisecond with the processor stopped.
    pub(crate) fn coast(&mut self) {
        let demand = self.demands.front().copied().unwrap_or_default();
        self.drive.coast(demand);
    }

    /// Takes a sample, and shows the one taken `input_delay` milliseconds ago.
    pub(crate) fn sample(&mut self) {
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
        Some((code, self.error_register(), [0; 5]))
    }
}
