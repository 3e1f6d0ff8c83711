//! One connection to the firmware: requests, path and heartbeats out, events in.

use etherpen::messages::RobotProtocol;
use etherpen_link::host;

pub use etherpen_link::host::SessionCounts;

/// The host's end of one connection.
pub type Session = host::Session<RobotProtocol>;
/// Event on the link.
pub type Event = host::Event<RobotProtocol>;

const _: () = assert!(
    host::HEARTBEAT_MS * 2 < 500,
    "two lost heartbeats must not hold a drawing by default"
);

/// A number that no other connection to the firmware has had; process numbers alone are reused.
pub fn session_number() -> u32 {
    let since = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap_or_default();
    (since.as_nanos() as u32 ^ std::process::id().rotate_left(16)).max(1)
}

#[cfg(test)]
mod tests;
