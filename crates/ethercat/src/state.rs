//! The application layer's state machine: INIT, PREOP, SAFEOP, OP, and the reasons for a refusal.
//!
//! On the way up, only one step is requested at a time. A slave may answer with another state and the error flag; the
//! AL status code gives the reason. Numbers: IEC 61158-6-12, AL status codes; texts and hints are this project's.
//!
//! A slave with device emulation has no processor: it copies the request to its status at once, the acknowledge bit
//! with it. An error flag with code 0 is such an echo; a request without the bit removes it.
//!
//! A slave whose processor is starting up answers, but does not read the request: until it does, a further one is not
//! executed (working counter 0). The master waits for it.
//!
//! Invariant: a change either ends in the requested state without error flag, or is an error with state and code.

use super::acyclic::{AcyclicPort, Outcome, Request};
use super::error::BusError;
use super::wire::{Address, Command, register};

/// Longest wait for INIT, ms. These waits are the usual ones of EtherCAT network information (ENI) files.
pub const INIT_TIMEOUT_MS: u32 = 5_000;
/// Longest wait for PREOP, ms.
pub const PRE_OPERATIONAL_TIMEOUT_MS: u32 = 3_000;
/// Longest wait for SAFEOP and for OP, ms.
pub const OPERATIONAL_TIMEOUT_MS: u32 = 10_000;
/// A slave that changes its state is asked each millisecond for so long, ms.
const ASKED_OFTEN_MS: u32 = 10;
/// Pause between questions to a slave that takes longer, ms: it may wait for SYNC0 to begin.
const ASKED_SELDOM_MS: u32 = 4;
/// Longest wait for a slave's processor to read a request before the caller is told, ms.
pub const READ_TIMEOUT_MS: u32 = 3_000;
/// Reads without an answer after which a slave counts as absent.
const ABSENT_TRIES_MAX: u8 = 8;
/// Longest wait for an error flag to clear after it was acknowledged, ms.
pub const ACKNOWLEDGE_TIMEOUT_MS: u32 = 500;
/// Longest wait for the number of the switches, ms; a slave without switches never shows one.
const SWITCH_TIMEOUT_MS: u32 = 100;

/// State of a slave's application layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum AlState {
    /// Registers only.
    Init = 1,
    /// Mailbox.
    PreOperational = 2,
    /// Firmware update.
    Bootstrap = 3,
    /// Mailbox and inputs; outputs are in their safe state.
    SafeOperational = 4,
    /// Mailbox, inputs and outputs.
    Operational = 8,
}

impl AlState {
    /// The state in an AL status register; the error flag is ignored.
    pub const fn from_status(status: u16) -> Option<Self> {
        Some(match status & register::AL_STATE_MASK {
            1 => Self::Init,
            2 => Self::PreOperational,
            3 => Self::Bootstrap,
            4 => Self::SafeOperational,
            8 => Self::Operational,
            _ => return None,
        })
    }

    /// Longest wait for this state, ms.
    const fn timeout_ms(self) -> u32 {
        match self {
            Self::Init => INIT_TIMEOUT_MS,
            Self::PreOperational | Self::Bootstrap => PRE_OPERATIONAL_TIMEOUT_MS,
            Self::SafeOperational | Self::Operational => OPERATIONAL_TIMEOUT_MS,
        }
    }

    /// Common name of the state.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Init => "INIT",
            Self::PreOperational => "PREOP",
            Self::Bootstrap => "BOOT",
            Self::SafeOperational => "SAFEOP",
            Self::Operational => "OP",
        }
    }
}

/// A slave's state with its error flag and code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AlReport {
    /// The AL status register: state and error flag.
    pub status: u8,
    /// The AL status code.
    pub code: u16,
}

impl AlReport {
    /// Bytes from the AL status register to the end of the code.
    pub const LEN: usize = 6;

    /// Parses the registers from AL status on; missing bytes count as 0.
    pub fn parse(bytes: &[u8]) -> Self {
        let status = super::wire::read_u16(bytes, 0);
        Self {
            status: (status & (register::AL_STATE_MASK | register::AL_ERROR_BIT)) as u8,
            code: super::wire::read_u16(bytes, 4),
        }
    }

    /// Whether the error flag is set, be it the echo of an acknowledgement.
    pub const fn is_flagged(&self) -> bool {
        self.status as u16 & register::AL_ERROR_BIT != 0
    }

    /// Whether the slave reports an error.
    pub const fn is_error(&self) -> bool {
        self.is_flagged() && self.code != 0
    }

    /// The state without the error flag.
    pub const fn state(&self) -> Option<AlState> {
        AlState::from_status(self.status as u16)
    }

    /// The error that a slave shows this report and is not in the state that it should have.
    pub(crate) const fn instead_of(self, expected: AlState) -> BusError {
        BusError::State {
            expected: expected as u8,
            actual: self.status,
            code: self.code,
        }
    }

    /// Whether the slave is in `state` without an error flag.
    pub fn is(&self, state: AlState) -> bool {
        self.status == state as u8
    }
}

/// Reads a slave's state, error flag and code in one datagram.
///
/// # Errors
/// As [`AcyclicPort::send_until_counted`].
pub async fn report<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<AlReport, BusError> {
    let bytes = port.read(station, register::AL_STATUS, AlReport::LEN).await?;
    Ok(AlReport::parse(&bytes))
}

/// Writes a request to AL control, and reads the state in the same frame. While the slave's processor has not read the
/// request before, it is repeated.
async fn request<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    control: u16,
) -> Result<AlReport, BusError> {
    let address = |register| Address::station(station, register);
    let requests = [
        Request::write(Command::Fpwr, address(register::AL_CONTROL), &control.to_le_bytes()),
        Request::read(Command::Fprd, address(register::AL_STATUS), AlReport::LEN),
    ];
    let (started_ms, mut absent) = (port.now_ms(), 0);
    loop {
        let (mut outcomes, mut now) = ([Outcome::Lost; 2], AlReport::default());
        let mut replies = outcomes.iter_mut();
        port.transact_all(requests.iter(), |reply| {
            now = AlReport::parse(&reply.data);
            if let Some(outcome) = replies.next() {
                *outcome = reply.outcome;
            }
        })
        .await;
        let [written, read] = outcomes.map(|outcome| outcome == Outcome::Processed { working_counter: 1 });
        if written && read {
            return Ok(now);
        }
        absent = if read { 0 } else { absent + 1 };
        if absent >= ABSENT_TRIES_MAX {
            report(port, station).await?;
            absent = 0;
        }
        let waited_ms = port.now_ms().wrapping_sub(started_ms);
        if waited_ms > READ_TIMEOUT_MS {
            return Err(BusError::RequestUnread {
                requested: control as u8,
                waited_ms,
            });
        }
    }
}

/// Acknowledges a pending error: requests the present state with the acknowledge bit. An echo of an earlier
/// acknowledgement is removed.
///
/// # Errors
/// [`BusError::State`] when the flag stays, [`BusError::RequestUnread`], or as [`AcyclicPort::send_until_counted`].
pub async fn acknowledge<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<AlReport, BusError> {
    let before = report(port, station).await?;
    if !before.is_flagged() {
        return Ok(before);
    }
    let state = u16::from(before.status) & register::AL_STATE_MASK;
    if !before.is_error() && !request(port, station, state).await?.is_flagged() {
        return report(port, station).await;
    }
    request(port, station, state | register::AL_ERROR_BIT).await?;
    let started_ms = port.now_ms();
    loop {
        let now = report(port, station).await?;
        if !now.is_flagged() {
            return Ok(now);
        }
        if port.now_ms().wrapping_sub(started_ms) > ACKNOWLEDGE_TIMEOUT_MS {
            return Err(BusError::State {
                expected: state as u8,
                actual: now.status,
                code: now.code,
            });
        }
    }
}

/// Asks a slave for the number of its identification switches, in its present state; 0 if it has none, or if it shows an
/// error. The request is withdrawn afterwards.
///
/// # Errors
/// [`BusError::RequestUnread`], or as [`AcyclicPort::send_until_counted`].
pub async fn switch<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) -> Result<u16, BusError> {
    let before = report(port, station).await?;
    if before.is_flagged() {
        return Ok(0);
    }
    let present = u16::from(before.status) & register::AL_STATE_MASK;
    request(port, station, present | register::AL_IDENTIFY_BIT).await?;
    let started_ms = port.now_ms();
    let number = loop {
        let bytes = port.read(station, register::AL_STATUS, AlReport::LEN).await?;
        if AlReport::parse(&bytes).is_flagged() {
            // It does not know the request.
            break 0;
        }
        if super::wire::read_u16(&bytes, 0) & register::AL_IDENTIFY_BIT != 0 {
            break super::wire::read_u16(&bytes, 4);
        }
        if port.now_ms().wrapping_sub(started_ms) > SWITCH_TIMEOUT_MS {
            break 0;
        }
    };
    request(port, station, present).await?;
    acknowledge(port, station).await?;
    Ok(number)
}

/// Requests `target` and waits until the slave has reached it. A pending error is acknowledged first.
///
/// On the way up, `target` has to be the next state.
///
/// # Errors
/// [`BusError::State`] when the slave refuses, [`BusError::StateTimeout`] when it does not reach the state,
/// [`BusError::RequestUnread`] when its processor does not read the request, or as [`AcyclicPort::send_until_counted`].
pub async fn change<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    target: AlState,
) -> Result<(), BusError> {
    let control = if target != AlState::Init {
        acknowledge(port, station).await?;
        target as u16
    } else if report(port, station).await?.is_flagged() {
        // INIT clears errors that an acknowledgement alone does not clear.
        target as u16 | register::AL_ERROR_BIT
    } else {
        target as u16
    };
    let mut now = request(port, station, control).await?;
    let started_ms = port.now_ms();
    loop {
        if now.is(target) {
            return Ok(());
        }
        if now.state() == Some(target) && !now.is_error() {
            now = request(port, station, target as u16).await?;
        } else if now.is_flagged() && target != AlState::Init {
            return Err(BusError::State {
                expected: target as u8,
                actual: now.status,
                code: now.code,
            });
        } else {
            if port.now_ms().wrapping_sub(started_ms) > ASKED_OFTEN_MS {
                port.wait_ms(ASKED_SELDOM_MS).await;
            }
            now = report(port, station).await?;
        }
        let waited_ms = port.now_ms().wrapping_sub(started_ms);
        if waited_ms > target.timeout_ms() && !now.is(target) {
            return Err(BusError::StateTimeout {
                expected: target as u8,
                actual: now.status,
                waited_ms,
            });
        }
    }
}

/// Text of an AL status code.
pub const fn al_code_text(code: u16) -> &'static str {
    match code {
        0x0000 => "no error code",
        0x0001 => "unspecified error",
        0x0002 => "out of memory",
        0x0003 => "device setup invalid",
        0x0006 => "SII and firmware do not match",
        0x0007 => "firmware update failed",
        0x000E => "licence error",
        0x0011 => "state change not allowed",
        0x0012 => "unknown state requested",
        0x0013 => "bootstrap not supported",
        0x0014 => "no valid firmware",
        0x0015 => "mailbox settings invalid (bootstrap)",
        0x0016 => "mailbox settings invalid",
        0x0017 => "sync manager settings invalid",
        0x0018 => "no valid inputs",
        0x0019 => "no valid outputs",
        0x001A => "synchronisation error",
        0x001B => "outputs stopped coming (sync manager watchdog)",
        0x001C => "sync manager types invalid",
        0x001D => "output settings invalid",
        0x001E => "input settings invalid",
        0x001F => "watchdog settings invalid",
        0x0020 => "slave needs a cold start",
        0x0021 => "slave needs INIT",
        0x0022 => "slave needs PREOP",
        0x0023 => "slave needs SAFEOP",
        0x0024 => "input mapping invalid",
        0x0025 => "output mapping invalid",
        0x0026 => "settings inconsistent",
        0x0027 => "free run not supported",
        0x0028 => "synchronous mode not supported",
        0x0029 => "free run needs three buffers",
        0x002A => "background watchdog",
        0x002B => "no valid inputs and outputs",
        0x002C => "fatal synchronisation error",
        0x002D => "no synchronisation signal",
        0x002E => "cycle time too short",
        0x0030 => "clock settings invalid",
        0x0031 => "clock did not lock",
        0x0032 => "clock control error",
        0x0033 => "clock timing error",
        0x0035 => "cycle time of the clock invalid",
        0x0042 => "mailbox error: EoE",
        0x0043 => "mailbox error: CoE",
        0x0044 => "mailbox error: FoE",
        0x0045 => "mailbox error: SoE",
        0x004F => "mailbox error: VoE",
        0x0050 => "no access to the SII",
        0x0051 => "SII error",
        0x0060 => "slave restarted itself",
        0x0061 => "device identification updated",
        0x00F0 => "application controller not available",
        _ => "unknown code",
    }
}

/// Whether an AL status code says that a slave does not take its process data or their sync managers.
pub(crate) const fn is_about_process_data(code: u16) -> bool {
    matches!(code, 0x0017 | 0x001C | 0x001D | 0x001E | 0x0024 | 0x0025 | 0x0026)
}

/// Suggested remedy for an AL status code.
pub const fn al_code_hint(code: u16) -> &'static str {
    match code {
        0x0011 | 0x0012 => "go up one state at a time; power-cycle the slave if it persists",
        0x0015 | 0x0016 => "compare the mailbox windows with the slave's SII",
        0x001C => "compare the sync managers' types (0x1C00) with the slave's SII",
        code if is_about_process_data(code) => "compare process data lengths with the objects selected",
        0x001A | 0x002C | 0x002D | 0x0030..=0x0035 => "check cycle time and clock settings",
        0x001B => {
            "keep cyclic data running before and in OP; look for lost frames or a watchdog shorter than the pauses"
        }
        0x001F => "choose a watchdog time that the slave supports",
        0x0020 | 0x0060 => "power-cycle the slave",
        0x0050 | 0x0051 => "check the slave's SII contents; the memory may be damaged",
        _ => "look for the code in the slave's manual",
    }
}

#[cfg(test)]
mod tests {
    use super::super::acyclic::{IN_FLIGHT_MAX, Lane, Outcome, REGISTER_BYTES_MAX, Reply};
    use super::super::wire::{read_u16, write_bytes};
    use super::*;
    use core::pin::pin;
    use core::task::{Context, Poll, Waker};
    use heapless::spsc::Queue;
    use std::vec::Vec;

    /// How a slave takes an acknowledgement.
    #[derive(Clone, Copy, PartialEq, Eq)]
    enum Nature {
        /// It drops its error flag.
        Obedient,
        /// It keeps its error flag.
        Stubborn,
        /// Device emulation: it copies what it gets.
        Emulated,
        /// The first reading of its status after the first request does not reach it.
        Unheard,
    }

    struct Slave {
        status: u16,
        nature: Nature,
        /// What was written to AL control.
        written: Vec<u16>,
    }

    impl Slave {
        fn answer(&mut self, request: &Request) -> Reply<REGISTER_BYTES_MAX> {
            let (mut data, mut working_counter) = (request.data.clone(), 1);
            match (request.command, request.address.register()) {
                (Command::Fprd, register::AL_STATUS) if self.nature == Nature::Unheard && self.written.len() == 1 => {
                    working_counter = 0;
                }
                (Command::Fprd, register::AL_STATUS) => {
                    let is_error = self.status & register::AL_ERROR_BIT != 0 && self.nature != Nature::Emulated;
                    write_bytes(&mut data, 0, &self.status.to_le_bytes());
                    write_bytes(&mut data, 4, &[if is_error { 0x1B } else { 0 }, 0]);
                }
                (Command::Fpwr, register::AL_CONTROL) => {
                    let wanted = read_u16(&data, 0);
                    self.written.push(wanted);
                    match self.nature {
                        Nature::Obedient if wanted & register::AL_ERROR_BIT != 0 => {
                            self.status = wanted & register::AL_STATE_MASK;
                        }
                        Nature::Emulated => self.status = wanted,
                        _ => {}
                    }
                }
                other => panic!("{other:?}"),
            }
            Reply {
                data,
                outcome: Outcome::Processed { working_counter },
            }
        }
    }

    /// Does something with a slave in a state; returns the result and what was written to the slave.
    fn with_slave<T>(
        status: u16,
        nature: Nature,
        work: impl AsyncFnOnce(&mut AcyclicPort<'_, 32>) -> T,
    ) -> (T, Vec<u16>) {
        let mut slave = Slave {
            status,
            nature,
            written: Vec::new(),
        };
        let mut requests = Queue::<Request, { IN_FLIGHT_MAX + 1 }>::new();
        let mut replies = Queue::<Reply<REGISTER_BYTES_MAX>, { IN_FLIGHT_MAX + 1 }>::new();
        let (mut messages, mut answers) = (Queue::<Request<32>, 2>::new(), Queue::<Reply<32>, 2>::new());
        let (ask, mut asked) = requests.split();
        let (mut give, given) = replies.split();
        let message_lane = Lane::new(messages.split().0, answers.split().1);
        let mut port = AcyclicPort::new(Lane::new(ask, given), message_lane);
        let mut future = pin!(work(&mut port));
        for _ in 0..2 * OPERATIONAL_TIMEOUT_MS {
            if let Poll::Ready(result) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                return (result, slave.written);
            }
            while let Some(request) = asked.dequeue() {
                assert!(give.enqueue(slave.answer(&request)).is_ok());
            }
        }
        panic!("no end");
    }

    fn acknowledged(status: u16, nature: Nature) -> (Result<AlReport, BusError>, Vec<u16>) {
        with_slave(status, nature, async |port| acknowledge(port, 0x1001).await)
    }

    #[test]
    fn an_error_is_acknowledged_in_the_state_that_it_left_and_nothing_is_written_without_one() {
        let report = |status| Ok(AlReport { status, code: 0 });
        assert_eq!(acknowledged(0x14, Nature::Obedient), (report(0x04), std::vec![0x14]));
        assert_eq!(acknowledged(0x08, Nature::Obedient), (report(0x08), Vec::new()));
    }

    #[test]
    fn an_error_that_stays_is_reported_with_the_state() {
        let expected = BusError::State {
            expected: 4,
            actual: 0x14,
            code: 0x1B,
        };
        assert_eq!(acknowledged(0x14, Nature::Stubborn), (Err(expected), std::vec![0x14]));
    }

    #[test]
    fn an_echo_of_the_acknowledgement_is_removed_and_not_repeated() {
        let report = |status| Ok(AlReport { status, code: 0 });
        assert_eq!(acknowledged(0x14, Nature::Emulated), (report(0x04), std::vec![4]));
        for (status, target) in [
            (0x11, AlState::PreOperational),
            (0x18, AlState::Init),
            (8, AlState::Init),
        ] {
            let (result, written) = with_slave(status, Nature::Emulated, async |port| {
                change(port, 0x1001, target).await
            });
            assert_eq!(result, Ok(()));
            assert_eq!(written.last(), Some(&(target as u16)), "{written:x?}");
        }
    }

    #[test]
    fn a_request_whose_status_was_not_read_is_tried_again() {
        let (result, written) = with_slave(2, Nature::Unheard, async |port| request(port, 0x1001, 4).await);
        assert_eq!(result, Ok(AlReport { status: 2, code: 0 }));
        assert_eq!(written, [4, 4]);
    }

    #[test]
    fn each_state_has_its_own_time() {
        let times = [
            (1, AlState::PreOperational, 3_000),
            (2, AlState::SafeOperational, 10_000),
            (4, AlState::Operational, 10_000),
            (8, AlState::Init, 5_000),
        ];
        for (status, target, limit_ms) in times {
            let (result, written) = with_slave(status, Nature::Stubborn, async |port| {
                change(port, 0x1001, target).await
            });
            let Err(BusError::StateTimeout {
                expected,
                actual,
                waited_ms,
            }) = result
            else {
                panic!("{result:?}");
            };
            assert_eq!(
                (u16::from(actual), expected, written),
                (status, target as u8, std::vec![target as u16])
            );
            assert!((limit_ms..limit_ms + 20).contains(&waited_ms), "{waited_ms} ms");
        }
    }
}
