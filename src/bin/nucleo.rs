//! The controller on an STM32H743: NUCLEO-H743ZI2, RMII Ethernet, serial line to the ST-LINK, and the board's USB.
//!
//! This file contains the wiring: which interrupt releases which task of the library, and at which priority. The tasks'
//! functions are in `etherpen::controller`; the emulated board runs these tasks at these priorities. The table of all
//! tasks is in `docs/tasks.md`.
//!
//! Invariants. The three critical tasks share one priority and own the sampler and the Ethernet driver without a lock;
//! they release others by pending an interrupt, never by a software task's `spawn`, which takes a critical section.
//! Critical sections mask up to priority 14 (`shared::critical`). Nothing else is at hardware priority 0 or 1:
//! `start_up_check` panics otherwise. What the critical tasks run is in ITCM and their own state in DTCM
//! (`stm32h7::tightly_coupled`); DMA memory is in SRAM3, not cached (`stm32h7::memory`).
//!
//! Another board is another file beside this one, with a folder, a binary and a feature of the same name in
//! `Cargo.toml` (with its `stm32-metapac` chip feature), its regions in `memory.x` and their aliases in `build.rs`.
//! With an STM32H7 it uses the drivers in `stm32h7` and brings a folder like `nucleo`: `board.rs` (what those drivers
//! and `shared` require), `pins.rs` (RMII pins, the ports', the emergency-stop input's), `lamps.rs`. `etherpen::board`
//! defines the meaning of inputs and lamps for all boards. `tests/images.rs` gets the addresses that its memory must
//! have, and `etherpen flash` the chip's.
//!
//! Wiring and first start: `docs/nucleo.md`.
#![no_std]
#![no_main]

mod nucleo {
    pub(crate) mod board;
    pub(crate) mod lamps;
    pub(crate) mod pins;
}
mod shared;
mod stm32h7;

use defmt_rtt as _;
use nucleo::board;

#[rtic::app(device = stm32_metapac, peripherals = false, dispatchers = [LPTIM5])]
mod app {
    use crate::board::{EXTERNAL_CLOCK, NAME};
    use crate::nucleo::{lamps, pins};
    use crate::shared::critical::{self, CRITICAL_PRIORITY};
    use crate::shared::frames::Frames;
    use crate::shared::mode_log::ModeLog;
    use crate::shared::release::Release;
    use crate::shared::{final_telegram, load, overruns, time};
    use crate::stm32h7::clocks::{self, Source};
    use crate::stm32h7::eth::{self, Ethernet};
    use crate::stm32h7::health::{Health, Periods};
    use crate::stm32h7::phy::{self as link_state, Sma};
    use crate::stm32h7::serial::{self, Serial};
    use crate::stm32h7::start_up::{self, Waits};
    use crate::stm32h7::usb::{self, Usb};
    use crate::stm32h7::{crash_record, memory, panic, timer, unique_number, watchdog};
    use core::future::poll_fn;
    use core::mem::MaybeUninit;
    use core::pin::pin;
    use core::sync::atomic::Ordering;
    use etherpen::black_box::{Keep, Memory, Recorder};
    use etherpen::board::{self, BoardState, EmergencyStopInput, Interlock, Lamps, RunEnd};
    use etherpen::control::sampler::Sampler;
    use etherpen::controller::{Channels, Parts};
    use etherpen::ethercat::clock::steering::CountCorrection;
    use etherpen::ethercat::frame_port::FramePort;
    use etherpen::ethernet::phy::Phy;
    use etherpen::hash::fnv1a;
    use etherpen::link_task::LinkTask;
    use etherpen::measurement::{CycleWatch, Measurements, Quantity, Run};
    use etherpen::network::NetworkTask;
    use etherpen::robot_bus::RobotSupervisor;
    use etherpen::trajectory_task::TrajectoryTask;
    use stm32_metapac::Interrupt;

    /// Data that the critical tasks share; they have one priority, so no lock is needed.
    #[shared]
    struct Shared {
        #[lock_free]
        sampler: &'static mut Sampler<'static>,
        #[lock_free]
        frame_port: &'static mut FramePort<Ethernet>,
        #[lock_free]
        watch: CycleWatch<'static>,
        measurements: &'static Measurements,
    }

    #[local]
    struct Local {
        recorder: &'static mut Recorder<'static>,
        trajectory: &'static mut TrajectoryTask<'static>,
        link: &'static mut LinkTask<'static>,
        serial: Serial,
        usb: &'static mut Usb,
        supervisor: &'static mut RobotSupervisor<'static>,
        network: &'static mut NetworkTask<'static>,
        phy: Phy,
        clock_source: Source,
    }

    /// Runs once with interrupts disabled: lamps, memory and clocks, drivers, then the check of all priorities.
    ///
    /// The watchdog runs from the first line on, and the crash record names the step in progress: a failed start is
    /// reported by the next one (`stm32h7::start_up`).
    #[init(local = [
        channels: Channels = Channels::new(),
        parts: MaybeUninit<Parts<'static>> = MaybeUninit::uninit(),
        frame_port: MaybeUninit<FramePort<Ethernet>> = MaybeUninit::uninit(),
        usb_memory: usb::Memory = usb::Memory::new()
    ])]
    fn init(mut context: init::Context) -> (Shared, Local) {
        watchdog::start();
        lamps::start();
        lamps::show(start_up::STARTING);
        let (previous, start_failed) = crash_record::take();
        crash_record::step_begins("memory");
        let core = &mut context.core;
        memory::start(&mut core.MPU, &mut core.SCB, &mut core.CPUID);
        let mut waits = Waits::new(&mut core.SYST);
        if let (true, RunEnd::Panic(cause)) = (start_failed, &previous.end) {
            pins::start_serial();
            waits.report_failure(cause, lamps::show);
        }
        crash_record::step_begins("clocks");
        let clock_source = clocks::start(&mut waits);
        crash_record::step_begins("pins");
        pins::start();
        defmt::info!("previous run: {}", defmt::Debug2Format(&previous));
        BLACK_BOX.start(Keep::after(&previous.end));
        BLACK_BOX.set_counts_per_s(clocks::TIMER_HZ);
        let init::LocalResources {
            channels,
            parts,
            frame_port,
            usb_memory,
            ..
        } = context.local;
        let parts = channels.split_into(NAME, &BLACK_BOX, parts);
        parts.link.set_previous_run(previous);
        crash_record::step_begins("Ethernet");
        let unique = unique_number();
        let frame_port = frame_port.write(FramePort::new(Ethernet::new(hardware_address(unique))));
        parts.network.set_hardware_address(frame_port.mac_address());
        crash_record::step_begins("serial line");
        let serial = Serial::new(&mut parts.host_bytes);
        crash_record::step_begins("USB");
        let usb = Usb::start(usb_memory, &unique, &mut parts.usb_bytes, &mut waits);
        crash_record::step_begins("tasks");
        waits.end();
        critical::start_up_check();
        assert!(supervisor::spawn().is_ok(), "the supervisor starts once");
        assert!(network::spawn().is_ok(), "the network task starts once");
        defmt::info!(
            "{=str}: {=u32} MHz, serial line at {=u32} baud",
            NAME,
            clocks::CORE_HZ / 1_000_000,
            serial::BAUD
        );
        if clock_source == Source::Internal {
            defmt::error!("without {=str} nothing will move", EXTERNAL_CLOCK);
        }
        final_telegram::prepare(&mut parts.sampler, frame_port);
        timer::start();
        watchdog::tighten();
        crash_record::start_up_completed();
        parts.measurements.set_counts_per_s(clocks::TIMER_HZ);
        (
            Shared {
                sampler: &mut parts.sampler,
                frame_port,
                watch: CycleWatch::new(parts.measurements),
                measurements: parts.measurements,
            },
            Local {
                recorder: &mut parts.recorder,
                trajectory: &mut parts.trajectory,
                link: &mut parts.link,
                serial,
                usb,
                supervisor: &mut parts.supervisor,
                network: &mut parts.network,
                phy: Phy::new(),
                clock_source,
            },
        )
    }

    /// Sleeps between interrupts; the time asleep is counted.
    #[idle]
    fn idle(_: idle::Context) -> ! {
        loop {
            load::sleep();
        }
    }

    /// Sends the input telegram, and releases `record` every millisecond and `trajectory` every twelfth.
    ///
    /// Period: 1 ms. Priority: 15, critical. Deadline: the next release. Overrun: the elapsed time handed over shows
    /// the lateness, which the sampler counts; more than the configured number in a second is a fault.
    #[task(
        binds = TIM1_UP,
        priority = 15,
        shared = [sampler, frame_port, watch],
        local = [
            clock_source,
            emergency_stop: EmergencyStopInput = EmergencyStopInput::new(),
            periods: Periods = Periods::new(),
            correction: CountCorrection = timer::correction()
        ]
    )]
    fn sample(context: sample::Context) {
        const { assert!(CRITICAL_PRIORITY == 15) };
        let (began_at, delay) = (timer::free_run(), timer::elapsed_counts());
        load::woke();
        timer::acknowledge_sample();
        let missed = context.local.periods.released();
        let resources = context.shared;
        if board::may_feed(overruns::TRAJECTORIES_DUE.load(Ordering::Relaxed)) {
            watchdog::feed();
        }
        let stopped = context.local.emergency_stop.step(pins::emergency_stop_shows_open());
        let internal = *context.local.clock_source == Source::Internal;
        resources.sampler.set_interlock(Interlock::of(stopped, internal));
        let alone = resources.sampler.has_the_wire_alone();
        resources.frame_port.driver_mut().keep_foreign_frames_out(alone);
        let correction_ns = resources.sampler.take_timer_correction_ns();
        timer::steer(context.local.correction, correction_ns);
        if resources
            .sampler
            .sample(resources.frame_port, timer::elapsed_ns(), missed)
        {
            overruns::trajectory_released();
            rtic::pend(Interrupt::LPTIM2);
        }
        rtic::pend(Interrupt::LPTIM1);
        resources.watch.sample(run(began_at), delay, load::slept_counts());
    }

    /// A critical task's run up to here.
    fn run(began_at: u32) -> Run {
        Run {
            began_at,
            ended_at: timer::free_run(),
            excluded: 0,
        }
    }

    /// Takes received frames: on the input reply control and the output telegram, on the output reply the counters.
    ///
    /// Period: twice a millisecond and once for each foreign frame. Priority: 15, critical. Deadline: 500 us after the
    /// sample for the output telegram. Overrun: `bus_deadline` has sent the output of this cycle already; the late
    /// reply is counted.
    #[task(binds = ETH, priority = 15, shared = [sampler, frame_port, watch])]
    fn bus_frame(context: bus_frame::Context) {
        let began_at = timer::free_run();
        load::woke();
        let resources = context.shared;
        resources.frame_port.driver_mut().acknowledge();
        let waiting = resources.sampler.awaits_input();
        if resources.sampler.bus_frame(resources.frame_port, timer::elapsed_ns()) {
            rtic::pend(Interrupt::ETH);
        }
        let served = waiting && !resources.sampler.awaits_input();
        resources.watch.bus_frame(run(began_at), served);
    }

    /// Sends the output telegram on predicted positions if no valid input has come.
    ///
    /// Period: 1 ms, 300 us behind `sample`. Priority: 15, critical. Deadline: 500 us after the sample. Overrun: that
    /// cycle's output is late, the sampler counts it; the drives bridge one.
    #[task(binds = TIM1_CC, priority = 15, shared = [sampler, frame_port, watch])]
    fn bus_deadline(context: bus_deadline::Context) {
        let began_at = timer::free_run();
        load::woke();
        timer::acknowledge_bus_deadline();
        let resources = context.shared;
        let waiting = resources.sampler.awaits_input();
        resources
            .sampler
            .bus_deadline(resources.frame_port, timer::elapsed_ns());
        let served = waiting && !resources.sampler.awaits_input();
        resources.watch.bus_deadline(run(began_at), served);
    }

    /// Moves bytes between the serial port's FIFOs and the link's queues.
    ///
    /// Period: 8 received bytes, an idle line or an empty transmit FIFO, and every millisecond. Priority: 10.
    /// Deadline: 86 us, the other half of the receive FIFO. Overrun: bytes are lost and counted, the link repeats the
    /// frame.
    #[task(binds = USART3, priority = 10, shared = [&measurements], local = [serial])]
    fn host_bytes(context: host_bytes::Context) {
        load::woke();
        let measurements = context.shared.measurements;
        load::urgent(|| measurements.critical_counts(), || context.local.serial.service());
    }

    /// Records the last millisecond and its frames in the black box, hands its report on, then releases `link`.
    ///
    /// Period: 1 ms. Priority: 8. Deadline: 4 ms, for the frames 2 ms. Overrun: releases merge; frames that nobody
    /// has copied by then are missing in the black box, which counts them.
    #[task(binds = LPTIM1, priority = 8, shared = [&measurements], local = [recorder])]
    fn record(context: record::Context) {
        let measurements = context.shared.measurements;
        load::urgent(
            || measurements.critical_counts(),
            || context.local.recorder.tick(&Frames),
        );
        rtic::pend(Interrupt::LPTIM3);
    }

    /// Plans ahead and fills the ring with the next 12 setpoints.
    ///
    /// Period: 12 ms. Priority: 6. Deadline: 12 ms. Overrun: a release that found the one before not completed is
    /// counted; the ring holds a plan that ends at rest, so late planning slows the motion down and never starves it.
    #[task(binds = LPTIM2, priority = 6, shared = [&measurements], local = [trajectory])]
    fn trajectory(context: trajectory::Context) {
        let measurements = context.shared.measurements;
        let preempting = || measurements.critical_counts().wrapping_add(load::urgent_counts());
        let (began_at, before) = (timer::free_run(), preempting());
        let due = overruns::TRAJECTORIES_DUE.load(Ordering::Relaxed);
        context.local.trajectory.release();
        let taken = timer::free_run().wrapping_sub(began_at);
        let preempted = preempting().wrapping_sub(before);
        measurements.record(Quantity::Trajectory, taken.saturating_sub(preempted));
        overruns::trajectory_completed(due);
    }

    /// Moves packets between the board's own USB and the link's queues.
    ///
    /// Period: events of the bus, at most 32 in a millisecond, and every millisecond. Priority: 3. Deadline: none.
    /// Overrun: the host's packets wait, nothing is lost.
    #[task(binds = OTG_FS, priority = 3, local = [usb])]
    fn usb_bytes(context: usb_bytes::Context) {
        load::woke();
        context.local.usb.service();
    }

    /// Messages of the host, telemetry; then releases the ports, the supervisor and the PHY.
    ///
    /// Period: 1 ms. Priority: 3. Deadline: 1 ms. Overrun: releases merge; the host sees answers and telemetry late.
    #[task(binds = LPTIM3, priority = 3, local = [link, mode_log: ModeLog = ModeLog::new(), ms: u32 = 0])]
    fn link(context: link::Context) {
        let link::LocalResources { link, mode_log, ms, .. } = context.local;
        let port = link_state::port();
        link.set_board(BoardState {
            port,
            ethernet_errors: eth::errors(),
        });
        link.tick();
        *ms = ms.wrapping_add(1);
        lamps::show(Lamps::show(link.mode(), port, *ms));
        if let Some(fault) = mode_log.watch(link.mode(), link.fault()) {
            crash_record::store_fault(&fault);
        }
        rtic::pend(Interrupt::USART3);
        usb::release();
        rtic::pend(Interrupt::LPTIM4);
        SUPERVISOR.release();
        NETWORK.release();
    }

    /// In memory that no start clears; `memory` has clocked it.
    #[unsafe(link_section = ".black_box")]
    static BLACK_BOX: Memory = Memory::new();

    static SUPERVISOR: Release = Release::new();
    static NETWORK: Release = Release::new();

    /// Brings the bus up, watches it, repairs it.
    ///
    /// Period: 1 ms. Priority: 1. Deadline: none. Overrun: steps merge: what it decides is slow.
    #[task(priority = 1, local = [supervisor])]
    async fn supervisor(context: supervisor::Context) {
        SUPERVISOR.poll_each(pin!(context.local.supervisor.run())).await;
    }

    /// Runs the IP stack that finds the addresses for EtherCAT in UDP.
    ///
    /// Period: 1 ms. Priority: 1. Deadline: none. Overrun: steps merge; frames that find its ring full are dropped and
    /// counted.
    #[task(priority = 1, local = [network])]
    async fn network(context: network::Context) {
        let mut run = pin!(context.local.network.run());
        let run = poll_fn(|task| {
            time::tick();
            run.as_mut().poll(task)
        });
        NETWORK.poll_each(pin!(run)).await;
    }

    /// Polls the PHY for the link's state, logs what changed and what was counted, and starts the firmware again on the
    /// ST-LINK's clock when it comes late: until then no drive gets power.
    ///
    /// Period: 1 ms. Priority: 1. Deadline: none. Overrun: steps merge; the link's state is known later.
    #[task(binds = LPTIM4, priority = 1, local = [phy, health: Health = Health::new()])]
    fn phy(context: phy::Context) {
        if let Some(event) = context.local.phy.step(&mut Sma) {
            link_state::publish(context.local.phy.port());
            defmt::info!("PHY: {}", defmt::Debug2Format(&event));
        }
        context.local.health.step();
        if clocks::external_clock_appeared() {
            BLACK_BOX.end();
            panic::end(format_args!("{EXTERNAL_CLOCK} have come: started again on them"));
        }
    }

    /// A locally administered address from the chip's unique number, so that two boards differ.
    fn hardware_address(unique: [u8; 12]) -> [u8; 6] {
        let hash = fnv1a(unique);
        let [a, b, c, d, ..] = (hash ^ hash >> 32).to_le_bytes();
        [0x02, 0x00, a, b, c, d]
    }
}
