//! The distributed clock of a slave controller behind registers 0x0900 to 0x09FF.
//!
//! The local clock has a drift. System time is the local time plus the offset written by the master. The system time
//! that the master distributes from the reference clock controls the rate, by a proportional and an integral part.
//! SYNC0 fires at the start time and every cycle after it, in system time; with 64 bits a start time in the past never
//! fires. Register layout: distributed clocks of the slave controller's register description (ET1100).
//!
//! Invariant: time never runs backwards by itself, and every call takes constant time whatever the registers contain.

use crate::controller::silicon::ClockWidth;
use crate::controller::{Nature, PORTS};

/// First register.
pub(crate) const BASE: usize = 0x0900;
/// Bytes of registers.
pub(crate) const LENGTH: usize = 0x100;

/// Bytes of the receive times of the ports.
pub(crate) const PORT_TIMES_LENGTH: usize = 0x10;

/// Bytes from the first register on that show times; writes to them are processed but not stored.
pub(crate) const TIMES_LENGTH: usize = 0x20;

const PORT_TIMES: usize = 0x00;
const SYSTEM_TIME: usize = 0x10;
const UNIT_TIME: usize = 0x18;
const OFFSET: usize = 0x20;
const DELAY: usize = 0x28;
const DIFFERENCE: usize = 0x2C;
const SPEED_START: usize = 0x30;
const FILTER_DEPTH: usize = 0x34;
const ACTIVATION: usize = 0x81;
const PULSE_LENGTH: usize = 0x82;
const ACTIVATION_STATUS: usize = 0x84;
const START_TIME: usize = 0x90;
const NEXT_SYNC1: usize = 0x98;
const CYCLE_TIME: usize = 0xA0;
const CYCLE_TIME_1: usize = 0xA4;
/// Registers of 8 bytes whose upper half a 32-bit clock does not have.
const LONG_TIMES: [usize; 5] = [SYSTEM_TIME, UNIT_TIME, OFFSET, START_TIME, NEXT_SYNC1];

const ACTIVATE: u8 = 0x01;
const ACTIVATE_SYNC0: u8 = 0x02;
const ACTIVATE_SYNC1: u8 = 0x04;
/// Receive times after power-up: bytes that are no times stay at ports where no frame arrives.
const PORT_TIMES_DEFAULT: [u8; PORT_TIMES_LENGTH] = *b"Beckhoff\0\0\0\0Verl";
const SPEED_START_DEFAULT: u16 = 0x1000;
const FILTER_DEFAULT: [u8; 2] = [4, 12];
const BILLION: i128 = 1_000_000_000;
/// Default time constant for correcting a difference, ns; the one for learning the drift is longer.
pub(crate) const LOCK_NS: i64 = 10_000_000;
const LEARNING_FACTOR: i64 = 10;
/// Largest corrections of the rate and of the learnt drift, in 1e-9.
const RATE_MAX_PPB: i64 = 100_000_000;
const DRIFT_MAX_PPB: i64 = 1_000_000;

/// Pulses with a period of a multiple of this keep their place in the segment's milliseconds, ns.
const PLACE_NS: u32 = 1_000_000;

/// State of the SYNC unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SyncState {
    /// Not activated.
    Off,
    /// Activated with inconsistent registers.
    Invalid,
    /// Waiting for its start time.
    Waiting,
    /// Generating pulses.
    Running,
}

/// Clock and SYNC unit of one slave.
#[derive(Clone, Debug)]
pub(crate) struct DistributedClock {
    width: ClockWidth,
    nature: Nature,
    true_ns: u64,
    local_ns: u64,
    /// Fraction of a nanosecond, 1e-9 ns.
    fraction: i128,
    offset_ns: u64,
    delay_ns: u32,
    mean_ns: i64,
    steering_ppb: i64,
    learnt_ppb: i64,
    steered_at_ns: Option<u64>,
    activation: u8,
    cycle_ns: u32,
    next_ns: Option<u64>,
    pulses: u64,
    unseen: u64,
}

impl DistributedClock {
    /// A clock with this crystal that has run for `local_ns`.
    pub(crate) fn new(width: ClockWidth, nature: Nature, local_ns: u64) -> Self {
        Self {
            width,
            nature,
            true_ns: 0,
            local_ns,
            fraction: 0,
            offset_ns: 0,
            delay_ns: 0,
            mean_ns: 0,
            steering_ppb: 0,
            learnt_ppb: 0,
            steered_at_ns: None,
            activation: 0,
            cycle_ns: 0,
            next_ns: None,
            pulses: 0,
            unseen: 0,
        }
    }

    /// Resets the clock to its state after power-up; the crystal keeps its drift.
    pub(crate) fn power_up(&mut self, registers: &mut [u8]) {
        let true_ns = self.true_ns;
        *self = Self::new(self.width, self.nature, 0);
        self.true_ns = true_ns;
        if self.has_register(PORT_TIMES) {
            put(registers, PORT_TIMES, &PORT_TIMES_DEFAULT);
        }
        if self.has_system_time() {
            put(registers, SPEED_START, &SPEED_START_DEFAULT.to_le_bytes());
            put(registers, FILTER_DEPTH, &FILTER_DEFAULT);
        }
    }

    /// Whether the slave has a clock that the bus can read and set.
    fn has_system_time(&self) -> bool {
        self.width.has_system_time()
    }

    /// Whether the silicon has a register at this offset.
    pub(crate) fn has_register(&self, offset: usize) -> bool {
        match self.width {
            ClockWidth::None => false,
            ClockWidth::DelayOnly => offset < PORT_TIMES_LENGTH,
            ClockWidth::Bits32 | ClockWidth::Bits64 => true,
        }
    }

    /// Advances to a true time; an earlier time has no effect.
    pub(crate) fn advance(&mut self, true_ns: u64) {
        let passed = i128::from(true_ns.saturating_sub(self.true_ns));
        self.true_ns = self.true_ns.max(true_ns);
        if passed == 0 || self.width == ClockWidth::None {
            return;
        }
        let rate = BILLION + i128::from(self.nature.drift_ppb + self.steering_ppb + self.learnt_ppb);
        let grown = passed * rate + self.fraction;
        self.fraction = grown.rem_euclid(BILLION);
        self.local_ns = self.local_ns.wrapping_add(grown.div_euclid(BILLION) as u64);
        let system_ns = self.system_ns();
        if let Some(next_ns) = self.next_ns
            && system_ns >= next_ns
        {
            let cycle_ns = u64::from(self.cycle_ns);
            let fired = (system_ns - next_ns).checked_div(cycle_ns).unwrap_or(0) + 1;
            self.pulses = self.pulses.saturating_add(fired);
            self.unseen = self.unseen.saturating_add(fired);
            self.next_ns = (cycle_ns > 0).then(|| next_ns.saturating_add(fired.saturating_mul(cycle_ns)));
        }
    }

    /// Number of SYNC0 pulses since the last call.
    pub(crate) fn take_pulses(&mut self) -> u64 {
        std::mem::take(&mut self.unseen)
    }

    /// Time to the next SYNC0 pulse, ns; `None` while none is generated, or not at the same place of each millisecond.
    pub(crate) fn pulse_ahead_ns(&self) -> Option<u64> {
        let keeps_place = self.state() == SyncState::Running && self.cycle_ns.is_multiple_of(PLACE_NS);
        let next_ns = self.next_ns.filter(|_| keeps_place)?;
        Some(next_ns.saturating_sub(self.system_ns()))
    }

    /// State of the SYNC unit.
    pub(crate) fn state(&self) -> SyncState {
        match (self.activation & ACTIVATE != 0, self.activation & ACTIVATE_SYNC0 != 0) {
            (false, _) => SyncState::Off,
            (true, false) => SyncState::Invalid,
            (true, true) if self.cycle_ns == 0 => SyncState::Invalid,
            (true, true) if self.pulses == 0 => SyncState::Waiting,
            (true, true) => SyncState::Running,
        }
    }

    /// Updates the registers that the clock itself changes.
    pub(crate) fn show(&self, registers: &mut [u8]) {
        if !self.has_system_time() {
            return;
        }
        self.put_time(registers, SYSTEM_TIME, self.system_ns());
        put(registers, DIFFERENCE, &difference_register(self.mean_ns).to_le_bytes());
        let pending = self.activation & ACTIVATE != 0 && self.pulses == 0;
        put(registers, ACTIVATION_STATUS, &[u8::from(pending)]);
        if let Some(next_ns) = self.next_ns {
            self.put_time(registers, START_TIME, next_ns);
            if self.activation & ACTIVATE_SYNC1 != 0 {
                let behind_ns = read_u32(registers, CYCLE_TIME_1);
                self.put_time(registers, NEXT_SYNC1, next_ns.wrapping_add(behind_ns.into()));
            }
        }
    }

    /// Handles a write of `data` at this offset by the bus; `back_ns` are the true times at which the frame comes back to
    /// the ports.
    pub(crate) fn written(&mut self, registers: &mut [u8], start: usize, data: &[u8], back_ns: [Option<u64>; PORTS]) {
        let touches = |from: usize, length: usize| start < from + length && from < start + data.len();
        if touches(PORT_TIMES, 1) && self.has_register(PORT_TIMES) {
            self.latch(registers, back_ns);
        }
        if !self.has_system_time() {
            return;
        }
        if self.width == ClockWidth::Bits32 {
            for at in LONG_TIMES {
                put(registers, at + 4, &[0; 4]);
            }
        }
        if touches(OFFSET, 8) {
            self.offset_ns = match self.width {
                ClockWidth::Bits32 => read_u32(registers, OFFSET).into(),
                _ => read_u64(registers, OFFSET),
            };
            self.restart_steering();
        }
        if touches(DELAY, 4) {
            self.delay_ns = read_u32(registers, DELAY);
        }
        if touches(SPEED_START, 2) {
            self.restart_steering();
        }
        if start == SYSTEM_TIME && data.len() >= 4 {
            self.steer(data, read_byte(registers, FILTER_DEPTH));
        }
        if touches(CYCLE_TIME, 4) {
            self.cycle_ns = read_u32(registers, CYCLE_TIME);
        }
        if touches(ACTIVATION, 1) {
            self.activate(read_byte(registers, ACTIVATION), registers);
        }
    }

    /// Sets the pulse length from the information memory.
    pub(crate) fn set_pulse_length(registers: &mut [u8], length: u16) {
        put(registers, PULSE_LENGTH, &length.to_le_bytes());
    }

    /// System time at a true time, ns, if nobody steers the clock until then; `None` without a clock.
    pub(crate) fn system_at_ns(&self, true_ns: u64) -> Option<u64> {
        let mut then = self.clone();
        then.advance(true_ns);
        let system_ns = then.system_ns();
        match self.width {
            ClockWidth::None | ClockWidth::DelayOnly => None,
            ClockWidth::Bits32 => Some(system_ns & u64::from(u32::MAX)),
            ClockWidth::Bits64 => Some(system_ns),
        }
    }

    fn system_ns(&self) -> u64 {
        self.local_ns.wrapping_add(self.offset_ns)
    }

    fn latch(&self, registers: &mut [u8], back_ns: [Option<u64>; PORTS]) {
        let local = |true_ns: u64| self.local_ns.wrapping_add(true_ns.saturating_sub(self.true_ns));
        put(registers, PORT_TIMES, &(self.local_ns as u32).to_le_bytes());
        for (port, back_ns) in back_ns.into_iter().enumerate() {
            if let Some(back_ns) = back_ns {
                put(registers, PORT_TIMES + 4 * port, &(local(back_ns) as u32).to_le_bytes());
            }
        }
        if self.has_system_time() {
            self.put_time(registers, UNIT_TIME, self.local_ns);
        }
    }

    fn restart_steering(&mut self) {
        self.mean_ns = 0;
        self.steering_ppb = 0;
        self.learnt_ppb = 0;
        self.steered_at_ns = None;
    }

    /// Takes the reference clock's system time from a passing datagram.
    fn steer(&mut self, data: &[u8], depth: u8) {
        let mine = self.system_ns().wrapping_sub(self.delay_ns.into());
        let difference = match (self.width, data.first_chunk::<8>()) {
            (ClockWidth::Bits64, Some(bytes)) => mine.wrapping_sub(u64::from_le_bytes(*bytes)) as i64,
            _ => (mine as u32).wrapping_sub(read_u32(data, 0)) as i32 as i64,
        };
        let difference = difference.clamp(-i64::from(i32::MAX), i64::from(i32::MAX));
        let first = self.steered_at_ns.is_none();
        let passed_ns = self
            .steered_at_ns
            .map_or(0, |at_ns| self.local_ns.wrapping_sub(at_ns))
            .min(1_000_000_000) as i64;
        self.steered_at_ns = Some(self.local_ns);
        self.mean_ns = match first {
            true => difference,
            false => self.mean_ns + (difference - self.mean_ns) / (1 << depth.min(12)).max(1),
        };
        let time_ns = self.nature.lock_ns.max(4 * passed_ns);
        let ppb = |of_ns: i64| i64::try_from(-i128::from(difference) * BILLION / i128::from(of_ns)).unwrap_or(0);
        self.steering_ppb = ppb(time_ns).clamp(-RATE_MAX_PPB, RATE_MAX_PPB);
        let share = i128::from(ppb(LEARNING_FACTOR * time_ns)) * i128::from(passed_ns) / i128::from(time_ns);
        let learnt = i128::from(self.learnt_ppb) + share;
        let limit = i128::from(DRIFT_MAX_PPB);
        self.learnt_ppb = learnt.clamp(-limit, limit) as i64;
    }

    fn activate(&mut self, activation: u8, registers: &[u8]) {
        let rises = activation & ACTIVATE != 0 && self.activation & ACTIVATE == 0;
        self.activation = activation;
        if activation & ACTIVATE == 0 {
            (self.next_ns, self.pulses, self.unseen) = (None, 0, 0);
        }
        if !rises || activation & ACTIVATE_SYNC0 == 0 {
            return;
        }
        let now_ns = self.system_ns();
        self.next_ns = match self.width {
            ClockWidth::Bits64 => Some(read_u64(registers, START_TIME)).filter(|start_ns| *start_ns > now_ns),
            _ => {
                let ahead_ns = read_u32(registers, START_TIME).wrapping_sub(now_ns as u32);
                Some(now_ns.wrapping_add(ahead_ns.into()))
            }
        };
    }

    fn put_time(&self, registers: &mut [u8], at: usize, time_ns: u64) {
        match self.width {
            ClockWidth::Bits64 => put(registers, at, &time_ns.to_le_bytes()),
            _ => put(registers, at, &(time_ns as u32).to_le_bytes()),
        }
    }
}

/// Sign and magnitude: bit 31 is set if the local clock is behind.
fn difference_register(difference_ns: i64) -> u32 {
    let magnitude = difference_ns.unsigned_abs().min(0x7FFF_FFFF) as u32;
    magnitude | if difference_ns < 0 { 0x8000_0000 } else { 0 }
}

fn put(registers: &mut [u8], at: usize, bytes: &[u8]) {
    for (target, source) in registers.iter_mut().skip(at).zip(bytes) {
        *target = *source;
    }
}

fn read_byte(bytes: &[u8], at: usize) -> u8 {
    bytes.get(at).copied().unwrap_or(0)
}

fn read_u32(bytes: &[u8], at: usize) -> u32 {
    bytes
        .get(at..)
        .and_then(|rest| rest.first_chunk())
        .map_or(0, |chunk| u32::from_le_bytes(*chunk))
}

fn read_u64(bytes: &[u8], at: usize) -> u64 {
    bytes
        .get(at..)
        .and_then(|rest| rest.first_chunk())
        .map_or(0, |chunk| u64::from_le_bytes(*chunk))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drifting(drift_ppb: i64) -> Nature {
        Nature {
            drift_ppb,
            ..Nature::default()
        }
    }

    fn write(clock: &mut DistributedClock, registers: &mut [u8], at: usize, data: &[u8]) {
        put(registers, at, data);
        clock.written(registers, at, data, [None; PORTS]);
    }

    #[test]
    fn a_slow_and_a_fast_clock_are_steered_to_the_reference() {
        for width in [ClockWidth::Bits32, ClockWidth::Bits64] {
            for drift_ppb in [-80_000, -1_000, 0, 50_000] {
                let mut clock = DistributedClock::new(width, drifting(drift_ppb), 5_000_000);
                let mut registers = vec![0; LENGTH];
                write(&mut clock, &mut registers, DELAY, &700u32.to_le_bytes());
                let offset = 1_000_000_000u64.wrapping_sub(5_000_000 - 700);
                write(&mut clock, &mut registers, OFFSET, &offset.to_le_bytes());
                let mut worst = 0;
                for millisecond in 1..3_000u64 {
                    let time_ns = millisecond * 1_000_000;
                    clock.advance(time_ns);
                    let reference = 1_000_000_000 + time_ns;
                    clock.written(&mut registers, SYSTEM_TIME, &reference.to_le_bytes(), [None; PORTS]);
                    if millisecond > 1_500 {
                        let mine = clock.system_ns().wrapping_sub(700);
                        worst = worst.max(mine.abs_diff(reference));
                    }
                }
                clock.show(&mut registers);
                assert!(worst < 100, "{width:?} {drift_ppb} ppb: {worst} ns");
                assert!(read_u32(&registers, DIFFERENCE) & 0x7FFF_FFFF < 100);
            }
        }
    }

    #[test]
    fn pulses_start_at_their_time_and_keep_their_cycle() {
        let mut clock = DistributedClock::new(ClockWidth::Bits64, drifting(0), 0);
        let mut registers = vec![0; LENGTH];
        write(&mut clock, &mut registers, CYCLE_TIME, &1_000_000u32.to_le_bytes());
        write(&mut clock, &mut registers, START_TIME, &10_000_000u64.to_le_bytes());
        write(&mut clock, &mut registers, ACTIVATION, &[3]);
        clock.advance(9_999_999);
        assert_eq!((clock.state(), clock.take_pulses()), (SyncState::Waiting, 0));
        clock.advance(10_000_000);
        assert_eq!((clock.state(), clock.take_pulses()), (SyncState::Running, 1));
        clock.advance(15_500_000);
        assert_eq!(clock.take_pulses(), 5);
        clock.show(&mut registers);
        assert_eq!(read_u64(&registers, START_TIME), 16_000_000, "the next pulse");
    }

    #[test]
    fn a_start_in_the_past_never_comes_with_64_bits_and_wraps_with_32() {
        for (width, state) in [
            (ClockWidth::Bits64, SyncState::Waiting),
            (ClockWidth::Bits32, SyncState::Running),
        ] {
            let mut clock = DistributedClock::new(width, drifting(0), 1_000_000);
            let mut registers = vec![0; LENGTH];
            write(&mut clock, &mut registers, CYCLE_TIME, &1_000_000u32.to_le_bytes());
            write(&mut clock, &mut registers, START_TIME, &900_000u64.to_le_bytes());
            write(&mut clock, &mut registers, ACTIVATION, &[3]);
            clock.advance(5_000_000_000);
            assert_eq!(clock.state(), state, "{width:?}");
            clock.show(&mut registers);
            assert_eq!(registers[ACTIVATION_STATUS], u8::from(state == SyncState::Waiting));
        }
    }

    #[test]
    fn an_activation_without_pulses_is_invalid() {
        let mut clock = DistributedClock::new(ClockWidth::Bits64, drifting(0), 0);
        let mut registers = vec![0; LENGTH];
        write(&mut clock, &mut registers, ACTIVATION, &[1]);
        assert_eq!(clock.state(), SyncState::Invalid);
        write(&mut clock, &mut registers, ACTIVATION, &[0]);
        write(&mut clock, &mut registers, ACTIVATION, &[3]);
        assert_eq!(clock.state(), SyncState::Invalid, "no cycle time");
    }
}
