//! The stack's network interface: two rings, and a filter that catches the datagram with the path.
//!
//! Invariant: a datagram to EtherCAT's port is never sent; its headers are kept.

use super::{FRAME_BYTES_MAX, Frame};
use crate::ethercat::wire::{MacAddress, UdpRepr};
use core::cell::Cell;
use core::task::Context;
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};
use heapless::spsc::{Consumer, Producer};

/// The stack's side of the rings.
pub(super) struct StackPort<'p, 'q> {
    pub(super) received: &'p mut Consumer<'q, Frame>,
    pub(super) sent: &'p mut Producer<'q, Frame>,
    /// The headers of the last datagram for the segment.
    pub(super) path: &'p Cell<Option<UdpRepr>>,
    pub(super) address: MacAddress,
}

pub(super) struct Received(Frame);

impl embassy_net_driver::RxToken for Received {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(mut self, take: F) -> R {
        take(&mut self.0)
    }
}

pub(super) struct ToSend<'t, 'q> {
    sent: &'t mut Producer<'q, Frame>,
    path: &'t Cell<Option<UdpRepr>>,
}

impl embassy_net_driver::TxToken for ToSend<'_, '_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, fill: F) -> R {
        let mut frame = Frame::new();
        // The stack respects the frame length that the port states.
        let _ = frame.resize(length, 0);
        let result = fill(&mut frame);
        match UdpRepr::parse(&frame) {
            Ok((headers, _)) => self.path.set(Some(headers)),
            // There is room: the token was only given out with it.
            Err(_) => drop(self.sent.enqueue(frame)),
        }
        result
    }
}

impl<'q> Driver for StackPort<'_, 'q> {
    type RxToken<'a>
        = Received
    where
        Self: 'a;
    type TxToken<'a>
        = ToSend<'a, 'q>
    where
        Self: 'a;

    fn receive(&mut self, _: &mut Context) -> Option<(Received, ToSend<'_, 'q>)> {
        if !self.sent.ready() {
            return None;
        }
        let frame = self.received.dequeue()?;
        Some((
            Received(frame),
            ToSend {
                sent: self.sent,
                path: self.path,
            },
        ))
    }

    fn transmit(&mut self, _: &mut Context) -> Option<ToSend<'_, 'q>> {
        self.sent.ready().then_some(ToSend {
            sent: self.sent,
            path: self.path,
        })
    }

    fn link_state(&mut self, _: &mut Context) -> LinkState {
        LinkState::Up
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = FRAME_BYTES_MAX;
        capabilities.max_burst_size = Some(1);
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet(self.address)
    }
}
