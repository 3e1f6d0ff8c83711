//! Text for a terminal: data on stdout, messages on stderr, colours, and numbers with nouns.

use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a line of stdout was lost although its reader wanted it.
static IS_CUT: AtomicBool = AtomicBool::new(false);

/// Prints a line on stdout, as the standard macro does, but never panics: a reader that has ended loses the line, and any
/// other failure is counted ([`is_cut`]). Tests keep the standard macro, whose output they capture.
#[cfg(not(test))]
#[macro_export]
macro_rules! println {
    ($($words:tt)*) => {
        $crate::terminal::say(format_args!($($words)*))
    };
}

/// Prints a line on stderr, as the standard macro does. A stderr that is closed or full loses the message and ends nothing.
#[macro_export]
macro_rules! eprintln {
    () => {
        $crate::terminal::tell(format_args!(""), "\n")
    };
    ($($words:tt)*) => {
        $crate::terminal::tell(format_args!($($words)*), "\n")
    };
}

/// Prints text on stderr, as the standard macro does. A stderr that is closed or full loses it and ends nothing.
#[macro_export]
macro_rules! eprint {
    ($($words:tt)*) => {
        $crate::terminal::tell(format_args!($($words)*), "")
    };
}

/// Writes a message and what ends it to stderr.
pub fn tell(message: std::fmt::Arguments<'_>, end: &str) {
    // A message that nobody can read must not end the work.
    let _ = write!(std::io::stderr().lock(), "{message}{end}");
}

/// Writes a line to stdout.
pub fn say(line: std::fmt::Arguments<'_>) {
    if let Err(cause) = writeln!(std::io::stdout().lock(), "{line}")
        && cause.kind() != ErrorKind::BrokenPipe
        && !IS_CUT.swap(true, Ordering::Relaxed)
    {
        eprintln!("stdout: {cause}");
    }
}

/// Whether stdout lacks a line although its reader has not ended: its disk is full, say.
pub fn is_cut() -> bool {
    IS_CUT.load(Ordering::Relaxed)
}

/// `text` in an ANSI colour when stderr is a terminal and `NO_COLOR` is not set.
pub fn in_colour(text: &str, colour: &str) -> String {
    if std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none() {
        format!("\x1b[{colour}m{text}\x1b[0m")
    } else {
        text.to_owned()
    }
}

/// A number with its noun: `1 stroke`, `2 strokes`.
pub fn counted(count: impl TryInto<u64>, thing: &str) -> String {
    let count = count.try_into().unwrap_or(u64::MAX);
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}
