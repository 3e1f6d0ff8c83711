//! ethercrab, used as its documentation shows.
//!
//! Its transmit half is asked for frames until there are none, as its own network tasks do; its clock is a number that
//! [`pass`] advances, the cheapest one there can be. The AL status comes from one datagram for each drive.

use crate::segment::{Segment, answer};
use crate::{Case, DRIVES, Exchange, Master, Meter, Uncounted, read_drive, write_drive};
use core::future::Future;
use core::hint::black_box;
use core::pin::pin;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::{Context, Poll, Waker};
use core::time::Duration;
use ethercrab::subdevice_group::{NoDc, Op};
use ethercrab::{Command, MainDevice, MainDeviceConfig, PduRx, PduStorage, PduTx, Reads, SubDeviceGroup, Timeouts};

/// Most drives.
pub const DRIVES_MAX: usize = 16;
/// Most process data of all drives, bytes.
const IMAGE_BYTES: usize = 512;
/// Frames in flight and the data of each, as in ethercrab's own examples.
const FRAMES: usize = 16;
const FRAME_BYTES: usize = PduStorage::element_size(1100);

/// Memory of the frames.
pub type Storage = PduStorage<FRAMES, FRAME_BYTES>;
type Group<S> = SubDeviceGroup<DRIVES_MAX, IMAGE_BYTES, ethercrab::DefaultLock, S, NoDc>;

static NOW_US: AtomicU32 = AtomicU32::new(0);

/// Lets time pass, us.
pub fn pass(duration_us: u32) {
    NOW_US.store(
        NOW_US.load(Ordering::Relaxed).wrapping_add(duration_us),
        Ordering::Relaxed,
    );
}

struct Clock;

impl embassy_time_driver::Driver for Clock {
    fn now(&self) -> u64 {
        u64::from(NOW_US.load(Ordering::Relaxed))
    }

    fn schedule_wake(&self, _at: u64, _waker: &Waker) {}
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock);

/// The two ends between ethercrab and the segment.
struct Port {
    tx: PduTx<'static>,
    rx: PduRx<'static>,
    frame: [u8; 1536],
}

impl Port {
    /// Splits `storage` into the port and what a main device is made of.
    fn new(storage: &'static Storage) -> (Self, MainDevice<'static>) {
        let Ok((tx, rx, pdu_loop)) = storage.try_split() else {
            panic!("the storage is in use");
        };
        let frame = [0; 1536];
        (Self { tx, rx, frame }, MainDevice::new(pdu_loop, timeouts(), config()))
    }

    /// Runs `future` to its end; `answer` turns each frame into its reply.
    fn run<M: Meter, F: Future>(&mut self, future: F, mut answer: impl FnMut(&mut [u8])) -> F::Output {
        let mut future = pin!(future);
        let mut context = Context::from_waker(Waker::noop());
        loop {
            if let Poll::Ready(output) = M::count(|| future.as_mut().poll(&mut context)) {
                return output;
            }
            while let Some(length) = M::count(|| self.send::<M>()) {
                let Some(frame) = self.frame.get_mut(..length) else {
                    break;
                };
                answer(frame);
                let received = M::count(|| self.rx.receive_frame(black_box(frame)));
                assert!(received.is_ok(), "a reply was refused");
            }
            pass(50);
        }
    }

    fn send<M: Meter>(&mut self) -> Option<usize> {
        let frame = &mut self.frame;
        let sent = self.tx.next_sendable_frame()?.send_blocking(|bytes| {
            M::pause(|| {
                if let Some(target) = frame.get_mut(..bytes.len()) {
                    target.copy_from_slice(bytes);
                }
            });
            Ok(bytes.len())
        });
        sent.ok()
    }
}

/// ethercrab with its drives in OP.
pub struct EthercrabMaster {
    device: MainDevice<'static>,
    group: Group<Op>,
    port: Port,
    case: Case,
    cycles: i32,
}

impl EthercrabMaster {
    /// Brings the drives to OP.
    ///
    /// # Panics
    /// `storage` is in use, or the drives did not get to OP.
    pub fn new(storage: &'static Storage, case: Case) -> Self {
        let (mut port, device) = Port::new(storage);
        let mut segment = Segment::new(case.data);
        let group = port.run::<Uncounted, _>(bring_up(&device), |frame| segment.frame(frame));
        Self {
            device,
            group,
            port,
            case,
            cycles: 0,
        }
    }

    fn read(&self) {
        for drive in self.group.iter(&self.device) {
            black_box(read_drive(drive.io_raw_mut().inputs()));
        }
    }

    fn write(&mut self) {
        self.cycles = self.cycles.wrapping_add(1);
        for drive in self.group.iter(&self.device) {
            write_drive(drive.io_raw_mut().outputs(), self.cycles, 0x0F);
        }
    }

    fn split<M: Meter>(&mut self) {
        let case = self.case;
        let data = case.data;
        let mut inputs = [0; DRIVES * 32];
        let mut outputs = [0; DRIVES * 32];
        let (inputs_length, outputs_length) = (DRIVES as u16 * data.inputs, DRIVES as u16 * data.outputs);
        let image = self.port.run::<M, _>(
            Reads::Lrd { address: 0 }
                .wrap()
                .with_wkc(DRIVES as u16)
                .receive_slice(&self.device, inputs_length),
            |frame| answer(frame, case),
        );
        M::count(|| {
            let Ok(image) = image else { panic!("no inputs") };
            if let Some(inputs) = inputs.get_mut(..image.len()) {
                inputs.copy_from_slice(&image);
            }
            self.cycles = self.cycles.wrapping_add(1);
            for drive in inputs.chunks_exact(usize::from(data.inputs)).take(DRIVES) {
                black_box(read_drive(drive));
            }
            for drive in outputs.chunks_exact_mut(usize::from(data.outputs)).take(DRIVES) {
                write_drive(drive, self.cycles, 0x0F);
            }
        });
        let outputs = outputs.get(..usize::from(outputs_length)).unwrap_or(&[]);
        let sent = self.port.run::<M, _>(
            Command::lwr(u32::from(inputs_length))
                .with_wkc(DRIVES as u16)
                .send(&self.device, outputs),
            |frame| answer(frame, case),
        );
        assert!(sent.is_ok(), "no outputs");
    }
}

impl Master for EthercrabMaster {
    fn cycle<M: Meter>(&mut self) {
        let case = self.case;
        let counter = match case.exchange {
            Exchange::Split => return self.split::<M>(),
            Exchange::Combined => {
                M::count(|| self.write());
                let exchange = self.group.tx_rx(&self.device);
                let result = self.port.run::<M, _>(exchange, |frame| answer(frame, case));
                result.map(|response| (response.working_counter, response.all_op()))
            }
            Exchange::CombinedWithClock => {
                M::count(|| self.write());
                let exchange = self.group.tx_rx_sync_system_time(&self.device);
                let result = self.port.run::<M, _>(exchange, |frame| answer(frame, case));
                result.map(|response| (response.working_counter, response.all_op()))
            }
        };
        assert!(
            counter.is_ok_and(|seen| seen == (3 * DRIVES as u16, true)),
            "the cycle failed"
        );
        M::count(|| self.read());
    }
}

/// Time limits that an unhurried segment meets.
fn timeouts() -> Timeouts {
    Timeouts {
        state_transition: Duration::from_secs(20),
        pdu: Duration::from_secs(1),
        mailbox_response: Duration::from_secs(5),
        ..Timeouts::default()
    }
}

/// Without the 10,000 frames that let the clocks settle before the bring-up goes on.
fn config() -> MainDeviceConfig {
    MainDeviceConfig {
        dc_static_sync_iterations: 0,
        ..MainDeviceConfig::default()
    }
}

/// From INIT to OP, with cyclic data from SAFEOP on.
///
/// # Panics
/// A step failed.
async fn bring_up(device: &MainDevice<'static>) -> Group<Op> {
    let Ok(group) = device.init_single_group::<DRIVES_MAX, IMAGE_BYTES>(|| 0).await else {
        panic!("no drives");
    };
    let Ok(group) = group.into_safe_op(device).await else {
        panic!("no SAFEOP");
    };
    assert!(group.tx_rx(device).await.is_ok(), "no cyclic data");
    let Ok(group) = group.request_into_op(device).await else {
        panic!("no OP");
    };
    loop {
        match group.tx_rx(device).await {
            Ok(response) if response.all_op() => return group,
            Ok(_) => {}
            Err(_) => panic!("no cyclic data"),
        }
    }
}

/// Static memory of a master for 16 drives and the future that brings them up, bytes.
pub fn ram_bytes() -> usize {
    size_of::<Storage>()
        + size_of::<MainDevice<'static>>()
        + size_of::<PduTx<'static>>()
        + size_of::<PduRx<'static>>()
        + size_of_output(bring_up)
}

/// Size of the future that a function returns.
fn size_of_output<'d, F: Future>(_: impl FnOnce(&'d MainDevice<'static>) -> F) -> usize {
    size_of::<F>()
}

/// Brings drives to OP over `wire`, which turns each frame into its reply; gives how many there are.
///
/// # Panics
/// `storage` is in use, or the drives did not get to OP.
pub fn bring_up_over(storage: &'static Storage, wire: impl FnMut(&mut [u8])) -> usize {
    let (mut port, device) = Port::new(storage);
    let group = port.run::<Uncounted, _>(bring_up(&device), wire);
    group.len()
}

/// A whole application: bring-up, then a cycle with clock for ever.
///
/// # Panics
/// Something failed.
pub fn serve(storage: &'static Storage, mut wire: impl FnMut(&mut [u8])) -> ! {
    let (mut port, device) = Port::new(storage);
    let application = async {
        let group = bring_up(&device).await;
        loop {
            for drive in group.iter(&device) {
                let mut data = drive.io_raw_mut();
                let inputs = read_drive(data.inputs()).unwrap_or_default();
                write_drive(data.outputs(), inputs.0, inputs.1);
            }
            assert!(group.tx_rx_sync_system_time(&device).await.is_ok());
        }
    };
    port.run::<Uncounted, _>(application, &mut wire)
}
