//! Tests that run twice: without distributed clocks, and once more with them.
//!
//! A test of a list of [`again`] is a test of its own with clocks; [`left_out`] finds tests that are in no list.

use std::cell::Cell;

thread_local! {
    /// Whether a bus that begins in this thread has distributed clocks, whatever its configuration says.
    static ON: Cell<bool> = const { Cell::new(false) };
}

/// Whether the buses of this test have distributed clocks.
pub(crate) fn clocks_are_on() -> bool {
    ON.get()
}

/// Runs a test with distributed clocks on every bus.
pub(crate) fn with_clocks(test: fn()) {
    ON.set(true);
    test();
}

/// Tests of modules, each once more with distributed clocks: the module's name, its path, and its tests.
macro_rules! again {
    ($($module:ident [$path:path] $($test:ident),+;)+) => {
        $(mod $module {
            use $path as tested;
            $(#[test]
            fn $test() {
                crate::again::with_clocks(tested::$test);
            })+
        })+

        /// The modules with their sources and their tests that run with clocks too.
        const AGAIN: &[(&str, &str, &[&str])] = &[
            $((stringify!($module), include_str!(concat!(stringify!($module), ".rs")), &[$(stringify!($test)),+]),)+
        ];
    };
}

/// The tests in a source that are not in a list.
pub(crate) fn left_out<'s>(source: &'s str, listed: &[&str]) -> Vec<&'s str> {
    let tests = source.split("#[test]\n").skip(1).map(|test| {
        let name = test.split_once("fn ").expect("a test").1;
        name.split_once('(').expect("a test").0
    });
    tests.filter(|test| !listed.contains(test)).collect()
}
