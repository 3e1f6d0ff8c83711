//! The master of this project.

use crate::segment::answer;
use crate::{Case, DRIVES, Exchange, Master, Meter, read_drive, write_drive};
use core::future::Future;
use core::hint::black_box;
use core::pin::pin;
use core::task::{Context, Waker};
use etherpen::robot_bus::MASTER_ADDRESS;
use etherpen::ethercat::cyclic::{Arrival, CyclicPlan, CyclicSlave, ExchangeKind, ReferenceClock};
use etherpen::ethercat::event::{BusCommand, BusSetup};
use etherpen::ethercat::wire::FRAME_LEN_MAX;
use etherpen::robot_bus::{RobotBusQueues, RobotExchange, RobotSupervisor};

/// Station address of the first drive, whose clock the others follow.
const STATION: u16 = 0x1001;

/// The master with its drives in OP: the critical side with the plan that the supervisor would have sent.
pub struct EtherpenMaster<'q> {
    exchange: RobotExchange<'q>,
    frame: [u8; FRAME_LEN_MAX],
    case: Case,
    cycles: i32,
}

impl<'q> EtherpenMaster<'q> {
    /// A master over `queues`.
    ///
    /// # Panics
    /// The plan found no place.
    pub fn new(queues: &'q mut RobotBusQueues, case: Case) -> Self {
        let (exchange_end, mut supervisor_end, _) = queues.split();
        let mut plan = CyclicPlan::default();
        if case.exchange != Exchange::Split {
            plan.exchange = ExchangeKind::Combined;
        }
        if case.exchange == Exchange::CombinedWithClock {
            plan.clock = Some(ReferenceClock {
                station: STATION,
                slaves: DRIVES as u16,
                wide: true,
                is_spread: true,
                time_number: 0,
            });
        }
        let (inputs, outputs) = (u32::from(case.data.inputs), u32::from(case.data.outputs));
        for number in 0..DRIVES as u32 {
            let drive = CyclicSlave {
                input_address: number * (inputs + outputs),
                input_length: case.data.inputs,
                output_address: number * (inputs + outputs) + inputs,
                output_length: case.data.outputs,
                watched: true,
                ..CyclicSlave::default()
            };
            assert!(plan.slaves.push(drive).is_ok(), "too many drives");
        }
        assert!(supervisor_end.plans.enqueue(plan).is_ok(), "no room for the plan");
        Self {
            exchange: RobotExchange::new(exchange_end, MASTER_ADDRESS),
            frame: [0; FRAME_LEN_MAX],
            case,
            cycles: 0,
        }
    }

    fn receive(&mut self, length: usize) -> Arrival {
        self.exchange
            .receive(black_box(self.frame.get(..length).unwrap_or(&[])))
    }

    fn read(&self) -> bool {
        (0..DRIVES).fold(true, |complete, drive| {
            let input = self.exchange.input(drive).and_then(read_drive);
            black_box(input).is_some() & complete
        })
    }

    fn write(&mut self) {
        self.cycles = self.cycles.wrapping_add(1);
        for drive in 0..DRIVES {
            write_drive(self.exchange.output(drive), self.cycles, 0x0F);
        }
    }

    fn combined<M: Meter>(&mut self) {
        M::count(|| self.write());
        let sent = M::count(|| black_box(self.exchange.input_telegram()));
        let length = reply(&mut self.frame, sent, self.case);
        let (arrival, complete) = M::count(|| (self.receive(length), self.read()));
        assert!(arrival == Arrival::Input && complete, "no inputs");
    }

    fn split<M: Meter>(&mut self) {
        let sent = M::count(|| black_box(self.exchange.input_telegram()));
        let length = reply(&mut self.frame, sent, self.case);
        let (arrival, complete) = M::count(|| {
            let arrival = self.receive(length);
            let complete = self.read();
            self.write();
            (arrival, complete)
        });
        assert!(arrival == Arrival::Input && complete, "no inputs");
        let sent = M::count(|| black_box(self.exchange.output_telegram()));
        let length = reply(&mut self.frame, sent, self.case);
        let arrival = M::count(|| self.receive(length));
        assert!(arrival == Arrival::Output, "no outputs");
    }
}

impl Master for EtherpenMaster<'_> {
    fn cycle<M: Meter>(&mut self) {
        match self.case.exchange {
            Exchange::Split => self.split::<M>(),
            Exchange::Combined | Exchange::CombinedWithClock => self.combined::<M>(),
        }
        assert!(
            self.exchange.counters().working_counter_errors == 0,
            "wrong working counters"
        );
        assert!(
            self.exchange.al_status().is_some_and(|al| al.status == 8),
            "no AL status"
        );
        let clock = self.exchange.clock_ns().is_some();
        assert!(
            clock == (self.case.exchange == Exchange::CombinedWithClock),
            "the clock's time"
        );
    }
}

/// A whole application: bring-up, exchange and supervision, a millisecond at a time, for ever.
///
/// # Panics
/// The order to start found no place.
pub fn serve(queues: &mut RobotBusQueues, mut wire: impl FnMut(&mut [u8])) -> ! {
    let (exchange_end, supervisor_end, mut application) = queues.split();
    let mut exchange = RobotExchange::new(exchange_end, MASTER_ADDRESS);
    let mut supervisor = RobotSupervisor::new(supervisor_end);
    let mut supervision = pin!(supervisor.run());
    let mut context = Context::from_waker(Waker::noop());
    let mut frame = [0; FRAME_LEN_MAX];
    let start = BusCommand::Start(black_box(BusSetup {
        members: DRIVES as u8,
        ..BusSetup::default()
    }));
    assert!(application.commands.enqueue(start).is_ok(), "no room for the order");
    loop {
        let telegram = copied(&mut frame, exchange.input_telegram());
        wire(telegram);
        exchange.receive(telegram);
        for drive in 0..DRIVES {
            let (position, status) = exchange.input(drive).and_then(read_drive).unwrap_or_default();
            write_drive(exchange.output(drive), position, status);
        }
        let telegram = copied(&mut frame, exchange.output_telegram());
        wire(telegram);
        exchange.receive(telegram);
        black_box(supervision.as_mut().poll(&mut context).is_pending());
        black_box(application.events.dequeue());
    }
}

/// What the segment makes of a telegram; gives its length.
fn reply(frame: &mut [u8], sent: &[u8], case: Case) -> usize {
    answer(copied(frame, sent), case.data);
    sent.len()
}

fn copied<'f>(frame: &'f mut [u8], sent: &[u8]) -> &'f mut [u8] {
    let frame = frame.get_mut(..sent.len()).unwrap_or(&mut []);
    frame.copy_from_slice(sent);
    frame
}

/// Static memory of a master for 16 slaves: queues, critical side, supervisor and its future, bytes.
pub fn ram_bytes() -> usize {
    let mut queues = RobotBusQueues::new();
    let (_, end, _) = queues.split();
    let mut supervisor = RobotSupervisor::new(end);
    let future = supervisor.run();
    let parts = size_of::<RobotBusQueues>() + size_of::<RobotExchange<'_>>() + size_of::<RobotSupervisor<'_>>();
    parts + size_of_val(&future)
}
