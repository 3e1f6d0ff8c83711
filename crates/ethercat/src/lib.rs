#![doc = include_str!("../README.md")]
//!
//! # Layers
//!
//! A module imports modules of lower layers only.
//!
//! 1. `wire`, `queue`, `port_state`, `slave_set`: wire formats; queues between priorities; state of the Ethernet port;
//!    sets of slaves
//! 2. `error`, `frame_port`: errors of the master; the seam to an Ethernet MAC
//! 3. `acyclic`, `observation`: datagrams outside the cycle; what a cycle has observed
//! 4. `mailbox`, `state`: mailboxes; states of slaves
//! 5. `coe`, `foe`, `diagnostics`: objects; files; requests of an application
//! 6. `configure`, `topology`: discovery of slaves and their objects; how slaves are connected
//! 7. `driver`: the seam to kinds of slaves
//! 8. `no_drivers`, `plan`, `slave`, `encapsulation`: an application without drivers; contents of a cycle; what is known
//!    of a slave; UDP
//! 9. `telegram`, `clock`: frames of a cycle; distributed clocks
//! 10. `event`, `cyclic`: events and commands; the cyclic exchange
//! 11. `process_data`, `place`: mapping of process data; places of values in them
//! 12. `supervisor`: bring-up, supervision and repair
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod acyclic;
pub mod clock;
pub mod coe;
#[cfg(test)]
mod coe_tests;
pub mod configure;
pub mod cyclic;
pub mod diagnostics;
pub mod driver;
pub mod encapsulation;
#[cfg(test)]
mod encapsulation_tests;
pub mod error;
pub mod event;
#[cfg(test)]
mod exchange_tests;
pub mod foe;
pub mod frame_port;
#[cfg(test)]
mod further_tests;
pub mod mailbox;
pub mod no_drivers;
mod observation;
pub mod place;
mod plan;
pub mod port_state;
pub mod process_data;
pub mod queue;
#[cfg(test)]
mod random;
#[cfg(test)]
mod reply_tests;
pub mod slave;
pub mod slave_set;
pub mod state;
pub mod supervisor;
mod telegram;
pub mod topology;
pub mod wire;

use acyclic::{AcyclicPort, IN_FLIGHT_MAX, Lane, Reply, Request};
use cyclic::{CyclicPlan, ExchangeEnd, Observation};
use diagnostics::{ServiceRequest, ServiceResult};
use driver::SlaveFactory;
use event::{BusCommand, BusEvent};
use heapless::spsc::{Consumer, Producer, Queue};
use supervisor::SupervisorEnd;

/// Size of a queue that holds `IN_FLIGHT_MAX` entries; one place of a queue stays empty.
const ACYCLIC_PLACES: usize = IN_FLIGHT_MAX + 1;

/// The queues between critical side, supervisor and application; in static memory.
///
/// `SLAVES` is the maximum number of slaves on the bus: up to 32, or up to 64 with further frames; `MESSAGE` is the longest
/// acyclic datagram in bytes, which is also the longest usable mailbox window; `FURTHER` is the number of frames that a cycle
/// may take in each direction besides the first one, up to [`cyclic::FURTHER_MAX`].
#[derive(Debug)]
pub struct BusQueues<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize = 0> {
    plans: Queue<CyclicPlan<F, SLAVES>, 3>,
    requests: Queue<Request, ACYCLIC_PLACES>,
    replies: Queue<Reply, ACYCLIC_PLACES>,
    messages: Queue<Request<MESSAGE>, 2>,
    message_replies: Queue<Reply<MESSAGE>, 2>,
    observations: Queue<Observation, 11>,
    commands: Queue<BusCommand<F>, 3>,
    events: Queue<BusEvent, 33>,
    services: Queue<ServiceRequest, 2>,
    answers: Queue<ServiceResult, 2>,
}

/// The application's ends of the queues.
pub struct ApplicationEnd<'a, F: SlaveFactory> {
    /// Commands to the supervisor.
    pub commands: Producer<'a, BusCommand<F>>,
    /// Events of the supervisor; take them at least every few milliseconds.
    pub events: Consumer<'a, BusEvent>,
    /// Service requests; one at a time.
    pub services: Producer<'a, ServiceRequest>,
    /// Answers to the service requests, in order.
    pub answers: Consumer<'a, ServiceResult>,
}

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize>
    BusQueues<F, SLAVES, MESSAGE, FURTHER>
{
    /// Empty queues.
    pub const fn new() -> Self {
        Self {
            plans: Queue::new(),
            requests: Queue::new(),
            replies: Queue::new(),
            messages: Queue::new(),
            message_replies: Queue::new(),
            observations: Queue::new(),
            commands: Queue::new(),
            events: Queue::new(),
            services: Queue::new(),
            answers: Queue::new(),
        }
    }

    /// Splits into the ends for the three sides.
    pub fn split(
        &mut self,
    ) -> (
        ExchangeEnd<'_, F, SLAVES, MESSAGE, FURTHER>,
        SupervisorEnd<'_, F, SLAVES, MESSAGE>,
        ApplicationEnd<'_, F>,
    ) {
        let (plans_in, plans) = self.plans.split();
        let (requests_in, requests) = self.requests.split();
        let (replies, replies_out) = self.replies.split();
        let (messages_in, messages) = self.messages.split();
        let (message_replies, message_replies_out) = self.message_replies.split();
        let (observations, observations_out) = self.observations.split();
        let (commands, commands_out) = self.commands.split();
        let (events_in, events) = self.events.split();
        let (services_in, services) = self.services.split();
        let (answers, answers_out) = self.answers.split();
        (
            ExchangeEnd {
                plans,
                requests,
                replies,
                messages,
                message_replies,
                observations,
            },
            SupervisorEnd {
                plans: plans_in,
                frames: 1 + FURTHER as u8,
                port: AcyclicPort::new(
                    Lane::new(requests_in, replies_out),
                    Lane::new(messages_in, message_replies_out),
                ),
                observations: observations_out,
                commands: commands_out,
                events: events_in,
                services,
                answers,
            },
            ApplicationEnd {
                commands,
                events,
                services: services_in,
                answers: answers_out,
            },
        )
    }
}

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize, const FURTHER: usize> Default
    for BusQueues<F, SLAVES, MESSAGE, FURTHER>
{
    fn default() -> Self {
        Self::new()
    }
}
