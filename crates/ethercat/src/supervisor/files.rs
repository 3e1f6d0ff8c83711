//! Requests for files: opens one, passes its packets on piece by piece, and closes it.
//!
//! With BOOT, the slave is brought to INIT, gets the mailboxes that its information memory names for BOOT, and goes to
//! BOOT; closing brings it back to INIT. Without, a slave in INIT is brought to PREOP and stays there.
//!
//! Invariants: one file is open at a time, and the supervisor's buffer holds at most one packet of it; a slave in BOOT is
//! not taken out of BOOT by a bring-up, a repair or a stop before its file is closed or abandoned.

use super::super::configure::{discovery, information};
use super::super::diagnostics::{
    FileRequest, PIECE_BYTES_MAX, Piece, ServiceError, ServiceReply, ServiceRequest, ServiceResult,
};
use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::event::{BusEvent, Step};
use super::super::foe::FileAccess;
use super::super::mailbox::Mailbox;
use super::super::slave::{Condition, SlaveData};
use super::super::state::{self, AlReport, AlState};
use super::super::wire::read_u16;
use super::super::wire::sii::{FixedPart, MailboxWindow, PROTOCOL_FOE, WORD_BOOTSTRAP_OUT};
use super::bus::{Bus, OpenFile};

/// After this pause between two requests for an open file, the file counts as abandoned, ms.
const FILE_IDLE_MS: u32 = 10_000;
/// Bytes of the four words that tell the mailboxes of BOOT.
const BOOTSTRAP_LEN: usize = 8;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Opens a file of a slave.
    pub(super) async fn open_file(&mut self, number: usize, request: &FileRequest) -> ServiceResult {
        self.close_file().await?;
        let fixed = self.slaves.get(number).ok_or(ServiceError::Interrupted)?.fixed;
        if fixed.protocols & PROTOCOL_FOE == 0 {
            return Err(ServiceError::NoFoe);
        }
        match request.bootstrap {
            true => self.enter_bootstrap(number, fixed).await?,
            false => self.open_any_mailbox(number).await?,
        }
        self.value.clear();
        let file = OpenFile {
            number,
            writes: request.writes,
            bootstrap: request.bootstrap,
            packet: 0,
            passed: 0,
            ended: false,
            used_ms: self.port.now_ms(),
        };
        // The slave leaves BOOT even when it refuses the file.
        self.file = Some(file);
        let Self {
            port, slaves, value, ..
        } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        let mut access = FileAccess::new(port, &mut slave.mailbox);
        if request.writes {
            access.begin_write(&request.name, request.password).await?;
        } else {
            access.begin_read(&request.name, request.password, value).await?;
            let ended = access.is_last(value);
            self.file = Some(OpenFile {
                packet: 1,
                ended,
                ..file
            });
        }
        Ok(ServiceReply::Done)
    }

    /// The next piece of the file that is read.
    pub(super) async fn read_file(&mut self, number: usize) -> ServiceResult {
        let Some(mut file) = self.file.filter(|file| file.number == number && !file.writes) else {
            return Err(ServiceError::Interrupted);
        };
        let Self {
            port, slaves, value, ..
        } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        let mut access = FileAccess::new(port, &mut slave.mailbox);
        if file.passed >= value.len() && !file.ended {
            access.next(file.packet, value).await?;
            file.packet = file.packet.wrapping_add(1);
            file.passed = 0;
            file.ended = access.is_last(value);
        }
        let rest = value.get(file.passed..).unwrap_or(&[]);
        let piece = rest.get(..rest.len().min(PIECE_BYTES_MAX)).unwrap_or(&[]);
        let piece = Piece::from_slice(piece).unwrap_or_default();
        file.passed += piece.len();
        let last = file.ended && file.passed >= value.len();
        if last {
            access.end_read(file.packet).await?;
        }
        self.file = Some(file);
        Ok(ServiceReply::FilePiece { piece, last })
    }

    /// Takes the next piece of the file that is written.
    pub(super) async fn write_file(&mut self, number: usize, piece: &[u8], last: bool) -> ServiceResult {
        let Some(mut file) = self
            .file
            .filter(|file| file.number == number && file.writes && !file.ended)
        else {
            return Err(ServiceError::Interrupted);
        };
        let Self {
            port, slaves, value, ..
        } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        let mut access = FileAccess::new(port, &mut slave.mailbox);
        let room = access.room().clamp(1, MESSAGE);
        let mut rest = piece;
        while !rest.is_empty() {
            let (here, behind) = rest.split_at(rest.len().min(room.saturating_sub(value.len())));
            // A packet that is full was sent and taken out of the buffer.
            value.extend_from_slice(here).map_err(|_| ServiceError::Interrupted)?;
            rest = behind;
            if value.len() >= room {
                file.packet = file.packet.wrapping_add(1);
                access.put(file.packet, value).await?;
                value.clear();
                self.file = Some(file);
            }
        }
        if last {
            file.packet = file.packet.wrapping_add(1);
            access.put(file.packet, value).await?;
            value.clear();
            file.ended = true;
            self.file = Some(file);
        }
        Ok(ServiceReply::Done)
    }

    /// Closes the open file, if there is one; a transfer that was not completed is ended.
    pub(super) async fn close_file(&mut self) -> Result<(), ServiceError> {
        let Some(file) = self.file.take() else { return Ok(()) };
        self.value.clear();
        let Self { port, slaves, .. } = self;
        let slave = slaves.get_mut(file.number).ok_or(ServiceError::Interrupted)?;
        let station = slave.station();
        if file.bootstrap && !state::report(port, station).await?.is(AlState::Bootstrap) {
            // A repair or a new bring-up has taken the slave out of BOOT: it may move a motor by now.
            return Ok(());
        }
        if !file.ended {
            // The change of state below ends the transfer too.
            let _ = FileAccess::new(port, &mut slave.mailbox).cancel().await;
        }
        if file.bootstrap {
            slave.mailbox = Mailbox::default();
            state::change(port, station, AlState::Init).await?;
            slave.report = state::report(port, station).await?;
            self.introduce(file.number).await;
        }
        Ok(())
    }

    /// Notes that a request for the open file has ended, carried out or not.
    pub(super) fn use_file(&mut self) {
        let now_ms = self.port.now_ms();
        if let Some(file) = self.file.as_mut() {
            file.used_ms = now_ms;
        }
    }

    /// Whether a request opens a file in BOOT, or passes a packet of one on.
    pub(super) fn transfers(&self, request: &ServiceRequest) -> bool {
        match request {
            ServiceRequest::OpenFile { file, .. } => file.bootstrap,
            ServiceRequest::ReadFile { .. } | ServiceRequest::WriteFile { .. } => {
                self.file.is_some_and(|file| file.bootstrap)
            }
            _ => false,
        }
    }

    /// The slave whose file is being transferred in BOOT: its memory may stay half written if its state is changed. A slave
    /// that has left BOOT has none, nor has one whose file nobody has asked for in [`FILE_IDLE_MS`]. A slave that does not
    /// answer may still be in BOOT.
    pub(super) async fn transferring(&mut self) -> Option<usize> {
        let file = self.file.filter(|file| file.bootstrap)?;
        let is_in_use = self.port.now_ms().wrapping_sub(file.used_ms) < FILE_IDLE_MS;
        let station = self.slaves.get(file.number).filter(|_| is_in_use)?.station();
        let report = state::report(&mut self.port, station).await;
        let has_left = report.is_ok_and(|report| !report.is(AlState::Bootstrap));
        (!has_left).then_some(file.number)
    }

    /// Refuses to bring a slave up whose file is being transferred.
    pub(super) async fn refuse_for_file(&mut self, number: usize) {
        let (position, step, error) = (number as u8, Step::Bootstrap, BusError::FileOpen);
        let event = match self.is_terminal(number) {
            true => BusEvent::TerminalRefused { position, step, error },
            false => BusEvent::Refused {
                position: Some(position),
                step,
                error,
            },
        };
        self.emit(event).await;
    }

    /// Forgets the open file: its slave begins anew.
    pub(super) fn forget_file(&mut self) {
        self.file = None;
        self.value.clear();
    }

    /// Brings a slave to BOOT, with the mailboxes of this state. A slave without such mailboxes keeps its state.
    async fn enter_bootstrap(&mut self, number: usize, fixed: FixedPart) -> Result<(), ServiceError> {
        let station = self.slaves.get(number).ok_or(ServiceError::Interrupted)?.station();
        let (fixed, mailbox) = match self.bootstrap_mailboxes(station, fixed).await {
            Ok(found) => found,
            Err(error) => {
                self.return_memory(number).await;
                return Err(error.into());
            }
        };
        // It may need its memory for BOOT.
        information::give_to_slave(&mut self.port, station).await;
        self.work_on(Some(number)).await;
        let Self { port, slaves, .. } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        if slave.is_used() {
            slave.condition = Condition::Parked;
        } else {
            slave.data = SlaveData::Unknown;
        }
        state::change(port, station, AlState::Init).await?;
        slave.report = AlReport::default();
        discovery::clear(port, station).await?;
        discovery::mailbox_managers(port, station, &fixed).await?;
        state::change(port, station, AlState::Bootstrap).await?;
        slave.mailbox = mailbox;
        slave.report = state::report(port, station).await?;
        self.introduce(number).await;
        Ok(())
    }

    /// The mailboxes that a slave's information memory names for BOOT.
    async fn bootstrap_mailboxes(&mut self, station: u16, fixed: FixedPart) -> Result<(FixedPart, Mailbox), BusError> {
        information::take(&mut self.port, station).await;
        let mut words = [0; BOOTSTRAP_LEN];
        information::read_words(&mut self.port, station, WORD_BOOTSTRAP_OUT, &mut words).await?;
        let window = |at: usize| MailboxWindow {
            start: read_u16(&words, at),
            length: read_u16(&words, at + 2),
        };
        let fixed = FixedPart {
            mailbox_out: window(0),
            mailbox_in: window(4),
            ..fixed
        };
        let mailbox = Mailbox::new::<MESSAGE>(station, fixed.mailbox_out, fixed.mailbox_in)?;
        Ok((fixed, mailbox))
    }

    /// Makes sure that a slave's mailbox can be used, whatever it speaks: a slave in INIT is brought to PREOP.
    async fn open_any_mailbox(&mut self, number: usize) -> Result<(), ServiceError> {
        let slave = self.slaves.get(number).copied().ok_or(ServiceError::Interrupted)?;
        if slave.fixed.mailbox_out.length == 0 {
            let (expected, actual) = (MESSAGE as u16, 0);
            return Err(BusError::MailboxLength { expected, actual }.into());
        }
        self.ready_or_reach_pre_operational(number).await
    }
}
