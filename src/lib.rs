//! etherpen: a robot controller that runs on a microcontroller.
//!
//! An EtherCAT master, a motion planner and a 1 kHz position controller for a robot with four servo drives,
//! without an operating system and without a heap. A host turns a photograph into strokes and streams them over a
//! serial link; the firmware turns them into motion. It follows the structure of *Using Real-time Java for Industrial
//! Robot Control* (Robertz, Henriksson, Nilsson, Blomdell, Tarasov; Lund, 2007).
//!
//! # Bird's eye view
//!
//! The library contains everything that does not depend on a board. [`controller::Channels`] holds the lock-free queues
//! and splits into eight parts. A board (`src/bin/nucleo.rs`, `src/bin/emulated.rs`) gives each part a priority and the
//! interrupts that release it; the host's simulation calls the parts in the same order in virtual time (`docs/tasks.md`
//! lists every task of both boards):
//!
//! | part | released by | priority | does |
//! |---|---|---|---|
//! | [`control::sampler::Sampler`] | timer, Ethernet, deadline | 15 | input telegram, control, output telegram |
//! | [`controller::HostBytes`] | serial line, every millisecond | 10 | the link's bytes in and out |
//! | [`black_box::Recorder`] | every millisecond | 8 | records the millisecond in memory that survives a reset |
//! | [`trajectory_task::TrajectoryTask`] | every 12th sample | 6 | plans, fills the ring of 1 ms setpoints |
//! | [`controller::HostBytes`], a second one | USB, every millisecond | 3 | the link's bytes on a board's own USB port |
//! | [`link_task::LinkTask`] | every millisecond | 3 | the link's messages; owns the [`coordinator::Coordinator`], which decides modes, admission and configuration |
//! | [`ethercat::supervisor::Supervisor`] | every millisecond | 1 | brings the bus up, watches and repairs it |
//! | [`network::NetworkTask`] | every millisecond | 1 | the IP stack that finds the addresses for EtherCAT in UDP |
//!
//! # Layers
//!
//! The crates below know nothing of this one: [`motion`] plans, [`drives`] knows servo drives, [`ethercat`] is the
//! master, [`link`] carries messages between host and firmware. In this crate a module imports modules of lower layers
//! only; `tests/layers.rs` reads this list and the sources.
//!
//! 1. `robot_bus`, `ethernet`, `hash`: the master with the robot's sizes; the logic of Ethernet controllers; FNV-1a
//! 2. `config`: every number that the controller needs, and its bounds
//! 3. `network`, `control::limit`, `control::position`: the IP stack for EtherCAT in UDP; position controller
//! 4. `control::velocity`, `control::torque_feedback`: velocity controller; monitor of one axis in torque mode
//! 5. `control::feedback`, `control::search`: monitor of one axis; homing by switches
//! 6. `control::robot_axes`, `application::fault`, `application::mode`: the drives as the robot's axes; what can go
//!    wrong, and the operating modes
//! 7. `board`: inputs, port, lamps and supervision of a board
//! 8. `application::command`, `application::condition`, `application::action`: what the operating modes take and give
//! 9. `control`: the sampler and its supervision
//! 10. `application`, `trajectory_task`, `measurement`: operating modes; the 12 ms task; timing of the tasks
//! 11. `black_box`: the last two seconds before a reset
//! 12. `messages`: what the messages between host and firmware contain
//! 13. `coordinator`: decides what the robot does with requests and reports
//! 14. `link_task`: moves the messages
//! 15. `controller`: all task bodies and the queues between them
//!
//! Logic of Ethernet controllers (`ethernet`) and the IP stack (`network`) are here and not in the master's crate: the
//! master takes any driver and knows no addresses. `board` is here because boards report faults and show modes; the
//! queues' operations are in [`ethercat::queue`], where both sides of the master and the tasks above reach them.
//!
//! # One vertex, from the photograph to the motor
//!
//! 1. The host vectorises a photograph into strokes, orders them, expands them with their lifts into a path in the
//!    robot's frame and admits every vertex ([`motion::Admission`]).
//! 2. The vertex travels in a path message within the firmware's credit ([`link`]); the [`coordinator`] admits it
//!    again and puts it into the vertex queue.
//! 3. The trajectory task takes it into its window, rounds the corner within the tolerance, finds the fastest speed
//!    along the path that keeps every joint within its limits and still ends at rest ([`motion`]), and puts one
//!    setpoint a millisecond into the ring.
//! 4. The sampler takes one setpoint a millisecond, compares it with the position that the drives have just reported
//!    ([`ethercat::cyclic`], [`control::robot_axes`]), and sends each drive a velocity ([`control::position`]).
//! 5. The drive turns the motor. Its measurements come back a millisecond later and also go to the host as telemetry.
//!
//! # Invariants
//!
//! - Priorities share only lock-free queues, atomics and histograms with one writer; no task waits for one of lower
//!   priority.
//! - The critical tasks do the same bounded work every millisecond, whatever arrives; they never lock, log or allocate.
//! - A committed plan ends at rest: after a lost link, a late planner or an empty queue the robot comes to rest on the
//!   path.
//! - Every fault ends in one way: a stop, standstill, brakes, power off, latched until acknowledged ([`application`]). A
//!   stop by command, late cycles or a stalled motion brakes along the path ([`control::path_stop`]); every other fault is
//!   the drives' quick stop.
//! - No `cfg` in this library selects a board; the library accesses no register of any microcontroller.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod application;
pub mod black_box;
pub mod board;
pub mod config;
pub mod control;
pub mod controller;
pub mod coordinator;
pub mod ethernet;
pub mod hash;
pub mod link_task;
pub mod measurement;
pub mod messages;
pub mod network;
pub mod robot_bus;
pub mod trajectory_task;

pub use etherpen_drives as drives;
pub use etherpen_ethercat as ethercat;
pub use etherpen_link as link;
pub use etherpen_motion as motion;
pub use etherpen_motion::robots;
