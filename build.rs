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

/// Code of the critical path in ITCM, its data and the log's memory, which a debug probe reads past the caches, in DTCM; other statics in AXI SRAM, what the Ethernet DMA touches in SRAM3,
/// which it reaches and `src/bin/nucleo/memory.rs` makes non-cacheable. The stack has the lower part of DTCM for itself: an
/// overflow then leaves the memory and faults instead of overwriting.
///
/// All tightly coupled sections are filled by `src/bin/nucleo/coupled.rs`. Which functions a critical task reaches is known
/// to the test of the images, which names those that no pattern here takes. These come before the general sections, so
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
    *(.text.TIM1_UP .text.TIM1_CC .text.ETH);
    *(.text.*6nucleo3eth* .text.*nucleo..eth* .text.*6nucleo5timer*);
    *(.text.*8etherpen5board18EmergencyStopInput*);
    *(.text.*8etherpen7control* .text.*etherpen..control*);
    *(.text.*8etherpen14ethercat_robot*EtherCatRobot* .text.*8etherpen14ethercat_robot9AxisState* .text.*8etherpen14ethercat_robot5Scale*);
    *(.text.*8etherpen11application9reference18resolver_angle_rad*);
    *(.text.*8etherpen8ethercat6cyclic* .text.*8etherpen8ethercat8telegram* .text.*8etherpen8ethercat8envelope*);
    *(.text.*8etherpen8ethercat4plan11CyclicSlave* .text.*8etherpen8ethercat5clock8steering*);
    *(.text.*8etherpen8ethercat4wire8datagram* .text.*8etherpen8ethercat4wire5frame* .text.*8etherpen8ethercat4wire3udp*);
    *(.text.*8etherpen8ethercat9transport3raw* .text.*8etherpen8ethernet11descriptors*);
    *(.text.*8etherpen6drives6cia402* .text.*8etherpen6drives6layout*);
    *(.text.*8etherpen11measurement10CycleWatch* .text.*8etherpen11measurement9Histogram*);
    *(.text.*8etherpen7network10NetworkEnd* .text.*8etherpen5queue* .text.*8heapless4spsc*);
    *(.text.*7smoltcp4wire2ip8checksum* .text.*7smoltcp4wire4ipv4*next_header*);
    *(.text.*core5array*try_map* .text.*4libm4math* .text.*aeabi_l2d* .text.*aeabi_d2lz* .text.memcpy .text.memclr .text.*memcmp*);
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
    *(.bss.*__rtic_internal_local_init_parts* .bss.*__rtic_internal_local_init_wire*);
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
