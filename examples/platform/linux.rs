//! A Linux computer for the examples: a raw socket (or UDP, or a Unix socket) and a tick.
//!
//! The first argument says where the slaves are: a network interface, `udp:ADDRESS` or `unix:PATH`. An interface needs
//! the right to open raw sockets (root, or `setcap cap_net_raw+ep PROGRAM`). This computer is no real-time controller: a
//! cycle waits for its reply.

use etherpen_segment::transport::{Endpoint, Transport, open, udp_address};
use std::fmt::Arguments;
use std::process::ExitCode;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

/// The master's Ethernet address.
pub(crate) const ADDRESS: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
/// Longest wait for a reply.
const REPLY_WAIT: Duration = Duration::from_millis(50);

/// This computer.
pub(crate) struct Platform {
    transport: Box<dyn Transport>,
    ticked: Instant,
}

impl Platform {
    /// Waits for the next millisecond; begins at once if it is late.
    pub(crate) fn tick(&mut self) {
        std::thread::sleep((self.ticked + Duration::from_millis(1)).saturating_duration_since(Instant::now()));
        self.ticked = Instant::now();
    }

    /// The time since the first call, ms, wrapping.
    pub(crate) fn now_ms() -> u32 {
        static BEGUN: LazyLock<Instant> = LazyLock::new(Instant::now);
        BEGUN.elapsed().as_millis() as u32
    }

    /// Sends a frame; an empty one is not sent.
    pub(crate) fn send(&mut self, frame: &[u8]) {
        if !frame.is_empty()
            && let Err(error) = self.transport.send(frame)
        {
            self.say(format_args!("not sent: {error}"));
        }
    }

    /// Passes received frames to `take` until it returns true, or the reply is too late.
    pub(crate) fn receive(&mut self, mut take: impl FnMut(&[u8]) -> bool) {
        let (until, mut frame) = (Instant::now() + REPLY_WAIT, [0; 2_048]);
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.transport.receive(&mut frame, left) {
                Ok(Some(length)) if !take(&frame[..length]) && !left.is_zero() => {}
                _ => return,
            }
        }
    }

    /// Prints a line.
    pub(crate) fn say(&self, line: Arguments) {
        println!("{line}");
    }
}

/// Opens the transport of the first argument, and runs the example.
pub(crate) fn start() -> ExitCode {
    let Some(name) = std::env::args().nth(1) else {
        eprintln!("where are the slaves? Give a network interface, udp:ADDRESS or unix:PATH");
        return ExitCode::from(2);
    };
    let endpoint = match (name.strip_prefix("udp:"), name.strip_prefix("unix:")) {
        (Some(address), _) => udp_address(address).map(Endpoint::Udp),
        (_, Some(path)) => Ok(Endpoint::Unix(path.into())),
        _ => Ok(Endpoint::Interface(name)),
    };
    match endpoint.and_then(|endpoint| open(&endpoint).map_err(|error| error.to_string())) {
        Ok(transport) => {
            let ticked = Instant::now();
            crate::run(&mut Platform { transport, ticked });
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
