//! Code that the boards share: everything around the tasks that depends on a Cortex-M7 but not on a chip.
//!
//! A board is a binary `src/bin/NAME.rs` with a folder of the same name. These modules use `crate::board`, a module of
//! that folder with these items: `CRITICAL`, the interrupts of the critical tasks; `INTERRUPT_LINES` and
//! `NVIC_PRIO_BITS`, lines and priority bits of the interrupt controller; `Port`, the driver of the EtherCAT port, with
//! `FRAME_BUFFERS`, how many buffers it has for each direction, and `is_readable`, whether the DMA has left a frame's
//! buffer alone; and `free_run`, a counter that never stops.

pub(crate) mod critical;
pub(crate) mod final_telegram;
pub(crate) mod frames;
pub(crate) mod load;
mod memcpy;
pub(crate) mod mode_log;
pub(crate) mod overruns;
pub(crate) mod release;
pub(crate) mod time;
