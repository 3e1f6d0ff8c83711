//! Clock tree: 480 MHz core, 240 MHz buses and timers, 120 MHz peripherals.
//!
//! The clock is 480 MHz at voltage scale 0 instead of 400 MHz at scale 1, because the critical path's share of a
//! millisecond matters most, and the board's revision V silicon at room temperature is specified for it. Scale 0 limits
//! the junction to 105 degrees C; a hotter cabinet needs scale 1, multiplier 100 and `CORE_HZ` 400 MHz, no other
//! change. Revision Y cannot run at scale 0 and is rejected by its identity before the clocks change.
//!
//! The source is a clock that the board puts on OSC_IN (HSE in bypass), on a NUCLEO the 8 MHz of the ST-LINK: the bus
//! master's cycle is then as precise as a crystal, unlike the internal oscillator (1 %). A NUCLEO powered through E5V
//! gets the clock late, or only when a computer is plugged in. The start-up therefore waits two seconds for it, then
//! runs on the internal oscillator, reports that, and keeps the drives without power. When the clock appears later, the
//! firmware restarts on it: no drive has power then, and the start-up is the only path into this clock tree, tested at
//! every power-up. When it stops, the clock security system ends the firmware (`panic.rs`).
//!
//! Every register is written before the unit that depends on it runs, and every wait is bounded (`start_up.rs`).
//! CSI feeds the compensation cell of fast outputs, HSI48 the USB.
//!
//! Registers: RM0433, chapters "PWR", "RCC" and "FLASH".

use super::start_up::Waits;
use crate::board::HSE_HZ;
use stm32_metapac::flash::regs::Acr;
use stm32_metapac::pwr::vals::Vos;
use stm32_metapac::rcc::vals::{Hpre, Plldiv, Pllm, Plln, Pllrge, Pllsrc, Pllvcosel, Ppre, Sw, Usbsel};
use stm32_metapac::{DBGMCU, FLASH, PWR, RCC, SYSCFG};

/// Clock of the processor, Hz.
pub(crate) const CORE_HZ: u32 = 480_000_000;
/// Clock of the buses and of the Ethernet MAC's registers, Hz.
pub(crate) const BUS_HZ: u32 = CORE_HZ / 2;
/// Kernel clock of the timers on APB1 and APB2, Hz: twice the peripherals' clock.
pub(crate) const TIMER_HZ: u32 = BUS_HZ;
/// Clock of the peripherals on APB1 to APB4, Hz.
pub(crate) const PERIPHERAL_HZ: u32 = BUS_HZ / 2;
/// The internal oscillator, which everything runs on after a reset, Hz.
pub(crate) const HSI_HZ: u32 = 64_000_000;

/// The PLL multiplies the external clock by this number and divides by 2.
const PLL_MULTIPLIER: u32 = 2 * CORE_HZ / HSE_HZ;
/// Divider that makes the internal oscillator as fast as the external clock.
const HSI_DIVIDER: u32 = HSI_HZ / HSE_HZ;
const _: () = assert!(HSE_HZ * PLL_MULTIPLIER / 2 == CORE_HZ && HSI_HZ / HSI_DIVIDER == HSE_HZ);
/// Input range of the PLL that `start_pll` selects.
const _: () = assert!(HSE_HZ >= 8_000_000 && HSE_HZ <= 16_000_000);

/// Longest wait for the external clock, ms.
const HSE_WAIT_MS: u32 = 2_000;
/// Wait states of the flash memory at 240 MHz and voltage scale 0, and its programming delay (RM0433, FLASH_ACR).
const FLASH_LATENCY: u8 = 4;
const FLASH_PROGRAMMING_DELAY: u8 = 2;
/// `REV_ID` of DBGMCU_IDC for revision Y (RM0433, debug chapter).
const REVISION_Y: u16 = 0x1003;

/// Source of the clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// The clock on OSC_IN, as precise as a crystal.
    External,
    /// The internal oscillator, within 1 %.
    Internal,
}

/// Starts the clocks and returns their source. The chip must be in its reset state, except for the lamps.
///
/// # Panics
///
/// On revision Y silicon, and when a required part does not get ready.
pub(crate) fn start(waits: &mut Waits) -> Source {
    assert!(
        DBGMCU.idc().read().rev_id() != REVISION_Y,
        "silicon revision Y: 480 MHz is out of its range"
    );
    // A debug probe reads the log's memory while the core sleeps, too.
    DBGMCU.cr().modify(|debug| {
        debug.set_dbgsleep_d1(true);
        debug.set_d1dbgcken(true);
        debug.set_d3dbgcken(true);
    });
    RCC.apb4enr().modify(|enable| enable.set_syscfgen(true));
    let _ = RCC.apb4enr().read();
    start_voltage(waits);
    let source = start_oscillators(waits);
    start_pll(waits, source);
    switch_over(waits);
    if source == Source::External {
        // From here on a clock that stops causes a non-maskable interrupt.
        RCC.cr().modify(|control| control.set_hsecsson(true));
    }
    source
}

/// Whether the firmware runs on the internal oscillator and the external clock has appeared since.
pub(crate) fn external_clock_appeared() -> bool {
    RCC.pllckselr().read().pllsrc() == Pllsrc::HSI && RCC.cr().read().hserdy()
}

/// Voltage scale 0: scale 1 first, then the overdrive.
fn start_voltage(waits: &mut Waits) {
    // The supply's configuration: the values after a reset, fixed by being written once.
    PWR.cr3().modify(|supply| {
        supply.set_scuen(true);
        supply.set_ldoen(true);
        supply.set_bypass(false);
    });
    waits.require("core voltage (ACTVOSRDY)", || PWR.csr1().read().actvosrdy());
    PWR.d3cr().modify(|voltage| voltage.set_vos(Vos::SCALE1));
    waits.require("voltage scale 1 (VOSRDY)", || PWR.d3cr().read().vosrdy());
    SYSCFG.pwrcr().modify(|overdrive| overdrive.set_oden(1));
    waits.require("voltage scale 0 (VOSRDY)", || PWR.d3cr().read().vosrdy());
}

/// Starts all oscillators and returns the source of the PLL. The HSE stays on in any case, so that its appearance is
/// detected.
fn start_oscillators(waits: &mut Waits) -> Source {
    waits.require("internal oscillator (HSIRDY)", || RCC.cr().read().hsirdy());
    // The bypass may be chosen only while the oscillator is off.
    RCC.cr().modify(|control| control.set_hsebyp(true));
    RCC.cr().modify(|control| {
        control.set_hseon(true);
        control.set_csion(true);
        control.set_hsi48on(true);
    });
    waits.require("oscillator of fast outputs (CSIRDY)", || RCC.cr().read().csirdy());
    waits.require("oscillator of the USB (HSI48RDY)", || RCC.cr().read().hsi48rdy());
    if waits.wait(HSE_WAIT_MS, || RCC.cr().read().hserdy()) {
        Source::External
    } else {
        Source::Internal
    }
}

fn start_pll(waits: &mut Waits, source: Source) {
    let (input, divider) = match source {
        Source::External => (Pllsrc::HSE, Pllm::DIV1),
        Source::Internal => (Pllsrc::HSI, Pllm::from_bits(HSI_DIVIDER as u8)),
    };
    RCC.pllckselr().modify(|select| {
        select.set_pllsrc(input);
        select.set_divm(0, divider);
    });
    RCC.pllcfgr().modify(|config| {
        config.set_pllvcosel(0, Pllvcosel::WIDE_VCO);
        config.set_pllrge(0, Pllrge::RANGE8);
        config.set_pllfracen(0, false);
        config.set_divpen(0, true);
        config.set_divqen(0, false);
        config.set_divren(0, false);
    });
    RCC.plldivr(0).modify(|dividers| {
        dividers.set_plln(Plln::from_bits((PLL_MULTIPLIER - 1) as u16));
        dividers.set_pllp(Plldiv::DIV2);
    });
    RCC.cr().modify(|control| control.set_pllon(0, true));
    waits.require("PLL (PLL1RDY)", || RCC.cr().read().pllrdy(0));
    // The chip ignores a new source or divider of a PLL that runs.
    let selected = RCC.pllckselr().read();
    assert!(
        selected.pllsrc() == input && selected.divm(0) == divider,
        "PLL source (PLLCKSELR): {:#010x}",
        selected.0
    );
}

/// Switches from the internal oscillator to the PLL; slower buses and more wait states come first.
fn switch_over(waits: &mut Waits) {
    RCC.d1cfgr().modify(|dividers| {
        dividers.set_d1cpre(Hpre::DIV1);
        dividers.set_hpre(Hpre::DIV2);
        dividers.set_d1ppre(Ppre::DIV2);
    });
    RCC.d2cfgr().modify(|dividers| {
        dividers.set_d2ppre1(Ppre::DIV2);
        dividers.set_d2ppre2(Ppre::DIV2);
    });
    RCC.d3cfgr().modify(|divider| divider.set_d3ppre(Ppre::DIV2));
    let access = |mut access: Acr| {
        access.set_latency(FLASH_LATENCY);
        access.set_wrhighfreq(FLASH_PROGRAMMING_DELAY);
        access
    };
    FLASH.acr().modify(|now| *now = access(*now));
    waits.require("flash wait states (FLASH_ACR)", || {
        let now = FLASH.acr().read();
        now == access(now)
    });
    RCC.d2ccip2r().modify(|kernel| kernel.set_usbsel(Usbsel::HSI48));
    // Outputs keep their edges over voltage and temperature.
    SYSCFG.cccsr().modify(|cell| cell.set_en(true));
    waits.require("compensation of fast outputs (CCCSR.READY)", || {
        SYSCFG.cccsr().read().rdy()
    });
    RCC.cfgr().modify(|select| select.set_sw(Sw::PLL1_P));
    waits.require("switch to the PLL (SWS)", || RCC.cfgr().read().sws() == Sw::PLL1_P);
    waits.clocked_at(CORE_HZ);
}
