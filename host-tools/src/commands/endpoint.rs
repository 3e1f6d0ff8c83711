//! Options for the address of a segment.

use etherpen_segment::transport::{Endpoint, udp_address};
use std::net::SocketAddrV4;
use std::path::{Path, PathBuf};

/// Options of a segment: its address for masters.
#[derive(clap::Args, Debug)]
#[group(required = true, multiple = false)]
pub struct SegmentArguments {
    /// Raw EtherCAT frames on this network interface; needs permission for raw sockets.
    #[arg(long, value_name = "IF")]
    interface: Option<String>,
    /// EtherCAT in UDP at this IPv4 address, HOST or HOST:PORT (default port 34980; 0 takes a free one).
    #[arg(long, value_name = "ADDR", value_parser = udp_address)]
    udp: Option<SocketAddrV4>,
    /// Unix socket (SOCK_SEQPACKET), one Ethernet frame per message.
    #[arg(long, value_name = "PATH")]
    unix: Option<PathBuf>,
    /// Send the COMMAND to the segment with this control socket (--control) and print its answer.
    #[arg(long, value_name = "PATH")]
    tell: Option<PathBuf>,
}

impl SegmentArguments {
    /// The control socket of the segment that gets a command, if one was given.
    pub fn tell(&self) -> Option<&Path> {
        self.tell.as_deref()
    }

    /// The one that was given.
    pub fn endpoint(&self) -> Endpoint {
        match (&self.interface, &self.udp, &self.unix) {
            (Some(name), _, _) => Endpoint::Interface(name.clone()),
            (_, Some(address), _) => Endpoint::Udp(*address),
            (_, _, path) => Endpoint::Unix(path.clone().unwrap_or_default()),
        }
    }
}
