//! The master with the robot's drivers and sizes.

use crate::drives::{EtherCatGroup, ServoDrives};
use crate::ethercat::cyclic::{Exchange, ExchangeEnd};
use crate::ethercat::event::{BusCommand, BusSetup};
use crate::ethercat::supervisor::Supervisor;
use crate::ethercat::{ApplicationEnd, BusQueues};
use crate::robots::AXES;

/// Length of the sample period, ns.
pub const PERIOD_NS: u32 = 1_000_000;
/// The master's Ethernet address on its own cable. Bit 1 of the first byte is clear: slaves set it in their replies.
pub const MASTER_ADDRESS: [u8; 6] = [0x10, 0x00, 0x00, 0x00, 0x00, 0x01];
/// Most slaves on the robot's bus.
pub const BUS_SLAVES_MAX: usize = 16;
/// Longest mailbox window on the robot's bus, bytes: that of a Kollmorgen AKD.
pub const BUS_MESSAGE_BYTES: usize = 1024;
/// The drivers of the robot's bus: each axis has a servo drive.
pub type RobotDrives = ServoDrives<AXES>;
/// Setup of the robot's bus.
pub type RobotBusSetup = BusSetup<RobotDrives>;
/// A command to the supervisor of the robot's bus.
pub type RobotBusCommand = BusCommand<RobotDrives>;
/// The ends of the queues to the robot's bus.
pub type RobotBusEnd<'a> = ApplicationEnd<'a, RobotDrives>;
/// The queues of the robot's bus.
pub type RobotBusQueues = BusQueues<RobotDrives, BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;
/// The exchange of the robot's bus.
pub type RobotExchange<'a> = Exchange<'a, RobotDrives, BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;
/// The exchange's ends of the queues of the robot's bus.
pub type RobotExchangeEnd<'a> = ExchangeEnd<'a, RobotDrives, BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;
/// The supervisor of the robot's bus.
pub type RobotSupervisor<'a> = Supervisor<'a, RobotDrives, BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;
/// The robot's drives as a group.
pub type RobotGroup<'a> = EtherCatGroup<'a, AXES, BUS_SLAVES_MAX, BUS_MESSAGE_BYTES>;
