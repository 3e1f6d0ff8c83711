//! Memory attributes: memory shared with the Ethernet DMA, and the black box, are not cached, the rest is.
//!
//! The DMA neither sees the D-cache nor reaches DTCM. Its descriptors and buffers therefore lie in the SRAM of domain
//! D2, and one MPU region makes that SRAM normal, shareable, non-cacheable memory: no cache maintenance anywhere,
//! unaligned access still allowed. The black box is in the same SRAM: what is written there survives a reset at once. It must be in force before the D-cache is on and before the first descriptor is
//! written.
//!
//! A second region makes the code in ITCM read-only: it begins at address zero, where a stray write is most likely to
//! go. A third one forbids the addresses of external memories, of which no board here has any: the default map treats
//! them as normal memory, which the core may read ahead of need, and a controller that is not set up may never answer.
//!
//! The Ethernet's SRAM is cleared once: its error correction computes a word's check bits only when the complete word
//! is written, and the DMA writes bytes (RM0433, RAM ECC).

use core::ptr;
use cortex_m::peripheral::{CPUID, MPU, SCB};
use stm32_metapac::RCC;

/// Start and size of SRAM3, which the Ethernet DMA uses.
const ETHERNET_SRAM_START: u32 = 0x3004_0000;
const ETHERNET_SRAM_SIZE: u32 = 32 * 1024;
/// Start of SRAM1, SRAM2 and SRAM3, which follow each other (RM0433, memory map).
const D2_SRAM_START: u32 = 0x3000_0000;
/// SRAM1 128 KiB, SRAM2 128 KiB, SRAM3 32 KiB.
const D2_SRAM_SIZE: u32 = 288 * 1024;
/// An MPU region is a power of two and lies on its own size.
const REGION_SIZE: u32 = 512 * 1024;
/// Eighths of the region without memory behind them are left to the default map.
const SUBREGIONS_OFF: u32 = 0b1110_0000;

const _: () = assert!(REGION_SIZE.is_power_of_two() && D2_SRAM_START.is_multiple_of(REGION_SIZE));
const _: () = assert!(D2_SRAM_SIZE <= REGION_SIZE / 8 * SUBREGIONS_OFF.trailing_zeros());

/// Never execute, full access, TEX 001 C 0 B 0 S 1: normal, shareable, non-cacheable (ARMv7-M, MPU_RASR).
const NON_CACHEABLE: u32 = 1 << 28 | 0b011 << 24 | 0b001 << 19 | 1 << 18;
const REGION_ENABLE: u32 = 1;
/// Start of the ITCM, whose 64 KiB hold the critical path's code.
const ITCM_START: u32 = 0;
const ITCM_SIZE: u32 = 64 * 1024;
/// Read-only, instructions may be fetched; otherwise normal memory, cached, not shared.
const READ_ONLY_CODE: u32 = 0b110 << 24 | 0b001 << 19;
/// The whole address space in eighths, of which the fourth and the fifth count: 0x6000_0000 to 0x9FFF_FFFF.
const ALL_ADDRESSES: u32 = 31 << 1;
const EXTERNAL_MEMORIES: u32 = !(1 << 3 | 1 << 4) & 0xFF;
/// Never execute, no access, strongly ordered.
const NO_ACCESS: u32 = 1 << 28;
/// MPU_CTRL: on, with the default map for everything outside the region.
const MPU_ENABLE: u32 = 0b101;

/// Clocks the D2 SRAM, makes it non-cacheable, the ITCM read-only and external memories unreachable, clears the
/// Ethernet's SRAM and turns both caches on.
pub(crate) fn start(mpu: &mut MPU, scb: &mut SCB, cpuid: &mut CPUID) {
    RCC.ahb2enr().modify(|enable| {
        enable.set_sram1en(true);
        enable.set_sram2en(true);
        enable.set_sram3en(true);
    });
    // The clock enable takes effect two bus cycles later; a read back spends them.
    let _ = RCC.ahb2enr().read();
    cortex_m::asm::dmb();
    // SAFETY: no D2 SRAM is in use yet, so no access in progress changes its meaning, and ITCM has been filled before;
    // the default map stays in force for all other memory, and the barriers end every access under the old attributes.
    unsafe {
        mpu.ctrl.write(0);
        mpu.rnr.write(0);
        mpu.rbar.write(D2_SRAM_START);
        mpu.rasr
            .write(NON_CACHEABLE | SUBREGIONS_OFF << 8 | (REGION_SIZE.trailing_zeros() - 1) << 1 | REGION_ENABLE);
        mpu.rnr.write(1);
        mpu.rbar.write(ITCM_START);
        mpu.rasr
            .write(READ_ONLY_CODE | (ITCM_SIZE.trailing_zeros() - 1) << 1 | REGION_ENABLE);
        mpu.rnr.write(2);
        mpu.rbar.write(0);
        mpu.rasr
            .write(NO_ACCESS | EXTERNAL_MEMORIES << 8 | ALL_ADDRESSES | REGION_ENABLE);
        mpu.ctrl.write(MPU_ENABLE);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    for word in (ETHERNET_SRAM_START..ETHERNET_SRAM_START + ETHERNET_SRAM_SIZE).step_by(4) {
        // SAFETY: the memory has just been clocked, and the one static in it, the Ethernet's, is not used before the
        // driver exists, which writes everything before it reads it.
        unsafe { ptr::write_volatile(word as *mut u32, 0) };
    }
    scb.enable_icache();
    scb.enable_dcache(cpuid);
}
