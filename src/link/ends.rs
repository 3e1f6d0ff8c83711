//! The link task's ends of the channels.

use super::frame::Decoder;
use super::ports::LinkPort;
use crate::control::sampler::{CycleReport, SamplerCommand};
use crate::measurement::Measurements;
use crate::network::SettingsEnd;
use crate::robot_bus::RobotBusEnd;
use crate::trajectory_task::{MotionOrder, MotionReport, PathItem};
use heapless::spsc::{Consumer, Producer};

/// The link task's ends of a port's channels.
pub struct PortEnds<'a> {
    /// Bytes from the host.
    pub received: Consumer<'a, u8>,
    /// Finds the frames in the received bytes; large, therefore stored in the channels.
    pub decoder: &'a mut Decoder,
    /// Bytes to the host.
    pub sent: Producer<'a, u8>,
}

/// The link task's ends of the channels.
pub struct LinkEnds<'a> {
    /// The serial line.
    pub serial: PortEnds<'a>,
    /// The board's own USB.
    pub usb: PortEnds<'a>,
    /// Reports of the sampler, one a millisecond.
    pub reports: Consumer<'a, CycleReport>,
    /// Commands to the sampler.
    pub sampler_commands: Producer<'a, SamplerCommand>,
    /// The path.
    pub vertices: Producer<'a, PathItem>,
    /// Orders to the trajectory task.
    pub motion_orders: Producer<'a, MotionOrder>,
    /// State of the trajectory task.
    pub motion_reports: Consumer<'a, MotionReport>,
    /// The bus's supervisor.
    pub bus: RobotBusEnd<'a>,
    /// Settings for the IP stack.
    pub network: SettingsEnd<'a>,
    /// Execution times of the tasks.
    pub measurements: &'a Measurements,
}

impl<'a> LinkEnds<'a> {
    pub(super) fn port(&mut self, port: LinkPort) -> &mut PortEnds<'a> {
        match port {
            LinkPort::Serial => &mut self.serial,
            LinkPort::Usb => &mut self.usb,
        }
    }
}
