//! The board NUCLEO-H743ZI2, for the modules in `shared` and `stm32h7`.

use crate::stm32h7::eth::{self, Ethernet};
pub(crate) use crate::stm32h7::{INTERRUPT_LINES, timer::free_run};
use etherpen::black_box::FrameNote;
use stm32_metapac::Interrupt;
pub(crate) use stm32_metapac::NVIC_PRIO_BITS;

/// Name by which the host knows the board.
pub(crate) const NAME: &str = "nucleo";
/// Interrupts of the critical tasks.
pub(crate) const CRITICAL: [Interrupt; 3] = [Interrupt::TIM1_UP, Interrupt::TIM1_CC, Interrupt::ETH];
/// Driver of the EtherCAT port.
pub(crate) type Port = Ethernet;
/// Its buffers for each direction.
pub(crate) const FRAME_BUFFERS: u32 = eth::RING_LENGTH as u32;

/// Whether a frame's buffer is as the critical tasks have left it.
pub(crate) fn is_readable(note: &FrameNote) -> bool {
    eth::is_readable(note)
}
/// Clock on OSC_IN, Hz.
pub(crate) const HSE_HZ: u32 = 8_000_000;
/// Name of the clock on OSC_IN, in messages.
pub(crate) const EXTERNAL_CLOCK: &str = "the 8 MHz from the ST-LINK";
