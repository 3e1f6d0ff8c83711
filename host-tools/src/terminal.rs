//! Text for a terminal: colours, and numbers with nouns.

use std::io::IsTerminal;

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
