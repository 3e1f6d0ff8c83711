//! Names of ports: a serial device, a TCP or a Unix socket.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// Address of the firmware.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortName {
    /// A serial device, for instance `/dev/ttyACM0`.
    Serial(PathBuf),
    /// `tcp:host:port`.
    Tcp(String),
    /// `unix:path`.
    Unix(PathBuf),
}

impl FromStr for PortName {
    type Err = PortNameError;

    fn from_str(text: &str) -> Result<Self, PortNameError> {
        let name = match text.split_once(':') {
            Some(("tcp", address)) if address.contains(':') => Self::Tcp(address.into()),
            Some(("unix", path)) if !path.is_empty() => Self::Unix(path.into()),
            Some(("tcp" | "unix", _)) => return Err(PortNameError::Invalid(text.into())),
            _ if text.is_empty() => return Err(PortNameError::Invalid(text.into())),
            Some((host, port)) if !host.contains('/') && port.parse::<u16>().is_ok() => {
                return Err(PortNameError::NoScheme(text.into()));
            }
            _ => Self::Serial(text.into()),
        };
        Ok(name)
    }
}

impl fmt::Display for PortName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial(path) => write!(f, "{}", path.display()),
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

/// Why a text is not the name of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortNameError {
    /// The text has none of the forms of a port name.
    Invalid(String),
    /// The text is a network address without its scheme.
    NoScheme(String),
}

impl fmt::Display for PortNameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Invalid(name) => {
                write!(f, "'{name}' is no port; use /dev/tty.., tcp:host:port or unix:path")
            }
            Self::NoScheme(name) => write!(f, "'{name}' is a network address; write tcp:{name}"),
        }
    }
}

impl std::error::Error for PortNameError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_ports_are_told_apart() {
        let name = |text: &str| text.parse::<PortName>().ok();
        assert_eq!(name("tcp:localhost:7000"), Some(PortName::Tcp("localhost:7000".into())));
        assert_eq!(name("unix:/run/a"), Some(PortName::Unix("/run/a".into())));
        assert_eq!(name("/dev/ttyACM0"), Some(PortName::Serial("/dev/ttyACM0".into())));
        assert_eq!([name(""), name("tcp:7000"), name("unix:")], [None, None, None]);
        let hint = "127.0.0.1:5000".parse::<PortName>().unwrap_err().to_string();
        assert!(hint.contains("tcp:127.0.0.1:5000"), "{hint}");
    }
}
