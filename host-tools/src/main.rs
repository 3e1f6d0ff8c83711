//! The `etherpen` program.
#![forbid(unsafe_code)]

fn main() {}
