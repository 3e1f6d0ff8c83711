//! An image of the master of this project, to be weighed and not to be run.
#![no_std]
#![no_main]

#[path = "image/mod.rs"]
mod image;

use benchmarks::etherpen_master;
use cortex_m_rt::entry;
use etherpen::robot_bus::RobotBusQueues;

#[entry]
fn main() -> ! {
    static mut QUEUES: RobotBusQueues = RobotBusQueues::new();
    etherpen_master::serve(QUEUES, image::wire)
}
