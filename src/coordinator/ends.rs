//! The coordinator's ends of the queues to the other tasks.

use crate::control::sampler::{CycleReport, SamplerCommand};
use crate::measurement::Measurements;
use crate::network::SettingsEnd;
use crate::robot_bus::RobotBusEnd;
use crate::trajectory_task::{MotionOrder, MotionReport, PathItem};
use heapless::spsc::{Consumer, Producer};

/// The coordinator's ends of the queues to the other tasks.
pub struct CoordinatorEnds<'a> {
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
