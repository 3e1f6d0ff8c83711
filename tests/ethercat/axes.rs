//! Axes on a bus without a robot, behind what fills the first frame, at cycle times other than a millisecond.

use crate::again::clocks_are_on;
use crate::device_images::terminal_of_bytes;
use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Waker};
use etherpen::drives::cia402::{DriveState, DriveTarget};
use etherpen::drives::io::{IoGroup, IoTrigger, PositionIo};
use etherpen::drives::{AxisLimits, AxisMode, DriveSettings, EtherCatGroup, ServoAxis, ServoDrives};
use etherpen::ethercat::BusQueues;
use etherpen::ethercat::cyclic::{Exchange, ExchangeKind};
use etherpen::ethercat::event::{BusCommand, BusEvent, BusSetup};
use etherpen::ethercat::slave_set::SlaveSet;
use etherpen::ethercat::supervisor::Supervisor;
use etherpen_segment::random::Random;
use etherpen_segment::{
    ControllerType, DataManagers, Fault, Flywheel, PlaceOptions, Segment, SegmentOptions, SlaveKind,
};
use heapless::spsc::{Consumer, Producer};
use std::f64::consts::TAU;

const DRIVES: usize = 4;
/// Terminals before them, with 32 bytes each way.
const TERMINALS: usize = 36;
const SLAVES: usize = TERMINALS + DRIVES;
/// Frames behind the first one.
const FURTHER: usize = 2;
const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const SPEED_MAX_RAD_S: f64 = 10.0;
/// Increments of a turn of the virtual drive.
const TURN: i32 = 1 << 20;
const BRING_UP_MS_MAX: u64 = 60_000;

struct Axes {
    segment: Segment<Flywheel>,
    group: EtherCatGroup<'static, DRIVES, SLAVES, 1024, FURTHER>,
    axes: [ServoAxis; DRIVES],
    settings: DriveSettings,
    /// Where each axis is to go, increments; `None` without power.
    targets: [Option<i32>; DRIVES],
    /// Whether faults of the drives without power are reset.
    resets: bool,
    supervisor: Pin<Box<dyn Future<Output = ()>>>,
    commands: Producer<'static, BusCommand<ServoDrives<DRIVES>>>,
    events: Consumer<'static, BusEvent>,
    log: Vec<BusEvent>,
    cycle_us: u64,
    now_us: u64,
    polled_ms: u64,
    /// Most telegrams of one direction in a cycle.
    frames: usize,
}

impl Axes {
    /// The drives, each with the settings of its place, behind so many terminals.
    fn new(cycle_us: u64, exchange: ExchangeKind, terminals: usize, drives: [PlaceOptions; DRIVES]) -> Self {
        let settings = DriveSettings {
            mode: AxisMode::Position,
            increments_per_revolution: TURN as u32,
            digits_per_rpm: 262_144.0 / 1_875.0,
            gear: 1.0,
            following_error_max_rad: 1.0,
            ..DriveSettings::default()
        };
        let setup = BusSetup {
            members: DRIVES as u8,
            settings: [settings; DRIVES],
            exchange,
            terminals: SlaveSet::ALL,
            clocks: clocks_are_on(),
            watchdog_ms: 100,
            cycle_ns: cycle_us as u32 * 1_000,
            ..BusSetup::default()
        };
        let queues = Box::leak(Box::new(BusQueues::<ServoDrives<DRIVES>, SLAVES, 1024, FURTHER>::new()));
        let (exchange_end, supervisor_end, mut application) = queues.split();
        assert!(application.commands.enqueue(BusCommand::Start(setup)).is_ok());
        let options = SegmentOptions {
            slaves: [
                vec![SlaveKind::Sii(terminal_of_bytes(32, 32, false).into()); terminals],
                vec![SlaveKind::Cia402; DRIVES],
            ]
            .concat(),
            places: [vec![PlaceOptions::default(); terminals], drives.to_vec()].concat(),
            ..SegmentOptions::default()
        };
        Self {
            segment: Segment::new(&options, Flywheel::default()),
            group: EtherCatGroup::new(Exchange::new(exchange_end, MAC)),
            axes: [ServoAxis::with_cycle(cycle_us as u32 * 1_000); DRIVES],
            settings,
            targets: [None; DRIVES],
            resets: false,
            supervisor: Box::pin(async move {
                let mut supervisor = Supervisor::new(supervisor_end);
                supervisor.run().await
            }),
            commands: application.commands,
            events: application.events,
            log: Vec::new(),
            cycle_us,
            now_us: 0,
            polled_ms: 0,
            frames: 0,
        }
    }

    /// Exchanges the telegrams of one direction.
    fn exchange(&mut self, after_control: bool, at_us: u64) {
        let mut telegram = match after_control {
            false => self.group.trigger_input().to_vec(),
            true => self.group.trigger_output().to_vec(),
        };
        let mut frames = 0;
        while !telegram.is_empty() {
            frames += 1;
            for reply in self.segment.frame(at_us, &telegram) {
                self.group.arrived(&reply);
            }
            let exchange = self.group.exchange_mut();
            telegram = match after_control {
                false => exchange.next_input_telegram().to_vec(),
                true => exchange.next_output_telegram().to_vec(),
            };
        }
        self.frames = self.frames.max(frames);
    }

    fn cycle(&mut self) {
        self.exchange(false, self.now_us);
        if self.group.renew() {
            for (member, axis) in self.axes.iter_mut().enumerate() {
                let limits = AxisLimits {
                    velocity_rad_s: SPEED_MAX_RAD_S,
                    torque_nm: 0.0,
                };
                axis.adopt(self.group.drive(member).as_ref(), &self.settings, &limits);
            }
        }
        for (member, axis) in self.axes.iter_mut().enumerate() {
            let input = self.group.read(member);
            if let Some(input) = &input {
                axis.take(input);
            }
            let target = self.targets[member];
            let wanted = match target {
                Some(_) => DriveTarget::Enabled,
                None if self.resets => DriveTarget::FaultReset,
                None => DriveTarget::Off,
            };
            let output = axis.set_position(wanted, target.filter(|_| input.is_some()), 0.0);
            self.group.write(member, &output);
        }
        self.exchange(true, self.now_us + self.cycle_us / 4);
        self.now_us += self.cycle_us;
        // The supervisor counts its polls as milliseconds.
        while self.polled_ms * 1_000 < self.now_us {
            self.polled_ms += 1;
            let poll = self.supervisor.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            assert!(poll.is_pending());
            while let Some(event) = self.events.dequeue() {
                self.log.push(event);
            }
        }
    }

    fn run_ms(&mut self, ms: u64) {
        let end_us = self.now_us + ms * 1_000;
        while self.now_us < end_us {
            self.cycle();
        }
    }

    fn operational(&mut self) {
        while !self.log.contains(&BusEvent::Operational) {
            assert!(self.now_us < BRING_UP_MS_MAX * 1_000, "{:#?}", self.log);
            self.cycle();
        }
        self.run_ms(20);
    }

    /// Drives go both ways, each by its own angle.
    fn assert_moves(&mut self, what: &str) {
        self.targets = self.positions().map(Some);
        self.run_ms(200);
        let before = self.errors();
        for turns in [0.5, -0.25] {
            let begun = self.angles_rad();
            let steps = |member: usize| turns * (1.0 - 0.2 * member as f64);
            let here = self.targets.map(Option::unwrap_or_default);
            let step = |member: usize| (steps(member) * f64::from(TURN)) as i32;
            self.targets = std::array::from_fn(|member| Some(here[member] + step(member)));
            self.run_ms(800);
            for (member, (begun, ended)) in begun.iter().zip(self.angles_rad()).enumerate() {
                let off_rad = ended - begun - steps(member) * TAU;
                assert!(off_rad.abs() < 0.01, "{what}, drive {member}: {off_rad} rad");
            }
        }
        assert_eq!(self.errors(), before, "{what}");
    }

    /// Frames lost, and wrong working counters.
    fn errors(&self) -> (u32, u32) {
        let counters = self.group.exchange().counters();
        (counters.frames_lost, counters.working_counter_errors)
    }

    /// Takes the power of a drive, from 1, away and gives it back, repairs the bus, and resets the drives' faults.
    fn power_again(&mut self, drive: usize) {
        self.targets = [None; DRIVES];
        self.segment.inject(Fault::Power(drive, 300));
        self.run_ms(500);
        assert!(self.commands.enqueue(BusCommand::Recover).is_ok());
        self.log.clear();
        self.operational();
        self.resets = true;
        self.run_ms(20);
        self.resets = false;
    }

    /// Where each drive is, increments.
    fn positions(&self) -> [i32; DRIVES] {
        std::array::from_fn(|member| self.group.read(member).expect("an input").position)
    }

    fn angles_rad(&self) -> Vec<f64> {
        self.segment.motors().map(|motor| motor.angle_rad).collect()
    }
}

#[test]
pub(crate) fn axes_beyond_one_frame_go_to_their_targets_at_their_limit_of_speed_whatever_the_cycle() {
    for (cycle_us, exchange) in [(500, ExchangeKind::Combined), (4_000, ExchangeKind::Split)] {
        let mut bus = Axes::new(cycle_us, exchange, TERMINALS, [PlaceOptions::default(); DRIVES]);
        bus.operational();
        let here = bus.positions();
        // Every drive somewhere else, half of them backwards.
        let turns = |member: usize| (member as f64 + 10.0) * if member.is_multiple_of(2) { 0.1 } else { -0.1 };
        bus.targets = here.map(Some);
        bus.run_ms(200);
        let states: Vec<DriveState> = bus.axes.iter().map(ServoAxis::state).collect();
        assert_eq!(states, [DriveState::OperationEnabled; DRIVES], "{cycle_us} us");
        let begun = bus.angles_rad();
        bus.targets = std::array::from_fn(|member| Some(here[member] + (turns(member) * f64::from(TURN)) as i32));
        bus.run_ms(100);
        let before = bus.angles_rad();
        bus.run_ms(300);
        for (member, (before, after)) in before.iter().zip(bus.angles_rad()).enumerate() {
            let speed_rad_s = (after - before) / 0.3 * turns(member).signum();
            assert!(
                (speed_rad_s - SPEED_MAX_RAD_S).abs() < 0.1,
                "drive {member} at {cycle_us} us: {speed_rad_s} rad/s"
            );
        }
        bus.run_ms(800);
        for (member, (begun, ended)) in begun.iter().zip(bus.angles_rad()).enumerate() {
            let off_rad = ended - begun - turns(member) * TAU;
            assert!(off_rad.abs() < 0.01, "drive {member} at {cycle_us} us: {off_rad} rad");
        }
        assert!(bus.frames > 1, "{} frames", bus.frames);
        assert_eq!(bus.errors(), (0, 0));
        println!("{cycle_us} us, {exchange:?}: {} frames each way at most", bus.frames);
    }
}

#[test]
pub(crate) fn drives_move_whichever_of_their_sync_managers_carry_the_process_data() {
    let numbers = (2..8).flat_map(|outputs| (2..8).map(move |inputs| DataManagers::new(outputs, inputs)));
    for managers in numbers.flatten() {
        let mut bus = Axes::new(1_000, ExchangeKind::Combined, 0, [with_managers(managers); DRIVES]);
        bus.operational();
        bus.assert_moves(&format!("{managers:?}"));
        assert_eq!(bus.errors(), (0, 0), "{managers:?}");
    }
}

#[test]
pub(crate) fn drives_of_one_product_come_up_and_come_back_each_with_its_own_sync_managers() {
    let numbers = (2..8).flat_map(|outputs| (2..8).map(move |inputs| DataManagers::new(outputs, inputs)));
    let numbers: Vec<_> = numbers.flatten().collect();
    let mut random = Random::new(17);
    for round in 0..12 {
        let mut any = || numbers[random.bits() as usize % numbers.len()];
        let managers: [DataManagers; DRIVES] = std::array::from_fn(|_| any());
        let what = format!("round {round}, {managers:?}");
        let mut places = managers.map(with_managers);
        // Controllers with no more sync managers than they need: those of an equal drive may not be there.
        for place in places.iter_mut().skip(1).step_by(2) {
            place.controller = Some(ControllerType::Lan9252);
        }
        let mut bus = Axes::new(1_000, ExchangeKind::Combined, 0, places);
        bus.operational();
        bus.assert_moves(&what);
        let lost = 1 + round % DRIVES;
        bus.power_again(lost);
        bus.assert_moves(&format!("{what} after the loss of drive {lost}"));
    }
}

fn with_managers(managers: DataManagers) -> PlaceOptions {
    PlaceOptions {
        managers: Some(managers),
        ..PlaceOptions::default()
    }
}
