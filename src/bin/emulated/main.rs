//! The controller on QEMU's mps2-an500, a Cortex-M7: wiring and priorities.
//!
//! Every task body is a function of the library; what a task is released by, how urgent it is and what an overrun means is
//! said here. The critical tasks share one priority: they never preempt each other, so they share the Ethernet port
//! and the sampler without a lock, and nothing below can mask them (see `critical`). They use no critical section, no
//! `spawn` and no log.
#![no_std]
#![no_main]

#[path = "../shared/copy.rs"]
mod copy;
mod critical;
mod device;
mod disturb;
mod health;
mod lan9118;
#[path = "../shared/last_word.rs"]
mod last_word;
#[path = "../shared/load.rs"]
mod load;
mod lockstep;
mod log;
mod metronome;
#[path = "../shared/modes.rs"]
mod modes;
mod panic;
#[cfg(feature = "primask")]
mod primask;
mod semihosting;
mod serial;
#[path = "../shared/time.rs"]
mod time;
mod timer;
mod uart;
mod wire;

use device::Interrupt;

/// The Ethernet port.
pub(crate) type Port = wire::Wire;
/// Interrupts of the tasks that nothing may mask.
const CRITICAL: [Interrupt; 4] = [
    Interrupt::TIMER0,
    Interrupt::TIMER1,
    Interrupt::DUAL_TIMER,
    Interrupt::LAN9118,
];

#[rtic::app(device = crate::device, peripherals = false, dispatchers = [FREE6])]
mod app {

    use crate::device::{CLOCK_HZ, Interrupt};
    use crate::health::{FRAMES_FAILED, Health, PERIODS_MISSED, TRAJECTORY_OVERRUNS};
    use crate::lan9118::{Mmio, free_run};
    use crate::lockstep::{self, Bus};
    use crate::log::{self, Drain};
    use crate::metronome::Metronome;
    use crate::modes::Modes;
    use crate::serial::{Route, Serial};
    use crate::timer::Clock;
    use crate::uart::Uart;
    use crate::wire::Wire;
    use crate::{CRITICAL, critical, disturb, last_word, load, time};
    use core::future::poll_fn;
    use core::pin::pin;
    use core::sync::atomic::{AtomicU32, Ordering};
    use etherpen::application::Mode;
    use etherpen::board::{BoardState, EmergencyStopInput, Interlock, PortState};
    use etherpen::control::sampler::Sampler;
    use etherpen::controller::Channels;
    use etherpen::ethercat::frame_port::FramePort;
    use etherpen::ethernet::lan9118::Lan9118;
    use etherpen::link_task::LinkTask;
    use etherpen::measurement::{CycleWatch, Measurements, Quantity, Run, disturbance};
    use etherpen::network::NetworkTask;
    use etherpen::robot_bus::MASTER_ADDRESS;
    use etherpen::robot_bus::RobotSupervisor;
    use etherpen::trajectory_task::TrajectoryTask;

    static SUPERVISOR: Metronome = Metronome::new();
    static NETWORK: Metronome = Metronome::new();

    /// Releases of the trajectory task that it has not yet completed.
    static TRAJECTORIES_DUE: AtomicU32 = AtomicU32::new(0);

    #[shared]
    struct Shared {
        measurements: &'static Measurements,
        #[lock_free]
        transport: FramePort<Wire>,
        #[lock_free]
        sampler: Sampler<'static>,
        #[lock_free]
        watch: CycleWatch<'static>,
        #[lock_free]
        serial: Serial,
    }

    #[local]
    struct Local {
        trajectory: TrajectoryTask<'static>,
        link: LinkTask<'static>,
        health: Health,
        network: NetworkTask<'static>,
        supervisor: RobotSupervisor<'static>,
        drain: Drain,
    }

    /// Opens the host's files, starts the Ethernet controller and the clock.
    #[init(local = [channels: Channels = Channels::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        critical::start_up_check(&CRITICAL);
        let parts = cx.local.channels.split("emulated");
        let drain = Drain::open();
        let (bus, route) = route();
        // SAFETY: `init` runs once, and it is the only caller.
        let mmio = unsafe { Mmio::take() };
        let mac = match Lan9118::start(mmio, MASTER_ADDRESS) {
            Ok(mac) => mac,
            Err(error) => panic!("Ethernet controller: {error:?}"),
        };
        // SAFETY: as above. The controller's reset also resets the counter that the clock reads, so the clock comes after.
        let clock = unsafe { Clock::start() };
        defmt::info!("emulated board, lockstep {=bool}", bus.is_some());
        parts.measurements.set_counts_per_s(CLOCK_HZ);
        parts.measurements.offer_disturbance();
        let shared = Shared {
            measurements: parts.measurements,
            transport: FramePort::new(Wire::new(mac, bus, clock)),
            sampler: parts.sampler,
            watch: CycleWatch::new(parts.measurements),
            serial: Serial::new(parts.host_bytes, route),
        };
        supervisor::spawn().unwrap_or_else(|()| panic!("the supervisor is spawned once"));
        network::spawn().unwrap_or_else(|()| panic!("the network task is spawned once"));
        let local = Local {
            trajectory: parts.trajectory,
            link: parts.link,
            health: Health::new(),
            network: parts.network,
            supervisor: parts.supervisor,
            drain,
        };
        (shared, local)
    }

    fn route() -> (Option<Bus>, Route) {
        match lockstep::open() {
            Some((bus, link)) => (Some(bus), Route::Lockstep(link)),
            // SAFETY: called once, by `init`.
            None => (None, Route::Uart(unsafe { Uart::start() })),
        }
    }

    /// Sleeps and lets `load` count it.
    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            load::sleep();
        }
    }

    /// Sends the input telegram.
    ///
    /// Period: 1 ms. Priority: 15, critical. Deadline: 500 us for the output telegram that follows from it. Overrun:
    /// it shows as lateness in `elapsed_ns`, which the sampler counts; a swallowed period is counted by the clock.
    #[task(
        binds = TIMER0,
        priority = 15,
        shared = [transport, sampler, watch, &measurements],
        local = [emergency_stop: EmergencyStopInput = EmergencyStopInput::new()]
    )]
    fn sample(cx: sample::Context) {
        let began_at = free_run();
        load::woke();
        let (transport, sampler) = (cx.shared.transport, cx.shared.sampler);
        last_word::prepare(sampler, transport);
        let wire = transport.driver_mut();
        wire.clock.release(sampler.take_timer_correction_ns());
        let delay = wire.clock.counts_to(began_at);
        log::MILLISECONDS.store(wire.clock.milliseconds(), Ordering::Relaxed);
        let missed = wire.clock.missed();
        PERIODS_MISSED.store(missed, Ordering::Relaxed);
        let elapsed_ns = wire.clock.elapsed_ns();
        let met = cx.shared.measurements.disturbance();
        let stopped = cx.local.emergency_stop.step(met & disturbance::EMERGENCY_STOP != 0);
        sampler.set_interlock(Interlock::of(stopped, met & disturbance::CLOCK != 0));
        if sampler.sample(transport, elapsed_ns, missed) {
            TRAJECTORIES_DUE.fetch_add(1, Ordering::Relaxed);
            rtic::pend(Interrupt::FREE15);
        }
        if transport.driver_mut().clock.begins_millisecond() {
            rtic::pend(Interrupt::FREE14);
        }
        let run = run(began_at, transport.driver_mut());
        cx.shared.watch.sample(run, delay, load::slept_counts());
    }

    /// A critical task's run up to here, without the lockstep's part.
    fn run(began_at: u32, wire: &mut Wire) -> Run {
        Run {
            began_at,
            ended_at: free_run(),
            excluded: wire.take_lockstep_counts(),
        }
    }

    /// Takes received telegrams; the input reply is followed by control and the output telegram.
    ///
    /// Released when a reply's time on the wire is over (lockstep) or by `arrival` (free-running). Period: twice a
    /// millisecond. Priority: 15, critical. Deadline: as for `sample`. Overrun: `bus_deadline` has sent the output
    /// telegram; frames that come while it runs release it again.
    #[task(binds = DUAL_TIMER, priority = 15, shared = [transport, sampler, watch])]
    fn bus_frame(cx: bus_frame::Context) {
        let began_at = free_run();
        load::woke();
        let (transport, sampler) = (cx.shared.transport, cx.shared.sampler);
        let wire = transport.driver_mut();
        wire.clock.delivery.acknowledge();
        let elapsed_ns = wire.clock.elapsed_ns();
        let waiting = sampler.awaits_input();
        if sampler.bus_frame(transport, elapsed_ns) {
            rtic::pend(Interrupt::DUAL_TIMER);
        }
        let served = waiting && !sampler.awaits_input();
        cx.shared.watch.bus_frame(run(began_at, transport.driver_mut()), served);
    }

    /// Hands a received frame's interrupt on to `bus_frame`.
    ///
    /// In lockstep the frames have been waited for when they come, and this task does not run (see `wire`). Period:
    /// every received frame, free-running only. Priority: 15, critical. Deadline: as for `sample`. Overrun: releases
    /// merge, `bus_frame` takes all frames.
    #[task(binds = LAN9118, priority = 15, shared = [transport])]
    fn arrival(cx: arrival::Context) {
        load::woke();
        cx.shared.transport.driver_mut().acknowledge();
        rtic::pend(Interrupt::DUAL_TIMER);
    }

    /// Sends the output telegram from predicted positions when no valid input has come.
    ///
    /// Period: 1 ms, 300 us behind `sample`. Priority: 15, critical. Deadline: as for `sample`. Overrun: the output
    /// telegram is late, which the sampler counts.
    #[task(binds = TIMER1, priority = 15, shared = [transport, sampler, watch, &measurements])]
    fn bus_deadline(cx: bus_deadline::Context) {
        let began_at = free_run();
        load::woke();
        let (transport, sampler) = (cx.shared.transport, cx.shared.sampler);
        let waiting = sampler.awaits_input();
        let wire = transport.driver_mut();
        if wire.clock.deadline.acknowledge() {
            let elapsed_ns = wire.clock.elapsed_ns();
            sampler.bus_deadline(transport, elapsed_ns);
        }
        FRAMES_FAILED.store(transport.driver_mut().failures(), Ordering::Relaxed);
        let served = waiting && !sampler.awaits_input();
        let watch = cx.shared.watch;
        watch.bus_deadline(run(began_at, transport.driver_mut()), served);
        if cx.shared.measurements.disturbance() & disturbance::NETWORK != 0 {
            let began_at = free_run();
            disturb::foreign_frames(transport, log::MILLISECONDS.load(Ordering::Relaxed));
            watch.preempted(run(began_at, transport.driver_mut()));
        }
    }

    /// Exchanges the link's bytes between the static queues and the host.
    ///
    /// Period: 1 ms, pended by `sample`. Priority: 10. Deadline: the next millisecond. Overrun: pends merge, bytes
    /// wait in the queues.
    #[task(binds = FREE14, priority = 10, shared = [serial, &measurements])]
    fn host_bytes(cx: host_bytes::Context) {
        let (serial, measurements) = (cx.shared.serial, cx.shared.measurements);
        let bits = measurements.disturbance();
        disturb::apply(bits);
        let ms = log::MILLISECONDS.load(Ordering::Relaxed);
        load::urgent(
            || measurements.critical_counts(),
            || serial.exchange(ms, bits & disturbance::SERIAL != 0),
        );
        rtic::pend(Interrupt::FREE16);
    }

    /// Loads the firmware with bytes and log lines when the host has asked for it.
    ///
    /// Period: 10.84 us while it is asked for, else off. Priority: 10. Deadline: none. Overrun: ticks merge.
    #[task(binds = SysTick, priority = 10, shared = [serial, &measurements])]
    fn tick(cx: tick::Context) {
        load::woke();
        let (serial, measurements) = (cx.shared.serial, cx.shared.measurements);
        let bits = measurements.disturbance();
        load::urgent(
            || measurements.critical_counts(),
            || {
                if bits & disturbance::SERIAL != 0 {
                    serial.noise();
                }
            },
        );
        if bits & disturbance::LOG != 0 {
            rtic::pend(Interrupt::FREE7);
        }
    }

    /// Floods the log when the host has asked for it.
    ///
    /// Period: pended by `tick`. Priority: 2. Deadline: none. Overrun: pends merge.
    #[task(binds = FREE7, priority = 2)]
    fn flood(_: flood::Context) {
        disturb::log();
    }

    /// Takes a byte from UART0, free-running only.
    ///
    /// Period: every byte, free-running only. Priority: 10. Deadline: none. Overrun: the UART holds the next byte back
    /// until this one is taken.
    #[task(binds = UART0_RX, priority = 10, shared = [serial])]
    fn byte_received(cx: byte_received::Context) {
        load::woke();
        cx.shared.serial.on_received();
    }

    /// Gives UART0 its next byte, free-running only.
    ///
    /// Period: every byte, free-running only. Priority: 10. Deadline: none. Overrun: bytes wait in the queue.
    #[task(binds = UART0_TX, priority = 10, shared = [serial])]
    fn byte_sent(cx: byte_sent::Context) {
        load::woke();
        cx.shared.serial.on_sent();
    }

    /// Plans, then fills the next 12 setpoints of the ring.
    ///
    /// Period: 12 ms, pended by `sample`. Priority: 6. Deadline: its next release. Overrun: a release that found the
    /// one before not completed is counted, and the late run serves both.
    #[task(binds = FREE15, priority = 6, shared = [&measurements], local = [trajectory])]
    fn trajectory(cx: trajectory::Context) {
        let measurements = cx.shared.measurements;
        let preempting = || measurements.critical_counts().wrapping_add(load::urgent_counts());
        let (began_at, before) = (free_run(), preempting());
        let due = TRAJECTORIES_DUE.load(Ordering::Relaxed);
        cx.local.trajectory.release();
        let taken = free_run().wrapping_sub(began_at);
        let preempted = preempting().wrapping_sub(before);
        measurements.record(Quantity::Trajectory, taken.saturating_sub(preempted));
        let before = TRAJECTORIES_DUE.fetch_sub(due, Ordering::Relaxed);
        TRAJECTORY_OVERRUNS.fetch_add(before.saturating_sub(1), Ordering::Relaxed);
    }

    /// Runs the link's protocol and the operating modes, then lets the supervisor and the log have their turn.
    ///
    /// Period: 1 ms, pended by `host_bytes`. Priority: 3. Deadline: none. Overrun: pends merge while the trajectory
    /// task runs.
    #[task(binds = FREE16, priority = 3, local = [link, health, modes: Modes = Modes::new(), drawn_ms: u32 = 0])]
    fn link(cx: link::Context) {
        let link = cx.local.link;
        link.set_board(BoardState {
            port: PortState::Unknown,
            ethernet_errors: FRAMES_FAILED.load(Ordering::Relaxed),
        });
        link.tick();
        let _ = cx.local.modes.watch(link.mode(), link.fault());
        panic_on_request(link, cx.local.drawn_ms);
        cx.local.health.tick(log::MILLISECONDS.load(Ordering::Relaxed));
        SUPERVISOR.tick();
        NETWORK.tick();
        rtic::pend(Interrupt::FREE17);
    }

    /// The variant for the test of a panic ends in the middle of a drawing.
    fn panic_on_request(link: &LinkTask, drawn_ms: &mut u32) {
        if cfg!(feature = "panic-while-drawing") && link.mode() == Mode::Drawing {
            *drawn_ms = drawn_ms.wrapping_add(1);
            assert!(*drawn_ms < 1_000, "this image was built to end here");
        }
    }

    /// Brings the bus up and watches it.
    ///
    /// Period: polled after each `link`. Priority: 1. Deadline: none. Overrun: polls merge.
    #[task(priority = 1, local = [supervisor])]
    async fn supervisor(cx: supervisor::Context) {
        SUPERVISOR.every_tick(cx.local.supervisor.run()).await;
    }

    /// Runs the IP stack that finds the addresses for EtherCAT in UDP.
    ///
    /// Period: polled after each `link`. Priority: 1. Deadline: none. Overrun: frames that find its ring full are
    /// dropped and counted.
    #[task(priority = 1, local = [network])]
    async fn network(cx: network::Context) {
        let mut run = pin!(cx.local.network.run());
        NETWORK
            .every_tick(poll_fn(|context| {
                time::tick();
                run.as_mut().poll(context)
            }))
            .await;
    }

    /// Empties the log's ring into the host's file.
    ///
    /// Period: pended by `link`. Priority: 1. Deadline: none. Overrun: what does not fit the ring is counted.
    #[task(binds = FREE17, priority = 1, local = [drain])]
    fn drain(cx: drain::Context) {
        cx.local.drain.run();
    }
}
