//! Chooses a board's memory and vector names for the linker.
//!
//! Host builds need nothing from here. A firmware build gets two things in its output folder, where the linker looks:
//!
//! - `board.x`, which `memory.x` includes. It says which of the board's regions are FLASH and RAM, and adds the board's own
//!   sections.
//! - A copy of the linker script in the board's folder. Nucleo: `itcm.x`, the list of what lies in ITCM, which `board.x`
//!   includes. Emulated: `device.x`, which lets every interrupt without a task end in the default handler; the start code
//!   includes it. A real chip's device crate brings its own `device.x`; QEMU's machine has no such crate.

use std::path::{Path, PathBuf};
use std::{env, fs};

/// Which of `memory.x`'s regions hold code and data.
struct Board {
    feature: &'static str,
    regions: &'static str,
    /// Linker scripts of the board's folder that `regions` or the start code include.
    scripts: &'static [&'static str],
}

const BOARDS: [Board; 2] = [
    Board {
        feature: "CARGO_FEATURE_EMULATED",
        regions: "REGION_ALIAS(FLASH, EMULATED_CODE);\nREGION_ALIAS(RAM, EMULATED_RAM);\n",
        scripts: &["src/bin/emulated/device.x"],
    },
    Board {
        feature: "CARGO_FEATURE_NUCLEO",
        regions: NUCLEO_REGIONS,
        scripts: &["src/bin/nucleo/itcm.x"],
    },
];

/// Code of the critical path in ITCM; its data, and the log's memory, which a debug probe reads past the caches, in DTCM;
/// other statics in AXI SRAM; what the Ethernet DMA touches in SRAM3, which it reaches, and the black box in SRAM1 and
/// SRAM2: `src/bin/stm32h7/memory.rs` makes all three non-cacheable. The stack has the lower part of DTCM for itself: an overflow then leaves the memory and faults instead of
/// overwriting.
///
/// `src/bin/stm32h7/tightly_coupled.rs` fills all tightly coupled sections. `src/bin/nucleo/itcm.x` lists the functions that a
/// critical task reaches; the test of the images writes and checks it. These sections come before the general ones, so
/// that the linker asks them first.
const NUCLEO_REGIONS: &str = "\
REGION_ALIAS(FLASH, H743_FLASH);
REGION_ALIAS(RAM, H743_AXI_SRAM);
_stack_start = ORIGIN(H743_DTCM_STACK) + LENGTH(H743_DTCM_STACK);
_stack_end = ORIGIN(H743_DTCM_STACK);
SECTIONS
{
  .itcm : ALIGN(8)
  {
    __sitcm = .;
    /* Undefined instructions: whoever calls address zero by mistake ends there. */
    LONG(0xDEDEDEDE); LONG(0xDEDEDEDE);
    INCLUDE itcm.x
    . = ALIGN(8);
    __eitcm = .;
  } > H743_ITCM AT > H743_FLASH
  __siitcm = LOADADDR(.itcm);
  .rtt : ALIGN(8)
  {
    __srtt = .;
    *(.data._SEGGER_RTT .data.defmt-rtt.NAME);
    . = ALIGN(8);
    __ertt = .;
  } > H743_DTCM_DATA AT > H743_FLASH
  __sirtt = LOADADDR(.rtt);
} INSERT AFTER .rodata;
SECTIONS
{
  .dtcm (NOLOAD) : ALIGN(8)
  {
    __sdtcm = .;
    *(.bss.*__rtic_internal_local_init_parts* .bss.*__rtic_internal_local_init_frame_port*);
    *(.bss..L_MergedGlobals*);
    *(.uninit.rtic*);
    *(.uninit.defmt-rtt.BUFFER);
    . = ALIGN(8);
    __edtcm = .;
  } > H743_DTCM_DATA
  .eth_dma (NOLOAD) : ALIGN(32)
  {
    *(.eth_dma .eth_dma.*);
    . = ALIGN(32);
  } > H743_SRAM3
  .black_box (NOLOAD) : ALIGN(32)
  {
    *(.black_box);
  } > H743_SRAM1_2
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
    for script in board.scripts.iter().map(Path::new) {
        println!("cargo:rerun-if-changed={}", script.display());
        let text = fs::read_to_string(script).unwrap_or_else(|error| panic!("{}: {error}", script.display()));
        write(&out.join(script.file_name().expect("a file")), &text);
    }
    println!("cargo:rustc-link-search={}", out.display());
}

fn write(path: &Path, text: &str) {
    fs::write(path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
