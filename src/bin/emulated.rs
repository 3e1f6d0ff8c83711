//! The controller on QEMU's mps2-an500, a Cortex-M7 with a LAN9118 Ethernet controller.
//!
//! This file contains the wiring: which interrupt releases which task of the library, and at which priority. The tasks'
//! functions are in `etherpen::controller`; the board nucleo runs these tasks at these priorities. The table of all
//! tasks is in `docs/tasks.md`.
//!
//! Invariants. The critical tasks share one priority and own the sampler and the Ethernet port without a lock; they
//! release others by pending an interrupt, never by a software task's `spawn`, which takes a critical section. Critical
//! sections mask up to priority 14 (`shared::critical`).
#![no_std]
#![no_main]

mod emulated {
    pub(crate) mod black_box;
    pub(crate) mod board;
    pub(crate) mod device;
    pub(crate) mod disturb;
    pub(crate) mod health;
    pub(crate) mod lan9118;
    pub(crate) mod lockstep;
    pub(crate) mod log;
    mod memory;
    mod panic;
    #[cfg(feature = "primask")]
    mod primask;
    mod semihosting;
    pub(crate) mod serial;
    pub(crate) mod timer;
    pub(crate) mod uart;
    mod wake;
    pub(crate) mod watchdog;
    pub(crate) mod wire;
}
mod shared;

use emulated::board;

#[rtic::app(device = crate::emulated::device, peripherals = false, dispatchers = [FREE6])]
mod app {
    use crate::board::NAME;
    use crate::emulated::black_box::BLACK_BOX;
    use crate::emulated::device::{CLOCK_HZ, Interrupt};
    use crate::emulated::disturb;
    use crate::emulated::health::{FRAMES_FAILED, Health, PERIODS_MISSED};
    use crate::emulated::lan9118::{Mmio, free_run};
    use crate::emulated::lockstep::{self, Bus, around};
    use crate::emulated::log::{self, Drain};
    use crate::emulated::serial::{Route, Serial};
    use crate::emulated::timer::Clock;
    use crate::emulated::uart::Uart;
    use crate::emulated::wire::Wire;
    use crate::shared::frames::Frames;
    use crate::shared::mode_log::ModeLog;
    use crate::shared::release::Release;
    use crate::shared::{critical, final_telegram, load, overruns, time};
    use core::future::poll_fn;
    use core::pin::pin;
    use core::sync::atomic::{AtomicU8, Ordering};
    use etherpen::application::Mode;
    use etherpen::black_box::{Keep, Recorder};
    use etherpen::board::{self, BoardState, EmergencyStopInput, Interlock, PortState};
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

    static SUPERVISOR: Release = Release::new();
    static NETWORK: Release = Release::new();
    /// Tasks that hang from now on, bits of `disturbance`, in the variant that ends while drawing.
    static HANGS: AtomicU8 = AtomicU8::new(0);

    #[shared]
    struct Shared {
        measurements: &'static Measurements,
        #[lock_free]
        frame_port: FramePort<Wire>,
        #[lock_free]
        sampler: Sampler<'static>,
        #[lock_free]
        watch: CycleWatch<'static>,
        #[lock_free]
        serial: Serial,
    }

    #[local]
    struct Local {
        recorder: Recorder<'static>,
        trajectory: TrajectoryTask<'static>,
        link: LinkTask<'static>,
        health: Health,
        network: NetworkTask<'static>,
        supervisor: RobotSupervisor<'static>,
        drain: Drain,
    }

    /// Opens the host's files, starts the Ethernet controller and the clock.
    #[init(local = [channels: Channels = Channels::new()])]
    fn init(context: init::Context) -> (Shared, Local) {
        critical::start_up_check();
        BLACK_BOX.start(Keep::Nothing);
        BLACK_BOX.set_counts_per_s(CLOCK_HZ);
        let parts = context.local.channels.split(NAME, &BLACK_BOX);
        let drain = Drain::open();
        let (bus, route) = route();
        // SAFETY: `init` runs once, and it is the only caller.
        let mmio = unsafe { Mmio::take() };
        let mac = match Lan9118::start(mmio, MASTER_ADDRESS) {
            Ok(mac) => mac,
            Err(error) => panic!("Ethernet controller: {error:?}"),
        };
        // SAFETY: as above. The controller's reset also resets the counter that the clock reads, so the clock comes
        // after.
        let clock = unsafe { Clock::start(bus.is_some()) };
        defmt::info!("emulated board, lockstep {=bool}", bus.is_some());
        parts.measurements.set_counts_per_s(CLOCK_HZ);
        parts.measurements.offer_disturbance();
        let shared = Shared {
            measurements: parts.measurements,
            frame_port: FramePort::new(Wire::new(mac, bus, clock)),
            sampler: parts.sampler,
            watch: CycleWatch::new(parts.measurements),
            serial: Serial::new(parts.host_bytes, route),
        };
        supervisor::spawn().unwrap_or_else(|()| panic!("the supervisor is spawned once"));
        network::spawn().unwrap_or_else(|()| panic!("the network task is spawned once"));
        let local = Local {
            recorder: parts.recorder,
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

    /// Sleeps between interrupts; the time asleep is counted.
    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            load::sleep();
        }
    }

    /// Sends the input telegram, and releases `host_bytes` every millisecond and `trajectory` every twelfth.
    ///
    /// Period: 1 ms. Priority: 15, critical. Deadline: 500 us for the output telegram that follows from it. Overrun:
    /// it shows as lateness in `elapsed_ns`, which the sampler counts; a swallowed period is counted by the clock.
    #[task(
        binds = TIMER0,
        priority = 15,
        shared = [frame_port, sampler, watch, &measurements],
        local = [emergency_stop: EmergencyStopInput = EmergencyStopInput::new(), trajectory_owed: bool = false]
    )]
    fn sample(context: sample::Context) {
        let began_at = free_run();
        load::woke();
        hang_on_request(disturbance::HANG_SAMPLE);
        let (frame_port, sampler) = (context.shared.frame_port, context.shared.sampler);
        final_telegram::prepare(sampler, frame_port);
        let wire = frame_port.driver_mut();
        wire.clock.release(sampler.take_timer_correction_ns());
        let delay = wire.clock.counts_to(began_at);
        log::MILLISECONDS.store(wire.clock.milliseconds(), Ordering::Relaxed);
        lockstep::EARLY_US.store(wire.clock.early_us(), Ordering::Relaxed);
        let missed = wire.clock.missed();
        PERIODS_MISSED.store(missed, Ordering::Relaxed);
        let elapsed_ns = wire.clock.elapsed_ns();
        let met = context.shared.measurements.disturbance();
        let stopped = context
            .local
            .emergency_stop
            .step(met & disturbance::EMERGENCY_STOP != 0 || around::is(around::STOP_OPEN));
        let is_substitute = met & disturbance::CLOCK != 0 || around::is(around::SUBSTITUTE_CLOCK);
        sampler.set_interlock(Interlock::of(stopped, is_substitute));
        let fed = board::may_feed(overruns::TRAJECTORIES_DUE.load(Ordering::Relaxed));
        let is_due = sampler.sample(frame_port, elapsed_ns, missed);
        if fed {
            frame_port.driver_mut().clock.watchdog.feed(began_at);
        }
        let owed = context.local.trajectory_owed;
        if is_due {
            overruns::trajectory_released();
            *owed = true;
        }
        if *owed && !around::is(around::TRAJECTORY_WAITS) {
            *owed = false;
            rtic::pend(Interrupt::FREE15);
        }
        if frame_port.driver_mut().clock.begins_millisecond() {
            rtic::pend(Interrupt::FREE14);
        }
        let run = run(began_at, frame_port.driver_mut());
        context.shared.watch.sample(run, delay, load::slept_counts());
    }

    /// A critical task's run up to here, without the lockstep's part.
    fn run(began_at: u32, wire: &mut Wire) -> Run {
        Run {
            began_at,
            ended_at: free_run(),
            excluded: wire.take_lockstep_counts(),
        }
    }

    /// Takes received frames: on the input reply control and the output telegram, on the output reply the counters.
    ///
    /// Released when a reply's time on the wire is over (lockstep) or by `arrival` (free-running). Period: twice a
    /// millisecond. Priority: 15, critical. Deadline: as for `sample`. Overrun: `bus_deadline` has sent the output
    /// telegram; frames that come while it runs release it again.
    #[task(binds = DUAL_TIMER, priority = 15, shared = [frame_port, sampler, watch])]
    fn bus_frame(context: bus_frame::Context) {
        let began_at = free_run();
        load::woke();
        let (frame_port, sampler) = (context.shared.frame_port, context.shared.sampler);
        let wire = frame_port.driver_mut();
        wire.clock.delivery.acknowledge();
        let elapsed_ns = wire.clock.elapsed_ns();
        let waiting = sampler.awaits_input();
        if sampler.bus_frame(frame_port, elapsed_ns) {
            rtic::pend(Interrupt::DUAL_TIMER);
        }
        let served = waiting && !sampler.awaits_input();
        context
            .shared
            .watch
            .bus_frame(run(began_at, frame_port.driver_mut()), served);
    }

    /// Hands a received frame's interrupt on to `bus_frame`.
    ///
    /// In lockstep the frames have been waited for when they come, and this task does not run (see `wire`). Period:
    /// every received frame, free-running only. Priority: 15, critical. Deadline: as for `sample`. Overrun: releases
    /// merge, `bus_frame` takes all frames.
    #[task(binds = LAN9118, priority = 15, shared = [frame_port])]
    fn arrival(context: arrival::Context) {
        load::woke();
        context.shared.frame_port.driver_mut().acknowledge();
        rtic::pend(Interrupt::DUAL_TIMER);
    }

    /// Sends the output telegram on predicted positions if no valid input has come.
    ///
    /// Period: 1 ms, 300 us behind `sample`. Priority: 15, critical. Deadline: as for `sample`. Overrun: that cycle's
    /// output is late, the sampler counts it; the drives bridge one.
    #[task(binds = TIMER1, priority = 15, shared = [frame_port, sampler, watch, &measurements])]
    fn bus_deadline(context: bus_deadline::Context) {
        let began_at = free_run();
        load::woke();
        let (frame_port, sampler) = (context.shared.frame_port, context.shared.sampler);
        let waiting = sampler.awaits_input();
        let wire = frame_port.driver_mut();
        if wire.clock.deadline.acknowledge() {
            let elapsed_ns = wire.clock.elapsed_ns();
            sampler.bus_deadline(frame_port, elapsed_ns);
        }
        FRAMES_FAILED.store(frame_port.driver_mut().failures(), Ordering::Relaxed);
        let served = waiting && !sampler.awaits_input();
        let watch = context.shared.watch;
        watch.bus_deadline(run(began_at, frame_port.driver_mut()), served);
        if context.shared.measurements.disturbance() & disturbance::NETWORK != 0 {
            let began_at = free_run();
            disturb::foreign_frames(frame_port, log::MILLISECONDS.load(Ordering::Relaxed));
            watch.preempted(run(began_at, frame_port.driver_mut()));
        }
    }

    /// Moves bytes between the host and the link's queues.
    ///
    /// Period: 1 ms, pended by `sample`. Priority: 10. Deadline: the next millisecond. Overrun: pends merge, bytes
    /// wait in the queues.
    #[task(binds = FREE14, priority = 10, shared = [serial, &measurements])]
    fn host_bytes(context: host_bytes::Context) {
        let (serial, measurements) = (context.shared.serial, context.shared.measurements);
        let bits = measurements.disturbance();
        disturb::apply(bits);
        let (ms, early_us) = (
            log::MILLISECONDS.load(Ordering::Relaxed),
            lockstep::EARLY_US.load(Ordering::Relaxed),
        );
        load::urgent(
            || measurements.critical_counts(),
            || serial.exchange((ms, early_us), bits & disturbance::SERIAL != 0),
        );
        rtic::pend(Interrupt::FREE18);
    }

    /// Records the last millisecond and its frames in the black box, hands its report on, then releases `link`.
    ///
    /// Period: 1 ms, pended by `host_bytes`. Priority: 8. Deadline: 4 ms, for the frames 2 ms. Overrun: releases
    /// merge; frames that nobody has copied by then are missing in the black box, which counts them.
    #[task(binds = FREE18, priority = 8, shared = [&measurements], local = [recorder])]
    fn record(context: record::Context) {
        let measurements = context.shared.measurements;
        load::urgent(
            || measurements.critical_counts(),
            || context.local.recorder.tick(&Frames),
        );
        rtic::pend(Interrupt::FREE16);
    }

    /// Loads the firmware with bytes and log lines when the host has asked for it.
    ///
    /// Period: 10.84 us while it is asked for, else off. Priority: 10. Deadline: none. Overrun: ticks merge.
    #[task(binds = SysTick, priority = 10, shared = [serial, &measurements])]
    fn tick(context: tick::Context) {
        load::woke();
        let (serial, measurements) = (context.shared.serial, context.shared.measurements);
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
    fn byte_received(context: byte_received::Context) {
        load::woke();
        context.shared.serial.on_received();
    }

    /// Gives UART0 its next byte, free-running only.
    ///
    /// Period: every byte, free-running only. Priority: 10. Deadline: none. Overrun: bytes wait in the queue.
    #[task(binds = UART0_TX, priority = 10, shared = [serial])]
    fn byte_sent(context: byte_sent::Context) {
        load::woke();
        context.shared.serial.on_sent();
    }

    /// Plans ahead and fills the ring with the next 12 setpoints.
    ///
    /// Period: 12 ms, pended by `sample`. Priority: 6. Deadline: 12 ms. Overrun: a release that found the one before
    /// not completed is counted; the ring holds a plan that ends at rest, so late planning slows the motion down and
    /// never starves it.
    #[task(binds = FREE15, priority = 6, shared = [&measurements], local = [trajectory])]
    fn trajectory(context: trajectory::Context) {
        let measurements = context.shared.measurements;
        let preempting = || measurements.critical_counts().wrapping_add(load::urgent_counts());
        let (began_at, before) = (free_run(), preempting());
        let due = overruns::TRAJECTORIES_DUE.load(Ordering::Relaxed);
        hang_on_request(disturbance::HANG_TRAJECTORY);
        context.local.trajectory.release();
        let taken = free_run().wrapping_sub(began_at);
        let preempted = preempting().wrapping_sub(before);
        measurements.record(Quantity::Trajectory, taken.saturating_sub(preempted));
        overruns::trajectory_completed(due);
    }

    /// Messages of the host, telemetry; then releases the supervisor, the IP stack and the log.
    ///
    /// Period: 1 ms, pended by `record`. Priority: 3. Deadline: none. Overrun: releases merge; the
    /// host sees answers and telemetry late.
    #[task(
        binds = FREE16,
        priority = 3,
        shared = [&measurements],
        local = [link, health, mode_log: ModeLog = ModeLog::new(), drawn_ms: u32 = 0]
    )]
    fn link(context: link::Context) {
        let link = context.local.link;
        link.set_board(BoardState {
            port: match around::is(around::PORT_DOWN) {
                true => PortState::Down,
                false => PortState::Unknown,
            },
            ethernet_errors: FRAMES_FAILED.load(Ordering::Relaxed),
        });
        link.tick();
        let _ = context.local.mode_log.watch(link.mode(), link.fault());
        let bits = context.shared.measurements.disturbance();
        end_on_request(link, bits, context.local.drawn_ms);
        context.local.health.tick(log::MILLISECONDS.load(Ordering::Relaxed));
        SUPERVISOR.release();
        NETWORK.release();
        rtic::pend(Interrupt::FREE17);
    }

    /// The variant for the tests of an end in motion, in the middle of a drawing: the task hangs that `bits` name, or
    /// this panics.
    fn end_on_request(link: &LinkTask, bits: u8, drawn_ms: &mut u32) {
        if cfg!(feature = "end-while-drawing") && link.mode() == Mode::Drawing {
            *drawn_ms = drawn_ms.wrapping_add(1);
            if *drawn_ms >= 2_000 {
                HANGS.store(bits, Ordering::Relaxed);
                assert!(bits != 0, "this image was built to end here");
            }
        }
    }

    /// Hangs if the task of this bit is to hang.
    fn hang_on_request(bit: u8) {
        while cfg!(feature = "end-while-drawing") && HANGS.load(Ordering::Relaxed) & bit != 0 {}
    }

    /// Brings the bus up, watches it, repairs it.
    ///
    /// Period: 1 ms, released by `link`. Priority: 1. Deadline: none. Overrun: steps merge: what it decides is slow.
    #[task(priority = 1, local = [supervisor])]
    async fn supervisor(context: supervisor::Context) {
        SUPERVISOR.poll_each(pin!(context.local.supervisor.run())).await;
    }

    /// Runs the IP stack that finds the addresses for EtherCAT in UDP.
    ///
    /// Period: 1 ms, released by `link`. Priority: 1. Deadline: none. Overrun: steps merge; frames that find its ring
    /// full are dropped and counted.
    #[task(priority = 1, local = [network])]
    async fn network(context: network::Context) {
        let mut run = pin!(context.local.network.run());
        let run = poll_fn(|task| {
            time::tick();
            run.as_mut().poll(task)
        });
        NETWORK.poll_each(pin!(run)).await;
    }

    /// Empties the log's ring into the host's file.
    ///
    /// Period: pended by `link`. Priority: 1. Deadline: none. Overrun: what does not fit the ring is counted.
    #[task(binds = FREE17, priority = 1, local = [drain])]
    fn drain(context: drain::Context) {
        context.local.drain.run();
    }
}
