//! Text for a terminal: messages on stderr, colours, and numbers with nouns.

use std::io::{IsTerminal, Write};

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
