//! Drifting clocks against the master: the slaves follow the reference, and the sample follows the bus.
//!
//! Everything runs in virtual time, in whole nanoseconds: the sample's timer is perfect, the slaves' crystals are not.

use core::future::Future;
use core::task::{Context, Waker};
use etherpen::config::Config;
use etherpen::ethercat::clock::steering::{ClockReading, ClockSteering};
use etherpen::ethercat::supervisor::{BusCommand, BusEvent};
use etherpen::ethercat::wire::{Address, Command, FRAME_LEN_MAX, FrameBuilder, FrameView, register};
use etherpen::robot_bus::{RobotBusQueues, RobotExchange, RobotSupervisor};
use host_tools::cell::{Cell, CellOptions, ClockOptions};

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

#[test]
fn clocks_that_drift_by_50_ppm_agree_before_op_and_the_sample_keeps_its_phase() {
    for seed in 1..=4 {
        let mut config = Config::default();
        config.bus.clocks = true;
        let clocks = ClockOptions {
            drift_max_ppm: 50.0,
            ..ClockOptions::default()
        };
        let options = CellOptions {
            seed,
            clocks,
            ..CellOptions::default()
        };
        let mut cell = Cell::new(&config, options);
        let mut queues = Box::new(RobotBusQueues::new());
        let (exchange_end, supervisor_end, mut application) = queues.split();
        let setup = config.bus_setup();
        assert!(application.commands.enqueue(BusCommand::Start(setup)).is_ok());
        let mut exchange = RobotExchange::new(exchange_end, MAC);
        let mut supervisor = RobotSupervisor::new(supervisor_end);
        let mut supervision = Box::pin(supervisor.run());
        let mut steering = ClockSteering::new(PERIOD_NS as u32);
        let (mut release_ns, mut correction_ns, mut steered) = (0_u64, 0, 0);
        let (mut operational_ms, mut error_max_ns, mut settled_max_ns) = (None, 0, 0);
        for ms in 0..6_000_u32 {
            release_ns += PERIOD_NS.saturating_add_signed(i64::from(correction_ns));
            let telegram = exchange.input_telegram().to_vec();
            for reply in cell.frame_at_ns(release_ns, &telegram) {
                exchange.receive(&reply);
            }
            if exchange.plan().clock.is_some() {
                steered += 1;
                correction_ns = steering.step(ClockReading {
                    reference_ns: exchange.clock_ns().map(|time_ns| time_ns as u32),
                    elapsed_ns: 0,
                });
                error_max_ns = error_max_ns.max(steering.error_ns().abs());
                if steered > 1_000 {
                    settled_max_ns = settled_max_ns.max(steering.error_ns().abs());
                }
                assert_eq!(steering.fault(50_000), None, "seed {seed}, {ms} ms");
            }
            let telegram = exchange.output_telegram().to_vec();
            for reply in cell.frame_at_ns(release_ns + 100_000, &telegram) {
                exchange.receive(&reply);
            }
            assert!(
                supervision
                    .as_mut()
                    .poll(&mut Context::from_waker(Waker::noop()))
                    .is_pending()
            );
            while let Some(event) = application.events.dequeue() {
                assert!(!matches!(event, BusEvent::Refused { .. }), "seed {seed}: {event:?}");
                if event == BusEvent::Operational {
                    operational_ms.get_or_insert(ms);
                }
            }
        }
        let differences: Vec<i32> = (1..SLAVES)
            .map(|slave| difference_ns(&mut cell, release_ns + 400_000, STATION_BASE + slave))
            .collect();
        for slave in 0..SLAVES {
            let active: [u8; 2] = read(
                &mut cell,
                release_ns + 450_000,
                STATION_BASE + slave,
                register::DC_CYCLIC_CONTROL,
            );
            assert_eq!(active, 0x0300_u16.to_le_bytes(), "SYNC0 of slave {slave} is on");
        }
        println!(
            "seed {seed}: OP after {operational_ms:?} ms and the phase error was at most {error_max_ns} ns, after a second \
             {settled_max_ns} ns; differences of the slaves {differences:?} ns"
        );
        assert!(operational_ms.is_some() && steering.is_locked());
        assert!(error_max_ns <= 2_500 && settled_max_ns <= 100);
        assert!(differences.iter().all(|difference| difference.abs() <= 100));
    }
}
