//! A master without drivers on a virtual chain, in virtual time, and what happens to single frames.

use crate::again::clocks_are_on;
use core::cell::Cell;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Waker};
use etherpen::ethercat::BusQueues;
use etherpen::ethercat::configure::Direction;
use etherpen::ethercat::cyclic::Exchange;
use etherpen::ethercat::driver::SlaveFactory;
use etherpen::ethercat::event::{BusCommand, BusSetup};
use etherpen::ethercat::no_drivers::NoDrivers;
use etherpen::ethercat::supervisor::{BusEvent, Supervisor};
use etherpen_segment::{Flywheel, Segment, SegmentOptions};
use heapless::spsc::{Consumer, Producer};

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
/// Longest bring-up, ms: waits of the master take cycles.
const BRING_UP_MS_MAX: u64 = 60_000;

/// What happens to a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fate {
    /// The slaves do not see it.
    RequestLost,
    /// The slaves process it, and the master does not see the reply.
    ReplyLost,
    /// The reply comes in the next cycle, before its own.
    Late,
}

/// A frame of the next cycle: its number among those of its direction, and whether it is one after control.
pub(crate) type Which = (usize, bool);

/// A master, without drivers unless a test brings its own, a chain and a clock.
pub(crate) struct Bench<const SLAVES: usize, const FURTHER: usize, F: SlaveFactory = NoDrivers> {
    pub(crate) segment: Segment<Flywheel>,
    pub(crate) exchange: Exchange<'static, F, SLAVES, 1024, FURTHER>,
    supervisor: Pin<Box<dyn Future<Output = ()>>>,
    pub(crate) commands: Producer<'static, BusCommand<F>>,
    events: Consumer<'static, BusEvent>,
    pub(crate) log: Vec<BusEvent>,
    /// What happens to frames of the next cycle.
    pub(crate) fates: Vec<(Which, Fate)>,
    late: Vec<Vec<u8>>,
    /// The telegrams of the last cycle: those of its start, and those after control.
    pub(crate) sent: [Vec<Vec<u8>>; 2],
    cycle_us: u64,
    pub(crate) now_us: u64,
    polled_ms: u64,
    pace: Pace,
}

/// When the supervisor is polled, and what its time is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pace {
    /// Once a millisecond: the polls are its time.
    Milliseconds,
    /// It has a clock, and so many polls follow so many cycles.
    Cycles { polls: u32, cycles: u64 },
}

thread_local! {
    /// The time of the bench in this thread, ms.
    static NOW_MS: Cell<u32> = const { Cell::new(0) };
}

impl<const SLAVES: usize, const FURTHER: usize, F: SlaveFactory + 'static> Bench<SLAVES, FURTHER, F> {
    /// Starts a master for this setup; its cycle is the setup's.
    pub(crate) fn start(options: &SegmentOptions, setup: BusSetup<F>) -> Self {
        Self::at_pace(options, setup, Pace::Milliseconds)
    }

    /// Starts a master whose supervisor is polled in another way.
    pub(crate) fn at_pace(options: &SegmentOptions, mut setup: BusSetup<F>, pace: Pace) -> Self {
        NOW_MS.set(0);
        setup.clocks |= clocks_are_on();
        let queues = Box::leak(Box::new(BusQueues::<F, SLAVES, 1024, FURTHER>::new()));
        let (exchange_end, supervisor_end, mut application) = queues.split();
        let cycle_us = u64::from(setup.cycle_ns) / 1_000;
        assert!(application.commands.enqueue(BusCommand::Start(setup)).is_ok());
        Self {
            segment: Segment::new(options, Flywheel::default()),
            exchange: Exchange::new(exchange_end, MAC),
            supervisor: Box::pin(async move {
                let supervisor = Supervisor::new(supervisor_end);
                let mut supervisor = match pace {
                    Pace::Milliseconds => supervisor,
                    Pace::Cycles { .. } => supervisor.with_clock(|| NOW_MS.get()),
                };
                supervisor.run().await
            }),
            commands: application.commands,
            events: application.events,
            log: Vec::new(),
            fates: Vec::new(),
            late: Vec::new(),
            sent: [Vec::new(), Vec::new()],
            cycle_us,
            now_us: 0,
            polled_ms: 0,
            pace,
        }
    }

    /// Exchanges the telegrams of one direction.
    fn exchange(&mut self, after_control: bool, at_us: u64) {
        let mut telegrams = Vec::new();
        let mut telegram = match after_control {
            false => self.exchange.input_telegram().to_vec(),
            true => self.exchange.output_telegram().to_vec(),
        };
        while !telegram.is_empty() {
            telegrams.push(telegram);
            telegram = match after_control {
                false => self.exchange.next_input_telegram().to_vec(),
                true => self.exchange.next_output_telegram().to_vec(),
            };
        }
        if !after_control {
            for reply in core::mem::take(&mut self.late) {
                self.exchange.receive(&reply);
            }
        }
        for (number, telegram) in telegrams.iter().enumerate() {
            let fate = self.fates.iter().find(|(which, _)| *which == (number, after_control));
            let fate = fate.map(|(_, fate)| *fate);
            if fate == Some(Fate::RequestLost) {
                continue;
            }
            for reply in self.segment.frame(at_us, telegram) {
                match fate {
                    None => drop(self.exchange.receive(&reply)),
                    Some(Fate::Late) => self.late.push(reply),
                    Some(_) => {}
                }
            }
        }
        self.sent[usize::from(after_control)] = telegrams;
    }

    pub(crate) fn cycle(&mut self) {
        self.exchange(false, self.now_us);
        self.exchange(true, self.now_us + self.cycle_us / 4);
        self.fates.clear();
        self.now_us += self.cycle_us;
        let now_ms = self.now_us.div_ceil(1_000);
        NOW_MS.set(now_ms as u32);
        let polls = match self.pace {
            Pace::Milliseconds => now_ms - self.polled_ms,
            Pace::Cycles { polls, cycles } if (self.now_us / self.cycle_us).is_multiple_of(cycles) => polls.into(),
            Pace::Cycles { .. } => 0,
        };
        self.polled_ms = now_ms;
        for _ in 0..polls {
            let poll = self.supervisor.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            assert!(poll.is_pending());
            while let Some(event) = self.events.dequeue() {
                self.log.push(event);
            }
        }
    }

    pub(crate) fn run(&mut self, cycles: u32) {
        for _ in 0..cycles {
            self.cycle();
        }
    }

    pub(crate) fn run_ms(&mut self, ms: u64) {
        let end_us = self.now_us + ms * 1_000;
        while self.now_us < end_us {
            self.cycle();
        }
    }

    /// Runs until the bus has come up; returns the time it took, ms.
    pub(crate) fn operational(&mut self) -> u64 {
        let (from, began_us) = (self.log.len(), self.now_us);
        while !self.log[from..].contains(&BusEvent::Operational) {
            assert!(self.now_us - began_us < BRING_UP_MS_MAX * 1_000, "{:#?}", self.log);
            self.cycle();
        }
        let took_ms = (self.now_us - began_us) / 1_000;
        self.run_ms(20);
        took_ms
    }

    pub(crate) fn bits(&self, slave: usize, direction: Direction, bits: u8) -> Option<u64> {
        self.exchange
            .get(&self.exchange.bits::<u64>(slave, direction, 0, bits)?)
    }

    pub(crate) fn set_bits(&mut self, slave: usize, bits: u8, value: u64) -> bool {
        let place = self.exchange.bits::<u64>(slave, Direction::Outputs, 0, bits);
        place.is_some_and(|place| self.exchange.set(&place, value))
    }
}
