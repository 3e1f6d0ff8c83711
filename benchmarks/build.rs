//! Gives the linker the emulated board's memory, and an empty script in place of the log's.
//!
//! The workspace's cargo configuration, which holds here too, names the script of the firmware's log; these images have
//! no log.

use std::path::Path;
use std::{env, fs};

fn main() {
    println!("cargo:rerun-if-changed=memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let folder = env::var("CARGO_MANIFEST_DIR").expect("cargo sets it for build scripts");
    let out = env::var("OUT_DIR").expect("cargo sets it for build scripts");
    fs::write(Path::new(&out).join("defmt.x"), "").expect("the build folder can be written");
    println!("cargo:rustc-link-search={folder}");
    println!("cargo:rustc-link-search={out}");
}
