//! The planner on QEMU's mps2-an500: prints `LOAD etherpen WORST MEAN PERIODS` in instructions, a line each.
//!
//! A period is what the trajectory task does in one: taking vertices, a command, and the step that gives twelve
//! references.
#![no_std]
#![no_main]

mod timer;

use benchmarks::motion::{LOADS, Path, run};
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use etherpen::motion::Trajectory;

#[entry]
fn main() -> ! {
    static mut TRAJECTORY: Trajectory = Trajectory::unconfigured();
    static mut PATH: Path = Path::new();
    timer::start();
    timer::check(|known| {
        let start = timer::now();
        known();
        i64::from(timer::now().wrapping_sub(start))
    });
    for load in &LOADS {
        let cost = run(TRAJECTORY, PATH, load, timer::now);
        hprintln!(
            "{} etherpen {} {} {}",
            load.name,
            timer::instructions(i64::from(cost.worst)),
            timer::instructions(cost.sum as i64 / i64::from(cost.periods)),
            cost.periods
        );
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
