//! What the EtherCAT master costs, and what the same work costs in another master; what the planner costs.
//!
//! Both masters exchange process data with four drives. The segment answers from memory and is not counted, nor is what
//! a driver of an Ethernet controller copies; everything else that a cycle needs is: preparing the telegram, checking
//! and taking the reply, reading the drives' inputs and writing their outputs. The same functions run on the emulated
//! Cortex-M7 (`src/bin/cortex_m7.rs`) and on the host; only the [`Meter`] differs.
//!
//! Invariant: a cycle whose data did not arrive whole ends the run; no figure comes from work that was not done.
#![no_std]
#![forbid(unsafe_code)]

pub mod ethercrab_master;
pub mod etherpen_master;
pub mod motion;
pub mod segment;

/// Drives on the segment.
pub const DRIVES: usize = 4;
/// Cycles that are counted.
pub const CYCLES: u32 = 256;
/// Cycles before the counting begins.
const WARM_UP_CYCLES: u32 = 8;

/// Counts instructions.
pub trait Meter {
    /// Runs `work`, counted.
    fn count<R>(work: impl FnOnce() -> R) -> R;
    /// Runs `work`, not counted; inside of [`Self::count`].
    fn pause<R>(work: impl FnOnce() -> R) -> R;
}

/// What a cycle carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exchange {
    /// Outputs and inputs in one frame.
    Combined,
    /// Outputs, inputs and the distribution of the reference clock's time in one frame.
    CombinedWithClock,
    /// Inputs in one frame, outputs in a second one.
    Split,
}

/// Process data of each drive, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessData {
    /// To the drive.
    pub outputs: u16,
    /// From the drive.
    pub inputs: u16,
}

/// One measurement.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Its name in the report, without the machine.
    pub name: &'static str,
    /// What is exchanged.
    pub exchange: Exchange,
    /// With how much data.
    pub data: ProcessData,
    /// With how many drives.
    pub drives: usize,
}

const fn case(name: &'static str, exchange: Exchange, outputs: u16, inputs: u16) -> Case {
    let data = ProcessData { outputs, inputs };
    Case {
        name,
        exchange,
        data,
        drives: DRIVES,
    }
}

/// The cycle with AL status and clock with 16 drives. Only this project's master: in the other one, the number of drives
/// is part of the program.
pub const SIXTEEN: Case = Case {
    drives: 16,
    ..case("cyclic/lrw+frmw+brd/16", Exchange::CombinedWithClock, 11, 11)
};

/// All measurements. Eleven bytes each way are a drive that takes position, velocity, torque limits and mode; the
/// AX2000-B110 has six out and, with the current, eight in.
pub const CASES: [Case; 6] = [
    case("cyclic/lrw", Exchange::Combined, 11, 11),
    case("cyclic/lrw+frmw+brd", Exchange::CombinedWithClock, 11, 11),
    case("cyclic/split", Exchange::Split, 11, 11),
    case("cyclic/lrw/ax2000", Exchange::Combined, 6, 8),
    case("cyclic/lrw+frmw+brd/ax2000", Exchange::CombinedWithClock, 6, 8),
    case("cyclic/split/ax2000", Exchange::Split, 6, 8),
];

/// A master with its drives in OP.
pub trait Master {
    /// One cycle.
    ///
    /// # Panics
    /// The data did not arrive.
    fn cycle<M: Meter>(&mut self);
}

/// A meter that counts nothing.
struct Uncounted;

impl Meter for Uncounted {
    fn count<R>(work: impl FnOnce() -> R) -> R {
        work()
    }

    fn pause<R>(work: impl FnOnce() -> R) -> R {
        work()
    }
}

/// Runs [`CYCLES`] counted cycles, after a few uncounted ones.
pub fn measure<M: Meter>(master: &mut impl Master) {
    for _ in 0..WARM_UP_CYCLES {
        master.cycle::<Uncounted>();
    }
    for _ in 0..CYCLES {
        master.cycle::<M>();
    }
}

/// What the application takes from a drive: position and status word.
fn read_drive(inputs: &[u8]) -> Option<(i32, u16)> {
    let (position, rest) = inputs.split_first_chunk::<4>()?;
    let status = rest.first_chunk::<2>()?;
    Some((i32::from_le_bytes(*position), u16::from_le_bytes(*status)))
}

/// What the application gives a drive: velocity and control word.
fn write_drive(outputs: &mut [u8], velocity: i32, control: u16) {
    if let Some(target) = outputs.first_chunk_mut::<6>() {
        let [a, b, c, d] = velocity.to_le_bytes();
        let [e, f] = control.to_le_bytes();
        *target = [a, b, c, d, e, f];
    }
}
