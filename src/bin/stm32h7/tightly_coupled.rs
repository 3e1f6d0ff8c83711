//! Fills the tightly coupled memories before anything runs from them.
//!
//! The critical tasks' code is in ITCM and their own data in DTCM, where every access takes a constant time,
//! independent of the caches and the other bus masters. `build.rs` lists the content. The code is stored in flash
//! memory and copied by the start code before Rust's memory is initialised, because the functions that copy and clear
//! memory are part of it. The log memory that a debug probe reads is in DTCM too, because no cache is between it and
//! the probe.
//!
//! Invariant: no code in ITCM is called, and nothing in DTCM but the stack is read, before this function has run.

use core::arch::global_asm;

// SAFETY: `cortex-m-rt` calls this function once, before any Rust code; it uses no stack and changes none of the
// registers that a callee has to keep. The linker's symbols are aligned to eight bytes, the stack lies outside of both
// ranges, and the barriers let the copied instructions be fetched. ITCMCR and DTCMCR (0xE000EF90, 0xE000EF94) have
// their enabling bit set on this chip after a reset; setting it again costs nothing and leaves their other bits.
global_asm!(
    ".syntax unified",
    ".thumb",
    ".section .text.__pre_init, \"ax\", %progbits",
    ".global __pre_init",
    ".type __pre_init, %function",
    ".thumb_func",
    "__pre_init:",
    "    movw r0, #0xEF90",
    "    movt r0, #0xE000",
    "    ldr r1, [r0]",
    "    orr r1, r1, #1",
    "    str r1, [r0]",
    "    ldr r1, [r0, #4]",
    "    orr r1, r1, #1",
    "    str r1, [r0, #4]",
    "    dsb",
    "    isb",
    "    ldr r0, =__sitcm",
    "    ldr r1, =__eitcm",
    "    ldr r2, =__siitcm",
    "10: cmp r0, r1",
    "    bhs 20f",
    "    ldr r3, [r2], #4",
    "    str r3, [r0], #4",
    "    b 10b",
    "20: ldr r0, =__srtt",
    "    ldr r1, =__ertt",
    "    ldr r2, =__sirtt",
    "30: cmp r0, r1",
    "    bhs 40f",
    "    ldr r3, [r2], #4",
    "    str r3, [r0], #4",
    "    b 30b",
    "40: ldr r0, =__sdtcm",
    "    ldr r1, =__edtcm",
    "    movs r2, #0",
    "50: cmp r0, r1",
    "    bhs 60f",
    "    str r2, [r0], #4",
    "    b 50b",
    "60: dsb",
    "    isb",
    "    bx lr",
    ".ltorg",
    ".size __pre_init, . - __pre_init",
);
