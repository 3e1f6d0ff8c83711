//! The master of this project.

use crate::segment::answer;
use crate::{Case, Exchange, Master, Meter, read_drive, write_drive};
use core::future::Future;
use core::hint::black_box;
use core::pin::pin;
use core::task::{Context, Waker};
use etherpen::ethercat::cyclic::{
    Arrival, CyclicPlan, CyclicSlave, ExchangeKind, InputPlace, OutputPlace, ReferenceClock,
};
use etherpen::ethercat::event::{BusCommand, BusSetup};
use etherpen::ethercat::wire::FRAME_LEN_MAX;
use etherpen::robot_bus::MASTER_ADDRESS;
use etherpen::robot_bus::{RobotBusQueues, RobotExchange, RobotSupervisor};

/// Station address of the first drive, whose clock the others follow.
const STATION: u16 = 0x1001;

/// The master with its drives in OP: the critical side with the plan that the supervisor would have sent.
pub struct EtherpenMaster<'q, const DRIVES: usize> {
    drives: Drives<'q, DRIVES>,
    frame: [u8; FRAME_LEN_MAX],
    case: Case,
}

/// The exchange, and where it has the values of the drives.
struct Drives<'q, const DRIVES: usize> {
    exchange: RobotExchange<'q>,
    places: [(InputPlace, OutputPlace); DRIVES],
    /// Number of the plan for which the places are valid.
    plan: Option<u32>,
    cycles: i32,
}

impl<const DRIVES: usize> Drives<'_, DRIVES> {
    /// Takes the places of a new plan, as the robot's group of drives does in each cycle.
    fn renew(&mut self) {
        let plan = Some(self.exchange.plan_number());
        if self.plan != plan {
            self.plan = plan;
            let place = |drive| (self.exchange.input_place(drive), self.exchange.output_place(drive));
            self.places = core::array::from_fn(place);
        }
    }

    fn read(&mut self) -> bool {
        self.renew();
        let exchange = &self.exchange;
        self.places.iter().fold(true, |complete, (place, _)| {
            let input = exchange.image_at(*place).and_then(|image| read_drive(image));
            input.map(black_box).is_some() & complete
        })
    }

    fn write(&mut self) {
        self.cycles = self.cycles.wrapping_add(1);
        let velocity = self.cycles;
        for (_, place) in &self.places {
            write_drive(self.exchange.output_at(*place), velocity, 0x0F);
        }
    }
}

impl<'q, const DRIVES: usize> EtherpenMaster<'q, DRIVES> {
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
                period: ReferenceClock::period_of_ns(1_000_000),
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
            drives: Drives {
                exchange: RobotExchange::new(exchange_end, MASTER_ADDRESS),
                places: [(InputPlace::default(), OutputPlace::default()); DRIVES],
                plan: None,
                cycles: 0,
            },
            frame: [0; FRAME_LEN_MAX],
            case,
        }
    }

    /// Receives the reply of this length and then does more with the drives, counted.
    fn receive<M: Meter, R>(&mut self, length: usize, then: impl FnOnce(&mut Drives<'q, DRIVES>) -> R) -> (Arrival, R) {
        let reply = self.frame.get(..length).unwrap_or(&[]);
        M::count(|| (self.drives.exchange.receive(black_box(reply)), then(&mut self.drives)))
    }

    fn combined<M: Meter>(&mut self) {
        M::count(|| self.drives.write());
        let sent = M::count(|| black_box(self.drives.exchange.input_telegram()));
        let length = reply(&mut self.frame, sent, self.case);
        let (arrival, complete) = self.receive::<M, _>(length, Drives::read);
        assert!(arrival == Arrival::Input && complete, "no inputs");
    }

    fn split<M: Meter>(&mut self) {
        let sent = M::count(|| black_box(self.drives.exchange.input_telegram()));
        let length = reply(&mut self.frame, sent, self.case);
        let (arrival, complete) = self.receive::<M, _>(length, |drives| {
            let complete = drives.read();
            drives.write();
            complete
        });
        assert!(arrival == Arrival::Input && complete, "no inputs");
        let sent = M::count(|| black_box(self.drives.exchange.output_telegram()));
        let length = reply(&mut self.frame, sent, self.case);
        let (arrival, ()) = self.receive::<M, _>(length, |_| ());
        assert!(arrival == Arrival::Output, "no outputs");
    }
}

impl<const DRIVES: usize> Master for EtherpenMaster<'_, DRIVES> {
    fn cycle<M: Meter>(&mut self) {
        match self.case.exchange {
            Exchange::Split => self.split::<M>(),
            Exchange::Combined | Exchange::CombinedWithClock => self.combined::<M>(),
        }
        let exchange = &self.drives.exchange;
        assert!(
            exchange.counters().working_counter_errors == 0,
            "wrong working counters"
        );
        assert!(exchange.al_status().is_some_and(|al| al.status == 8), "no AL status");
        let clock = exchange.clock_ns().is_some();
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
        members: crate::DRIVES as u8,
        ..BusSetup::default()
    }));
    assert!(application.commands.enqueue(start).is_ok(), "no room for the order");
    loop {
        let telegram = copied(&mut frame, exchange.input_telegram());
        wire(telegram);
        exchange.receive(telegram);
        for drive in 0..crate::DRIVES {
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
    answer(copied(frame, sent), case);
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
