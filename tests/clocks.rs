//! Drifting clocks against the master: the slaves follow the reference, and the sample follows the bus.
//!
//! Everything runs in virtual time, in whole nanoseconds: the sample's timer is perfect, the slaves' crystals are not.

use core::future::Future;
use core::task::{Context, Waker};
use etherpen::config::{Bus, Config};
use etherpen::ethercat::clock::steering::{ClockReading, ClockSteering};
use etherpen::ethercat::supervisor::{BusCommand, BusEvent};
use etherpen::ethercat::wire::{Address, Command, FRAME_LEN_MAX, FrameBuilder, FrameView, register};
use etherpen::robot_bus::{RobotBusQueues, RobotExchange, RobotSupervisor};
use host_tools::cell::{Cell, CellOptions, ClockOptions, PlaceOptions};

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const PERIOD_NS: u64 = 1_000_000;
const SLAVES: u16 = 4;
const STATION_BASE: u16 = 0x1001;

/// A register of a slave, read without the master.
fn read<const LENGTH: usize>(cell: &mut Cell, time_ns: u64, station: u16, register: u16) -> [u8; LENGTH] {
    let mut frame = [0; FRAME_LEN_MAX];
    let mut builder = FrameBuilder::new(&mut frame, MAC).expect("room");
    let address = Address::station(station, register);
    builder.push(Command::Fprd, 0xEE, address, LENGTH).expect("room");
    let length = builder.finish();
    let replies = cell.frame_at_ns(time_ns, &frame[..length]);
    let view = FrameView::new_checked(&replies[0]).expect("a reply");
    view.payload()[10..10 + LENGTH].try_into().expect("as many bytes")
}

/// Difference of a slave's clock from the reference as its own register shows it, ns.
fn difference_ns(cell: &mut Cell, time_ns: u64, station: u16) -> i32 {
    let bytes = read(cell, time_ns, station, register::DC_TIME_DIFFERENCE);
    register::time_difference_ns(u32::from_le_bytes(bytes))
}

/// A bus with clocks that was run for a while.
struct Run {
    cell: Cell,
    release_ns: u64,
    operational_ms: Option<u32>,
    steering: ClockSteering,
    /// Largest phase error of the sample, and the largest after a second, ns.
    error_max_ns: i32,
    settled_max_ns: i32,
}

impl Run {
    /// Brings the bus up and runs it for `longest_ms`, or until a second after it is in OP. The clocks may take `settle_ms`
    /// to agree.
    fn new(options: CellOptions, settle_ms: u16, longest_ms: u32) -> Self {
        let mut config = Config::default();
        (config.bus.clocks, config.bus.settle_max_ms) = (true, settle_ms);
        let seed = options.seed;
        let mut queues = Box::new(RobotBusQueues::new());
        let (exchange_end, supervisor_end, mut application) = queues.split();
        let setup = config.bus_setup();
        assert!(application.commands.enqueue(BusCommand::Start(setup)).is_ok());
        let mut exchange = RobotExchange::new(exchange_end, MAC);
        let mut supervisor = RobotSupervisor::new(supervisor_end);
        let mut supervision = Box::pin(supervisor.run());
        let (mut correction_ns, mut steered) = (0, 0);
        let mut run = Self {
            cell: Cell::new(&config, options),
            release_ns: 0,
            operational_ms: None,
            steering: ClockSteering::new(PERIOD_NS as u32),
            error_max_ns: 0,
            settled_max_ns: 0,
        };
        for ms in 0..longest_ms {
            run.release_ns += PERIOD_NS.saturating_add_signed(i64::from(correction_ns));
            let telegram = exchange.input_telegram().to_vec();
            for reply in run.cell.frame_at_ns(run.release_ns, &telegram) {
                exchange.receive(&reply);
            }
            if exchange.plan().clock.is_some() {
                steered += 1;
                correction_ns = run.steering.step(ClockReading {
                    reference_ns: exchange.clock_ns().map(|time_ns| time_ns as u32),
                    elapsed_ns: 0,
                });
                let error_ns = run.steering.error_ns().abs();
                run.error_max_ns = run.error_max_ns.max(error_ns);
                if steered > 1_000 {
                    run.settled_max_ns = run.settled_max_ns.max(error_ns);
                }
                assert_eq!(run.steering.fault(50_000), None, "seed {seed}, {ms} ms");
            }
            let telegram = exchange.output_telegram().to_vec();
            for reply in run.cell.frame_at_ns(run.release_ns + 100_000, &telegram) {
                exchange.receive(&reply);
            }
            let mut context = Context::from_waker(Waker::noop());
            assert!(supervision.as_mut().poll(&mut context).is_pending());
            while let Some(event) = application.events.dequeue() {
                assert!(!matches!(event, BusEvent::Refused { .. }), "seed {seed}: {event:?}");
                if event == BusEvent::Operational {
                    run.operational_ms.get_or_insert(ms);
                }
            }
            if run
                .operational_ms
                .is_some_and(|operational_ms| ms > operational_ms + 1_000)
            {
                break;
            }
        }
        run
    }

    /// Differences of the slaves behind the reference from it, ns.
    fn differences_ns(&mut self) -> Vec<i32> {
        let time_ns = self.release_ns + 400_000;
        (1..SLAVES)
            .map(|slave| difference_ns(&mut self.cell, time_ns, STATION_BASE + slave))
            .collect()
    }
}

/// Options of a cell whose clocks drift by up to 50 ppm.
fn drifting(seed: u64) -> CellOptions {
    CellOptions {
        seed,
        clocks: ClockOptions {
            drift_max_ppm: 50.0,
            ..ClockOptions::default()
        },
        ..CellOptions::default()
    }
}

#[test]
fn clocks_that_drift_by_50_ppm_agree_before_op_and_the_sample_keeps_its_phase() {
    for seed in 1..=4 {
        let mut run = Run::new(drifting(seed), Bus::default().settle_max_ms, 6_000);
        let differences = run.differences_ns();
        for slave in 0..SLAVES {
            let (time_ns, station) = (run.release_ns + 450_000, STATION_BASE + slave);
            let active: [u8; 2] = read(&mut run.cell, time_ns, station, register::DC_CYCLIC_CONTROL);
            assert_eq!(active, 0x0300_u16.to_le_bytes(), "SYNC0 of slave {slave} is on");
        }
        let Run {
            operational_ms,
            error_max_ns,
            settled_max_ns,
            ..
        } = run;
        println!(
            "seed {seed}: OP after {operational_ms:?} ms and the phase error was at most {error_max_ns} ns, after a second \
             {settled_max_ns} ns; differences of the slaves {differences:?} ns"
        );
        assert!(operational_ms.is_some() && run.steering.is_locked());
        assert!(error_max_ns <= 2_500 && settled_max_ns <= 100);
        assert!(differences.iter().all(|difference| difference.abs() <= 100));
    }
}

#[test]
fn clocks_that_lock_slowly_are_waited_for_until_they_agree() {
    // Loops that need longer than the default get it by the configuration.
    for (lock_ms, settle_ms) in [(30, 5_000), (100, 5_000), (300, 20_000)] {
        let place = PlaceOptions {
            lock_ms: Some(lock_ms),
            ..PlaceOptions::default()
        };
        let options = CellOptions {
            places: vec![place; SLAVES.into()],
            ..drifting(5)
        };
        let mut run = Run::new(options, settle_ms, 60_000);
        let differences = run.differences_ns();
        println!(
            "loop of {lock_ms} ms: OP after {:?} ms, differences a second later {differences:?} ns",
            run.operational_ms
        );
        assert!(run.operational_ms.is_some());
        assert!(
            differences.iter().all(|difference| difference.abs() <= 1_000),
            "{differences:?} ns"
        );
    }
}
