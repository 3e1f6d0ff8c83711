//! The board on USB: its debug probe (ST-LINK), the program probe-rs, and its serial ports.
//!
//! Linux shows USB devices as folders (sysfs), which can be read without permissions. A probe that cannot be opened can
//! thus be distinguished from a missing one.

pub mod flash;

use std::io;
use std::path::{Path, PathBuf};

/// Vendor number of STMicroelectronics on USB.
const VENDOR: &str = "0483";
/// Product numbers of the ST-LINKs, V2 to V3: 3744 to 375f (ST's own udev rules name them one by one).
const PRODUCTS: std::ops::RangeInclusive<u16> = 0x3744..=0x375f;
/// Vendor and product number of the firmware's own USB port (the first test pair of pid.codes) and its product name,
/// because other devices use that pair too (`src/bin/stm32h7/usb.rs`).
const FIRMWARE: (&str, u16, &str) = ("1209", 0x0001, "etherpen robot controller");
/// Where Linux lists serial ports.
pub const SERIAL_PORTS: &str = "/sys/class/tty";
/// Where Linux lists USB devices.
pub const USB_DEVICES: &str = "/sys/bus/usb/devices";
/// The command that installs probe-rs.
pub const INSTALL: &str = "cargo install probe-rs-tools --locked";
/// Gives the user access to the probe: a udev file and how to activate it.
pub const UDEV_RULE: &str = "\
put this line into /etc/udev/rules.d/70-st-link.rules:
  SUBSYSTEM==\"usb\", ATTRS{idVendor}==\"0483\", ATTRS{idProduct}==\"37[45]?\", MODE=\"0660\", GROUP=\"plugdev\", TAG+=\"uaccess\"
then: sudo udevadm control --reload && sudo udevadm trigger, and plug the board in again";

/// An ST-LINK on USB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StLink {
    /// Product number.
    pub product: u16,
    /// Its product name.
    pub name: String,
    /// Its serial number.
    pub serial: String,
    /// Its device node.
    pub node: PathBuf,
}

impl StLink {
    /// Whether the user may open the probe.
    ///
    /// # Errors
    /// Error of the operating system.
    pub fn access(&self) -> io::Result<()> {
        let opened = std::fs::OpenOptions::new().read(true).write(true).open(&self.node);
        opened.map(drop)
    }

    /// Its selector for probe-rs: `VID:PID:SERIAL`.
    pub fn selector(&self) -> String {
        format!("{VENDOR}:{:04x}:{}", self.product, self.serial)
    }
}

/// The ST-LINKs below a folder such as [`USB_DEVICES`]; none if the folder does not exist.
pub fn st_links(devices: &Path) -> Vec<StLink> {
    let entries = std::fs::read_dir(devices).into_iter().flatten().flatten();
    let mut found: Vec<StLink> = entries.filter_map(|entry| st_link(&entry.path())).collect();
    found.sort_by(|one, other| one.node.cmp(&other.node));
    found
}

/// A port to the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardPort {
    /// The ST-LINK's serial line.
    StLink,
    /// The firmware's own USB.
    Firmware,
}

/// The board's port that a serial port belongs to, below a folder such as [`SERIAL_PORTS`]; `None` for any other.
pub fn board_port(ports: &Path, name: &str) -> Option<BoardPort> {
    // A port's link points to one of its device's interfaces.
    let device = ports.join(name).join("device/..");
    let (vendor, product) = numbers(&device)?;
    if vendor == VENDOR && PRODUCTS.contains(&product) {
        return Some(BoardPort::StLink);
    }
    let ours = (vendor.as_str(), product, read(&device, "product")?.as_str()) == FIRMWARE;
    ours.then_some(BoardPort::Firmware)
}

fn read(device: &Path, name: &str) -> Option<String> {
    let text = std::fs::read_to_string(device.join(name)).ok()?;
    Some(text.trim().to_owned())
}

/// Vendor and product number of a device.
fn numbers(device: &Path) -> Option<(String, u16)> {
    let product = u16::from_str_radix(&read(device, "idProduct")?, 16).ok()?;
    Some((read(device, "idVendor")?, product))
}

fn st_link(device: &Path) -> Option<StLink> {
    let read = |name: &str| read(device, name);
    let (vendor, product) = numbers(device)?;
    if vendor != VENDOR || !PRODUCTS.contains(&product) {
        return None;
    }
    let number = |name: &str| read(name)?.parse::<u16>().ok();
    Some(StLink {
        product,
        name: read("product").unwrap_or_else(|| "ST-LINK".into()),
        serial: read("serial").unwrap_or_default(),
        node: PathBuf::from(format!(
            "/dev/bus/usb/{:03}/{:03}",
            number("busnum")?,
            number("devnum")?
        )),
    })
}

/// The program probe-rs: on the search path, or where cargo installs programs.
pub fn probe_rs() -> Option<PathBuf> {
    let on_path = std::env::var_os("PATH").unwrap_or_default();
    let cargo_home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let cargo_home = cargo_home.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cargo")));
    std::env::split_paths(&on_path)
        .chain(cargo_home.map(|home| home.join("bin")))
        .map(|folder| folder.join("probe-rs"))
        .find(|program| program.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_st_link_is_found_among_other_devices_and_named_as_probe_rs_wants_it() {
        let root = std::env::temp_dir().join(format!("etherpen-usb-{}", std::process::id()));
        let device = |name: &str, files: &[(&str, &str)]| {
            let folder = root.join(name);
            std::fs::create_dir_all(&folder).unwrap();
            for (file, text) in files {
                std::fs::write(folder.join(file), format!("{text}\n")).unwrap();
            }
        };
        device("1-1", &[("idVendor", "0483"), ("idProduct", "5740")]);
        device("1-2", &[("idVendor", "1d6b"), ("idProduct", "374e")]);
        device("1-2:1.0", &[]);
        device(
            "1-3",
            &[
                ("idVendor", "0483"),
                ("idProduct", "374e"),
                ("product", "STLINK-V3"),
                ("serial", "0042"),
                ("busnum", "1"),
                ("devnum", "7"),
            ],
        );
        let found = st_links(&root);
        std::fs::remove_dir_all(&root).unwrap();
        let expected = StLink {
            product: 0x374e,
            name: "STLINK-V3".into(),
            serial: "0042".into(),
            node: "/dev/bus/usb/001/007".into(),
        };
        assert_eq!(found, [expected]);
        assert_eq!(found[0].selector(), "0483:374e:0042");
        assert_eq!(st_links(&root), [], "no such folder, no probe");
    }

    #[test]
    fn a_serial_port_of_the_board_is_told_from_others() {
        let root = std::env::temp_dir().join(format!("etherpen-tty-{}", std::process::id()));
        let ports = root.join("tty");
        let port = |name: &str, vendor: &str, product: &str, title: &str| {
            let device = root.join(name);
            for folder in [device.join("1.0"), ports.join(name)] {
                std::fs::create_dir_all(folder).unwrap();
            }
            for (file, text) in [("idVendor", vendor), ("idProduct", product), ("product", title)] {
                std::fs::write(device.join(file), format!("{text}\n")).unwrap();
            }
            std::os::unix::fs::symlink(device.join("1.0"), ports.join(name).join("device")).unwrap();
        };
        port("ttyACM0", "0483", "374e", "STLINK-V3");
        port("ttyACM1", "1209", "0001", "etherpen robot controller");
        port("ttyACM2", "1209", "0001", "a clock");
        port("ttyACM3", "2341", "0043", "etherpen robot controller");
        std::fs::create_dir_all(ports.join("ttyS0")).unwrap();
        let found = ["ttyACM0", "ttyACM1", "ttyACM2", "ttyACM3", "ttyS0"].map(|name| board_port(&ports, name));
        std::fs::remove_dir_all(&root).unwrap();
        let (st_link, firmware) = (Some(BoardPort::StLink), Some(BoardPort::Firmware));
        assert_eq!(found, [st_link, firmware, None, None, None]);
    }
}
