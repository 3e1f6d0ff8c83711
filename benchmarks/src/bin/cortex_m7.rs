//! All cases on QEMU's mps2-an500: prints `CASE SUBJECT INSTRUCTIONS`, a line each, and ends the emulator.
#![no_std]
#![no_main]

mod timer;

use benchmarks::ethercrab_master::{self, EthercrabMaster, Storage};
use benchmarks::etherpen_master::{self, EtherpenMaster};
use benchmarks::{CASES, CYCLES, Case, DRIVES, Master, Meter, SIXTEEN, measure};
use core::sync::atomic::{AtomicI32, Ordering};
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use etherpen::robot_bus::RobotBusQueues;

static COUNTED: AtomicI32 = AtomicI32::new(0);
static OVERHEAD: AtomicI32 = AtomicI32::new(0);
static PAUSE_OVERHEAD: AtomicI32 = AtomicI32::new(0);

fn add(counts: i32) {
    COUNTED.store(COUNTED.load(Ordering::Relaxed).wrapping_add(counts), Ordering::Relaxed);
}

/// Counts of the timer while the work runs, less what the counting itself takes.
struct Timer;

impl Meter for Timer {
    #[inline(never)]
    fn count<R>(work: impl FnOnce() -> R) -> R {
        let start = timer::now();
        let result = work();
        let end = timer::now();
        add((end.wrapping_sub(start) as i32).wrapping_sub(OVERHEAD.load(Ordering::Relaxed)));
        result
    }

    #[inline(never)]
    fn pause<R>(work: impl FnOnce() -> R) -> R {
        let start = timer::now();
        let result = work();
        let end = timer::now();
        let overhead = PAUSE_OVERHEAD.load(Ordering::Relaxed);
        add((end.wrapping_sub(start) as i32).wrapping_add(overhead).wrapping_neg());
        result
    }
}

fn take() -> i64 {
    i64::from(COUNTED.swap(0, Ordering::Relaxed))
}

/// Finds what counting and pausing take, and makes sure that the clock counts instructions.
fn calibrate() {
    Timer::count(|| ());
    OVERHEAD.store(take() as i32, Ordering::Relaxed);
    Timer::count(|| Timer::pause(|| ()));
    PAUSE_OVERHEAD.store(take() as i32, Ordering::Relaxed);
    timer::check(|known| {
        Timer::count(known);
        take()
    });
}

fn report(case: Case, subject: &str, mut master: impl Master) {
    take();
    measure::<Timer>(&mut master);
    let value = (timer::instructions(take()) + i64::from(CYCLES) / 2) / i64::from(CYCLES);
    hprintln!("{} {} {}", case.name, subject, value);
}

#[entry]
fn main() -> ! {
    static mut STORAGES: [Storage; CASES.len()] = [const { Storage::new() }; CASES.len()];
    timer::start();
    calibrate();
    hprintln!("ram_bytes etherpen {}", etherpen_master::ram_bytes());
    hprintln!("ram_bytes ethercrab {}", ethercrab_master::ram_bytes());
    for (case, storage) in CASES.into_iter().zip(STORAGES) {
        let mut queues = RobotBusQueues::new();
        report(case, "etherpen", EtherpenMaster::<DRIVES>::new(&mut queues, case));
        report(case, "ethercrab", EthercrabMaster::new(storage, case));
    }
    let mut queues = RobotBusQueues::new();
    report(SIXTEEN, "etherpen", EtherpenMaster::<16>::new(&mut queues, SIXTEEN));
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
