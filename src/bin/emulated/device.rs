//! Device definitions of the machine for RTIC and the vector table.
//!
//! Interrupt numbers are those of QEMU's `mps2-an500`; the numbers named `FREE` are not connected and are pended by
//! software. Every table entry without a task ends in the default handler (see `device.x`).

// The start-up code and the first entries of the vector table come from here.
use cortex_m_rt as _;

/// Priority bits of the interrupt controller that are used: those of the STM32H743; the machine itself has 8.
pub(crate) const NVIC_PRIO_BITS: u8 = 4;

/// Frequency of the core, the timers and the time base, Hz.
pub(crate) const CLOCK_HZ: u32 = 25_000_000;

/// Releases of the critical tasks in a millisecond: 1, more in the variants for measurements.
pub(crate) const RELEASES_PER_MS: u32 = if cfg!(feature = "rate-8khz") {
    8
} else if cfg!(feature = "rate-4khz") {
    4
} else if cfg!(feature = "rate-2khz") {
    2
} else {
    1
};

/// Entries of the interrupt vector table.
pub(crate) const INTERRUPT_LINES: u16 = 32;
const INTERRUPTS: usize = INTERRUPT_LINES as usize;

#[allow(unused_imports)] // RTIC looks for this name
pub(crate) use Interrupt as interrupt;

/// The interrupts that tasks can bind, by their number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(dead_code, non_camel_case_types)] // lists every interrupt, bound or not; RTIC wants vector names
#[repr(u16)]
pub(crate) enum Interrupt {
    UART0_RX = 0,
    UART0_TX = 1,
    FREE6 = 6,
    FREE7 = 7,
    TIMER0 = 8,
    TIMER1 = 9,
    DUAL_TIMER = 10,
    LAN9118 = 13,
    FREE14 = 14,
    FREE15 = 15,
    FREE16 = 16,
    FREE17 = 17,
    FREE18 = 18,
}

// SAFETY: the discriminants are the machine's interrupt numbers, all below 32, and no two are equal.
unsafe impl cortex_m::interrupt::InterruptNumber for Interrupt {
    fn number(self) -> u16 {
        self as u16
    }
}

unsafe extern "C" {
    fn UART0_RX();
    fn UART0_TX();
    fn FREE6();
    fn FREE7();
    fn TIMER0();
    fn TIMER1();
    fn DUAL_TIMER();
    fn LAN9118();
    fn FREE14();
    fn FREE15();
    fn FREE16();
    fn FREE17();
    fn FREE18();
    fn DefaultHandler();
}

type Handler = unsafe extern "C" fn();

const fn vectors() -> [Handler; INTERRUPTS] {
    let mut table: [Handler; INTERRUPTS] = [DefaultHandler; INTERRUPTS];
    table[Interrupt::UART0_RX as usize] = UART0_RX;
    table[Interrupt::UART0_TX as usize] = UART0_TX;
    table[Interrupt::FREE6 as usize] = FREE6;
    table[Interrupt::FREE7 as usize] = FREE7;
    table[Interrupt::TIMER0 as usize] = TIMER0;
    table[Interrupt::TIMER1 as usize] = TIMER1;
    table[Interrupt::DUAL_TIMER as usize] = DUAL_TIMER;
    table[Interrupt::LAN9118 as usize] = LAN9118;
    table[Interrupt::FREE14 as usize] = FREE14;
    table[Interrupt::FREE15 as usize] = FREE15;
    table[Interrupt::FREE16 as usize] = FREE16;
    table[Interrupt::FREE17 as usize] = FREE17;
    table[Interrupt::FREE18 as usize] = FREE18;
    table
}

// SAFETY: this is the one definition of `__INTERRUPTS` in the image, and cortex-m-rt's linker script puts its section
// right behind the 16 system vectors, where the core looks for it.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [Handler; INTERRUPTS] = vectors();
