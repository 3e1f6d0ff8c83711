//! TIM1 releases the sample every millisecond and the bus deadline 300 us after it.
//!
//! TIM1 has separate interrupt vectors for update and compare, so the two releases are two tasks. The time since the
//! release is the counter itself: one read of the clock that caused the release. TIM2 runs free on that clock and
//! measures times longer than a period.

use super::clocks::TIMER_HZ;
use etherpen::ethercat::clock::steering::{CORRECTION_MAX_NS, CountCorrection};
use stm32_metapac::timer::regs::SrAdv;
use stm32_metapac::timer::vals::Urs;
use stm32_metapac::{RCC, TIM1, TIM2};

/// Rate of the sample task, Hz.
const SAMPLE_HZ: u32 = 1_000;
/// Release of the bus deadline after the sample's, us.
const BUS_DEADLINE_US: u32 = 300;
/// Divider in front of the 16-bit counter.
const PRESCALER: u32 = 4;
const TICK_HZ: u32 = TIMER_HZ / PRESCALER;
const TICKS_PER_SAMPLE: u32 = TICK_HZ / SAMPLE_HZ;
const TICKS_TO_DEADLINE: u32 = TICK_HZ / 1_000_000 * BUS_DEADLINE_US;

const _: () = assert!(
    TIMER_HZ.is_multiple_of(PRESCALER * SAMPLE_HZ),
    "the period must be exact"
);
/// Counts of the sample's timer in a microsecond.
const TICKS_PER_US: u32 = TICK_HZ / 1_000_000;
/// Longest correction of a period, counts.
const CORRECTION_TICKS_MAX: u32 = CORRECTION_MAX_NS as u32 * TICKS_PER_US / 1_000 + 1;
const _: () = assert!(
    TICKS_PER_SAMPLE + CORRECTION_TICKS_MAX <= 1 << 16,
    "the counter has 16 bits"
);
const _: () = assert!(TICKS_TO_DEADLINE + CORRECTION_TICKS_MAX < TICKS_PER_SAMPLE);
const _: () = assert!(TICK_HZ.is_multiple_of(1_000_000), "the deadline must be exact");
const _: () = assert!(TICKS_TO_DEADLINE < TICKS_PER_SAMPLE);
/// Counts of [`free_run`] in a period of the sample.
pub(crate) const PERIOD_COUNTS: u32 = TIMER_HZ / SAMPLE_HZ;
/// Nanoseconds per tick as a fraction whose product with the largest count fits 32 bits.
const NS_NUMERATOR: u32 = 1_000;
const NS_DENOMINATOR: u32 = TICK_HZ / 1_000_000;
const _: () = assert!(TICKS_PER_SAMPLE as u64 * NS_NUMERATOR as u64 <= u32::MAX as u64);

/// Position of the sample's flag in the status register.
const UPDATE: SrAdv = SrAdv(1);
/// Position of the deadline's flag (compare channel 1).
const COMPARE_1: SrAdv = SrAdv(1 << 1);

/// Configures and starts both timers: the first release is a sample's, 700 us later.
pub(crate) fn start() {
    RCC.apb1lenr().modify(|enable| enable.set_tim2en(true));
    RCC.apb2enr().modify(|enable| enable.set_tim1en(true));
    // The clock enable takes effect two bus cycles later; a read back spends them.
    let _ = RCC.apb2enr().read();
    TIM2.arr().write_value(u32::MAX);
    TIM2.cr1().write(|control| control.set_cen(true));
    TIM1.psc().write_value((PRESCALER - 1) as u16);
    TIM1.arr().write(|reload| reload.set_arr((TICKS_PER_SAMPLE - 1) as u16));
    // Compare mode stays "frozen" and the channel is not an output: a match sets the flag and nothing else.
    TIM1.ccr(0).write(|compare| compare.set_ccr(TICKS_TO_DEADLINE as u16));
    TIM1.cr1().write(|control| control.set_urs(Urs::COUNTER_ONLY));
    // Loads the prescaler and clears the counter; with URS set it raises no update flag.
    TIM1.egr().write(|event| event.set_ug(true));
    // Behind the compare value, so that the first release is a sample.
    TIM1.cnt().write(|count| count.set_cnt((TICKS_TO_DEADLINE + 1) as u16));
    TIM1.sr().write_value(SrAdv(0));
    TIM1.dier().write(|enable| {
        enable.set_uie(true);
        enable.set_ccie(0, true);
    });
    TIM1.cr1().modify(|control| control.set_cen(true));
}

/// Adjusts the running period by the correction of the bus clock; call it first in the task that the sample releases,
/// while the counter is still low.
pub(crate) fn steer(correction: &mut CountCorrection, correction_ns: i32) {
    let ticks = TICKS_PER_SAMPLE.saturating_add_signed(correction.take(correction_ns));
    // Without preload the new end counts at once.
    TIM1.arr().write(|reload| reload.set_arr((ticks - 1) as u16));
}

/// The correction of the sample's timer that is still to be applied.
pub(crate) const fn correction() -> CountCorrection {
    CountCorrection::new(TICKS_PER_US)
}

/// Time since the latest release of the sample, ns, 0 to 1,000,983. Safe in a critical task: one register read.
pub(crate) fn elapsed_ns() -> u32 {
    u32::from(TIM1.cnt().read().cnt()) * NS_NUMERATOR / NS_DENOMINATOR
}

/// Counts of a clock of `TIMER_HZ` that never stops, wrapping after 17 s. Durations are measured with it, because the
/// core's own cycle counter stops while the core sleeps. Safe in a critical task.
pub(crate) fn free_run() -> u32 {
    TIM2.cnt().read()
}

/// Counts of [`free_run`] since the latest release of the sample. Safe in a critical task.
pub(crate) fn elapsed_counts() -> u32 {
    u32::from(TIM1.cnt().read().cnt()) * PRESCALER
}

/// Ends the request of the sample's interrupt.
pub(crate) fn acknowledge_sample() {
    acknowledge(UPDATE);
}

/// Ends the request of the deadline's interrupt.
pub(crate) fn acknowledge_bus_deadline() {
    acknowledge(COMPARE_1);
}

/// Flags are cleared by writing zero; writing one leaves the others as they are.
fn acknowledge(flag: SrAdv) {
    TIM1.sr().write_value(SrAdv(!flag.0));
    // The read makes the write arrive before the task can return, else the same request would enter twice.
    let _ = TIM1.sr().read();
}
