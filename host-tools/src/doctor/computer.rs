//! Checks of this computer: tools, permissions and configuration.

use super::Check;
use crate::{probe, settings, setup};
use nix::errno::Errno;
use nix::sys::socket::{AddressFamily, SockFlag, SockProtocol, SockType, socket};
use std::path::Path;

/// The Rust toolchain and the target of the boards.
pub(super) fn toolchain() -> Check {
    const NAME: &str = "rust";
    let Some(version) = setup::version_line("rustc") else {
        return Check::failed(NAME, "no Rust toolchain", "install rustup from https://rustup.rs");
    };
    if setup::has_target() {
        return Check::ok(
            NAME,
            format!("{version}, target {} (its own linker, no gcc)", setup::TARGET),
        );
    }
    let found = format!("{version}, without the boards' target {}", setup::TARGET);
    let remedy = format!("rustup target add {}   (demo, verify and flash do it)", setup::TARGET);
    Check::warning(NAME, found, remedy)
}

/// The emulator of the boards.
pub(super) fn qemu() -> Check {
    const NAME: &str = "emulator";
    let Some(version) = setup::version_line(setup::QEMU) else {
        let remedy = "sudo apt-get install -y --no-install-recommends qemu-system-arm   (demo and verify do it)";
        return Check::warning(NAME, format!("no {}", setup::QEMU), remedy);
    };
    match setup::major(&version) {
        Some(major) if major < setup::QEMU_MAJOR_MIN => {
            let remedy = format!("install version {} or newer", setup::QEMU_MAJOR_MIN);
            Check::failed(NAME, format!("{version}: too old"), remedy)
        }
        _ => Check::ok(NAME, version),
    }
}

/// The program that writes firmware to a board.
pub(super) fn probe_rs() -> Check {
    const NAME: &str = "probe-rs";
    let Some(path) = probe::probe_rs() else {
        return Check::warning(
            NAME,
            "not installed; only flash needs it",
            format!("{}   (or: etherpen flash --install)", probe::INSTALL),
        );
    };
    let shown = path.display().to_string();
    match setup::version_line(&shown) {
        Some(version) => Check::ok(NAME, format!("{version}, {shown}")),
        None => Check::failed(
            NAME,
            format!("{shown} cannot be started"),
            format!("{} --force", probe::INSTALL),
        ),
    }
}

/// The permission that `bus --interface` and `segment --interface` need.
pub(super) fn raw_sockets() -> Check {
    const NAME: &str = "raw sockets";
    let opened = socket(
        AddressFamily::Packet,
        SockType::Raw,
        SockFlag::SOCK_CLOEXEC,
        SockProtocol::EthAll,
    );
    match opened {
        Ok(_) => Check::ok(NAME, "bus --interface and segment --interface may be used"),
        Err(Errno::EPERM | Errno::EACCES) => {
            let program = std::env::current_exe().unwrap_or_else(|_| "etherpen".into());
            let remedy = format!(
                "run it as root, or once: sudo setcap cap_net_raw+ep {}",
                program.display()
            );
            Check::warning(NAME, "no right to use network interfaces by raw sockets", remedy)
        }
        Err(cause) => Check::warning(
            NAME,
            format!("no raw sockets here ({cause})"),
            "use --udp or --unix instead",
        ),
    }
}

/// What the tests with two network interfaces on one computer require.
pub(super) fn namespaces() -> Check {
    const NAME: &str = "namespaces";
    /// CAP_SYS_ADMIN and CAP_NET_ADMIN (capabilities(7)).
    const NEEDED: u64 = 1 << 21 | 1 << 12;
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let effective = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    let rights = effective.and_then(|text| u64::from_str_radix(text.trim(), 16).ok());
    let allowed = rights.is_some_and(|rights| rights & NEEDED == NEEDED);
    match (allowed, setup::is_installed("ip")) {
        (true, true) => Check::ok(NAME, "a second network namespace may be made"),
        (_, false) => Check::warning(
            NAME,
            "no program ip; the tests against another master are skipped",
            "sudo apt-get install -y --no-install-recommends iproute2",
        ),
        (false, true) => Check::warning(
            NAME,
            "no right to make network namespaces; the tests against another master are skipped",
            "run the tests as root",
        ),
    }
}

/// The configuration file in use, or the built-in configuration.
pub(super) fn configuration(file: Option<&Path>) -> Check {
    const NAME: &str = "configuration";
    match settings::load(file) {
        Ok(config) => {
            let hash = config.hash().unwrap_or_default();
            let source = file.map_or_else(
                || "built-in (no etherpen.toml here)".into(),
                |path| path.display().to_string(),
            );
            Check::ok(NAME, format!("{source}, hash {hash:016x}"))
        }
        Err(error) => Check::failed(
            NAME,
            error.message,
            "samples/etherpen.toml lists all values with their defaults",
        ),
    }
}
