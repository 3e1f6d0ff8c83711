//! The board that QEMU's mps2-an500 emulates, for the modules in `shared`.

use super::device::Interrupt;
pub(crate) use super::device::{INTERRUPT_LINES, NVIC_PRIO_BITS};
pub(crate) use super::lan9118::free_run;
use super::wire::Wire;
use etherpen::black_box::FrameNote;
use etherpen::ethernet::lan9118::BUFFERS;

/// Name by which the host knows the board.
pub(crate) const NAME: &str = "emulated";
/// Interrupts of the critical tasks.
pub(crate) const CRITICAL: [Interrupt; 4] = [
    Interrupt::TIMER0,
    Interrupt::TIMER1,
    Interrupt::DUAL_TIMER,
    Interrupt::LAN9118,
];
/// Driver of the EtherCAT port.
pub(crate) type Port = Wire;
/// Its buffers for each direction.
pub(crate) const FRAME_BUFFERS: u32 = BUFFERS as u32;

/// Whether a frame's buffer is as the critical tasks have left it: always, because there is no DMA.
pub(crate) fn is_readable(_: &FrameNote) -> bool {
    true
}
