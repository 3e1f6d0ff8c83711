//! Clock tree: 480 MHz core, 240 MHz buses and timers, 120 MHz peripherals.
//!
//! 480 MHz at voltage scale 0 rather than 400 MHz at scale 1: the critical path's share of a millisecond is the figure
//! that counts here, and the board's revision V silicon at room temperature is specified for it. Scale 0 limits the
//! junction to 105 degrees C; a hotter cabinet takes scale 1, multiplier 100 and `CORE_HZ` 400 MHz, nothing else.
//! Revision Y cannot run at scale 0 and is refused by its identity before the clocks change.
//!
//! The source is the 8 MHz that the ST-LINK puts on OSC_IN (HSE in bypass): the bus master's cycle then is as exact as
//! a crystal, which the internal oscillator (1 %) is not. Without them the board starts on the internal oscillator, so
//! that it can say so, and moves nothing; when they stop later, the clock security system ends the firmware (`panic.rs`).
//! CSI feeds the compensation cell of fast outputs, HSI48 the USB.

use embassy_stm32::pac::{DBGMCU, RCC};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, Hsi48Config, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk,
    TimerPrescaler, VoltageScale, mux::Usbsel,
};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Config, Peripherals, interrupt::Priority};

/// Clock of the processor, Hz.
pub(crate) const CORE_HZ: u32 = 480_000_000;
/// Clock of the buses and of the Ethernet MAC's registers, Hz.
pub(crate) const BUS_HZ: u32 = CORE_HZ / 2;
/// Kernel clock of the timers on APB1 and APB2, Hz: twice the peripherals' clock.
pub(crate) const TIMER_HZ: u32 = BUS_HZ;
/// Clock of the peripherals on APB1 to APB4, Hz.
pub(crate) const PERIPHERAL_HZ: u32 = BUS_HZ / 2;

const HSE_HZ: u32 = 8_000_000;
const PLL_MULTIPLIER: u32 = 120;
const _: () = assert!(HSE_HZ * PLL_MULTIPLIER / 2 == CORE_HZ);

/// The internal oscillator's 64 MHz by this are as fast as the 8 MHz.
const HSI_DIVIDER: PllPreDiv = PllPreDiv::DIV8;
/// Looks at the 8 MHz before they count as missing: some milliseconds.
const HSE_LOOKS_MAX: u32 = 100_000;

/// Where the clocks come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    /// The ST-LINK's 8 MHz, as exact as a crystal.
    Exact,
    /// The internal oscillator.
    Substitute,
}

/// `REV_ID` of DBGMCU_IDC for revision Y (RM0433, debug chapter).
const REVISION_Y: u16 = 0x1003;

/// Starts the clocks and hands out the chip's peripherals and where the clocks come from.
///
/// No embassy time driver is linked, and the DMA interrupts that the HAL enables get the lowest priority: nothing sits
/// at hardware priority 0.
///
/// # Panics
///
/// On revision Y silicon, and when called twice.
pub(crate) fn start() -> (Peripherals, Source) {
    assert!(
        DBGMCU.idc().read().rev_id() != REVISION_Y,
        "silicon revision Y: 480 MHz is out of its range"
    );
    let source = look_for_hse();
    let mut config = Config::default();
    config.rcc.hse = (source == Source::Exact).then_some(Hse {
        freq: Hertz(HSE_HZ),
        mode: HseMode::Bypass,
    });
    config.rcc.csi = true;
    // For USB, which trims it by itself (`usb.rs`).
    config.rcc.hsi48 = Some(Hsi48Config { sync_from_usb: false });
    config.rcc.mux.usbsel = Usbsel::HSI48;
    config.rcc.pll1 = Some(Pll {
        source: match source {
            Source::Exact => PllSource::HSE,
            Source::Substitute => PllSource::HSI,
        },
        prediv: match source {
            Source::Exact => PllPreDiv::DIV1,
            Source::Substitute => HSI_DIVIDER,
        },
        mul: PllMul::MUL120,
        fracn: None,
        divp: Some(PllDiv::DIV2),
        divq: None,
        divr: None,
    });
    config.rcc.sys = Sysclk::PLL1_P;
    config.rcc.d1c_pre = AHBPrescaler::DIV1;
    config.rcc.ahb_pre = AHBPrescaler::DIV2;
    config.rcc.apb1_pre = APBPrescaler::DIV2;
    config.rcc.apb2_pre = APBPrescaler::DIV2;
    config.rcc.apb3_pre = APBPrescaler::DIV2;
    config.rcc.apb4_pre = APBPrescaler::DIV2;
    config.rcc.timer_prescaler = TimerPrescaler::DefaultX2;
    config.rcc.voltage_scale = VoltageScale::Scale0;
    config.dma_interrupt_priority = Priority::P15;
    config.bdma_interrupt_priority = Priority::P15;
    config.mdma_interrupt_priority = Priority::P15;
    let chip = embassy_stm32::init(config);
    if source == Source::Exact {
        // From here on a clock that stops is a non-maskable interrupt.
        RCC.cr().modify(|control| control.set_hsecsson(true));
    }
    (chip, source)
}

/// Whether the 8 MHz are there, looked for in vain for a bounded time; the oscillator is off again afterwards.
fn look_for_hse() -> Source {
    RCC.cr().modify(|control| control.set_hsebyp(true));
    RCC.cr().modify(|control| control.set_hseon(true));
    let found = (0..HSE_LOOKS_MAX).any(|_| RCC.cr().read().hserdy());
    RCC.cr().modify(|control| control.set_hseon(false));
    // Its mode may be changed only when it has stopped.
    let _ = (0..HSE_LOOKS_MAX).any(|_| !RCC.cr().read().hserdy());
    if found { Source::Exact } else { Source::Substitute }
}
