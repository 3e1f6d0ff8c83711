//! See `TARGETS` of `etherpen-fuzzing`.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| etherpen_fuzzing::run("control", bytes));
