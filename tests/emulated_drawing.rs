//! The short drawing by the firmware image in the emulator, on an idle and on a busy machine.

mod golden;

use host_tools::run::{Drawn, Task, emulate};
use host_tools::setup;
use std::hint::black_box;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

/// Threads that take the machine's processors away from the emulator and its peer.
const BUSY_THREADS: usize = 2;

fn draw(task: &Task, image: &Path) -> Drawn {
    emulate(task, image, None, &mut |_| {}, |_| {}).expect("the emulator runs")
}

fn draw_on_a_busy_machine(task: &Task, image: &Path) -> Drawn {
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        for _ in 0..BUSY_THREADS {
            scope.spawn(|| {
                let mut count = 0_u64;
                while !over.load(Ordering::Relaxed) {
                    count = black_box(count.wrapping_add(1));
                }
            });
        }
        // The busy threads end also when the drawing panics.
        let drawn = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| draw(task, image)));
        over.store(true, Ordering::Relaxed);
        drawn.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

#[test]
fn the_drawing_in_the_emulator_is_clean_the_golden_one_and_the_same_on_a_busy_machine() {
    setup::ensure_qemu().expect("the emulator can be had");
    let image = setup::build_firmware("emulated").expect("the firmware builds");
    let (prepared, task) = golden::strokes();
    let (idle, busy) = (draw(&task, &image), draw_on_a_busy_machine(&task, &image));
    let report = golden::assert_clean(&prepared, &task, &idle);
    golden::assert_clean(&prepared, &task, &busy);
    let different = idle.job.samples.iter().zip(&busy.job.samples).find(|(a, b)| a != b);
    assert_eq!(different, None);
    assert_eq!(idle.job.samples.len(), busy.job.samples.len());
    assert!(idle.cell.ink() == busy.cell.ink(), "the ink of two runs differs");
    golden::compare(&task, &idle, &report);
}
