//! ethercrab, an independent master, on the virtual segment: one cable, two network namespaces.

use crate::network::Network;
use crate::program::{Folder, Running, etherpen};
use ethercrab::std::{ethercat_now, tx_rx_task};
use ethercrab::subdevice_group::{DcConfiguration, HasDc, Op};
use ethercrab::{
    DcSupport, DcSync, DefaultLock, MainDevice, MainDeviceConfig, PduStorage, RetryBehaviour, SubDevice,
    SubDeviceGroup, SubDeviceRef, Timeouts, error::Error,
};
use std::ops::{Deref, DerefMut};
use std::pin::{Pin, pin};
use std::sync::Arc;
use std::task::{Context, Poll, Wake, Waker};
use std::thread::Thread;
use std::time::{Duration, Instant};

/// Cycles required without a wrong working counter.
const CYCLES: usize = 10_000;
const DRIVES: usize = 4;
/// Room for slaves; a power of two.
const SLAVES_MAX: usize = 16;
/// Room for process data, bytes.
const IMAGE_BYTES: usize = 64;
/// Every drive is read (1) and written (2).
const WORKING_COUNTER: u16 = 3 * DRIVES as u16;
/// Most cycles until the drives follow a control word.
const OBEY_CYCLES_MAX: usize = 2_000;
/// Longest wait for OP.
const PATIENCE: Duration = Duration::from_secs(60);
/// Velocity demand, digits; 140 are one revolution of the motor in a minute.
const DEMAND: i32 = 14_000;

/// Divider of the process-data watchdog, 100 us (register 0x0400), and the watchdog in these units, 6 s: a computer
/// under load stops this program for longer than the default 100 ms.
const WATCHDOG_DIVIDER: (u16, u16) = (0x0400, 2_498);
const WATCHDOG_TIME: (u16, u16) = (0x0420, 60_000);

type Storage = PduStorage<16, { PduStorage::element_size(1100) }>;

/// The storages of the two tests: each can be used once.
static STORAGE: Storage = PduStorage::new();
static MIXED_STORAGE: Storage = PduStorage::new();

/// Coupler, terminals and drives of three makers.
const MIXED: &str = "ek1100,el1008,el2004,ax2000,akd,cia402";
/// Product code of the AKD, which refuses SAFEOP with the process data that it has unasked.
const AKD: u32 = 0x0041_4B44;
/// Clocks as ethercrab sees them. A terminal's features announce one; whether it has a clock, only its register tells.
const MIXED_CLOCKS: [DcSupport; 6] = [
    DcSupport::RefOnly,
    DcSupport::Bits64,
    DcSupport::Bits64,
    DcSupport::Bits64,
    DcSupport::Bits32,
    DcSupport::Bits64,
];
/// First drive of the mixed chain, and the place of its EL2004.
const MIXED_DRIVES_FROM: usize = 3;
const MIXED_DRIVES: [MixedDrive; 3] = [
    MixedDrive {
        device_name: "AX2000-B110 EtherCAT Drive",
        mode: -2,
        control_first: false,
        clock_bits: 64,
    },
    MixedDrive {
        device_name: "AKD",
        mode: 9,
        control_first: false,
        clock_bits: 32,
    },
    MixedDrive {
        device_name: "etherpen CiA 402 drive",
        mode: 9,
        control_first: true,
        clock_bits: 64,
    },
];
const EL2004: usize = 2;
/// Inputs add 1, outputs 2: EL1008, EL2004, and both for each of three drives.
const MIXED_WORKING_COUNTER: u16 = 1 + 2 + 3 * 3;
const SYNC0: Duration = Duration::from_millis(1);
/// Start of the pulses after their configuration.
const SYNC0_DELAY: Duration = Duration::from_millis(100);
/// Device name and mode of operation, objects.
const DEVICE_NAME: u16 = 0x1008;
const MODE: u16 = 0x6060;
/// System time, activation of SYNC0, its next pulse and its period, registers; the activation of the pulses.
const SYSTEM_TIME: u16 = 0x0910;
const SYNC_ACTIVATION: u16 = 0x0981;
const SYNC0_NEXT: u16 = 0x0990;
const SYNC0_PERIOD: u16 = 0x09A0;
const SYNC0_ACTIVE: u8 = 3;

/// Control words that enable a drive, and the status word, under its mask, that each of them leads to.
const STEPS: [(u16, u16); 3] = [(0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)];
const STATUS_MASK: u16 = 0x6F;

/// A drive of the mixed chain: its object "Device name", its velocity mode, the order of its process data, and the length of
/// its clock.
struct MixedDrive {
    device_name: &'static str,
    mode: i8,
    control_first: bool,
    clock_bits: u32,
}

impl MixedDrive {
    fn outputs(&self, demand: i32, control: u16) -> [u8; 6] {
        let mut bytes = outputs(demand, control);
        if self.control_first {
            bytes.rotate_right(2);
        }
        bytes
    }

    fn inputs(&self, bytes: &[u8]) -> (i32, u16) {
        let mut bytes = bytes.to_vec();
        if self.control_first {
            bytes.rotate_left(2);
        }
        inputs(&bytes)
    }

    /// Whether the next SYNC0 pulse lies ahead; its register keeps a start time that was missed.
    fn is_ahead(&self, next_ns: u64, now_ns: u64) -> bool {
        let unused_bits = u64::BITS - self.clock_bits;
        (next_ns.wrapping_sub(now_ns) << unused_bits).cast_signed() > 0
    }
}

type MixedGroup = SubDeviceGroup<SLAVES_MAX, IMAGE_BYTES, DefaultLock, Op, HasDc>;

struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

/// Runs `work` while `driver` moves its frames.
fn drive<T>(mut driver: Pin<&mut impl Future>, work: impl Future<Output = T>) -> T {
    let waker = Waker::from(Arc::new(Unpark(std::thread::current())));
    let mut context = Context::from_waker(&waker);
    let mut work = pin!(work);
    loop {
        if let Poll::Ready(result) = work.as_mut().poll(&mut context) {
            return result;
        }
        assert!(driver.as_mut().poll(&mut context).is_pending(), "the socket was lost");
        std::thread::park();
    }
}

/// Inputs of a drive: position and CiA 402 status word.
fn inputs(bytes: &[u8]) -> (i32, u16) {
    let position = i32::from_le_bytes(bytes[..4].try_into().expect("four bytes"));
    (position, u16::from_le_bytes([bytes[4], bytes[5]]))
}

/// Outputs to a drive: velocity demand and control word.
fn outputs(demand: i32, control: u16) -> [u8; 6] {
    let mut bytes = [0; 6];
    bytes[..4].copy_from_slice(&demand.to_le_bytes());
    bytes[4..].copy_from_slice(&control.to_le_bytes());
    bytes
}

/// Assigns velocity demand and control word to the outputs, position and status word to the inputs.
async fn assign(drive: &SubDeviceRef<'_, impl Deref<Target = SubDevice>>) -> Result<(), Error> {
    for (list, pdo) in [(0x1C12, 0x1702_u16), (0x1C13, 0x1B01)] {
        drive.sdo_write(list, 0, 0_u8).await?;
        drive.sdo_write(list, 1, pdo).await?;
        drive.sdo_write(list, 0, 1_u8).await?;
    }
    Ok(())
}

/// From power-up to turning drives; returns the cycles and the wrong working counters.
async fn run(maindevice: &MainDevice<'_>) -> Result<(usize, usize), Error> {
    let group = maindevice
        .init_single_group::<SLAVES_MAX, IMAGE_BYTES>(ethercat_now)
        .await?;
    assert_eq!(group.len(), DRIVES);
    for drive in group.iter(maindevice) {
        let identity = drive.identity();
        assert_eq!(
            (identity.vendor_id, identity.product_id),
            (2, 0x07D0_6014),
            "{}",
            drive.name()
        );
        for (register, value) in [WATCHDOG_DIVIDER, WATCHDOG_TIME] {
            drive.register_write(register, value).await?;
        }
        // Digital speed.
        assign(&drive).await?;
        drive.sdo_write(0x6060, 0, -2_i8).await?;
    }
    let group = group.into_safe_op(maindevice).await?;
    let group = group.request_into_op(maindevice).await?;
    let (mut cycles, mut wrong) = (0, 0);
    let mut before_op = 0;
    while !group.tx_rx(maindevice).await?.all_op() {
        before_op += 1;
        assert!(before_op < OBEY_CYCLES_MAX, "not in OP");
    }
    let mut wait_for = OBEY_CYCLES_MAX;
    let mut steps = STEPS.into_iter();
    let mut step = steps.next();
    let mut start = None;
    while cycles < CYCLES || step.is_some() {
        let (control, state) = step.unwrap_or((0x0F, 0x27));
        let demand = if step.is_none() { DEMAND } else { 0 };
        for drive in group.iter(maindevice) {
            drive.outputs_raw_mut().copy_from_slice(&outputs(demand, control));
        }
        let response = group.tx_rx(maindevice).await?;
        cycles += 1;
        wrong += usize::from(response.working_counter != WORKING_COUNTER);
        assert!(response.all_op(), "cycle {cycles}: {:?}", response.subdevice_states);
        let drives: Vec<_> = group
            .iter(maindevice)
            .map(|drive| inputs(&drive.inputs_raw()))
            .collect();
        let all_there = drives.iter().all(|(_, status)| status & STATUS_MASK == state);
        if step.is_some() && all_there {
            step = steps.next();
            wait_for = OBEY_CYCLES_MAX;
        } else if step.is_some() {
            wait_for -= 1;
            assert!(wait_for > 0, "control word {control:#x}: {drives:x?}");
        } else {
            assert!(all_there, "cycle {cycles}: {drives:x?}");
        }
        if step.is_none() && start.is_none() {
            start = Some(drives.clone());
        }
        if cycles == CYCLES {
            let moved = drives.iter().zip(start.iter().flatten());
            assert!(moved.clone().all(|(now, then)| now.0 != then.0), "{moved:?}");
        }
    }
    Ok((cycles, wrong))
}

/// Mode and process data of a drive in PREOP, and its names in its information memory and its object dictionary.
async fn set_up(drive: &SubDeviceRef<'_, impl DerefMut<Target = SubDevice>>, kind: &MixedDrive) -> Result<(), Error> {
    let mut name = drive.description().await?.unwrap_or_default();
    assert!(!name.is_empty(), "a name in the information memory");
    name = drive.sdo_read(DEVICE_NAME, 0).await?;
    assert_eq!(name, kind.device_name);
    for (register, value) in [WATCHDOG_DIVIDER, WATCHDOG_TIME] {
        drive.register_write(register, value).await?;
    }
    if drive.identity().product_id == AKD {
        assign(drive).await?;
    }
    drive.sdo_write(MODE, 0, kind.mode).await
}

/// One cycle in which all drives get a demand and a control word; their positions and status words, and whether the
/// working counter was right.
async fn cycle_mixed(
    maindevice: &MainDevice<'_>,
    group: &MixedGroup,
    (demand, control, pattern): (i32, u16, u8),
) -> Result<(Vec<(i32, u16)>, bool), Error> {
    let mut inputs = Vec::new();
    for (place, slave) in group.iter(maindevice).enumerate() {
        match place.checked_sub(MIXED_DRIVES_FROM).map(|drive| &MIXED_DRIVES[drive]) {
            Some(kind) => {
                inputs.push(kind.inputs(&slave.inputs_raw()));
                slave.outputs_raw_mut().copy_from_slice(&kind.outputs(demand, control));
            }
            None if place == EL2004 => slave.outputs_raw_mut().fill(pattern),
            None => {}
        }
    }
    let response = group.tx_rx_dc(maindevice).await?;
    assert!(response.all_op(), "{:?}", response.subdevice_states);
    Ok((inputs, response.working_counter == MIXED_WORKING_COUNTER))
}

/// Whether SYNC0 runs in all drives.
async fn check_sync0(maindevice: &MainDevice<'_>, group: &MixedGroup) -> Result<(), Error> {
    for (drive, kind) in group.iter(maindevice).skip(MIXED_DRIVES_FROM).zip(&MIXED_DRIVES) {
        assert_eq!(drive.register_read::<u8>(SYNC_ACTIVATION).await?, SYNC0_ACTIVE);
        let period_ns = drive.register_read::<u32>(SYNC0_PERIOD).await?;
        assert_eq!(u128::from(period_ns), SYNC0.as_nanos());
        let now_ns = drive.register_read::<u64>(SYSTEM_TIME).await?;
        let next_ns = drive.register_read::<u64>(SYNC0_NEXT).await?;
        assert!(
            kind.is_ahead(next_ns, now_ns),
            "{}: {next_ns} after {now_ns} ns",
            kind.device_name
        );
    }
    Ok(())
}

/// The mixed chain from power-up to OP with SYNC0 pulses and turning drives; returns the cycles and the wrong working counters.
async fn run_mixed(maindevice: &MainDevice<'_>) -> Result<(usize, usize), Error> {
    let mut group = maindevice
        .init_single_group::<SLAVES_MAX, IMAGE_BYTES>(ethercat_now)
        .await?;
    let clocks: Vec<_> = group.iter(maindevice).map(|slave| slave.dc_support()).collect();
    assert_eq!(clocks, MIXED_CLOCKS);
    for (mut drive, kind) in group.iter_mut(maindevice).skip(MIXED_DRIVES_FROM).zip(&MIXED_DRIVES) {
        set_up(&drive, kind).await?;
        drive.set_dc_sync(DcSync::Sync0);
    }
    let group = group.into_pre_op_pdi(maindevice).await?;
    let clocks = DcConfiguration {
        start_delay: SYNC0_DELAY,
        sync0_period: SYNC0,
        sync0_shift: Duration::ZERO,
    };
    let group = group.configure_dc_sync(maindevice, clocks).await?;
    let group = group.into_safe_op(maindevice).await?;
    let group = group.request_into_op(maindevice).await?;
    // Cycles follow each other as fast as the computer allows; the drives wait for their first pulse.
    let since = Instant::now();
    loop {
        let response = group.tx_rx_dc(maindevice).await?;
        if response.all_op() {
            break;
        }
        assert!(since.elapsed() < PATIENCE, "not in OP: {:?}", response.subdevice_states);
    }
    check_sync0(maindevice, &group).await?;
    for (control, state) in STEPS {
        for cycle in 0.. {
            assert!(cycle < OBEY_CYCLES_MAX, "control word {control:#x}");
            let (drives, _) = cycle_mixed(maindevice, &group, (0, control, 0)).await?;
            if drives.iter().all(|(_, status)| status & STATUS_MASK == state) {
                break;
            }
        }
    }
    let mut wrong = 0;
    let (mut last, _) = cycle_mixed(maindevice, &group, (0, 0x0F, 0)).await?;
    // Cycles in which a drive's position grew and became smaller: one that repeats after a turn falls once a turn.
    let mut changes = vec![[0_usize; 2]; last.len()];
    for cycle in 0..CYCLES {
        let (drives, is_right) = cycle_mixed(maindevice, &group, (DEMAND, 0x0F, (cycle & 0xF) as u8)).await?;
        wrong += usize::from(!is_right);
        for ((then, now), [grew, fell]) in last.iter().zip(&drives).zip(&mut changes) {
            *grew += usize::from(now.0 > then.0);
            *fell += usize::from(now.0 < then.0);
        }
        last = drives;
    }
    let turned = changes.iter().all(|[grew, fell]| grew > fell);
    assert!(turned, "{changes:?}, at {last:x?}");
    check_sync0(maindevice, &group).await?;
    Ok((CYCLES, wrong))
}

/// Runs ethercrab against a segment of these slaves; `None` where it cannot be done.
fn exchange(
    test: &str,
    slaves: Option<&str>,
    storage: &'static Storage,
    work: impl AsyncFnOnce(&MainDevice<'_>) -> Result<(usize, usize), Error> + Send,
) -> Option<(usize, usize)> {
    let network = Network::new(test)?;
    let folder = Folder::new();
    let [at_segment, at_master] = network.interfaces();
    let mut program = etherpen(&folder);
    program.args(["segment", "--interface", at_segment]);
    if let Some(slaves) = slaves {
        program.args(["--slaves", slaves]);
    }
    let mut segment = Running::start(&mut network.command(0, &program));
    segment.wait_for("segment", |running| {
        running.stdout().contains("interface:").then_some(())
    });
    let result = std::thread::scope(|scope| {
        let master = network.spawn(scope, 1, || {
            let (tx, rx, pdu_loop) = storage.try_split().expect("each test has its storage");
            let timeouts = Timeouts {
                pdu: Duration::from_secs(10),
                eeprom: Duration::from_secs(10),
                mailbox_echo: Duration::from_secs(10),
                mailbox_response: Duration::from_secs(10),
                state_transition: Duration::from_secs(60),
                ..Timeouts::default()
            };
            let config = MainDeviceConfig {
                // A computer under load may lose a frame of a raw socket.
                retry_behaviour: RetryBehaviour::Count(1),
                dc_static_sync_iterations: 100,
            };
            let maindevice = MainDevice::new(pdu_loop, timeouts, config);
            let driver = tx_rx_task(at_master, tx, rx).expect("root may open the interface");
            drive(pin!(driver), work(&maindevice))
        });
        master.join().expect("the master's thread")
    });
    let (cycles, wrong) = result.unwrap_or_else(|error| panic!("{error:?}; segment: {}", segment.stderr()));
    println!("{cycles} cycles, {wrong} wrong working counters");
    Some((cycles, wrong))
}

#[test]
fn ethercrab_enables_the_four_drives_and_exchanges_ten_thousand_cycles_without_a_wrong_counter() {
    if let Some((cycles, wrong)) = exchange("the test with ethercrab", None, &STORAGE, run) {
        assert_eq!(wrong, 0, "of {cycles}");
    }
}

#[test]
fn ethercrab_sees_the_clocks_of_a_mixed_chain_and_brings_it_to_op_with_sync0() {
    let test = "the test with ethercrab and terminals";
    if let Some((cycles, wrong)) = exchange(test, Some(MIXED), &MIXED_STORAGE, run_mixed) {
        assert_eq!(wrong, 0, "of {cycles}");
    }
}
