//! What usvg says about a file, as warnings of that file.
//!
//! usvg speaks through the program's one logger; a thread that reads a file keeps what is said on it meanwhile.

use super::WARNINGS_MAX;
use std::cell::RefCell;

thread_local! {
    static MESSAGES: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
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
            if let Some(messages) = messages
                && messages.len() < WARNINGS_MAX
            {
                messages.push(record.args().to_string());
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
        MESSAGES.set(Some(Vec::new()));
        Self
    }

    pub(super) fn end(self) -> Vec<String> {
        let mut messages = MESSAGES.take().unwrap_or_default();
        messages.dedup();
        messages
    }
}
