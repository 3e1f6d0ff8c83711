//! The switch between the mutants of one build: at most one is on, by an environment variable.
//!
//! The tool writes this file as a crate of its own into the instrumented copy of the sources. Without the variable every
//! mutant is off.

use std::sync::atomic::{AtomicU32, Ordering};

/// Environment variable with the number of the mutant that is on.
pub const VARIABLE: &str = "ETHERPEN_MUTANT";

/// No mutant; the numbers begin at 1.
const NONE: u32 = 0;
/// The variable has not been read yet.
const UNREAD: u32 = u32::MAX;

static NUMBER: AtomicU32 = AtomicU32::new(UNREAD);

/// Whether the mutant with this number is on. The variable is read once in a process.
#[inline]
pub fn on(number: u32) -> bool {
    let mut is_on = NUMBER.load(Ordering::Relaxed);
    if is_on == UNREAD {
        is_on = read();
    }
    is_on == number
}

/// A value with a total order. The compiler refuses floating-point numbers, whose boundaries are no mutants: a comparison
/// that differs for one number of 2^64 is hardly ever another one.
#[inline]
pub fn ordered<T: Ord + ?Sized>(value: &T) -> &T {
    value
}

/// Reads the variable. A value that is not a number ends the process: its result would be counted for a mutant.
#[cold]
fn read() -> u32 {
    let number = std::env::var(VARIABLE).map_or(NONE, |value| match value.parse() {
        Ok(number) if number != UNREAD => number,
        _ => {
            eprintln!("{VARIABLE}={value} is not the number of a mutant");
            std::process::exit(2);
        }
    });
    NUMBER.store(number, Ordering::Relaxed);
    number
}
