//! Checks of everything that the commands need, and what to try if something is wrong.
//!
//! Nothing is changed: no tool is installed, no drive gets power, and the firmware is only greeted and asked for its
//! status.

mod board;
mod computer;

use crate::link::port::PortName;
use serde::Serialize;
use std::path::Path;

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum CheckVerdict {
    Ok,
    /// Something is missing that only some commands need.
    Warning,
    /// Something present or requested does not work.
    Failed,
}

/// One check with its result.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Check {
    /// What was checked.
    pub(crate) check: &'static str,
    pub(crate) verdict: CheckVerdict,
    pub(crate) found: String,
    /// What to try; empty if there is nothing to do.
    #[serde(rename = "try")]
    pub(crate) remedy: String,
}

impl Check {
    fn ok(check: &'static str, found: impl Into<String>) -> Self {
        Self {
            check,
            verdict: CheckVerdict::Ok,
            found: found.into(),
            remedy: String::new(),
        }
    }

    fn warning(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: CheckVerdict::Warning,
            remedy: remedy.into(),
            ..Self::ok(check, found)
        }
    }

    fn failed(check: &'static str, found: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self {
            verdict: CheckVerdict::Failed,
            ..Self::warning(check, found, remedy)
        }
    }
}

/// Runs all checks.
///
/// `configuration` is the configuration file in use, `None` for the built-in one. With `port`, the firmware at that
/// port is greeted.
pub(crate) fn check_all(configuration: Option<&Path>, port: Option<&PortName>) -> Vec<Check> {
    let mut checks = vec![
        computer::toolchain(),
        computer::qemu(),
        computer::probe_rs(),
        board::st_link(),
        computer::raw_sockets(),
        computer::namespaces(),
        computer::configuration(configuration),
    ];
    checks.extend(match port {
        Some(name) => board::firmware(name),
        None => vec![board::ports()],
    });
    checks
}
