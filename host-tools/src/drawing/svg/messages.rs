//! What usvg says about a file, as warnings of that file.
//!
//! usvg speaks through the program's one logger; a thread that reads a file keeps what is said on it meanwhile.

use super::WARNINGS_MAX;
use std::cell::RefCell;
use std::collections::BTreeSet;

thread_local! {
    static MESSAGES: RefCell<Option<Said>> = const { RefCell::new(None) };
}

/// What usvg has said.
#[derive(Default)]
pub(super) struct Said {
    /// Warnings, as it words them.
    pub(super) warnings: Vec<String>,
    /// Characters that no font has.
    pub(super) missing: BTreeSet<char>,
}

/// The character of a message that says that no font has it.
fn missing(message: &str) -> Option<char> {
    let rest = message
        .strip_prefix("No fonts with a ")?
        .strip_suffix(" character were found.")?;
    let (_, number) = rest.rsplit_once("/U+")?;
    char::from_u32(u32::from_str_radix(number, 16).ok()?)
}

/// What usvg says about a file on this thread, kept as warnings.
pub(super) struct Collected;

struct Collector;

impl log::Log for Collector {
    fn enabled(&self, metadata: &log::Metadata) -> bool {
        metadata.level() <= log::Level::Warn
    }

    fn log(&self, record: &log::Record) {
        MESSAGES.with_borrow_mut(|messages| {
            let Some(said) = messages else { return };
            let message = record.args().to_string();
            if let Some(missing) = missing(&message) {
                said.missing.insert(missing);
            } else if said.warnings.len() < WARNINGS_MAX {
                said.warnings.push(message);
            }
        });
    }

    fn flush(&self) {}
}

impl Collected {
    pub(super) fn begin() -> Self {
        // Another logger that is installed already keeps the messages; a file is read all the same.
        if log::set_logger(&Collector).is_ok() {
            log::set_max_level(log::LevelFilter::Warn);
        }
        MESSAGES.set(Some(Said::default()));
        Self
    }

    pub(super) fn end(self) -> Said {
        let mut said = MESSAGES.take().unwrap_or_default();
        said.warnings.dedup();
        said
    }
}
