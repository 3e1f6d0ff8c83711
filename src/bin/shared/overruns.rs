//! Releases of the trajectory task that it has not completed, and those that came too early.

use core::sync::atomic::{AtomicU32, Ordering};

/// Releases of the trajectory task that it has not completed. Reading it is safe in a critical task.
pub(crate) static TRAJECTORIES_DUE: AtomicU32 = AtomicU32::new(0);
/// Releases of the trajectory task that found an earlier one not completed.
pub(crate) static TRAJECTORY_OVERRUNS: AtomicU32 = AtomicU32::new(0);

/// Counts a release of the trajectory task. Safe in a critical task.
pub(crate) fn trajectory_released() {
    TRAJECTORIES_DUE.fetch_add(1, Ordering::Relaxed);
}

/// Completes the releases that were due when the task began. Releases that arrived meanwhile, or that were due in
/// addition to the first one, are overruns.
pub(crate) fn trajectory_completed(due: u32) {
    let before = TRAJECTORIES_DUE.fetch_sub(due, Ordering::Relaxed);
    TRAJECTORY_OVERRUNS.fetch_add(before.saturating_sub(1), Ordering::Relaxed);
}
