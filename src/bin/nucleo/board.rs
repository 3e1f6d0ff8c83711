//! The board NUCLEO-H743ZI2, for the modules in `shared` and `stm32h7`.

use crate::stm32h7::eth::Ethernet;
pub(crate) use crate::stm32h7::{INTERRUPT_LINES, timer::free_run};
use stm32_metapac::Interrupt;
pub(crate) use stm32_metapac::NVIC_PRIO_BITS;

/// Name by which the host knows the board.
pub(crate) const NAME: &str = "nucleo";
/// Interrupts of the critical tasks.
pub(crate) const CRITICAL: [Interrupt; 3] = [Interrupt::TIM1_UP, Interrupt::TIM1_CC, Interrupt::ETH];
/// Driver of the EtherCAT port.
pub(crate) type Port = Ethernet;
/// Clock on OSC_IN, Hz.
pub(crate) const HSE_HZ: u32 = 8_000_000;
/// Name of the clock on OSC_IN, in messages.
pub(crate) const EXTERNAL_CLOCK: &str = "the 8 MHz from the ST-LINK";
