//! Copies the product's sources with other atomics: loom's, or ones that may be interrupted at every access.
//!
//! The text is the product's own, so a model cannot differ from it; what is replaced must exist.

use std::path::Path;
use std::{env, fs};

/// A copy: its name, the source, and what is replaced by what.
type Copied = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

const COPIES: [Copied; 8] = [
    (
        "descriptors.rs",
        "src/ethernet/descriptors.rs",
        &[
            ("core::sync::atomic::", "crate::atomic::"),
            // A model's atomic is larger than a word.
            (
                "const _: () = assert!(size_of::<Descriptor>() == DESCRIPTOR_BYTES as usize);",
                "",
            ),
        ],
    ),
    (
        "queue.rs",
        "crates/ethercat/src/queue.rs",
        &[
            ("core::sync::atomic::", "crate::atomic::"),
            ("heapless::spsc::", "crate::spsc::"),
        ],
    ),
    (
        "measurement.rs",
        "src/measurement.rs",
        &[
            ("core::sync::atomic::", "crate::atomic::"),
            ("crate::control::sampler::OUTPUT_LATE_NS", "crate::OUTPUT_LATE_NS"),
        ],
    ),
    (
        "interrupted_measurement.rs",
        "src/measurement.rs",
        &[
            ("core::sync::atomic::", "crate::interrupted::"),
            ("crate::control::sampler::OUTPUT_LATE_NS", "crate::OUTPUT_LATE_NS"),
        ],
    ),
    (
        "overruns.rs",
        "src/bin/shared/overruns.rs",
        &[
            ("core::sync::atomic::", "crate::atomic::"),
            (
                "/// Releases of the trajectory task that it has not completed. Reading it is safe in a critical task.\npub(crate) static TRAJECTORIES_DUE: AtomicU32 = AtomicU32::new(0);",
                DUE,
            ),
            (
                "/// Releases of the trajectory task that found an earlier one not completed.\npub(crate) static TRAJECTORY_OVERRUNS: AtomicU32 = AtomicU32::new(0);",
                OVERRUNS,
            ),
        ],
    ),
    (
        "memory.rs",
        "src/black_box/memory.rs",
        &[
            ("core::sync::atomic::", "crate::interrupted::"),
            ("crate::board::RunEnd", "crate::RunEnd"),
        ],
    ),
    (
        "frames.rs",
        "src/black_box/frames.rs",
        &[("core::sync::atomic::", "crate::interrupted::")],
    ),
    (
        "load.rs",
        "src/bin/shared/load.rs",
        &[
            ("core::sync::atomic::", "crate::interrupted::"),
            ("crate::board::free_run", "crate::interrupted::free_run"),
            ("cortex_m::asm::wfi", "crate::interrupted::wait"),
        ],
    ),
];

/// A static of a model begins anew in each execution.
const DUE: &str = "loom::lazy_static! { pub static ref TRAJECTORIES_DUE: AtomicU32 = AtomicU32::new(0); }";
const OVERRUNS: &str = "loom::lazy_static! { pub static ref TRAJECTORY_OVERRUNS: AtomicU32 = AtomicU32::new(0); }";

fn main() {
    let out = env::var_os("OUT_DIR").expect("cargo sets it");
    for (name, source, changes) in COPIES {
        let path = Path::new("..").join(source);
        println!("cargo::rerun-if-changed={}", path.display());
        let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{source}: {error}"));
        // `include!` takes no inner documentation, and the product's own tests stay where they are.
        let text: Vec<&str> = text.lines().filter(|line| !line.starts_with("//!")).collect();
        let text = text.join("\n");
        let mut text = text.split("#[cfg(test)]").next().unwrap_or_default().to_owned();
        for (from, to) in changes {
            assert!(text.contains(from), "{source} no longer contains {from}");
            text = text.replace(from, to);
        }
        fs::write(Path::new(&out).join(name), text).expect("OUT_DIR can be written");
    }
}
