//! The serial link between the host's tools and the firmware.
//!
//! Both ends use the types of [`protocol`]. Frames are COBS with a CRC. The path travels in a window with credit.
//! Commands are answered one by one and overtake the path. Telemetry is best effort and counts the samples that it
//! drops.
//!
//! Invariant: the link carries messages and does not know what they do: no file here imports a task or the coordinator.

pub mod device;
pub mod frame;
pub mod path;
pub mod ports;
pub mod protocol;

#[cfg(test)]
mod tests {
    #[test]
    fn no_file_of_the_link_imports_a_task() {
        let files = [
            include_str!("device.rs"),
            include_str!("frame.rs"),
            include_str!("path.rs"),
            include_str!("ports.rs"),
            include_str!("protocol.rs"),
        ];
        let imports = files.iter().flat_map(|file| file.lines());
        let above = ["control", "controller", "coordinator", "link_task", "trajectory_task"];
        for import in imports.filter_map(|line| line.trim().strip_prefix("use crate::")) {
            let module = import.split([':', ';']).next();
            assert!(!above.contains(&module.unwrap_or_default()), "{import}");
        }
    }
}
