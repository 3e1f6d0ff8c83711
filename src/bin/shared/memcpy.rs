//! Copying and clearing memory, eight words at a time.
//!
//! The compiler calls these functions by name for every value that is too long for registers. Its own versions copy
//! word by word and, where source and destination are aligned differently, assemble every word from two; the critical
//! tasks copy a telegram and a report several times a millisecond. A Cortex-M7 loads and stores eight aligned words
//! with one instruction each, and single words at any address of normal memory.
//!
//! Invariant: exactly the requested bytes are copied or cleared; no other byte is read or written.

use core::arch::global_asm;

// SAFETY: the names are those of the "Run-time ABI for the Arm Architecture" and of the C library, the arguments and
// the registers kept those of the procedure call standard: r0 to r3 and r12 may be changed, the others are saved. All
// callers hand over memory of their own, `length` bytes of it; unaligned accesses are single loads and stores, which
// the core makes wherever it does not trap them (CCR.UNALIGN_TRP, clear after reset and left so).
global_asm!(
    ".syntax unified",
    ".thumb",
    ".macro etherpen_function name",
    "    .global \\name",
    "    .type \\name, %function",
    "    .thumb_func",
    "    \\name:",
    ".endm",
    // r0: destination, which is also the result; r1: source; r2: length.
    ".section .text.memcpy, \"ax\", %progbits",
    "etherpen_function __aeabi_memcpy8",
    "etherpen_function __aeabi_memcpy4",
    "etherpen_function __aeabi_memcpy",
    "etherpen_function memcpy",
    "    mov r12, r0",
    "    subs r2, #32",
    "    blo 20f",
    "    orr r3, r0, r1",
    "    tst r3, #3",
    "    bne 30f",
    "    push {{r4-r10}}",
    "10: ldm r1!, {{r3-r10}}",
    "    stm r12!, {{r3-r10}}",
    "    subs r2, #32",
    "    bhs 10b",
    "    pop {{r4-r10}}",
    "20: adds r2, #28",
    "    bmi 22f",
    "21: ldr r3, [r1], #4",
    "    str r3, [r12], #4",
    "    subs r2, #4",
    "    bhs 21b",
    // The last two bits of the length, from here on, are in the carry and in the sign.
    "22: lsls r2, #31",
    "    itt cs",
    "    ldrhcs r3, [r1], #2",
    "    strhcs r3, [r12], #2",
    "    itt mi",
    "    ldrbmi r3, [r1]",
    "    strbmi r3, [r12]",
    "    bx lr",
    "30: adds r2, #16",
    "31: ldr r3, [r1], #4",
    "    str r3, [r12], #4",
    "    ldr r3, [r1], #4",
    "    str r3, [r12], #4",
    "    ldr r3, [r1], #4",
    "    str r3, [r12], #4",
    "    ldr r3, [r1], #4",
    "    str r3, [r12], #4",
    "    subs r2, #16",
    "    bhs 31b",
    "    subs r2, #16",
    "    b 20b",
    ".size __aeabi_memcpy8, . - __aeabi_memcpy8",
    ".size __aeabi_memcpy4, . - __aeabi_memcpy4",
    ".size __aeabi_memcpy, . - __aeabi_memcpy",
    ".size memcpy, . - memcpy",
    // r0: destination; r1: length.
    ".section .text.memclr, \"ax\", %progbits",
    "etherpen_function __aeabi_memclr8",
    "etherpen_function __aeabi_memclr4",
    "etherpen_function __aeabi_memclr",
    "    movs r2, #0",
    "    subs r1, #16",
    "    blo 41f",
    "40: str r2, [r0], #4",
    "    str r2, [r0], #4",
    "    str r2, [r0], #4",
    "    str r2, [r0], #4",
    "    subs r1, #16",
    "    bhs 40b",
    "41: adds r1, #12",
    "    bmi 43f",
    "42: str r2, [r0], #4",
    "    subs r1, #4",
    "    bhs 42b",
    "43: lsls r1, #31",
    "    it cs",
    "    strhcs r2, [r0], #2",
    "    it mi",
    "    strbmi r2, [r0]",
    "    bx lr",
    ".size __aeabi_memclr8, . - __aeabi_memclr8",
    ".size __aeabi_memclr4, . - __aeabi_memclr4",
    ".size __aeabi_memclr, . - __aeabi_memclr",
);
