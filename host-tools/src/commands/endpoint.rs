//! Options for the address of a segment.

use etherpen_segment::transport::{Endpoint, udp_address};
use std::net::SocketAddrV4;
use std::path::PathBuf;

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
}

impl SegmentArguments {
    /// The one that was given.
    pub fn endpoint(&self) -> Endpoint {
        match (&self.interface, &self.udp, &self.unix) {
            (Some(name), _, _) => Endpoint::Interface(name.clone()),
            (_, Some(address), _) => Endpoint::Udp(*address),
            (_, _, path) => Endpoint::Unix(path.clone().unwrap_or_default()),
        }
    }
}
