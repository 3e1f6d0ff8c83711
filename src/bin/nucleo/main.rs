//! The controller on an STM32H743: NUCLEO-H743ZI2, RMII Ethernet, serial line to the ST-LINK, and the board's USB.
//!
//! This folder contains the wiring: which interrupt releases which task of the library, at which priority, and the
//! drivers of this chip. The tasks' functions are in `etherpen::controller`; the emulated board runs these tasks at
//! these priorities.
//!
//! The table of all tasks is in `docs/tasks.md`.
//!
//! Invariants. The three critical tasks share one priority and own the sampler and the Ethernet driver without a lock;
//! they release others by pending an interrupt, never by a software task's `spawn`, which takes a critical section.
//! Critical sections mask up to priority 14 (`critical.rs`). Nothing else is at hardware priority 0 or 1:
//! `start_up_check` panics otherwise. What the critical tasks run is in ITCM and their own state in
//! DTCM (`coupled.rs`); DMA memory is in SRAM3, not cached (`memory.rs`).
//!
//! Another STM32 with Ethernet is another folder beside this one and a binary and feature of the same name in
//! `Cargo.toml` (with its `stm32-metapac` chip feature), its regions in `memory.x` and their aliases in `build.rs`. Of
//! this folder it changes `clocks.rs` (clock tree), `pins.rs` (RMII pins, the ports', the emergency-stop input's),
//! `lamps.rs`, `memory.rs` (the SRAM that its Ethernet DMA reaches) and the interrupts' names below; `eth.rs` serves every
//! chip whose MAC that crate calls `eth_v2` (STM32H5 and STM32H7), `timer.rs` needs a timer with separate update and compare
//! vectors, `kept.rs` and `watchdog.rs` the reset flags and the watchdog of an H7. What the inputs and lamps mean is
//! `etherpen::board`, the same for all. `tests/images.rs` gets the addresses that its memory must have, and
//! `etherpen flash` the chip's.
//!
//! Wiring and first start: `docs/nucleo.md`.
#![no_std]
#![no_main]

mod clocks;
#[path = "../shared/copy.rs"]
mod copy;
mod coupled;
mod critical;
mod eth;
mod health;
mod kept;
mod lamps;
#[path = "../shared/last_word.rs"]
mod last_word;
#[path = "../shared/load.rs"]
mod load;
mod memory;
#[path = "../shared/modes.rs"]
mod modes;
mod panic;
mod phy;
mod pins;
mod release;
mod serial;
mod start_up;
#[path = "../shared/time.rs"]
mod time;
mod timer;
mod usb;
mod watchdog;

use defmt_rtt as _;
use stm32_metapac::Interrupt;

/// Name by which the host knows the board.
const BOARD: &str = "nucleo";
/// The Ethernet port.
pub(crate) type Port = eth::Ethernet;
/// Interrupts of the critical tasks.
const CRITICAL: [Interrupt; 3] = [Interrupt::TIM1_UP, Interrupt::TIM1_CC, Interrupt::ETH];

#[rtic::app(device = stm32_metapac, peripherals = false, dispatchers = [LPTIM5])]
mod app {
    use crate::clocks::Source;
    use crate::critical::{self, CRITICAL_PRIORITY};
    use crate::eth::{self, Ethernet};
    use crate::health::{self, Health, Periods};
    use crate::modes::Modes;
    use crate::phy::{self as link_state, Sma};
    use crate::release::Release;
    use crate::serial::{self, Serial};
    use crate::start_up::{self, Waits};
    use crate::usb::{self, Usb};
    use crate::{BOARD, CRITICAL, clocks, kept, lamps, last_word, load, memory, panic, pins, time, timer, watchdog};
    use core::future::poll_fn;
    use core::mem::MaybeUninit;
    use core::pin::pin;
    use etherpen::board::{self, BoardState, EmergencyStopInput, Interlock, Lamps, RunEnd};
    use etherpen::control::sampler::Sampler;
    use etherpen::controller::{Channels, Parts};
    use etherpen::ethercat::clock::steering::CountCorrection;
    use etherpen::ethercat::frame_port::FramePort;
    use etherpen::ethernet::phy::Phy;
    use etherpen::link_task::LinkTask;
    use etherpen::measurement::{CycleWatch, Measurements, Quantity, Run};
    use etherpen::network::NetworkTask;
    use etherpen::robot_bus::RobotSupervisor;
    use etherpen::trajectory_task::TrajectoryTask;
    use stm32_metapac::{Interrupt, UID};

    /// What the critical tasks share: they have one priority, so no lock exists.
    #[shared]
    struct Shared {
        #[lock_free]
        sampler: &'static mut Sampler<'static>,
        #[lock_free]
        wire: &'static mut FramePort<Ethernet>,
        #[lock_free]
        watch: CycleWatch<'static>,
        measurements: &'static Measurements,
    }

    #[local]
    struct Local {
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
    /// The watchdog runs from the first line on, and memory keeps the step that is under way: a start that fails is told by
    /// the next one (`start_up.rs`).
    #[init(local = [
        channels: Channels = Channels::new(),
        parts: MaybeUninit<Parts<'static>> = MaybeUninit::uninit(),
        wire: MaybeUninit<FramePort<Ethernet>> = MaybeUninit::uninit(),
        usb_memory: usb::Memory = usb::Memory::new()
    ])]
    fn init(mut context: init::Context) -> (Shared, Local) {
        watchdog::start();
        lamps::start();
        lamps::show(start_up::STARTING);
        let (previous, start_failed) = kept::take();
        kept::starting("memory");
        let core = &mut context.core;
        memory::start(&mut core.MPU, &mut core.SCB, &mut core.CPUID);
        let mut waits = Waits::new(&mut core.SYST);
        if let (true, RunEnd::Panic(cause)) = (start_failed, &previous.end) {
            waits.tell(cause);
        }
        kept::starting("clocks");
        let clock_source = clocks::start(&mut waits);
        kept::starting("pins");
        pins::start();
        defmt::info!("previous run: {}", defmt::Debug2Format(&previous));
        let init::LocalResources {
            channels,
            parts,
            wire,
            usb_memory,
            ..
        } = context.local;
        let parts = parts.write(channels.split(BOARD));
        parts.link.set_previous_run(previous);
        kept::starting("Ethernet");
        let unique = unique_number();
        let wire = wire.write(FramePort::new(Ethernet::new(hardware_address(unique))));
        parts.network.set_hardware_address(wire.mac_address());
        kept::starting("serial line");
        let serial = Serial::new(&mut parts.host_bytes);
        kept::starting("USB");
        let usb = Usb::start(usb_memory, &unique, &mut parts.usb_bytes, &mut waits);
        kept::starting("tasks");
        critical::start_up_check(&mut core.SYST, &CRITICAL);
        assert!(supervisor::spawn().is_ok(), "the supervisor starts once");
        assert!(network::spawn().is_ok(), "the network task starts once");
        defmt::info!(
            "{=str}: {=u32} MHz, serial line at {=u32} baud",
            BOARD,
            clocks::CORE_HZ / 1_000_000,
            serial::BAUD
        );
        if clock_source == Source::Substitute {
            defmt::error!("no 8 MHz from the ST-LINK: nothing will move");
        }
        last_word::prepare(&mut parts.sampler, wire);
        timer::start();
        watchdog::tighten();
        kept::started();
        parts.measurements.set_counts_per_s(clocks::TIMER_HZ);
        (
            Shared {
                sampler: &mut parts.sampler,
                wire,
                watch: CycleWatch::new(parts.measurements),
                measurements: parts.measurements,
            },
            Local {
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

    /// Sends the input telegram, and releases `link` and every twelfth time `trajectory`.
    ///
    /// Period: 1 ms. Priority: 15, critical. Deadline: the next release. Overrun: the elapsed time handed over shows
    /// the lateness, which the sampler counts; more than the configured number in a second is a fault.
    #[task(
        binds = TIM1_UP,
        priority = 15,
        shared = [sampler, wire, watch],
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
        if board::may_feed(health::trajectories_due()) {
            watchdog::feed();
        }
        let stopped = context.local.emergency_stop.step(pins::emergency_stop_shows_open());
        let substitute = *context.local.clock_source == Source::Substitute;
        resources.sampler.set_interlock(Interlock::of(stopped, substitute));
        let alone = resources.sampler.has_the_wire_alone();
        resources.wire.driver_mut().keep_foreign_frames_out(alone);
        let correction_ns = resources.sampler.take_timer_correction_ns();
        timer::steer(context.local.correction, correction_ns);
        if resources.sampler.sample(resources.wire, timer::elapsed_ns(), missed) {
            health::trajectory_released();
            rtic::pend(Interrupt::LPTIM2);
        }
        rtic::pend(Interrupt::LPTIM3);
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
    #[task(binds = ETH, priority = 15, shared = [sampler, wire, watch])]
    fn bus_frame(context: bus_frame::Context) {
        let began_at = timer::free_run();
        load::woke();
        let resources = context.shared;
        resources.wire.driver_mut().acknowledge();
        let waiting = resources.sampler.awaits_input();
        if resources.sampler.bus_frame(resources.wire, timer::elapsed_ns()) {
            rtic::pend(Interrupt::ETH);
        }
        let served = waiting && !resources.sampler.awaits_input();
        resources.watch.bus_frame(run(began_at), served);
    }

    /// Sends the output telegram on predicted positions if no valid input has come.
    ///
    /// Period: 1 ms, 300 us behind `sample`. Priority: 15, critical. Deadline: 500 us after the sample. Overrun: that
    /// cycle's output is late, the sampler counts it; the drives bridge one.
    #[task(binds = TIM1_CC, priority = 15, shared = [sampler, wire, watch])]
    fn bus_deadline(context: bus_deadline::Context) {
        let began_at = timer::free_run();
        load::woke();
        timer::acknowledge_bus_deadline();
        let resources = context.shared;
        let waiting = resources.sampler.awaits_input();
        resources.sampler.bus_deadline(resources.wire, timer::elapsed_ns());
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

    /// Plans ahead and fills the ring with the next 12 setpoints.
    ///
    /// Period: 12 ms. Priority: 6. Deadline: 12 ms. Overrun: a release that found the one before not completed is
    /// counted; the ring holds a plan that ends at rest, so late planning slows the motion down and never starves it.
    #[task(binds = LPTIM2, priority = 6, shared = [&measurements], local = [trajectory])]
    fn trajectory(context: trajectory::Context) {
        let measurements = context.shared.measurements;
        let preempting = || measurements.critical_counts().wrapping_add(load::urgent_counts());
        let (began_at, before) = (timer::free_run(), preempting());
        health::trajectory_runs(|| context.local.trajectory.release());
        let taken = timer::free_run().wrapping_sub(began_at);
        let preempted = preempting().wrapping_sub(before);
        measurements.record(Quantity::Trajectory, taken.saturating_sub(preempted));
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
    #[task(binds = LPTIM3, priority = 3, local = [link, modes: Modes = Modes::new(), ms: u32 = 0])]
    fn link(context: link::Context) {
        let link::LocalResources { link, modes, ms, .. } = context.local;
        let port = link_state::port();
        link.set_board(BoardState {
            port,
            ethernet_errors: eth::errors(),
        });
        link.tick();
        *ms = ms.wrapping_add(1);
        lamps::show(Lamps::show(link.mode(), port, *ms));
        if let Some(fault) = modes.watch(link.mode(), link.fault()) {
            kept::keep_fault(&fault);
        }
        rtic::pend(Interrupt::USART3);
        usb::release();
        rtic::pend(Interrupt::LPTIM4);
        SUPERVISOR.now();
        NETWORK.now();
    }

    static SUPERVISOR: Release = Release::new();
    static NETWORK: Release = Release::new();

    /// Brings the bus up, watches it, repairs it.
    ///
    /// Period: 1 ms. Priority: 1. Deadline: none. Overrun: steps merge: what it decides is slow.
    #[task(priority = 1, local = [supervisor])]
    async fn supervisor(context: supervisor::Context) {
        // It registers no waker: what it waits for are critical tasks, which may not wake.
        let mut run = pin!(context.local.supervisor.run());
        poll_fn(|task| {
            SUPERVISOR.wait(task.waker());
            run.as_mut().poll(task)
        })
        .await
    }

    /// Runs the IP stack that finds the addresses for EtherCAT in UDP.
    ///
    /// Period: 1 ms. Priority: 1. Deadline: none. Overrun: steps merge; frames that find its ring full are dropped and
    /// counted.
    #[task(priority = 1, local = [network])]
    async fn network(context: network::Context) {
        let mut run = pin!(context.local.network.run());
        poll_fn(|task| {
            NETWORK.wait(task.waker());
            time::tick();
            run.as_mut().poll(task)
        })
        .await
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
        if clocks::exact_source_has_come() {
            panic::end(format_args!(
                "the 8 MHz from the ST-LINK have come: started again on them"
            ));
        }
    }

    /// The chip's own number.
    fn unique_number() -> [u8; 12] {
        let mut bytes = [0; 12];
        for (word, four) in bytes.chunks_exact_mut(4).enumerate() {
            four.copy_from_slice(&UID.uid(word).read().to_le_bytes());
        }
        bytes
    }

    /// A locally administered address from the chip's unique number (FNV-1a), so that two boards differ.
    fn hardware_address(unique: [u8; 12]) -> [u8; 6] {
        let folded = unique.iter().fold(0x811C_9DC5u32, |hash, byte| {
            (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193)
        });
        let [a, b, c, d] = folded.to_le_bytes();
        [0x02, 0x00, a, b, c, d]
    }
}
