//! Text tables: columns as wide as their widest cell.

use crate::error::ProgramError;
use std::io::Write;

/// Prints rows under a heading on stdout; every row has as many cells as the heading.
pub(super) fn print<const COLUMNS: usize>(
    heading: [&str; COLUMNS],
    rows: &[[String; COLUMNS]],
) -> Result<(), ProgramError> {
    let mut text = String::new();
    let heading = heading.map(str::to_owned);
    let widths: [usize; COLUMNS] = std::array::from_fn(|column| {
        let cells = rows.iter().chain([&heading]);
        cells
            .map(|row| row.get(column).map_or(0, |cell| cell.chars().count()))
            .max()
            .unwrap_or(0)
    });
    for row in [&heading].into_iter().chain(rows) {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:<width$}"));
        let line = cells.collect::<Vec<_>>().join("  ");
        text.push_str(line.trim_end());
        text.push('\n');
    }
    say(text.trim_end())
}

/// Prints a line on stdout.
pub(super) fn say(line: &str) -> Result<(), ProgramError> {
    heard(line).map(|_| ())
}

/// Prints a line on stdout; returns whether it still has a reader.
pub(super) fn heard(line: &str) -> Result<bool, ProgramError> {
    match writeln!(std::io::stdout(), "{line}") {
        Ok(()) => Ok(true),
        Err(cause) => ProgramError::of_stdout(cause).map(|()| false),
    }
}
