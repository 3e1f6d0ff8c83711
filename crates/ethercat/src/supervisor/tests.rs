//! The supervisor on a chain of slaves that have addresses and states, and nothing else.

extern crate std;

use super::super::acyclic::{Outcome, Reply, Request};
use super::super::clock::{BusClocks, SlaveClock, Width};
use super::super::configure::Windows;
use super::super::configure::discovery::{STATION_BASE, STATION_TEMPORARY};
use super::super::cyclic::{CyclicSlave, ExchangeEnd};
use super::super::driver::ProcessData;
use super::super::no_drivers::NoDrivers;
use super::super::process_data::cyclic_slave;
use super::super::slave::{Slave, SlaveData};
use super::super::state::{AlReport, AlState};
use super::super::wire::register::{DlStatus, ErrorCounters, PortErrors, PortStatus};
use super::super::wire::{Address, Command, register};
use super::super::{ApplicationEnd, BusQueues};
use super::*;
use core::future::Future;
use core::task::{Context, Poll, Waker};
use std::boxed::Box;
use std::vec::Vec;

const SLAVES: usize = 4;
const MESSAGE: usize = 64;

type TestBus = Bus<'static, NoDrivers, SLAVES, MESSAGE>;

/// A slave in the chain.
#[derive(Clone, Copy)]
struct Device {
    station: u16,
    al_status: u8,
    errors: ErrorCounters,
}

impl Device {
    fn at(station: u16) -> Self {
        Self {
            station,
            al_status: AlState::Init as u8,
            errors: ErrorCounters::default(),
        }
    }

    /// Executes a command; returns whether there is such a register.
    fn access(&mut self, command: Command, register: u16, data: &mut [u8]) -> bool {
        match (register, command.writes()) {
            (register::STATION_ADDRESS, true) => self.station = u16::from_le_bytes([data[0], data[1]]),
            (register::STATION_ADDRESS, false) => data[..2].copy_from_slice(&self.station.to_le_bytes()),
            (register::AL_CONTROL, true) => self.al_status = data[0] & register::AL_STATE_MASK as u8,
            (register::AL_STATUS, false) => data[0] |= self.al_status,
            (register::RECEIVE_ERRORS, false) => assert_eq!(self.errors.emit(data), Ok(())),
            _ => return false,
        }
        true
    }
}

/// What is around the supervisor: slaves, critical side and application.
struct Outside {
    chain: Vec<Device>,
    /// The chain as it is put together just before a slave is addressed by its place.
    rearranged: Option<Vec<Device>>,
    /// The slave that is switched off as soon as a slave is addressed by its place.
    switched_off: Option<usize>,
    /// The slave that is plugged in at the end of the chain at the same time.
    plugged_in: Option<Device>,
    exchange: ExchangeEnd<'static, NoDrivers, SLAVES, MESSAGE>,
    application: ApplicationEnd<'static, NoDrivers>,
    plans: Vec<CyclicPlan<NoDrivers, SLAVES>>,
    events: Vec<BusEvent>,
}

impl Outside {
    fn new(chain: &[Device]) -> (Self, SupervisorEnd<'static, NoDrivers, SLAVES, MESSAGE>) {
        let (exchange, supervisor, application) = Box::leak(Box::new(BusQueues::new())).split();
        let outside = Self {
            chain: chain.to_vec(),
            rearranged: None,
            switched_off: None,
            plugged_in: None,
            exchange,
            application,
            plans: Vec::new(),
            events: Vec::new(),
        };
        (outside, supervisor)
    }

    fn with_bus(chain: &[Device]) -> (Self, TestBus) {
        let (outside, end) = Self::new(chain);
        (outside, Bus::new(end.port, end.plans, end.frames, end.events))
    }

    fn stations(&self) -> Vec<u16> {
        self.chain.iter().map(|device| device.station).collect()
    }

    fn answer(&mut self, request: &Request) -> Reply {
        let (command, address, mut data) = (request.command, request.address, request.data.clone());
        let register = address.register();
        let mut working_counter = 0;
        if command == Command::Apwr
            && let Some(chain) = self.rearranged.take()
        {
            self.chain = chain;
        }
        for (place, device) in (0..).zip(&mut self.chain) {
            let is_addressed = match command {
                Command::Brd | Command::Bwr => true,
                Command::Aprd | Command::Apwr => address == Address::position(place, register),
                _ => address.device() == device.station,
            };
            working_counter += u16::from(is_addressed && device.access(command, register, &mut data));
        }
        if command == Command::Apwr
            && let Some(place) = self.switched_off.take()
        {
            self.chain.remove(place);
            self.chain.extend(self.plugged_in.take());
        }
        Reply {
            data,
            outcome: Outcome::Processed { working_counter },
        }
    }

    /// One millisecond.
    fn step(&mut self) {
        while let Some(request) = self.exchange.requests.dequeue() {
            let reply = self.answer(&request);
            assert!(self.exchange.replies.enqueue(reply).is_ok());
        }
        self.plans.extend(core::iter::from_fn(|| self.exchange.plans.dequeue()));
        self.events
            .extend(core::iter::from_fn(|| self.application.events.dequeue()));
    }

    /// Runs work to its end.
    fn run<T>(&mut self, work: impl Future<Output = T>) -> T {
        let mut work = pin!(work);
        for _ in 0..10_000 {
            let result = work.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            self.step();
            if let Poll::Ready(value) = result {
                return value;
            }
        }
        panic!("the work did not end");
    }

    /// Commands the supervisor and lets it run; returns its events.
    fn command<T>(
        &mut self,
        command: BusCommand<NoDrivers>,
        mut supervisor: core::pin::Pin<&mut impl Future<Output = T>>,
    ) -> Vec<BusEvent> {
        assert!(self.application.commands.enqueue(command).is_ok());
        for _ in 0..LINK_TIMEOUT_MS + 100 {
            let result = supervisor.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            assert!(result.is_pending());
            self.step();
        }
        core::mem::take(&mut self.events)
    }

    fn last_plan(&self) -> Vec<CyclicSlave<NoDrivers>> {
        self.plans.last().unwrap().slaves.to_vec()
    }
}

/// A slave in OP with process data.
fn operational(position: u16, member: Option<u8>) -> Slave<NoDrivers> {
    Slave {
        device: Some(()),
        member,
        data: SlaveData::OfDriver(ProcessData {
            windows: Windows::standard(0x1100, 0x1180),
            output_length: 6,
            input_length: 8,
            layout: (),
        }),
        condition: Condition::Operational,
        report: AlReport {
            status: AlState::Operational as u8,
            code: 0,
        },
        ..Slave::at(position)
    }
}

#[test]
fn a_stopped_bus_is_left_alone_until_the_next_start() {
    let (mut outside, end) = Outside::new(&[]);
    let mut supervisor = Supervisor::new(end);
    let mut supervisor = pin!(supervisor.run());
    let port = PortState::Down;
    let refused = [BusEvent::Refused {
        position: None,
        step: Step::Discover,
        error: BusError::NoLink { port },
    }];
    assert_eq!(outside.command(BusCommand::Port(port), supervisor.as_mut()), []);
    let start = BusCommand::Start(BusSetup::default());
    assert_eq!(outside.command(start, supervisor.as_mut()), refused);
    assert_eq!(outside.command(BusCommand::Recover, supervisor.as_mut()), refused);
    assert_eq!(
        outside.command(BusCommand::Stop, supervisor.as_mut()),
        [BusEvent::Stopped]
    );
    assert_eq!(outside.command(BusCommand::Recover, supervisor.as_mut()), []);
}

#[test]
fn a_slave_is_not_watched_while_it_is_worked_on() {
    let (mut outside, mut bus) = Outside::with_bus(&[]);
    for position in 0..2 {
        assert!(bus.slaves.push(operational(position, None)).is_ok());
    }
    outside.run(bus.send_plan());
    assert!(outside.last_plan().iter().all(|slave| slave.watched));
    outside.run(bus.work_on(Some(0)));
    let watched: Vec<bool> = outside.last_plan().iter().map(|slave| slave.watched).collect();
    assert_eq!(watched, [false, true]);
}

#[test]
fn a_slave_in_use_keeps_its_place_in_the_cycle_when_it_is_taken_down() {
    for member in [Some(0), None] {
        let (mut outside, mut bus) = Outside::with_bus(&[Device {
            al_status: AlState::Operational as u8,
            ..Device::at(STATION_BASE)
        }]);
        let slave = operational(0, member);
        assert!(bus.slaves.push(slave).is_ok());
        let report = outside.run(bus.set_state(0, AlState::PreOperational));
        assert_eq!(report.map(|report| report.state()), Ok(Some(AlState::PreOperational)));
        outside.run(bus.work_on(None));
        let share = match member {
            Some(_) => cyclic_slave(&slave),
            None => CyclicSlave::default(),
        };
        assert_eq!(outside.last_plan(), [share]);
    }
}

#[test]
fn a_new_bring_up_distributes_no_time_before_its_clocks_are_set_up() {
    let (mut outside, mut bus) = Outside::with_bus(&[Device::at(0)]);
    let clock = SlaveClock {
        width: Some(Width::Bits64),
        is_set: true,
        ..SlaveClock::default()
    };
    bus.clocks = BusClocks::default();
    assert!(bus.clocks.slaves.push(clock).is_ok());
    assert!(bus.slaves.push(Slave::at(0)).is_ok());
    outside.run(bus.send_plan());
    assert!(outside.plans.pop().unwrap().clock.is_some());
    assert!(outside.run(bus.find_all()).is_ok());
    assert_eq!(outside.stations(), [STATION_BASE]);
    assert_eq!(outside.last_plan().len(), 1);
    assert!(outside.plans.iter().all(|plan| plan.clock.is_none()));
}

#[test]
fn a_new_slave_does_not_get_the_address_of_one_that_is_switched_off_meanwhile() {
    let chain = [STATION_BASE, STATION_BASE + 1, 0].map(Device::at);
    let (mut outside, mut bus) = Outside::with_bus(&chain);
    bus.slaves = (0..3).map(Slave::at).collect();
    bus.ordered = 3;
    let places = outside.run(bus.places()).unwrap();
    outside.switched_off = Some(1);
    assert_eq!(
        outside.run(bus.mark(2, &places)),
        Err(BusError::SlaveCount { expected: 3, actual: 2 })
    );
    assert_eq!(outside.stations(), [STATION_BASE, 0]);
}

#[test]
fn a_mark_that_another_slave_has_got_is_taken_back_also_if_as_many_slaves_are_there_as_before() {
    let chain = [STATION_BASE, STATION_BASE + 1, 0].map(Device::at);
    let (mut outside, mut bus) = Outside::with_bus(&chain);
    bus.slaves = (0..3).map(Slave::at).collect();
    bus.ordered = 3;
    let places = outside.run(bus.places()).unwrap();
    (outside.switched_off, outside.plugged_in) = (Some(0), Some(Device::at(0)));
    let expected = BusError::Station {
        expected: STATION_TEMPORARY,
        actual: 0,
    };
    assert_eq!(outside.run(bus.mark(2, &places)), Err(expected));
    assert_eq!(outside.stations(), [STATION_BASE + 1, 0, 0]);
}

#[test]
fn a_mark_is_taken_back_where_another_slave_has_lost_its_address_meanwhile() {
    let chain = [STATION_BASE, STATION_BASE + 1, 0].map(Device::at);
    let (mut outside, mut bus) = Outside::with_bus(&chain);
    bus.slaves = (0..3).map(Slave::at).collect();
    bus.ordered = 3;
    let places = outside.run(bus.places()).unwrap();
    // The second and the third slave have changed places, and both were without power: the mark goes to the second one.
    outside.rearranged = Some([STATION_BASE, 0, 0].map(Device::at).to_vec());
    let expected = BusError::Station {
        expected: STATION_BASE + 1,
        actual: 0,
    };
    assert_eq!(outside.run(bus.mark(2, &places)), Err(expected));
    assert_eq!(outside.stations(), [STATION_BASE, 0, 0]);
}

#[test]
fn a_mark_set_while_a_slave_drops_out_gives_no_slave_the_address_of_another() {
    let address = |number: u16| STATION_BASE + number;
    // The second slave is back without its address, and one behind it drops out: nothing before the mark has changed.
    // The first slave drops out: the mark goes to the third one, which gets its address back.
    for (there, expected) in [
        ([address(0), 0, address(2)], [address(0), 0, address(2)]),
        ([0, address(2), address(3)], [0, address(2), address(3)]),
    ] {
        let chain = [address(0), 0, address(2), address(3)].map(Device::at);
        let (mut outside, mut bus) = Outside::with_bus(&chain);
        bus.slaves = (0..4).map(Slave::at).collect();
        bus.ordered = 4;
        let places = outside.run(bus.places()).unwrap();
        outside.rearranged = Some(there.map(Device::at).to_vec());
        assert!(outside.run(bus.mark(1, &places)).is_err());
        assert_eq!(outside.stations(), expected);
    }
}

#[test]
fn a_slave_that_was_put_elsewhere_with_its_mark_is_not_the_one_at_its_former_place() {
    let chain = [STATION_BASE, 0, 0].map(Device::at);
    let (mut outside, mut bus) = Outside::with_bus(&chain);
    bus.slaves = (0..3).map(Slave::at).collect();
    bus.ordered = 3;
    let places = outside.run(bus.places()).unwrap();
    assert_eq!(outside.run(bus.mark(1, &places)), Ok(()));
    assert_eq!(outside.run(bus.confirm_mark(1, &places)), Ok(()));
    outside.chain.swap(1, 2);
    let expected = BusError::Station {
        expected: STATION_TEMPORARY,
        actual: 0,
    };
    assert_eq!(outside.run(bus.confirm_mark(1, &places)), Err(expected));
    assert_eq!(outside.stations(), [STATION_BASE, 0, 0]);
}

#[test]
fn nobody_is_taken_for_a_slave_whose_neighbours_have_changed_places() {
    let chain = [STATION_BASE + 2, 0, STATION_BASE].map(Device::at);
    let (mut outside, mut bus) = Outside::with_bus(&chain);
    bus.slaves = (0..3).map(Slave::at).collect();
    bus.ordered = 3;
    let Err(failure) = outside.run(bus.repair(1)) else {
        panic!("a slave was taken");
    };
    let error = BusError::SlaveCount { expected: 3, actual: 3 };
    assert_eq!(
        (failure.position, failure.step, failure.error),
        (Some(1), Step::Locate, error)
    );
    assert_eq!(outside.stations(), [STATION_BASE + 2, 0, STATION_BASE]);
}

#[test]
fn a_slave_with_the_temporary_address_loses_it_and_counts_as_one_without_an_address() {
    let chain = [STATION_BASE, STATION_TEMPORARY].map(Device::at);
    let (mut outside, mut bus) = Outside::with_bus(&chain);
    let places = outside.run(bus.places()).unwrap();
    assert_eq!(places, [STATION_BASE, 0]);
    assert_eq!(outside.stations(), [STATION_BASE, 0]);
}

#[test]
fn an_event_that_the_application_leaves_no_room_for_is_counted() {
    let (mut outside, mut bus) = Outside::with_bus(&[]);
    let room = outside.application.events.capacity();
    for (events, dropped) in (1..=room + 2).map(|events| (events, events.saturating_sub(room))) {
        // The application takes no events meanwhile.
        let polls = {
            let mut emitted = pin!(bus.emit(BusEvent::Stopped));
            let mut poll = || emitted.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            (0..1_000).take_while(|_| poll().is_pending()).count()
        };
        assert!(polls < 1_000, "event {events} waits for ever");
        assert_eq!(bus.events_dropped as usize, dropped, "after event {events}");
    }
    outside.step();
    assert_eq!(outside.events.len(), room);
}

#[test]
fn the_distributor_is_the_first_slave_that_answers_with_the_time_of_the_bus() {
    let (_outside, mut bus) = Outside::with_bus(&[]);
    bus.slaves = (0..3).map(Slave::at).collect();
    assert_eq!(bus.distributor(), None);
    let clock = |is_set| SlaveClock {
        width: Some(Width::Bits64),
        is_set,
        ..SlaveClock::default()
    };
    bus.clocks.slaves = [false, true, true].map(clock).into_iter().collect();
    assert_eq!(bus.distributor(), Some(1));
    bus.slaves[1].condition = Condition::Lost;
    assert_eq!(bus.distributor(), Some(2));
}

#[test]
fn a_cable_is_reported_by_each_end_that_has_counted_more_errors_than_before() {
    let chain = [0, 1, 2].map(|number| Device::at(STATION_BASE + number));
    let (mut outside, mut bus) = Outside::with_bus(&chain);
    bus.slaves = (0..3).map(Slave::at).collect();
    // A line: frames go on through port 1 of all but the last.
    for (slave, open) in bus.slaves.iter_mut().zip([2, 2, 1]) {
        let ports = core::array::from_fn(|port| PortStatus {
            link: port < open,
            loop_closed: port >= open,
            communication: port < open,
        });
        slave.dl_status = DlStatus {
            ports,
            ..DlStatus::default()
        }
        .bits();
    }
    let of_port = |invalid_frames, receive_errors, lost_links| PortErrors {
        invalid_frames,
        receive_errors,
        lost_links,
        ..PortErrors::default()
    };
    let event = |position, port, partner, count| BusEvent::CableErrors {
        position,
        port,
        partner,
        count,
    };
    let unchanged = PortErrors::default();
    // Counters of the ports of the second slave, and what is reported.
    for (ports, expected) in [
        ([unchanged; 2], &[][..]),
        (
            [of_port(2, 5, 0), of_port(0, 0, 3)],
            &[event(1, 0, Some(0), 5), event(1, 1, Some(2), 3)],
        ),
        ([of_port(2, 5, 0), of_port(0, 0, 3)], &[]),
        ([of_port(2, 5, 0), of_port(1, 0, 3)], &[event(1, 1, Some(2), 1)]),
        // Somebody has cleared them.
        ([unchanged; 2], &[]),
        ([unchanged, of_port(1, 1, 0)], &[event(1, 1, Some(2), 1)]),
    ] {
        outside.chain[1].errors.ports[..2].copy_from_slice(&ports);
        for _ in 0..bus.slaves.len() {
            outside.run(bus.check_cables());
        }
        assert_eq!(outside.events, expected, "{ports:?}");
        outside.events.clear();
    }
}
