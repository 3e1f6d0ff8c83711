//! The part common to all servo drives: a drive, and the delays of its inputs and outputs.
//!
//! A command takes effect `output_delay` milliseconds after it arrived on the bus. A position appears on the bus
//! `input_delay` milliseconds after it was measured.

use super::drive::{Demand, Drive};
use std::collections::VecDeque;

const ERROR_REGISTER_GENERIC: u8 = 0x01;

/// An emergency message: error code, error register, five manufacturer-specific bytes.
pub(super) type Emergency = (u16, u8, [u8; 5]);

/// Values of the drive at one time.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DriveValues {
    /// Position, increments.
    pub(super) position: i32,
    /// Speed in digits of the velocity demand.
    pub(super) velocity: i32,
    /// Torque in digits of the torque demand.
    pub(super) torque: i16,
    /// Status word.
    pub(super) status: u16,
}

/// A drive with its delays.
#[derive(Clone, Debug)]
pub(super) struct Servo {
    /// The drive and its motor.
    pub(super) drive: Drive,
    /// Last demand from the bus.
    pub(super) demand: Demand,
    shown: DriveValues,
    demands: VecDeque<Demand>,
    samples: VecDeque<DriveValues>,
    output_delay: usize,
    input_delay: usize,
}

impl Servo {
    /// A drive behind delays of whole milliseconds.
    pub(super) fn new(drive: Drive, output_delay: usize, input_delay: usize) -> Self {
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
    pub(super) fn power_up(&mut self) {
        let mut drive = self.drive.clone();
        drive.power_up();
        *self = Self::new(drive, self.output_delay, self.input_delay);
    }

    /// Advances by one millisecond; `operational` if the outputs are valid.
    pub(super) fn step(&mut self, operational: bool) {
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
    pub(super) fn coast(&mut self) {
        let demand = self.demands.front().copied().unwrap_or_default();
        self.drive.coast(demand);
    }

    /// Takes a sample, and shows the one taken `input_delay` milliseconds ago.
    pub(super) fn sample(&mut self) {
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
    pub(super) fn shown(&self) -> DriveValues {
        self.shown
    }

    /// Content of the error register, object 0x1001.
    pub(super) fn error_register(&self) -> u8 {
        if self.drive.error_code() == 0 {
            0
        } else {
            ERROR_REGISTER_GENERIC
        }
    }

    /// The next emergency.
    pub(super) fn take_emergency(&mut self) -> Option<Emergency> {
        let code = self.drive.take_emergency()?;
        Some((code, self.error_register(), [0; 5]))
    }
}
