//! What is true in an episode: the cell with its motors and ink, and every frame on the wire.

use crate::cell::{Cell, Fault, Truth};
use crate::emulator::Segment;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Frames kept for a millisecond; more than the controller sends and receives in one.
const FRAMES_MAX: usize = 16;

/// Most kinds of faults that hit one frame.
const KINDS_MAX: usize = 16;

/// A frame on the wire.
#[derive(Clone, Debug, Default)]
pub(super) struct Frame {
    pub(super) from_master: bool,
    pub(super) time_ns: u64,
    pub(super) bytes: Vec<u8>,
}

/// Frames of a millisecond, in buffers that are used again.
#[derive(Debug, Default)]
pub(super) struct Wire {
    frames: Vec<Frame>,
    used: usize,
}

impl Wire {
    fn keep(&mut self, from_master: bool, time_ns: u64, bytes: &[u8]) {
        if self.used == self.frames.len() && self.used < FRAMES_MAX {
            self.frames.push(Frame::default());
        }
        if let Some(frame) = self.frames.get_mut(self.used) {
            (frame.from_master, frame.time_ns) = (from_master, time_ns);
            frame.bytes.clear();
            frame.bytes.extend_from_slice(bytes);
            self.used += 1;
        }
    }

    /// The frames since the last [`Self::clear`].
    pub(super) fn frames(&self) -> &[Frame] {
        self.frames.get(..self.used).unwrap_or_default()
    }

    pub(super) fn clear(&mut self) {
        self.used = 0;
    }
}

/// The cell, its wire, and the faults that hit the next frames, with their numbers of frames.
struct Inside {
    cell: Cell,
    wire: Wire,
    waiting: Vec<(Fault, u32)>,
}

/// The cell and its wire, shared by the firmware's port and the operator.
#[derive(Clone)]
pub(super) struct World(Arc<Mutex<Inside>>);

impl World {
    pub(super) fn new(cell: Cell) -> Self {
        Self(Arc::new(Mutex::new(Inside {
            cell,
            wire: Wire::default(),
            waiting: Vec::new(),
        })))
    }

    fn inside(&self) -> MutexGuard<'_, Inside> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Injects a fault now.
    pub(super) fn inject(&self, fault: Fault) {
        self.inside().cell.inject(fault);
    }

    /// Lets a fault of frames hit each of the next `count` frames, after those that an earlier one of its kind hits.
    pub(super) fn inject_into_frames(&self, fault: Fault, count: u32) {
        self.inside().waiting.push((fault, count));
    }

    /// No further frame is hit.
    pub(super) fn spare_frames(&self) {
        self.inside().waiting.clear();
    }

    /// The motors and the pen.
    pub(super) fn truth(&self) -> Truth {
        self.inside().cell.truth()
    }

    /// Puts an empty sheet in the place of the one with the ink.
    #[cfg(test)]
    pub(super) fn new_sheet(&self) {
        self.inside().cell.new_sheet();
    }

    /// Calls `look` with the cell and the frames of this millisecond, and forgets the frames.
    pub(super) fn look<R>(&self, look: impl FnOnce(&Cell, &[Frame]) -> R) -> R {
        let Inside { cell, wire, .. } = &mut *self.inside();
        let result = look(cell, wire.frames());
        wire.clear();
        result
    }
}

impl Segment for World {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame_at_ns(time_us.saturating_mul(1_000), frame)
    }

    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let Inside { cell, wire, waiting } = &mut *self.inside();
        let mut kinds: heapless::Vec<&str, KINDS_MAX> = heapless::Vec::new();
        waiting.retain_mut(|(fault, count)| {
            let is_first = !kinds.contains(&fault.name()) && kinds.push(fault.name()).is_ok();
            if is_first {
                cell.inject(*fault);
                *count = count.saturating_sub(1);
            }
            *count > 0
        });
        wire.keep(true, time_ns, frame);
        let replies = cell.frame_at_ns(time_ns, frame);
        for reply in &replies {
            wire.keep(false, time_ns, reply);
        }
        replies
    }

    fn advance_to(&mut self, time_us: u64) {
        self.inside().cell.advance_to(time_us);
    }
}
