//! The link task's ends of the channels.

use super::frame::Decoder;
use super::ports::LinkPort;
use crate::control::sampler::{CycleReport, SamplerCommand};
use crate::ethercat::ApplicationEnd;
use crate::measurement::Measurements;
use crate::motion::task::{MotionOrder, MotionReport, PathItem};
use crate::network::SettingsEnd;
use heapless::spsc::{Consumer, Producer};

/// The link task's ends of a port's channels.
pub struct PortEnds<'a> {
    /// Bytes from the host.
    pub received: Consumer<'a, u8>,
    /// Finds the frames in them; long, hence in the channels.
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
    /// What the sampler saw.
    pub reports: Consumer<'a, CycleReport>,
    /// What the sampler is asked for.
    pub sampler_commands: Producer<'a, SamplerCommand>,
    /// The path.
    pub vertices: Producer<'a, PathItem>,
    /// What the trajectory is asked for.
    pub motion_orders: Producer<'a, MotionOrder>,
    /// Where the trajectory stands.
    pub motion_reports: Consumer<'a, MotionReport>,
    /// The bus' supervisor.
    pub bus: ApplicationEnd<'a>,
    /// What the IP stack is to do.
    pub network: SettingsEnd<'a>,
    /// How long things took.
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
