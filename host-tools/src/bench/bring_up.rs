//! Number of frames that a master needs until four identical drives are in OP, with their clocks set.
//!
//! Both masters use a freshly powered-up virtual cell of one kind. This project's master also writes ten objects to
//! each drive, which count; ethercrab only does its default steps. Frames of this master that carry cyclic datagrams only,
//! most of them while the clocks settle, are counted apart. The cell's time advances with the frames: a
//! millisecond for each cycle of this master, a round trip of 100 us for each frame of ethercrab, which waits for
//! replies only.

use super::{BenchError, programs};
use crate::cell::{AlState, Cell, CellOptions};
use etherpen::config::Config;
use etherpen::ethercat::event::{BusCommand, BusEvent};
use etherpen::ethercat::wire::{Command, FrameView, register};
use etherpen::robot_bus::MASTER_ADDRESS;
use etherpen::robot_bus::{RobotBusQueues, RobotExchange, RobotSupervisor};
use std::io::{ErrorKind, Read, Write};
use std::pin::pin;
use std::task::{Context, Waker};

/// Longest bring-up, ms of the cell's time.
const BRING_UP_MS_MAX: u64 = 30_000;
/// Most frames of a bring-up.
const FRAMES_MAX: u64 = 100_000;
const ROUND_TRIP_US: u64 = 100;
/// A millisecond's second telegram follows the first after this time, us.
const OUTPUT_AFTER_US: u64 = 100;

fn failed(subject: &str, cause: impl std::fmt::Display) -> BenchError {
    BenchError::Program {
        program: format!("bring-up by {subject}"),
        cause: cause.to_string(),
    }
}

fn all_operational(cell: &Cell) -> bool {
    let slaves = cell.state().slaves;
    !slaves.is_empty() && slaves.iter().all(|slave| slave.al_state == AlState::Operational)
}

/// Frames of a bring-up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Frames {
    /// Frames with an acyclic datagram.
    pub(super) acyclic: u64,
    /// Frames of cyclic datagrams only: process data, AL status, and the reference clock's time.
    pub(super) cyclic: u64,
}

/// Whether a telegram carries cyclic datagrams only.
fn is_cyclic(telegram: &[u8]) -> bool {
    let Ok(view) = FrameView::new_checked(telegram) else {
        return false;
    };
    let mut states = 0;
    view.datagrams().flatten().all(|datagram| {
        let register = (datagram.address().0 >> 16) as u16;
        match Command::from_number(datagram.command_number()) {
            Ok(Command::Lrd | Command::Lwr | Command::Lrw) => true,
            Ok(Command::Frmw) => register == register::DC_SYSTEM_TIME,
            Ok(Command::Brd) => {
                states += 1;
                register == register::AL_STATUS && states == 1
            }
            _ => false,
        }
    })
}

/// Frames of this project's bring-up.
pub(super) fn etherpen() -> Result<Frames, BenchError> {
    let mut config = Config::default();
    config.bus.clocks = true;
    let mut cell = Cell::new(&config, CellOptions::default());
    let mut queues = Box::new(RobotBusQueues::new());
    let (exchange_end, supervisor_end, mut application) = queues.split();
    let mut exchange = RobotExchange::new(exchange_end, MASTER_ADDRESS);
    let mut supervisor = RobotSupervisor::new(supervisor_end);
    let mut supervision = pin!(supervisor.run());
    let mut context = Context::from_waker(Waker::noop());
    let setup = config.bus_setup();
    if application.commands.enqueue(BusCommand::Start(setup)).is_err() {
        return Err(failed("etherpen", "no room for the order"));
    }
    let mut cyclic = 0;
    for now_ms in 0..BRING_UP_MS_MAX {
        for (output, time_us) in [(false, now_ms * 1000), (true, now_ms * 1000 + OUTPUT_AFTER_US)] {
            let telegram = if output {
                exchange.output_telegram()
            } else {
                exchange.input_telegram()
            };
            cyclic += u64::from(is_cyclic(telegram));
            for reply in cell.frame(time_us, telegram) {
                exchange.receive(&reply);
            }
        }
        if supervision.as_mut().poll(&mut context).is_ready() {
            break;
        }
        while let Some(event) = application.events.dequeue() {
            match event {
                BusEvent::Operational if all_operational(&cell) => {
                    let acyclic = cell.state().frames.saturating_sub(cyclic);
                    return Ok(Frames { acyclic, cyclic });
                }
                BusEvent::Refused { .. } => return Err(failed("etherpen", format_args!("{event:?}"))),
                _ => {}
            }
        }
    }
    Err(failed("etherpen", "the drives did not get to OP"))
}

/// Frames of ethercrab's bring-up; its program has already been built.
pub(super) fn ethercrab() -> Result<u64, BenchError> {
    let mut cell = Cell::new(&Config::default(), CellOptions::default());
    let mut child = programs::start("bring_up")?;
    let exchanged = match (child.stdin.take(), child.stdout.take()) {
        (Some(input), Some(output)) => exchange(&mut cell, output, input),
        _ => Ok(()),
    };
    let status = child.wait().map_err(|cause| failed("ethercrab", cause))?;
    exchanged?;
    if status.success() && all_operational(&cell) {
        Ok(cell.state().frames)
    } else {
        let states: Vec<_> = cell.state().slaves.iter().map(|slave| slave.al_state).collect();
        Err(failed("ethercrab", format_args!("{status}, drives in {states:?}")))
    }
}

/// Passes frames through the cell until there are no more.
fn exchange(cell: &mut Cell, mut from: impl Read, mut to: impl Write) -> Result<(), BenchError> {
    let error = |cause: std::io::Error| failed("ethercrab", cause);
    for number in 0..FRAMES_MAX {
        let mut length = [0; 2];
        match from.read_exact(&mut length) {
            Err(cause) if cause.kind() == ErrorKind::UnexpectedEof => return Ok(()),
            result => result.map_err(error)?,
        }
        let mut frame = vec![0; usize::from(u16::from_le_bytes(length))];
        from.read_exact(&mut frame).map_err(error)?;
        let replies = cell.frame(number * ROUND_TRIP_US, &frame);
        let Some(reply) = replies.first().filter(|reply| reply.len() == frame.len()) else {
            return Err(failed("ethercrab", "a frame got no reply of its length"));
        };
        to.write_all(&[&length, reply.as_slice()].concat()).map_err(error)?;
    }
    Err(failed("ethercrab", format_args!("not in OP after {FRAMES_MAX} frames")))
}
