//! Motion watchdog: detects a motion that should progress and does not, whatever the cause.
//!
//! Progress is a vertex executed, a micrometre of the path or a ten-thousandth of a radian of the fourth axis. The
//! slowest motion that any configuration allows moves by 0.1 mm a second on a line, and turns by 0.01 rad a second in a
//! corner.

use super::PERIOD_MS;
use super::delay_line::PathSample;
use crate::robots::vector::{length, subtract};

/// Longest time without progress, ms.
pub(super) const STALL_MS: u32 = 2_000;
/// Distance that counts as progress, mm: the resolution of the link.
const WAY_MM: f64 = 1.0e-3;
/// Turn of the fourth axis that counts as progress, rad.
const TURN_RAD: f64 = 1.0e-4;

/// Watches each motion for progress.
#[derive(Clone, Copy, Debug)]
pub(super) struct Watch {
    /// Position of the last progress.
    mark: PathSample,
    still_ms: u32,
}

impl Watch {
    /// A watch before the first motion.
    pub(super) const fn new() -> Self {
        Self {
            mark: PathSample::NONE,
            still_ms: 0,
        }
    }

    /// Takes the state at the end of a period; `moves` is true if progress is required.
    pub(super) fn step(&mut self, here: &PathSample, moves: bool) {
        let mark = &self.mark;
        let progress = here.label.vertex != mark.label.vertex
            || length(&subtract(&here.point, &mark.point)) >= WAY_MM
            || (here.heading - mark.heading).abs() >= TURN_RAD;
        if progress || !moves {
            self.mark = *here;
            self.still_ms = 0;
        } else {
            self.still_ms = self.still_ms.saturating_add(PERIOD_MS as u32);
        }
    }

    /// Time without progress, ms; 0 up to [`STALL_MS`].
    pub(super) fn stalled_ms(&self) -> u32 {
        if self.still_ms > STALL_MS { self.still_ms } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_up_to_the_limit_is_no_stall() {
        for (still_ms, stalled_ms) in [(STALL_MS, 0), (STALL_MS + 1, STALL_MS + 1)] {
            let watch = Watch {
                still_ms,
                ..Watch::new()
            };
            assert_eq!(watch.stalled_ms(), stalled_ms);
        }
    }
}
