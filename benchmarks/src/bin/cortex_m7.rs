//! All cases on QEMU's mps2-an500: prints `CASE SUBJECT INSTRUCTIONS`, a line each, and ends the emulator.
//!
//! With `-icount shift=10` every instruction takes 1,024 ns of virtual time, which a timer of 25 MHz resolves: the counts
//! are exact. A loop of known length is counted first, and a wrong result ends the run.
#![no_std]
#![no_main]

use benchmarks::ethercrab_master::{self, EthercrabMaster, Storage};
use benchmarks::etherpen_master::{self, EtherpenMaster};
use benchmarks::{CASES, CYCLES, Case, Master, Meter, measure};
use core::sync::atomic::{AtomicI32, Ordering, compiler_fence};
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use etherpen::ethercat_robot::RobotBusQueues;

/// CMSDK APB timer 0: control, value, reload.
const TIMER: *mut u32 = 0x4000_0000 as *mut u32;
/// Counts of the timer and the instructions that take as long at shift 10: 40 ns against 1,024 ns.
const INSTRUCTIONS_PER_COUNT: (i64, i64) = (5, 128);
/// The loop that checks the clock: two instructions a round and one before.
const KNOWN_ROUNDS: u32 = 10_000;

static COUNTED: AtomicI32 = AtomicI32::new(0);
static OVERHEAD: AtomicI32 = AtomicI32::new(0);
static PAUSE_OVERHEAD: AtomicI32 = AtomicI32::new(0);

#[inline(always)]
fn now() -> u32 {
    compiler_fence(Ordering::SeqCst);
    // SAFETY: reading the value of a timer that only `main` has set up changes nothing.
    let value = unsafe { TIMER.add(1).read_volatile() };
    compiler_fence(Ordering::SeqCst);
    !value
}

fn add(counts: i32) {
    COUNTED.store(COUNTED.load(Ordering::Relaxed).wrapping_add(counts), Ordering::Relaxed);
}

/// Counts of the timer while the work runs, less what the counting itself takes.
struct Timer;

impl Meter for Timer {
    #[inline(never)]
    fn count<R>(work: impl FnOnce() -> R) -> R {
        let start = now();
        let result = work();
        let end = now();
        add((end.wrapping_sub(start) as i32).wrapping_sub(OVERHEAD.load(Ordering::Relaxed)));
        result
    }

    #[inline(never)]
    fn pause<R>(work: impl FnOnce() -> R) -> R {
        let start = now();
        let result = work();
        let end = now();
        let overhead = PAUSE_OVERHEAD.load(Ordering::Relaxed);
        add((end.wrapping_sub(start) as i32).wrapping_add(overhead).wrapping_neg());
        result
    }
}

fn take() -> i64 {
    i64::from(COUNTED.swap(0, Ordering::Relaxed))
}

fn instructions(counts: i64) -> i64 {
    let (numerator, denominator) = INSTRUCTIONS_PER_COUNT;
    (counts * numerator + denominator / 2) / denominator
}

/// Finds what counting and pausing take, and makes sure that the clock counts instructions.
fn calibrate() {
    Timer::count(|| ());
    OVERHEAD.store(take() as i32, Ordering::Relaxed);
    Timer::count(|| Timer::pause(|| ()));
    PAUSE_OVERHEAD.store(take() as i32, Ordering::Relaxed);
    Timer::count(|| {
        // SAFETY: counts a register of its own down to zero.
        unsafe {
            core::arch::asm!("2: subs {0}, {0}, #1", "bne 2b", inout(reg) KNOWN_ROUNDS => _);
        }
    });
    let counted = instructions(take());
    let known = i64::from(2 * KNOWN_ROUNDS);
    // A register has to be loaded first.
    assert!(
        (known..=known + 2).contains(&counted),
        "{known} instructions were counted as {counted}"
    );
}

fn report(case: Case, subject: &str, mut master: impl Master) {
    take();
    measure::<Timer>(&mut master);
    let value = (instructions(take()) + i64::from(CYCLES) / 2) / i64::from(CYCLES);
    hprintln!("{} {} {}", case.name, subject, value);
}

#[entry]
fn main() -> ! {
    static mut STORAGES: [Storage; CASES.len()] = [const { Storage::new() }; CASES.len()];
    // SAFETY: nothing else uses the timer; the whole range, running.
    unsafe {
        TIMER.add(2).write_volatile(u32::MAX);
        TIMER.add(1).write_volatile(u32::MAX);
        TIMER.write_volatile(1);
    }
    calibrate();
    hprintln!("ram_bytes etherpen {}", etherpen_master::ram_bytes());
    hprintln!("ram_bytes ethercrab {}", ethercrab_master::ram_bytes());
    for (case, storage) in CASES.into_iter().zip(STORAGES) {
        let mut queues = RobotBusQueues::new();
        report(case, "etherpen", EtherpenMaster::new(&mut queues, case));
        report(case, "ethercrab", EthercrabMaster::new(storage, case));
    }
    debug::exit(debug::EXIT_SUCCESS);
    panic!("the emulator goes on");
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo) -> ! {
    hprintln!("{}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::bkpt();
    }
}
