//! The clocks' set-up against a small model of slave clocks, frame by frame.

extern crate std;

use super::super::acyclic::{self, Lane, Outcome, Reply};
use super::super::wire::{read_u32, write_bytes};
use super::*;
use core::future::Future;
use core::ops::Range;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use heapless::spsc::Queue;
use std::boxed::Box;
use std::collections::VecDeque;
use std::println;
use std::string::String;
use std::vec::Vec as StdVec;

mod agreement;
mod counters;
mod places;
mod source;

const PERIOD_NS: u32 = 1_000_000;
const STATIONS: [u16; 4] = [0x1001, 0x1002, 0x1003, 0x1004];
/// Most milliseconds of a step: more than an hour.
const POLLS_MAX: u32 = 4_000_000;
/// One way from a slave's entry to the next one's, ns.
const HOP_NS: u64 = 500;
/// How long a clock that swings is ahead, and then behind, ns.
const SWING_NS: u64 = 20_000_000;

/// A slave with a clock of its own, which differs from true time by a start value and a drift.
struct Model {
    width: Option<Width>,
    start_ns: u64,
    drift_ppb: i64,
    memory: StdVec<u8>,
    delay_ns: u64,
    /// Whether its features tell of a clock.
    latches: bool,
    /// Whether the times of its ports stay what they are.
    is_frozen: bool,
    /// Whether its time cannot be written.
    is_fixed: bool,
    /// How far its time swings round the reference's, ns, each way for [`SWING_NS`].
    swing_ns: i32,
}

impl Model {
    fn local_ns(&self, true_ns: u64) -> u64 {
        let drift_ns = (true_ns as i64 / 1_000 * self.drift_ppb / 1_000_000) as u64;
        let time_ns = true_ns.wrapping_add(self.start_ns).wrapping_add(drift_ns);
        match self.width {
            Some(Width::Bits32) => time_ns & u64::from(u32::MAX),
            _ => time_ns,
        }
    }

    fn system_ns(&self, true_ns: u64) -> u64 {
        let offset_ns = read_u64(&self.memory, usize::from(register::DC_OFFSET));
        let time_ns = self.local_ns(true_ns).wrapping_add(offset_ns);
        match self.width {
            Some(Width::Bits32) => time_ns & u64::from(u32::MAX),
            _ => time_ns,
        }
    }

    fn put(&mut self, at: u16, bytes: &[u8]) {
        write_bytes(&mut self.memory, usize::from(at), bytes);
    }
}

/// A chain of four slaves; a frame a millisecond.
struct Chain {
    slaves: StdVec<Model>,
    /// Their addresses; in order until slaves are exchanged.
    stations: [u16; 4],
    true_ns: u64,
    /// Whether the time of the first slave is distributed in each millisecond.
    distributes: bool,
    /// Whether the second slave hangs alone at port 3 of the first, and the others behind its port 1.
    is_junction: bool,
    /// Reads of station addresses that are still lost.
    losses: usize,
    /// Frames, from 1, with wrong working counters.
    miscounted: Range<usize>,
    /// What is added to their working counters.
    miscount: u16,
    /// Measurements whose frame is still to be passed on by so many slaves only: a cable behind them is being plugged.
    cut: (usize, usize),
    frames: usize,
    log: String,
}

impl Chain {
    fn new(slaves: [(Option<Width>, u64, i64); 4]) -> Self {
        let mut models = StdVec::new();
        for (number, (width, start_ns, drift_ppb)) in (0_u64..).zip(slaves) {
            let features = match width {
                None => 0,
                Some(Width::Bits32) => register::FEATURE_CLOCKS,
                Some(Width::Bits64) => register::FEATURE_CLOCKS | register::FEATURE_CLOCKS_64,
            };
            let mut model = Model {
                width,
                start_ns,
                drift_ppb,
                memory: std::vec![0; 0x1000],
                delay_ns: number * HOP_NS,
                latches: width.is_some(),
                is_frozen: false,
                is_fixed: false,
                swing_ns: 0,
            };
            model.put(register::FEATURES, &features.to_le_bytes());
            // Ports 0 and 1 open, the last slave's port 1 closed; ports 2 and 3 closed.
            let status: u16 = if number == 3 { 0x5611 } else { 0x5A31 };
            model.put(register::DL_STATUS, &status.to_le_bytes());
            models.push(model);
        }
        Self {
            slaves: models,
            stations: STATIONS,
            true_ns: 7_000_000_123,
            distributes: false,
            is_junction: false,
            losses: 0,
            miscounted: 0..0,
            miscount: 0,
            cut: (0, 0),
            frames: 0,
            log: String::new(),
        }
    }

    /// Exchanges two slaves, which keep their clocks and their addresses.
    fn exchange(&mut self, one: usize, other: usize) {
        let status = usize::from(register::DL_STATUS);
        let cables = |slave: &Model| (slave.delay_ns, [slave.memory[status], slave.memory[status + 1]]);
        let before: StdVec<_> = self.slaves.iter().map(cables).collect();
        self.slaves.swap(one, other);
        self.stations.swap(one, other);
        for (slave, (delay_ns, status)) in self.slaves.iter_mut().zip(before) {
            slave.delay_ns = delay_ns;
            slave.put(register::DL_STATUS, &status);
        }
    }

    fn latch(&mut self) {
        if self.is_junction {
            return self.latch_at_junction();
        }
        for model in self.slaves.iter_mut().filter(|model| !model.is_frozen) {
            let entry_ns = model.local_ns(self.true_ns + model.delay_ns);
            let behind_ns = 2 * (3 * HOP_NS - model.delay_ns);
            let back_ns = model.local_ns(self.true_ns + model.delay_ns + behind_ns);
            model.put(register::DC_RECEIVE_TIME, &(entry_ns as u32).to_le_bytes());
            model.put(register::DC_RECEIVE_TIME + 4, &(back_ns as u32).to_le_bytes());
            model.put(register::DC_RECEIVE_TIME_UNIT, &entry_ns.to_le_bytes());
        }
    }

    /// The second slave hangs at port 3 of the first, the third and the fourth behind its port 1.
    fn latch_at_junction(&mut self) {
        // Open ports, and hops from the master's frame until it has come back to ports 0, 1 and 3.
        const PASSES: [(u16, [u64; 4]); 4] = [
            (0x1A31 | 0x8000 | 0x80, [0, 6, 0, 2]),
            (0x5611, [1, 0, 0, 0]),
            (0x5A31, [3, 5, 0, 0]),
            (0x5611, [4, 0, 0, 0]),
        ];
        for (model, (status, hops)) in self.slaves.iter_mut().zip(PASSES) {
            model.delay_ns = hops[0] * HOP_NS;
            model.put(register::DL_STATUS, &status.to_le_bytes());
            if model.is_frozen {
                continue;
            }
            for (port, hops) in (0..).zip(hops) {
                let time_ns = model.local_ns(self.true_ns + hops * HOP_NS) as u32;
                model.put(register::DC_RECEIVE_TIME + 4 * port, &time_ns.to_le_bytes());
            }
            let entry_ns = model.local_ns(self.true_ns + model.delay_ns);
            model.put(register::DC_RECEIVE_TIME_UNIT, &entry_ns.to_le_bytes());
        }
    }

    /// What a frame with the time of the first slave leaves in the others.
    fn distribute(&mut self) {
        let reference_ns = self.slaves[0].system_ns(self.true_ns);
        for model in &mut self.slaves[1..] {
            let difference_ns = model.system_ns(self.true_ns).wrapping_sub(reference_ns) as i32;
            let is_behind = (self.true_ns / SWING_NS).is_multiple_of(2);
            let swung_ns = if is_behind { -model.swing_ns } else { model.swing_ns };
            let bits = register::time_difference_bits(difference_ns + swung_ns);
            model.put(register::DC_TIME_DIFFERENCE, &bits.to_le_bytes());
        }
    }

    fn answer(&mut self, request: &Request) -> Reply {
        self.frames += 1;
        let (at, mut data, mut working_counter) = (request.address.register(), request.data.clone(), 0);
        if !self.log.is_empty() {
            self.log.push(' ');
        }
        self.log.push_str(&std::format!("{:?}:{at:04x}", request.command));
        if self.losses > 0 && at == register::STATION_ADDRESS {
            self.losses -= 1;
            return Reply {
                data,
                outcome: Outcome::Lost,
            };
        }
        if request.command == Command::Bwr && at == register::DC_RECEIVE_TIME {
            working_counter = self.slaves.len() as u16;
            match &mut self.cut {
                (left, passed) if *left > 0 => {
                    *left -= 1;
                    let passed = *passed;
                    working_counter = passed as u16;
                    let before: StdVec<_> = self.slaves.iter().map(|slave| slave.memory.clone()).collect();
                    self.latch();
                    let back = usize::from(register::DC_RECEIVE_TIME) + 4;
                    for (place, (slave, before)) in self.slaves.iter_mut().zip(before).enumerate() {
                        match place + 1 {
                            behind if behind > passed => slave.memory = before,
                            // The frame has left this one's port 1, and has not come back.
                            last if last == passed => {
                                slave.memory[back..back + 4].copy_from_slice(&before[back..back + 4])
                            }
                            _ => {}
                        }
                    }
                }
                _ => self.latch(),
            }
        }
        if self.distributes {
            self.distribute();
        }
        for (place, (model, station)) in (0_u16..).zip(self.slaves.iter_mut().zip(self.stations)) {
            let now_ns = self.true_ns + model.delay_ns;
            let system = model.system_ns(now_ns).to_le_bytes();
            write_bytes(&mut model.memory, usize::from(register::DC_SYSTEM_TIME), &system);
            let is_here = request.command == Command::Aprd && request.address == Address::position(place, at);
            let mine = request.address == Address::station(station, at);
            match request.command {
                Command::Fprd if mine && at == register::DC_SYSTEM_TIME && model.width.is_none() => {}
                Command::Aprd if is_here && at == register::STATION_ADDRESS => {
                    data.copy_from_slice(&station.to_le_bytes());
                    working_counter += 1;
                }
                Command::Brd => working_counter += 1,
                Command::Fprd | Command::Frmw | Command::Aprd if mine || is_here => {
                    let length = data.len();
                    data.copy_from_slice(&model.memory[usize::from(at)..][..length]);
                    working_counter += 1;
                }
                Command::Frmw if model.width.is_some() && !model.is_fixed => {
                    let delay_ns = u64::from(read_u32(&model.memory, usize::from(register::DC_DELAY)));
                    let reference_ns = read_u64(&data, 0).wrapping_add(delay_ns);
                    let difference_ns = (read_u64(&system, 0) as u32).wrapping_sub(reference_ns as u32) as i32;
                    let bits = register::time_difference_bits(difference_ns);
                    model.put(register::DC_TIME_DIFFERENCE, &bits.to_le_bytes());
                    working_counter += 1;
                }
                Command::Fpwr if mine && !(model.is_fixed && at == register::DC_OFFSET) => {
                    model.put(at, &data);
                    working_counter += 1;
                }
                _ => {}
            }
        }
        if self.miscounted.contains(&self.frames) {
            working_counter = working_counter.wrapping_add(self.miscount);
        }
        Reply {
            data,
            outcome: Outcome::Processed { working_counter },
        }
    }

    /// Runs a step of the set-up to its end.
    fn run<T, F>(&mut self, step: impl FnOnce(AcyclicPort<'static, 64>) -> F) -> T
    where
        F: Future<Output = T>,
    {
        let requests: &'static mut Queue<Request, 5> = Box::leak(Box::default());
        let replies: &'static mut Queue<Reply, 5> = Box::leak(Box::default());
        let messages: &'static mut Queue<Request<64>, 2> = Box::leak(Box::default());
        let message_replies: &'static mut Queue<Reply<64>, 2> = Box::leak(Box::default());
        let ((request_in, mut request_out), (mut reply_in, reply_out)) = (requests.split(), replies.split());
        let (message_in, message_reply_out) = (messages.split().0, message_replies.split().1);
        let port = AcyclicPort::new(
            Lane::new(request_in, reply_out),
            Lane::new(message_in, message_reply_out),
        );
        let mut future = pin!(step(port));
        for _ in 0..POLLS_MAX {
            if let Poll::Ready(result) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                return result;
            }
            self.true_ns += u64::from(PERIOD_NS);
            let taken: VecDeque<Request> = core::iter::from_fn(|| request_out.dequeue()).collect();
            for request in taken {
                let reply = self.answer(&request);
                assert!(reply_in.enqueue(reply).is_ok());
            }
        }
        panic!("no end after {} frames", self.frames);
    }

    fn set_up(&mut self) -> BusClocks<16> {
        self.run(async |mut port: AcyclicPort<'static, 64>| set_up(&mut port, &STATIONS, PERIOD_NS, 0, |_| true).await)
            .expect("the set-up")
    }

    fn differences_ns(&mut self) -> StdVec<i32> {
        STATIONS
            .iter()
            .map(|station| {
                self.run(async |mut port: AcyclicPort<'static, 64>| difference_ns(&mut port, *station).await)
                    .expect("the difference")
            })
            .collect()
    }
}

/// Slaves that are used, and those that are lost.
fn present(answers: impl Fn(usize) -> bool) -> impl Fn(usize) -> Presence {
    move |place| match answers(place) {
        true => Presence::Used,
        false => Presence::Lost,
    }
}

const WIDE: Option<Width> = Some(Width::Bits64);
const NARROW: Option<Width> = Some(Width::Bits32);

#[test]
fn offsets_and_delays_let_all_clocks_agree_with_the_reference() {
    let mut chain = Chain::new([
        (WIDE, 5, 0),
        (WIDE, 1 << 40, 0),
        (WIDE, u64::MAX - 77, 0),
        (WIDE, 123_456, 0),
    ]);
    let clocks = chain.set_up();
    let delays: StdVec<u32> = clocks.slaves.iter().map(|slave| slave.delay_ns).collect();
    let differences_ns = chain.differences_ns();
    println!(
        "{} frames, delays {delays:?} ns, differences {differences_ns:?} ns",
        chain.frames
    );
    assert_eq!(delays, [0, 500, 1_000, 1_500]);
    assert_eq!(differences_ns, [0; 4]);
    assert_eq!(clocks.reference(), Some(0));
    // The frames pass the reference at this phase of its own time.
    assert_eq!(u64::from(clocks.phase_ns), (7_000_000_123 + 5) % 1_000_000);
}

#[test]
fn clocks_of_32_and_of_64_bits_agree_in_what_they_share() {
    for widths in [[WIDE, NARROW, WIDE, NARROW], [NARROW, WIDE, NARROW, WIDE]] {
        let starts = [u64::from(u32::MAX) - 9, 1 << 35, 3, 99];
        let slaves = core::array::from_fn(|number| (widths[number], starts[number], 0));
        let mut chain = Chain::new(slaves);
        chain.set_up();
        assert_eq!(chain.differences_ns(), [0; 4]);
    }
}

#[test]
fn the_first_slave_with_a_clock_is_the_reference_and_a_bus_without_clocks_is_left_alone() {
    let mut chain = Chain::new([(None, 0, 0), (WIDE, 9_000, 0), (None, 0, 0), (WIDE, 50, 0)]);
    let clocks = chain.set_up();
    assert_eq!(clocks.reference(), Some(1));
    assert_eq!(clocks.slaves[3].delay_ns, 1_000);
    assert_eq!(chain.differences_ns(), [0; 4]);

    let mut bare = Chain::new([(None, 0, 0); 4]);
    let clocks = bare.set_up();
    assert_eq!((clocks.reference(), bare.frames), (None, 4));
    assert_eq!(bare.log, "Fprd:0008 Fprd:0008 Fprd:0008 Fprd:0008");
}

#[test]
fn a_clock_that_cannot_be_set_stops_nobody_if_its_slave_is_not_used() {
    let mut chain = Chain::new([(WIDE, 9_000, 0), (WIDE, 1 << 40, 0), (WIDE, 77, 0), (WIDE, 50, 0)]);
    chain.slaves[2].is_fixed = true;
    let mut set_up = |used: fn(usize) -> bool| {
        chain.run(async move |mut port: AcyclicPort<'static, 64>| {
            set_up::<16, 64>(&mut port, &STATIONS, PERIOD_NS, 0, used).await
        })
    };
    let clocks = set_up(|place| place != 2).expect("the others' clocks");
    let has_clock: StdVec<bool> = (0..4).map(|place| clocks.has_clock(place)).collect();
    assert_eq!(has_clock, [true, true, false, true]);
    let refused = set_up(|_| true);
    assert!(
        matches!(refused, Err(BusError::WorkingCounter { .. })),
        "a drive without its clock"
    );
    assert_eq!((chain.differences_ns()[1], chain.differences_ns()[3]), (0, 0));
}

#[test]
fn a_first_clock_that_cannot_be_set_leaves_the_next_one_as_the_reference() {
    let mut chain = Chain::new([(WIDE, 9_000, 0), (WIDE, 1 << 40, 0), (WIDE, 77, 0), (WIDE, 50, 0)]);
    chain.slaves[0].is_fixed = true;
    let mut set_up = |used: fn(usize) -> bool| {
        chain.run(async move |mut port: AcyclicPort<'static, 64>| {
            set_up::<16, 64>(&mut port, &STATIONS, PERIOD_NS, 0, used).await
        })
    };
    let clocks = set_up(|place| place != 0).expect("the others' clocks");
    assert_eq!(clocks.reference(), Some(1));
    assert!(set_up(|_| true).is_err(), "a drive without its clock");
    let differences_ns = chain.differences_ns();
    assert_eq!(differences_ns[2], differences_ns[1], "they keep the second one's time");
    assert_eq!(differences_ns[3], differences_ns[1]);
}

#[test]
fn a_clock_that_latches_no_times_stops_nobody_if_its_slave_is_not_used() {
    for (frozen, is_junction) in [(0, false), (1, false), (2, false), (3, false), (0, true), (2, true)] {
        let mut chain = Chain::new([(WIDE, 9_000, 0), (WIDE, 1 << 40, 0), (WIDE, 77, 0), (WIDE, 50, 0)]);
        (chain.slaves[frozen].is_frozen, chain.is_junction) = (true, is_junction);
        let others = || (0..4).filter(|place| *place != frozen);
        let first = others().next().unwrap();
        let refused = chain.run(async |mut port: AcyclicPort<'static, 64>| {
            set_up::<16, 64>(&mut port, &STATIONS, PERIOD_NS, 0, |_| true).await
        });
        assert!(
            matches!(refused, Err(BusError::WorkingCounter { .. })),
            "a drive without its clock"
        );
        let mut clocks: BusClocks<16> = chain
            .run(async |mut port: AcyclicPort<'static, 64>| {
                set_up(&mut port, &STATIONS, PERIOD_NS, 0, |place| place != frozen).await
            })
            .expect("the others' clocks");
        // It answers the time all the same, and counts.
        let reference = clocks.reference_clock(&STATIONS, |_| true).expect("a reference");
        assert_eq!((reference.station, reference.slaves), (STATIONS[first], 4));
        let agree = |chain: &mut Chain| {
            let times_ns: StdVec<u64> = chain
                .slaves
                .iter()
                .map(|slave| slave.system_ns(chain.true_ns))
                .collect();
            // What leads from one branch to the other through a junction without times is not measured.
            let most_ns = if is_junction && frozen == 0 { 2 * HOP_NS } else { 0 };
            assert!(
                others().all(|place| times_ns[place].abs_diff(times_ns[first]) <= most_ns),
                "{frozen} is frozen: {times_ns:?}"
            );
        };
        agree(&mut chain);
        // Neither does it stop the repair of another one.
        let repaired = others().next_back().unwrap();
        chain.slaves[repaired].start_ns = 1 << 33;
        clocks.was_off(repaired);
        clocks.chain_changed();
        let presence = |place| match place == frozen {
            true => Presence::Unused,
            false => Presence::Used,
        };
        chain
            .run(async |mut port: AcyclicPort<'static, 64>| {
                restore(&mut port, &STATIONS, &mut clocks, repaired, presence).await?;
                tell_delays(&mut port, &STATIONS, &mut clocks, &presence).await
            })
            .expect("the clock of the slave that is back");
        agree(&mut chain);
        let used = clocks.slaves.iter().enumerate().filter(|(place, _)| *place != frozen);
        assert!(
            used.into_iter().all(|(_, slave)| slave.measured && slave.is_set),
            "{clocks:?}"
        );
    }
}

#[test]
fn clocks_of_64_bits_are_told_the_lower_half_for_ever_where_one_of_32_bits_has_told_them_its_time() {
    let mut chain = Chain::new([(NARROW, 9_000, 0), (WIDE, 1 << 40, 0), (WIDE, 77, 0), (WIDE, 50, 0)]);
    let clocks = chain.set_up();
    for lost in [9, 0] {
        let clock = clocks
            .reference_clock(&STATIONS, |place| place != lost)
            .expect("a reference");
        assert!(!clock.wide, "without slave {lost}");
    }
}

#[test]
fn a_slave_that_only_latches_times_has_no_clock_but_its_cable_is_measured() {
    let mut chain = Chain::new([(WIDE, 9_000, 0), (None, 0, 0), (None, 77, 0), (WIDE, 50, 0)]);
    // As EL1004 and EL2828: bit 2 of the features, receive times, no system time.
    for terminal in &mut chain.slaves[1..3] {
        terminal.latches = true;
        terminal.put(register::FEATURES, &register::FEATURE_CLOCKS.to_le_bytes());
    }
    let clocks = chain.set_up();
    let found: StdVec<_> = clocks
        .slaves
        .iter()
        .map(|slave| (slave.width, slave.delay_ns))
        .collect();
    assert_eq!(found, [(WIDE, 0), (None, 500), (None, 1_000), (WIDE, 1_500)]);
    assert_eq!(
        clocks.reference_clock(&STATIONS, |_| true).map(|clock| clock.slaves),
        Some(2)
    );
    assert_eq!(chain.differences_ns()[3], 0);
}

#[test]
fn the_time_is_distributed_by_the_first_clock_that_answers_and_is_set() {
    let mut chain = Chain::new([(WIDE, 5, 0), (None, 0, 0), (WIDE, 42, 0), (WIDE, 9, 0)]);
    let mut clocks = chain.set_up();
    let station = |clocks: &BusClocks<16>, lost: &[usize]| {
        let clock = clocks.reference_clock(&STATIONS, |place| !lost.contains(&place));
        clock.map(|clock| (clock.station, clock.slaves))
    };
    assert_eq!(station(&clocks, &[]), Some((STATIONS[0], 3)));
    assert_eq!(station(&clocks, &[0]), Some((STATIONS[2], 2)));
    assert_eq!(station(&clocks, &[0, 2, 3]), None);
    clocks.was_off(0);
    assert_eq!(
        station(&clocks, &[]),
        Some((STATIONS[2], 3)),
        "it has returned with a time of its own"
    );
}

#[test]
fn the_set_up_comes_in_order_and_in_a_bounded_number_of_frames() {
    let mut chain = Chain::new([(WIDE, 5, 0), (None, 0, 0), (None, 0, 0), (NARROW, 9, 0)]);
    chain.set_up();
    let settling = " Frmw:0910".repeat(usize::from(SETTLING_FRAMES));
    let expected = "Fprd:0008 Fprd:0910 Fprd:0008 Fprd:0008 Fprd:0008 Fprd:0910 Brd:0130 Bwr:0900 Fprd:0110 Fprd:0900 Fprd:0110 Fprd:0110 Fprd:0110 \
                    Fprd:0900 Brd:0130 Fpwr:0920 Fpwr:0928 Fpwr:0930 Fpwr:0920 Fpwr:0928 Fpwr:0930";
    assert_eq!(chain.log, std::format!("{expected}{settling}"));
    assert_eq!(
        read_u16(&chain, 3, register::DC_SPEED_START),
        register::SPEED_START_DEFAULT
    );
}

fn read_u16(chain: &Chain, slave: usize, at: u16) -> u16 {
    super::super::wire::read_u16(&chain.slaves[slave].memory, usize::from(at))
}

#[test]
fn a_slave_that_was_switched_off_takes_the_time_of_the_others_also_as_the_reference() {
    for position in [2, 0] {
        let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
        let mut clocks = chain.set_up();
        let before_ns = chain.slaves[1].system_ns(chain.true_ns);
        chain.slaves[position].start_ns = 0_u64.wrapping_sub(chain.true_ns);
        chain.slaves[position].put(register::DC_OFFSET, &[0; 12]);
        // Another one that was off as well, and waits for its own repair.
        chain.slaves[3].start_ns = 99;
        clocks.was_off(3);
        let writes = chain.log.matches("Fpwr").count();
        chain
            .run(async |mut port: AcyclicPort<'static, 64>| {
                restore(&mut port, &STATIONS, &mut clocks, position, |_| Presence::Used).await
            })
            .expect("the clock");
        // Its own registers, and the delay of the one that waits.
        assert_eq!(chain.log.matches("Fpwr").count() - writes, 6);
        let passed_ns = chain.slaves[1].system_ns(chain.true_ns) - before_ns;
        assert_eq!(passed_ns % u64::from(PERIOD_NS), 0);
        let now_ns = chain.true_ns;
        let mut models = chain.slaves.iter().take(3);
        assert!(models.all(|slave| slave.system_ns(now_ns) == chain.slaves[1].system_ns(now_ns)));
    }
}

#[test]
fn delays_are_told_from_the_clock_that_distributes_its_time_which_then_runs_freely() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 123_456, 0)]);
    let mut clocks = chain.set_up();
    for (lost, delays, source) in [
        (&[][..], [0, 500, 1_000, 1_500], None),
        (&[0], [0, 0, 500, 1_000], Some(STATIONS[1])),
        // The one that is lost too keeps what it was told.
        (&[0, 1], [0, 0, 0, 500], Some(STATIONS[2])),
        (&[], [0, 500, 1_000, 1_500], Some(STATIONS[0])),
    ] {
        for repeated in [false, true] {
            chain.log.clear();
            let presence = present(|place| !lost.contains(&place));
            chain
                .run(async |mut port: AcyclicPort<'static, 64>| {
                    tell_delays(&mut port, &STATIONS, &mut clocks, &presence).await
                })
                .expect("the delays");
            let delay = |slave: &Model| read_u32(&slave.memory, usize::from(register::DC_DELAY));
            let told: StdVec<u32> = chain.slaves.iter().map(delay).collect();
            assert_eq!(told, delays, "{lost:?}");
            let restarts = usize::from(source.is_some() && !repeated);
            assert_eq!(chain.log.matches("Fpwr:0930").count(), restarts, "{lost:?}");
            assert!(!repeated || chain.log.is_empty(), "{}", chain.log);
        }
    }
}

#[test]
fn the_first_clock_to_return_continues_the_time_when_all_were_off() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (None, 0, 0), (None, 0, 0)]);
    let (clocks, before_ns, after_ns) = {
        let models = &mut chain;
        let mut clocks = models.set_up();
        let before_ns = models.slaves[0].system_ns(models.true_ns);
        for slave in 0..2 {
            clocks.was_off(slave);
            models.slaves[slave].start_ns = 31 + slave as u64;
            models.slaves[slave].put(register::DC_OFFSET, &[0; 12]);
        }
        for slave in [1, 0] {
            models
                .run(async |mut port: AcyclicPort<'static, 64>| {
                    restore(&mut port, &STATIONS, &mut clocks, slave, |_| Presence::Used).await
                })
                .expect("the clock");
        }
        (clocks, before_ns, models.slaves[0].system_ns(models.true_ns))
    };
    let period_ns = u64::from(PERIOD_NS);
    assert_eq!(before_ns % period_ns, u64::from(clocks.phase_ns));
    let off_ns = (after_ns % period_ns).abs_diff(u64::from(clocks.phase_ns));
    assert!(
        off_ns <= 2 * HOP_NS,
        "{off_ns} ns: the phase of the frames is kept to their delay"
    );
    assert_eq!(chain.slaves[1].system_ns(chain.true_ns), after_ns);
}

#[test]
fn sync_starts_at_its_shift_behind_the_frames_after_an_hour_with_clocks_of_any_width() {
    let chains = [
        [NARROW; 4],
        [NARROW, WIDE, NARROW, WIDE],
        [WIDE, NARROW, WIDE, NARROW],
        [WIDE; 4],
    ];
    for (widths, slave) in chains
        .into_iter()
        .flat_map(|widths| [(widths, 1), (widths, 2), (widths, 3)])
    {
        let starts = [u64::from(u32::MAX) - 9, 1 << 35, 3, 99];
        let mut chain = Chain::new(core::array::from_fn(|number| (widths[number], starts[number], 0)));
        let begin_ns = chain.true_ns;
        let start_ns = chain
            .run(async |mut port: AcyclicPort<'static, 64>| -> Result<u64, BusError> {
                let mut clocks: BusClocks<16> = set_up(&mut port, &STATIONS, PERIOD_NS, 0, |_| true).await?;
                for _ in 0..3_600 {
                    port.wait_ms(999).await;
                    follow(&mut port, &STATIONS, &mut clocks, |_| true).await;
                }
                start_sync(&mut port, &STATIONS, slave, &mut clocks, sync0(250_000), |_| true).await
            })
            .expect("the activation");
        // The true time of the first pulse: within 2 s of now, in the slave's own time.
        let model = &chain.slaves[slave];
        let ahead_ns = (start_ns as u32).wrapping_sub(model.system_ns(chain.true_ns) as u32) as i32;
        let pulse_ns = chain.true_ns.wrapping_add_signed(ahead_ns.into()) - begin_ns;
        assert_eq!(pulse_ns % u64::from(PERIOD_NS), 250_000, "{widths:?}, slave {slave}");
    }
}

/// SYNC0 alone, this time after the frames.
fn sync0(shift_ns: u32) -> SyncSignals {
    SyncSignals {
        assign_activate: 0x0300,
        sync1_ns: 0,
        shift_ns,
    }
}

#[test]
fn sync1_is_as_far_behind_sync0_as_the_device_wants_it() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 7, 0)]);
    let mut clocks = chain.set_up();
    let signals = SyncSignals {
        assign_activate: 0x0700,
        sync1_ns: 125_000,
        shift_ns: 0,
    };
    let run = chain.run(async |mut port: AcyclicPort<'static, 64>| {
        start_sync(&mut port, &STATIONS, 2, &mut clocks, signals, |_| true).await
    });
    run.expect("the activation");
    let time = |register: u16| read_u32(&chain.slaves[2].memory, usize::from(register));
    assert_eq!(
        (time(register::DC_SYNC0_CYCLE), time(register::DC_SYNC1_CYCLE)),
        (PERIOD_NS, 125_000)
    );
    assert_eq!(read_u16(&chain, 2, register::DC_CYCLIC_CONTROL), 0x0700);
}

#[test]
fn sync_starts_ahead_in_time_at_its_shift_behind_the_phase_of_the_frames() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 7, 0)]);
    let mut clocks = chain.set_up();
    for (shift_ns, station) in [(0, STATIONS[1]), (250_000, STATIONS[2]), (999_999, STATIONS[3])] {
        chain.log.clear();
        // What another master may have left.
        let slave = usize::from(station - STATIONS[0]);
        chain.slaves[slave].put(register::DC_SYNC1_CYCLE, &[0xA5; 4]);
        let start_ns = chain
            .run(async |mut port: AcyclicPort<'static, 64>| {
                start_sync(&mut port, &STATIONS, slave, &mut clocks, sync0(shift_ns), |_| true).await
            })
            .expect("the activation");
        assert_eq!(chain.log, "Fpwr:0980 Fpwr:09a0 Fprd:0910 Fpwr:0990 Fpwr:0980");
        let now_ns = chain.slaves[0].system_ns(chain.true_ns);
        let ahead_ns = start_ns - now_ns;
        println!("shift {shift_ns} ns: {ahead_ns} ns ahead");
        assert!((START_AHEAD_NS - 3_000_000..=START_AHEAD_NS + 1_000_000).contains(&ahead_ns));
        let behind_ns = (start_ns + u64::from(PERIOD_NS) - u64::from(clocks.phase_ns)) % u64::from(PERIOD_NS);
        assert_eq!(behind_ns, u64::from(shift_ns));
        assert_eq!(read_u16(&chain, slave, register::DC_CYCLIC_CONTROL), 0x0300);
        let time = |register: u16| read_u32(&chain.slaves[slave].memory, usize::from(register));
        assert_eq!(
            (time(register::DC_SYNC0_CYCLE), time(register::DC_SYNC1_CYCLE)),
            (PERIOD_NS, 0)
        );
    }
}

#[test]
fn a_slave_is_replaced_by_one_with_another_clock_or_with_none() {
    for (old, new) in [(WIDE, None), (None, WIDE), (WIDE, NARROW), (NARROW, WIDE)] {
        let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (old, 42, 0), (WIDE, 7, 0)]);
        let mut clocks = chain.set_up();
        let features = Chain::new([(new, 0, 0); 4]).slaves[0].memory[usize::from(register::FEATURES)..][..2].to_vec();
        let other = &mut chain.slaves[2];
        (other.width, other.latches, other.start_ns) = (new, new.is_some(), 1 << 33);
        other.put(register::FEATURES, &features);
        other.put(register::DC_OFFSET, &[0; 8]);
        clocks.was_off(2);
        let counted = chain.run(async |mut port: AcyclicPort<'static, 64>| -> Result<_, BusError> {
            let found = read_clock(&mut port, STATIONS[2]).await?.expect("an answer");
            clocks.replace(2, &found);
            restore(&mut port, &STATIONS, &mut clocks, 2, |_| Presence::Used).await?;
            Ok(clocks.reference_clock(&STATIONS, |_| true))
        });
        let reference = counted.expect("the repair").expect("a reference");
        // A clock of 32 bits has told the others a time without an upper half, even if it is gone.
        let expected = (3 + u16::from(new.is_some()), new != NARROW && old != NARROW);
        assert_eq!((reference.slaves, reference.wide), expected, "{old:?} to {new:?}");
        assert_eq!(clocks.has_clock(2), new.is_some());
        let ours = chain.slaves[2].system_ns(chain.true_ns) as u32;
        let bus = chain.slaves[0].system_ns(chain.true_ns) as u32;
        assert!(new.is_none() || ours == bus, "{old:?} to {new:?}: {ours} and {bus} ns");
    }
}

#[test]
fn an_extra_slave_is_counted_and_neither_measured_nor_set() {
    let mut chain = Chain::new([(WIDE, 5, 0), (WIDE, 1 << 40, 0), (WIDE, 42, 0), (WIDE, 7, 0)]);
    let known = &STATIONS[..3];
    let extra = chain.slaves.pop().expect("a slave");
    let mut clocks: BusClocks<16> = chain
        .run(async |mut port: AcyclicPort<'static, 64>| set_up(&mut port, known, PERIOD_NS, 0, |_| true).await)
        .expect("the set-up");
    let before = clocks.slaves.clone();
    chain.slaves.push(extra);
    let offset = chain.slaves[3].memory[usize::from(register::DC_OFFSET)..][..8].to_vec();
    let there = |lost: usize| move |position: usize| position != lost;
    chain
        .run(async |mut port: AcyclicPort<'static, 64>| -> Result<(), BusError> {
            let found = read_clock(&mut port, STATIONS[3]).await?.expect("an answer");
            clocks.add_extra(5, Some(found));
            assert_eq!(clocks.slaves.len(), 3, "a place that is not the next one");
            clocks.add_extra(3, Some(found));
            restore(&mut port, &STATIONS, &mut clocks, 3, |_| Presence::Used).await?;
            clocks.chain_changed();
            tell_delays(&mut port, &STATIONS, &mut clocks, |_| Presence::Used).await
        })
        .expect("the extra slave");
    let counted = |lost| {
        clocks
            .reference_clock(&STATIONS, there(lost))
            .map(|clock| (clock.station, clock.slaves))
    };
    assert_eq!((counted(9), counted(3)), (Some((0x1001, 4)), Some((0x1001, 3))));
    assert_eq!(counted(0), Some((0x1002, 3)));
    assert!(!clocks.has_clock(3) && clocks.is_set(3) && !clocks.slaves[3].measured);
    assert_eq!(chain.slaves[3].memory[usize::from(register::DC_OFFSET)..][..8], offset);
    let delays = |slaves: &[SlaveClock]| slaves.iter().map(|slave| slave.delay_ns).collect::<StdVec<_>>();
    assert_eq!(delays(&clocks.slaves[..3]), delays(&before));
}

#[test]
fn without_a_period_sync_starts_at_the_earliest_time() {
    let clocks = BusClocks::<4>::default();
    assert_eq!(clocks.period_ns, 0);
    for now_ns in [0, 1, u64::from(u32::MAX)] {
        assert_eq!(clocks.start_time_ns(now_ns, 250_000), now_ns + START_AHEAD_NS);
    }
}
