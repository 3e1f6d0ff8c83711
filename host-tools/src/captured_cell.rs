//! The virtual cell with packet capture: every frame in both directions is recorded.

use crate::cell::Cell;
use crate::emulator::Segment;
use etherpen_segment::capture::{Capture, Direction};
use std::io::{self, Write};

/// A cell whose frames are recorded.
pub struct CapturedCell {
    cell: Cell,
    capture: Option<Capture<Box<dyn Write + Send>>>,
    failure: Option<io::Error>,
}

impl CapturedCell {
    /// A cell that captures its frames into a pcapng file, or does not capture without a sink.
    ///
    /// # Errors
    /// Errors of the sink.
    pub fn new(cell: Cell, sink: Option<Box<dyn Write + Send>>) -> io::Result<Self> {
        let capture = sink.map(Capture::new).transpose()?;
        Ok(Self {
            cell,
            capture,
            failure: None,
        })
    }

    /// Completes the capture and returns the cell.
    ///
    /// # Errors
    /// The first error while the capture was written.
    pub fn finish(self) -> io::Result<Cell> {
        match (self.failure, self.capture) {
            (Some(failure), _) => Err(failure),
            (None, Some(capture)) => capture.finish().map(|_| self.cell),
            (None, None) => Ok(self.cell),
        }
    }

    fn record(&mut self, time_us: u64, direction: Direction, frame: &[u8]) {
        if let Some(capture) = &mut self.capture
            && let Err(error) = capture.record(time_us, direction, frame)
        {
            self.failure = Some(error);
            self.capture = None;
        }
    }
}

impl Segment for Cell {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        Cell::frame(self, time_us, frame)
    }

    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        Cell::frame_at_ns(self, time_ns, frame)
    }

    fn advance_to(&mut self, time_us: u64) {
        Cell::advance_to(self, time_us);
    }
}

impl Segment for CapturedCell {
    fn frame(&mut self, time_us: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        self.frame_at_ns(time_us * 1_000, frame)
    }

    fn frame_at_ns(&mut self, time_ns: u64, frame: &[u8]) -> Vec<Vec<u8>> {
        let time_us = time_ns / 1_000;
        self.record(time_us, Direction::Sent, frame);
        let replies = self.cell.frame_at_ns(time_ns, frame);
        for reply in &replies {
            self.record(time_us, Direction::Received, reply);
        }
        replies
    }

    fn advance_to(&mut self, time_us: u64) {
        self.cell.advance_to(time_us);
    }
}
