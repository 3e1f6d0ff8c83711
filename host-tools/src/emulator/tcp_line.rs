//! The firmware's serial line as a TCP port.

use super::client::ClientSlot;
use super::{LINK_BYTES_MAX, Link};
use std::net::{SocketAddr, TcpListener, TcpStream};

/// The serial link as a TCP port: one client at a time, bytes as on a line of 921,600 baud.
pub struct TcpLine<S> {
    listener: TcpListener,
    client: ClientSlot<TcpStream>,
    show: S,
}

/// Event at a [`TcpLine`].
#[derive(Clone, Copy, Debug)]
pub enum LineEvent {
    /// A client has connected.
    Connected(SocketAddr),
    /// The client has gone.
    Disconnected,
}

impl<S: FnMut(LineEvent)> TcpLine<S> {
    /// Listens on 127.0.0.1; port 0 selects a free one. `show` gets the events.
    ///
    /// # Errors
    /// The port cannot be used.
    pub fn listen(port: u16, show: S) -> std::io::Result<Self> {
        let listener = TcpListener::bind(("127.0.0.1", port))?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            listener,
            client: ClientSlot::empty(),
            show,
        })
    }

    /// Address on which the line listens.
    ///
    /// # Errors
    /// Error of the operating system.
    pub fn address(&self) -> std::io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    fn accept(&mut self) {
        if let Ok((client, address)) = self.listener.accept() {
            let ready = client.set_nonblocking(true).and_then(|()| client.set_nodelay(true));
            if ready.is_ok() {
                (self.show)(LineEvent::Connected(address));
                self.client.take(client);
            }
        }
    }
}

impl<S: FnMut(LineEvent)> Link for TcpLine<S> {
    fn exchange(&mut self, _ms: u32, from_device: &[u8], to_device: &mut Vec<u8>) {
        if self.client.is_empty() {
            self.accept();
        }
        if !self.client.exchange(from_device, to_device, LINK_BYTES_MAX) {
            (self.show)(LineEvent::Disconnected);
        }
    }
}
