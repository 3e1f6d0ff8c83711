//! Chooses a board's memory and vector names for the linker.
//!
//! Host builds need nothing from here. A firmware build gets `board.x`, which `memory.x` includes and which names the
//! board's regions FLASH and RAM; the emulated board, whose device module is part of this package, gets `device.x`, which
//! lets every interrupt without a task end in the default handler. A real chip's device crate brings its own.

use std::path::{Path, PathBuf};
use std::{env, fs};

/// Which of `memory.x`'s regions hold code and data.
struct Board {
    feature: &'static str,
    regions: &'static str,
    interrupts: Option<&'static str>,
}

const BOARDS: [Board; 2] = [
    Board {
        feature: "CARGO_FEATURE_EMULATED",
        regions: "REGION_ALIAS(FLASH, EMULATED_CODE);\nREGION_ALIAS(RAM, EMULATED_RAM);\n",
        interrupts: Some("src/bin/emulated/device.x"),
    },
    Board {
        feature: "CARGO_FEATURE_NUCLEO",
        regions: NUCLEO_REGIONS,
        interrupts: None,
    },
];

/// Statics in AXI SRAM, the stack alone in DTCM (an overflow then leaves the memory and faults instead of overwriting),
/// what the Ethernet DMA touches in SRAM3, which it reaches and `src/bin/nucleo/memory.rs` makes non-cacheable.
const NUCLEO_REGIONS: &str = "\
REGION_ALIAS(FLASH, H743_FLASH);
REGION_ALIAS(RAM, H743_AXI_SRAM);
_stack_start = ORIGIN(H743_DTCM) + LENGTH(H743_DTCM);
_stack_end = ORIGIN(H743_DTCM);
SECTIONS
{
  .eth_dma (NOLOAD) : ALIGN(32)
  {
    *(.eth_dma .eth_dma.*);
    . = ALIGN(32);
  } > H743_SRAM3
} INSERT AFTER .uninit;
";

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let chosen: Vec<&Board> = BOARDS
        .iter()
        .filter(|board| env::var_os(board.feature).is_some())
        .collect();
    let [board] = chosen.as_slice() else {
        // The library alone builds for the target without a board; two boards cannot share one image.
        assert!(chosen.is_empty(), "choose one board: feature nucleo or emulated");
        return;
    };
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR for build scripts"));
    write(&out.join("board.x"), board.regions);
    if let Some(path) = board.interrupts {
        println!("cargo:rerun-if-changed={path}");
        let names = fs::read_to_string(path).unwrap_or_else(|error| panic!("{path}: {error}"));
        write(&out.join("device.x"), &names);
    }
    println!("cargo:rustc-link-search={}", out.display());
}

fn write(path: &Path, text: &str) {
    fs::write(path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
