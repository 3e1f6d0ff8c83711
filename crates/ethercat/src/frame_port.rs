//! EtherCAT directly in Ethernet frames, over any `embassy_net_driver::Driver`.
//!
//! Made for the critical tasks: the driver gets a waker that does nothing, so no lock and no wake-up is needed, and a
//! frame is passed on or dropped at once.
//!
//! Invariant: no call waits.

use crate::wire::write_bytes;
use core::task::{Context, Waker};
use embassy_net_driver::{Driver, HardwareAddress, RxToken, TxToken};

/// Result of sending a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sending {
    /// The driver has accepted the frame.
    Sent {
        /// Length of the frame, bytes.
        length: usize,
    },
    /// There was nothing to send.
    Nothing,
    /// The driver has no room; the frame is lost.
    Busy,
}

/// EtherCAT over an Ethernet driver.
#[derive(Debug)]
pub struct FramePort<D> {
    driver: D,
}

impl<D: Driver> FramePort<D> {
    /// A transport over `driver`.
    pub const fn new(driver: D) -> Self {
        Self { driver }
    }

    /// The driver's Ethernet address; a locally administered one if the driver has none.
    pub fn mac_address(&self) -> [u8; 6] {
        match self.driver.hardware_address() {
            HardwareAddress::Ethernet(address) => address,
            _ => [0x10, 0, 0, 0, 0, 1],
        }
    }

    /// The driver, for its other functions.
    pub fn driver_mut(&mut self) -> &mut D {
        &mut self.driver
    }

    /// Passes `frame` to the driver; does nothing if it is empty.
    pub fn send(&mut self, frame: &[u8]) -> Sending {
        let length = frame.len();
        if frame.is_empty() {
            return Sending::Nothing;
        }
        match self.driver.transmit(&mut Context::from_waker(Waker::noop())) {
            Some(token) => {
                token.consume(length, |buffer| write_bytes(buffer, 0, frame));
                Sending::Sent { length }
            }
            None => Sending::Busy,
        }
    }

    /// Passes the next received frame to `take`; `None` when there is none.
    pub fn receive<R>(&mut self, take: impl FnOnce(&[u8]) -> R) -> Option<R> {
        let (token, _) = self.driver.receive(&mut Context::from_waker(Waker::noop()))?;
        Some(token.consume(|frame| take(frame)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embassy_net_driver::{Capabilities, LinkState};
    use heapless::Vec;

    #[derive(Default)]
    struct Loopback {
        frames: Vec<Vec<u8, 64>, 1>,
    }

    struct Received(Vec<u8, 64>);

    impl RxToken for Received {
        fn consume<R, F: FnOnce(&mut [u8]) -> R>(mut self, f: F) -> R {
            f(&mut self.0)
        }
    }

    struct ToSend<'a>(&'a mut Loopback);

    impl TxToken for ToSend<'_> {
        fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, f: F) -> R {
            let mut frame = Vec::new();
            frame.resize(len, 0).unwrap();
            let result = f(&mut frame);
            self.0.frames.push(frame).unwrap();
            result
        }
    }

    impl Driver for Loopback {
        type RxToken<'a> = Received;
        type TxToken<'a> = ToSend<'a>;

        fn receive(&mut self, _: &mut Context) -> Option<(Received, ToSend<'_>)> {
            let frame = self.frames.pop()?;
            Some((Received(frame), ToSend(self)))
        }

        fn transmit(&mut self, _: &mut Context) -> Option<ToSend<'_>> {
            if self.frames.is_full() {
                None
            } else {
                Some(ToSend(self))
            }
        }

        fn link_state(&mut self, _: &mut Context) -> LinkState {
            LinkState::Up
        }

        fn capabilities(&self) -> Capabilities {
            Capabilities::default()
        }

        fn hardware_address(&self) -> HardwareAddress {
            HardwareAddress::Ethernet([1, 2, 3, 4, 5, 6])
        }
    }

    #[test]
    fn a_frame_goes_out_and_comes_in_and_a_full_driver_drops_it() {
        let mut transport = FramePort::new(Loopback::default());
        assert_eq!(transport.mac_address(), [1, 2, 3, 4, 5, 6]);
        assert_eq!(transport.send(&[]), Sending::Nothing);
        assert_eq!(transport.send(&[7; 60]), Sending::Sent { length: 60 });
        assert_eq!(transport.send(&[7; 60]), Sending::Busy);
        assert_eq!(transport.receive(|frame| (frame.len(), frame[59])), Some((60, 7)));
        assert_eq!(transport.receive(|frame| frame.len()), None);
    }
}
