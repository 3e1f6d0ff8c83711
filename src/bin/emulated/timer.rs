//! The millisecond: three alarms and the clock that they follow.
//!
//! All times are readings of the Ethernet controller's free-running counter. An alarm is set to a time, not to a
//! period: a late task cannot shift the next release, and the alarms can be removed and restored (`pause`, `resume`)
//! without losing a count. Virtual time can therefore stop while a reply is on its way (see `wire`).

use super::device::{CLOCK_HZ, Interrupt, RELEASES_PER_MS};
use super::disturb;
pub(crate) use super::lan9118::free_run;
use super::watchdog::Watchdog;
use etherpen::ethercat::clock::steering::CountCorrection;
use etherpen::ethernet::lan9118::FREE_RUN_HZ;

/// Counts in one period of the sample task.
pub(crate) const PERIOD_COUNTS: u32 = CLOCK_HZ / 1000 / RELEASES_PER_MS;
/// Counts from a sample's release to the deadline of its input frame: 300 us, or half the period of the fastest loop.
const DEADLINE_COUNTS: u32 = match RELEASES_PER_MS {
    8 => PERIOD_COUNTS / 2,
    _ => PERIOD_COUNTS * 3 / 10,
};
/// Counts from a frame's sending to its reply's arrival in lockstep, 30 us.
const DELIVERY_COUNTS: u32 = CLOCK_HZ / 1000 * 3 / 100;
/// Periods before the first release: the end of `init` still moves the tasks' data with all interrupts masked.
const START_PERIODS: u32 = 50 * RELEASES_PER_MS;
const NS_PER_COUNT: u32 = 1_000_000_000 / CLOCK_HZ;
const COUNTS_PER_US: u64 = CLOCK_HZ as u64 / 1_000_000;

const _: () = assert!(FREE_RUN_HZ == CLOCK_HZ);
const _: () = assert!(CLOCK_HZ.is_multiple_of(1_000_000) && 1_000_000_000 % CLOCK_HZ == 0);
const _: () = assert!(DEADLINE_COUNTS < PERIOD_COUNTS);
// Input and output reply arrive before the deadline.
const _: () = assert!(2 * DELIVERY_COUNTS < DEADLINE_COUNTS);

/// Addresses of a timer's registers, and the value of its control register that starts it with its interrupt.
///
/// "Cortex-M System Design Kit Technical Reference Manual": APB timer, APB dual-input timers.
struct Layout {
    base: usize,
    control: usize,
    value: usize,
    clear: usize,
    running: u32,
    /// A register to clear once, else the timer repeats.
    reload: Option<usize>,
}

const APB_TIMER_0: Layout = apb_timer(0x4000_0000);
const APB_TIMER_1: Layout = apb_timer(0x4000_1000);
const DUAL_TIMER: Layout = Layout {
    base: 0x4000_2000,
    control: 0x8,
    value: 0x0,
    clear: 0xc,
    // enabled, interrupting, 32 bits, one shot
    running: 1 << 7 | 1 << 5 | 1 << 1 | 1 << 0,
    reload: None,
};

const fn apb_timer(base: usize) -> Layout {
    Layout {
        base,
        control: 0x0,
        value: 0x4,
        clear: 0xc,
        // enabled, interrupting
        running: 1 << 3 | 1 << 0,
        reload: Some(0x8),
    }
}

/// A timer that interrupts at a given time.
pub(crate) struct Alarm {
    layout: &'static Layout,
    interrupt: Interrupt,
    due: Option<u32>,
}

impl Alarm {
    fn new(layout: &'static Layout, interrupt: Interrupt) -> Self {
        let alarm = Self {
            layout,
            interrupt,
            due: None,
        };
        alarm.write(layout.control, 0);
        if let Some(reload) = layout.reload {
            alarm.write(reload, 0);
        }
        alarm
    }

    fn write(&self, register: usize, value: u32) {
        // SAFETY: the layouts above name registers of timers, which reach no memory; each timer has one `Alarm`, made
        // by `Clock::start`, and alarms are used by tasks of one priority.
        unsafe { core::ptr::write_volatile((self.layout.base + register) as *mut u32, value) };
    }

    /// Interrupts at `due`, or at once if that time has passed.
    fn set(&mut self, due: u32) {
        self.pause();
        self.due = Some(due);
        self.resume();
    }

    /// Clears the interrupt; returns true if the alarm was due, false if the interrupt belongs to a cancelled time.
    pub(crate) fn acknowledge(&mut self) -> bool {
        self.write(self.layout.clear, 1);
        let due = self.due.is_some_and(|due| !is_before(free_run(), due));
        if due {
            self.due = None;
        }
        due
    }

    /// Stops the timer and keeps `due`.
    fn pause(&self) {
        self.write(self.layout.control, 0);
    }

    /// Restarts the timer for the time left until `due`.
    fn resume(&self) {
        let Some(due) = self.due else {
            return;
        };
        let now = free_run();
        if is_before(now, due) {
            self.write(self.layout.value, due.wrapping_sub(now));
            self.write(self.layout.control, self.layout.running);
        } else {
            rtic::pend(self.interrupt);
        }
    }
}

/// Whether `moment` comes before `other`; the two are less than half the counter's range (85 s) apart.
fn is_before(moment: u32, other: u32) -> bool {
    moment.wrapping_sub(other) > u32::MAX / 2
}

/// Time since the first release, and within the present millisecond.
pub(crate) struct Clock {
    /// Releases `sample`.
    pub(crate) sample: Alarm,
    /// Releases `bus_deadline`.
    pub(crate) deadline: Alarm,
    /// Releases `bus_frame` in lockstep.
    pub(crate) delivery: Alarm,
    /// Ends a firmware that hangs.
    pub(crate) watchdog: Watchdog,
    /// Nominal release of the present millisecond.
    released_at: u32,
    /// Counts from that release to the next one.
    period: u32,
    /// Time of the next delivery, if it differs from the default delay.
    next_delivery: Option<u32>,
    /// Counts from the first nominal release to that of the present millisecond.
    counts: u64,
    /// Correction requested by the bus clock.
    correction: CountCorrection,
    /// Nominal releases so far, the first included.
    releases: u32,
    /// Nominal releases at which `sample` did not run.
    missed: u32,
}

impl Clock {
    /// Takes the timers and lets the first millisecond begin [`START_PERIODS`] and one from now. Starts the watchdog if
    /// `watched`.
    ///
    /// # Safety
    /// Call it once: the clock owns the timers.
    pub(crate) unsafe fn start(watched: bool) -> Self {
        let mut clock = Self {
            sample: Alarm::new(&APB_TIMER_0, Interrupt::TIMER0),
            deadline: Alarm::new(&APB_TIMER_1, Interrupt::TIMER1),
            delivery: Alarm::new(&DUAL_TIMER, Interrupt::DUAL_TIMER),
            // SAFETY: called once, as the caller promises.
            watchdog: unsafe { Watchdog::take() },
            released_at: free_run(),
            period: PERIOD_COUNTS,
            next_delivery: None,
            counts: 0,
            correction: CountCorrection::new(COUNTS_PER_US as u32),
            releases: 0,
            missed: 0,
        };
        clock.released_at = clock.released_at.wrapping_add(START_PERIODS * PERIOD_COUNTS);
        clock.sample.set(clock.released_at.wrapping_add(PERIOD_COUNTS));
        if watched {
            clock.watchdog.feed(clock.released_at);
            clock.watchdog.resume();
        }
        clock
    }

    /// Begins the next millisecond, lengthened by `correction_ns`; call it first in the task that `sample` releases.
    pub(crate) fn release(&mut self, correction_ns: i32) {
        self.sample.acknowledge();
        self.advance();
        self.period = PERIOD_COUNTS.saturating_add_signed(self.correction.take(correction_ns));
        while !is_before(free_run(), self.released_at.wrapping_add(self.period)) {
            self.advance();
            self.missed = self.missed.wrapping_add(1);
            self.period = PERIOD_COUNTS;
        }
        self.sample.set(self.released_at.wrapping_add(self.period));
        self.deadline.set(self.released_at.wrapping_add(DEADLINE_COUNTS));
    }

    fn advance(&mut self) {
        self.released_at = self.released_at.wrapping_add(self.period);
        if self.releases > 0 {
            self.counts += u64::from(self.period);
        }
        self.releases = self.releases.wrapping_add(1);
    }

    /// Removes the alarms, so that virtual time stops while the core sleeps.
    pub(crate) fn pause(&mut self) {
        self.sample.pause();
        self.deadline.pause();
        self.delivery.pause();
        self.watchdog.pause();
        disturb::pause();
    }

    /// Restores the alarms and sets the one for the reply, which has just arrived, to a frame sent at `sent_at`.
    pub(crate) fn resume_and_deliver(&mut self, sent_at: u32) {
        self.sample.resume();
        self.deadline.resume();
        let usual = sent_at.wrapping_add(DELIVERY_COUNTS);
        self.delivery.set(self.next_delivery.take().unwrap_or(usual));
        self.watchdog.resume();
        disturb::resume();
    }

    /// Makes the next frame's replies arrive `after` counts after the time that is `before` counts ahead of the next
    /// release.
    pub(crate) fn deliver_around_release(&mut self, before: u32, after: u32) {
        let release = self.released_at.wrapping_add(self.period);
        self.next_delivery = Some(release.wrapping_sub(before).wrapping_add(after));
    }

    /// Counts from the nominal release of this millisecond to a reading of the free-running counter.
    pub(crate) fn counts_to(&self, moment: u32) -> u32 {
        if is_before(moment, self.released_at) {
            return 0;
        }
        moment.wrapping_sub(self.released_at)
    }

    fn elapsed_counts(&self) -> u32 {
        self.counts_to(free_run())
    }

    /// Nanoseconds since the nominal release of this millisecond.
    pub(crate) fn elapsed_ns(&self) -> u32 {
        self.elapsed_counts().saturating_mul(NS_PER_COUNT)
    }

    /// Microseconds since the first nominal release.
    pub(crate) fn time_us(&self) -> u64 {
        (self.counts + u64::from(self.elapsed_counts())) / COUNTS_PER_US
    }

    /// By how many microseconds this release is earlier than without corrections by the bus clock.
    pub(crate) fn early_us(&self) -> i32 {
        let uncorrected = u64::from(self.releases.saturating_sub(1)) * u64::from(PERIOD_COUNTS);
        let early = uncorrected.wrapping_sub(self.counts) as i64;
        (early / COUNTS_PER_US as i64) as i32
    }

    /// Number of this millisecond, counted from 0.
    pub(crate) fn milliseconds(&self) -> u32 {
        self.releases.saturating_sub(1) / RELEASES_PER_MS
    }

    /// Whether this release begins a millisecond.
    pub(crate) fn begins_millisecond(&self) -> bool {
        self.releases.saturating_sub(1).is_multiple_of(RELEASES_PER_MS)
    }

    /// Nominal releases at which `sample` did not run.
    pub(crate) fn missed(&self) -> u32 {
        self.missed
    }
}
