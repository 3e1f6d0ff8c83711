//! The short drawing by the firmware image in the emulator: on an idle and on a busy machine, and over a bad line.

mod broken;
mod golden;

use broken::{BadLine, assert_same_ink};
use host_tools::cell::Cell;
use host_tools::emulator::{Emulator, Options};
use host_tools::run::{Drawn, RunTask, emulate};
use host_tools::setup;
use std::hint::black_box;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

/// Threads that take the machine's processors away from the emulator and its peer.
const BUSY_THREADS: usize = 2;

fn draw(task: &RunTask, image: &Path) -> Drawn {
    emulate(task, image, None, &mut |_| {}, |_| {}).expect("the emulator runs")
}

/// Draws over a line that spoils bytes and is unplugged; asserts that the ink is that of the undisturbed drawing.
fn assert_same_over_a_bad_line(task: &RunTask, image: &Path, undisturbed: &Drawn) {
    let cell = Arc::new(Mutex::new(Cell::new(&task.config, task.cell.clone())));
    let line = Arc::new(Mutex::new(BadLine::new(task, 0x5eed)));
    let emulator = Emulator::start(image, &Options::default(), cell.clone(), line.clone(), |_| {});
    let emulator = emulator.expect("the emulator starts");
    let over = || line.lock().expect("nobody panics with the line").outcome.is_some();
    while !over() && emulator.is_running() {
        thread::sleep(Duration::from_millis(50));
    }
    emulator.stop().expect("the emulator runs to the end");
    line.lock().expect("nobody panics with the line").assert_reported();
    assert_same_ink(
        undisturbed.cell.ink(),
        cell.lock().expect("nobody panics with the cell").ink(),
    );
}

fn draw_on_a_busy_machine(task: &RunTask, image: &Path) -> Drawn {
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
        // The busy threads end even if the drawing panics.
        let drawn = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| draw(task, image)));
        over.store(true, Ordering::Relaxed);
        drawn.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

#[test]
fn the_drawing_in_the_emulator_is_clean_the_golden_one_and_the_same_on_a_busy_machine_and_over_a_bad_line() {
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
    assert_same_over_a_bad_line(&task, &image, &idle);
}
