//! The Ethernet port for the critical tasks: controller, clock and lockstep together.
//!
//! In lockstep, sending a frame includes waiting for its replies while virtual time is stopped. The host's token gives
//! the number of replies; then all alarms are removed and the core sleeps. Without an alarm the emulator cannot advance
//! its clock, so it only delivers the replies to the controller, however long a busy host takes. Then the alarms are
//! restored, and one more releases `bus_frame` after a fixed delay of the wire. A reply is therefore never late, and
//! all runs have identical times, to the count.
//!
//! All of this is owned by the tasks of the critical priority and takes no critical section.

use super::device::Interrupt;
use super::lan9118::{Mmio, frames_waiting, free_run};
use super::lockstep::Bus;
use super::timer::Clock;
use super::wake;
use crate::shared::frames;
use core::task::Context;
use cortex_m::peripheral::NVIC;
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};
use etherpen::black_box::Direction;
use etherpen::ethernet::lan9118::{self, Lan9118, RxToken};

/// Controller, clock and lockstep.
pub(crate) struct Wire {
    mac: Lan9118<Mmio>,
    bus: Option<Bus>,
    lockstep_counts: u32,
    waits: bool,
    /// The clock that stamps outgoing frames.
    pub(crate) clock: Clock,
}

impl Wire {
    pub(crate) fn new(mac: Lan9118<Mmio>, bus: Option<Bus>, clock: Clock) -> Self {
        Self {
            mac,
            bus,
            lockstep_counts: 0,
            waits: true,
            clock,
        }
    }

    /// Clears the controller's interrupt.
    pub(crate) fn acknowledge(&mut self) {
        self.mac.acknowledge();
    }

    /// Counts spent on the lockstep since the last call; firmware on silicon does not have this work.
    pub(crate) fn take_lockstep_counts(&mut self) -> u32 {
        core::mem::take(&mut self.lockstep_counts)
    }

    /// Stops waiting for replies: the firmware is ending, and a wait would let tasks run again.
    pub(crate) fn wait_no_more(&mut self) {
        self.waits = false;
    }

    /// Frames that were damaged or not sent.
    pub(crate) fn failures(&self) -> u32 {
        self.mac.counters().failures()
    }
}

impl Driver for Wire {
    type RxToken<'a> = Noted<'a>;
    type TxToken<'a> = TxToken<'a>;

    fn receive(&mut self, context: &mut Context) -> Option<(Noted<'_>, TxToken<'_>)> {
        let (received, inner) = self.mac.receive(context)?;
        let token = TxToken {
            inner,
            lockstep_counts: &mut self.lockstep_counts,
            waits: self.waits,
            clock: &mut self.clock,
            bus: self.bus.as_ref(),
        };
        Some((Noted(received), token))
    }

    fn transmit(&mut self, context: &mut Context) -> Option<TxToken<'_>> {
        Some(TxToken {
            inner: self.mac.transmit(context)?,
            lockstep_counts: &mut self.lockstep_counts,
            waits: self.waits,
            clock: &mut self.clock,
            bus: self.bus.as_ref(),
        })
    }

    fn link_state(&mut self, context: &mut Context) -> LinkState {
        self.mac.link_state(context)
    }

    fn capabilities(&self) -> Capabilities {
        self.mac.capabilities()
    }

    fn hardware_address(&self) -> HardwareAddress {
        self.mac.hardware_address()
    }
}

/// A received frame, noted for the black box when it is taken.
pub(crate) struct Noted<'a>(RxToken<'a>);

impl embassy_net_driver::RxToken for Noted<'_> {
    fn consume<T, F: FnOnce(&mut [u8]) -> T>(self, f: F) -> T {
        self.0.consume(|frame| {
            frames::note(Direction::Received, frame.as_ptr(), frame.len(), free_run());
            f(frame)
        })
    }
}

/// Permission to send one frame and to wait for its token.
pub(crate) struct TxToken<'a> {
    inner: lan9118::TxToken<'a, Mmio>,
    lockstep_counts: &'a mut u32,
    waits: bool,
    clock: &'a mut Clock,
    bus: Option<&'a Bus>,
}

impl TxToken<'_> {
    fn clear_arrival(&mut self) {
        self.inner.acknowledge();
        NVIC::unpend(Interrupt::LAN9118);
    }

    /// Sleeps until `wanted` frames, replies to one sent at `sent_at`, wait in the controller.
    fn await_replies(&mut self, wanted: u32, sent_at: u32) {
        self.clock.pause();
        wake::woken_by(Interrupt::LAN9118, || {
            self.clear_arrival();
            frames_waiting() >= wanted
        });
        // The last of several may have arrived between two checks; the clock releases `bus_frame`, not this interrupt.
        self.clear_arrival();
        self.clock.resume_and_deliver(sent_at);
    }
}

impl embassy_net_driver::TxToken for TxToken<'_> {
    fn consume<T, F: FnOnce(&mut [u8]) -> T>(mut self, length: usize, f: F) -> T {
        let f = |frame: &mut [u8]| {
            frames::note(Direction::Sent, frame.as_ptr(), frame.len(), free_run());
            f(frame)
        };
        let Some(bus) = self.bus else {
            return self.inner.send(length, f).0;
        };
        let waiting = frames_waiting();
        self.clear_arrival();
        let (result, sent) = self.inner.send(length, f);
        if sent {
            let sent_at = free_run();
            let replies = bus.frame_sent(self.clock.time_us());
            if replies > 0 && self.waits {
                self.await_replies(waiting + u32::from(replies), sent_at);
            }
            *self.lockstep_counts = self.lockstep_counts.wrapping_add(free_run().wrapping_sub(sent_at));
        }
        result
    }
}
