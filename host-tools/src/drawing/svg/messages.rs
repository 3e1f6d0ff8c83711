//! Collects usvg's messages about a file as warnings of that file.
//!
//! usvg logs through the program's one logger; a thread that reads a file collects the messages logged on that thread
//! meanwhile.

use super::WARNINGS_MAX;
use std::cell::RefCell;
use std::collections::BTreeSet;

thread_local! {
    static MESSAGES: RefCell<Option<Said>> = const { RefCell::new(None) };
}

/// Messages of usvg.
#[derive(Default)]
pub(super) struct Said {
    /// Warnings, in usvg's words.
    pub(super) warnings: Vec<String>,
    /// Characters that no font has.
    pub(super) missing: BTreeSet<char>,
}

/// The character in a message about a missing glyph.
fn missing(message: &str) -> Option<char> {
    let rest = message
        .strip_prefix("No fonts with a ")?
        .strip_suffix(" character were found.")?;
    let (_, number) = rest.rsplit_once("/U+")?;
    char::from_u32(u32::from_str_radix(number, 16).ok()?)
}

/// Collects usvg's messages on this thread.
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
        // If another logger is already installed, it gets the messages; the file is read anyway.
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
