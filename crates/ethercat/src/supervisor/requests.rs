//! Service requests: carries out bus requests from people and tools.
//!
//! If the bus was not brought up, the slaves are first found and identified whenever their number or their addresses
//! have changed; nothing is configured. Values longer than a piece stay in one buffer.
//!
//! Invariant: a request accesses the slave that it names and no other, except `ClearErrors`.

use super::super::acyclic::REGISTER_BYTES_MAX;
use super::super::coe::ObjectDictionary;
use super::super::configure::discovery::STATION_BASE;
use super::super::configure::{information, own_data};
use super::super::cyclic::Observation;
use super::super::diagnostics::{
    BusInfo, Name, PIECE_BYTES_MAX, Piece, ServiceError, ServiceReply, ServiceRequest, ServiceResult, SlaveInfo,
};
use super::super::driver::{Direction, SlaveFactory};
use super::super::error::BusError;
use super::super::mailbox::Mailbox;
use super::super::slave::Condition;
use super::super::state::{self, AlState};
use super::super::wire::coe::Object;
use super::super::wire::register;
use super::super::wire::sii::PROTOCOL_COE;
use super::bus::Bus;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Carries out a request.
    pub(super) async fn carry_out(
        &mut self,
        request: &ServiceRequest,
        seen: Option<Observation>,
        running: bool,
    ) -> ServiceResult {
        // A slave that is plugged in does not end a transfer.
        if !running && self.transferring().await.is_none() {
            self.know_all().await?;
        }
        let number = usize::from(request.slave().unwrap_or(0));
        let station = match request.slave() {
            Some(slave) if usize::from(slave) >= self.slaves.len() => {
                let slaves = self.slaves.len() as u8;
                return Err(ServiceError::NoSlave { slaves });
            }
            slave => STATION_BASE.wrapping_add(slave.unwrap_or(0).into()),
        };
        let uses_buffer = matches!(
            request,
            ServiceRequest::Upload { .. } | ServiceRequest::Download { .. } | ServiceRequest::SetState { .. }
        );
        if uses_buffer {
            self.close_file().await?;
        }
        match request {
            ServiceRequest::OpenFile { file, .. } => {
                let opened = self.open_file(number, file).await;
                if opened.is_err() {
                    // The reason is returned whether or not the slave could be brought back.
                    let _ = self.close_file().await;
                }
                opened
            }
            ServiceRequest::ReadFile { .. } => self.read_file(number).await,
            ServiceRequest::WriteFile { piece, last, .. } => self.write_file(number, piece, *last).await,
            ServiceRequest::CloseFile { .. } => {
                self.close_file().await?;
                Ok(ServiceReply::Done)
            }
            ServiceRequest::Bus => Ok(ServiceReply::Bus(self.bus_info(seen, running))),
            ServiceRequest::Slave { .. } => {
                let info = self.slave_info(number).await;
                self.return_memory(number).await;
                Ok(ServiceReply::Slave(info?))
            }
            ServiceRequest::SetState { state, .. } => Ok(ServiceReply::State(self.set_state(number, *state).await?)),
            ServiceRequest::Upload {
                object,
                offset,
                complete,
                ..
            } => {
                if *offset == 0 {
                    self.open_mailbox(number).await?;
                    self.upload(number, *object, *complete).await?;
                }
                self.piece(*offset)
            }
            ServiceRequest::Download { .. } => self.download(number, request).await,
            ServiceRequest::Objects { first, .. } => {
                self.open_mailbox(number).await?;
                self.object_list(number, *first).await
            }
            ServiceRequest::DescribeObject { index, .. } => {
                self.open_mailbox(number).await?;
                self.object_description(number, *index).await
            }
            ServiceRequest::DescribeEntry { object, .. } => {
                self.open_mailbox(number).await?;
                self.entry_description(number, *object).await
            }
            ServiceRequest::Registers { address, length, .. } => self.registers(station, *address, *length).await,
            ServiceRequest::Information { word, length, .. } => {
                let answer = self.information(station, *word, *length).await;
                self.return_memory(number).await;
                answer
            }
            ServiceRequest::Errors { .. } => {
                self.read_ports().await;
                Ok(ServiceReply::Errors(self.errors(number).await?))
            }
            ServiceRequest::ClearErrors => {
                let nothing = [0; register::ERROR_COUNTERS_LEN];
                self.port.broadcast_write(register::RECEIVE_ERRORS, &nothing).await?;
                self.forget_errors();
                Ok(ServiceReply::Done)
            }
        }
    }

    /// Gives the SII back to a slave that has had it since SAFEOP.
    pub(super) async fn return_memory(&mut self, number: usize) {
        let Some(slave) = self.slaves.get(number) else { return };
        let state = slave.report.state().unwrap_or(AlState::Init);
        if matches!(state, AlState::SafeOperational | AlState::Operational) {
            information::give_to_slave(&mut self.port, slave.station()).await;
        }
    }

    /// Makes sure that the slaves are identified and have their addresses.
    async fn know_all(&mut self) -> Result<(), ServiceError> {
        let places = self.places().await?;
        let same = places.len() == self.slaves.len();
        if same && (STATION_BASE..).zip(&places).all(|(station, there)| station == *there) {
            return Ok(());
        }
        if places.len() > SLAVES {
            let error = BusError::TooManySlaves {
                expected: SLAVES as u16,
                actual: places.len() as u16,
            };
            return Err(error.into());
        }
        self.identify_all(places.len() as u16).await?;
        for first in (0..self.slaves.len()).step_by(super::bus::LOOK_MAX) {
            let reports = self.reports(first..first + super::bus::LOOK_MAX).await;
            for (slave, report) in self.slaves.iter_mut().skip(first).zip(reports) {
                slave.report = report.unwrap_or_default();
            }
        }
        self.send_plan().await;
        Ok(())
    }

    fn bus_info(&self, seen: Option<Observation>, running: bool) -> BusInfo {
        let al = seen.map(|seen| seen.al).unwrap_or_default();
        BusInfo {
            slaves: self.slaves.len() as u8,
            answering: al.slaves,
            al_status: al.status,
            operational: running && self.is_operational(),
            reference_clock: self.distributor().map(|number| number as u8),
        }
    }

    async fn slave_info(&mut self, number: usize) -> Result<SlaveInfo, ServiceError> {
        self.read_ports().await;
        let Some(slave) = self.slaves.get(number).copied() else {
            return Err(ServiceError::Interrupted);
        };
        let station = slave.station();
        let report = state::report(&mut self.port, station).await?;
        let name_here = |text: &str| Name::try_from(text).unwrap_or_default();
        let description = slave.device.map(F::describe).unwrap_or_default();
        let driver = description.name;
        information::take(&mut self.port, station).await;
        let memory = information::summary(&mut self.port, station).await.unwrap_or_default();
        let speaks = report
            .state()
            .is_some_and(|state| state as u8 >= AlState::PreOperational as u8);
        let status_word = match description.status {
            Some(object) if speaks && slave.condition != Condition::Lost => {
                self.open_mailbox(number).await?;
                self.read_u16(number, object).await
            }
            _ => None,
        };
        let (output_bytes, input_bytes) = self.exchanged(number, speaks).await;
        // To ask is to write AL control: never while the slave may move a motor or set an output.
        let may_ask = matches!(report.state(), Some(AlState::Init | AlState::PreOperational));
        let switch = match slave.switch {
            None if memory.has_switch && may_ask => self.ask_for_switch(number).await?,
            known => known,
        };
        Ok(SlaveInfo {
            station,
            alias: memory.alias,
            switch: switch.filter(|switch| *switch != 0),
            identity: slave.identity(),
            name: if memory.name.is_empty() {
                name_here(driver)
            } else {
                memory.name
            },
            driver: name_here(driver),
            member: slave.member,
            report,
            status_word,
            mailbox_out: slave.fixed.mailbox_out,
            mailbox_in: slave.fixed.mailbox_in,
            protocols: slave.fixed.protocols,
            output_bytes,
            input_bytes,
            ports: self.ports(number),
            clock: self.clock(number, station).await?,
            emergency: slave.emergency,
        })
    }

    /// Bytes of outputs and inputs that a slave exchanges, or would exchange in SAFEOP if it has no driver. `speaks` if its
    /// mailbox works in its present state; the SII has to be the master's.
    async fn exchanged(&mut self, number: usize, speaks: bool) -> (u16, u16) {
        let Self { port, slaves, .. } = self;
        let Some(slave) = slaves.get_mut(number) else {
            return (0, 0);
        };
        if slave.data.is_known() || !slave.has_own_data() {
            return slave.lengths();
        }
        let has_objects = slave.fixed.protocols & PROTOCOL_COE != 0 && slave.mailbox != Mailbox::default();
        let station = slave.station();
        let mailbox = (speaks && has_objects).then_some(&mut slave.mailbox);
        let data = own_data::find(port, station, mailbox, |_, _, _| {}).await;
        // A slave that does not describe its process data exchanges none.
        data.map_or((0, 0), |data| {
            (data.length(Direction::Outputs), data.length(Direction::Inputs))
        })
    }

    async fn read_u16(&mut self, number: usize, object: Object) -> Option<u16> {
        let slave = self.slaves.get_mut(number)?;
        let mut dictionary = ObjectDictionary::new(&mut self.port, &mut slave.mailbox);
        let value = dictionary.read(object, 2).await.ok()?;
        u16::try_from(value).ok()
    }

    /// A part of the value in the buffer.
    fn piece(&self, offset: u16) -> ServiceResult {
        let rest = self
            .value
            .get(usize::from(offset)..)
            .ok_or(ServiceError::Piece { room: MESSAGE as u16 })?;
        let piece = rest.get(..rest.len().min(PIECE_BYTES_MAX)).unwrap_or(&[]);
        Ok(ServiceReply::Piece {
            total: self.value.len() as u16,
            piece: Piece::from_slice(piece).unwrap_or_default(),
        })
    }

    /// Reads registers or memory, as much in a frame as fits.
    async fn registers(&mut self, station: u16, address: u16, length: u16) -> ServiceResult {
        let mut piece = Piece::new();
        let length = usize::from(length).min(PIECE_BYTES_MAX);
        while piece.len() < length {
            let here = (length - piece.len()).min(REGISTER_BYTES_MAX);
            let from = address.wrapping_add(piece.len() as u16);
            let bytes = self.port.read(station, from, here).await?;
            if piece.extend_from_slice(&bytes).is_err() || bytes.is_empty() {
                break;
            }
        }
        let total = piece.len() as u16;
        Ok(ServiceReply::Piece { total, piece })
    }

    /// Reads the slave information memory up to its end.
    async fn information(&mut self, station: u16, word: u16, length: u16) -> ServiceResult {
        let mut bytes = [0; PIECE_BYTES_MAX];
        let wanted = usize::from(length).min(PIECE_BYTES_MAX);
        let room = bytes.get_mut(..wanted).unwrap_or_default();
        information::take(&mut self.port, station).await;
        let read = information::read_words(&mut self.port, station, word, room).await?;
        let piece = Piece::from_slice(bytes.get(..read).unwrap_or(&[])).unwrap_or_default();
        let total = piece.len() as u16;
        Ok(ServiceReply::Piece { total, piece })
    }

    /// Takes the pieces of a value; the last one starts the transfer.
    async fn download(&mut self, number: usize, request: &ServiceRequest) -> ServiceResult {
        let ServiceRequest::Download {
            object,
            complete,
            total,
            offset,
            piece,
            ..
        } = request
        else {
            return Err(ServiceError::Interrupted);
        };
        if *offset == 0 {
            self.value.clear();
        }
        let room = ServiceError::Piece { room: MESSAGE as u16 };
        let end = self.value.len() + piece.len();
        if usize::from(*offset) != self.value.len() || end > usize::from(*total) || usize::from(*total) > MESSAGE {
            self.value.clear();
            return Err(room);
        }
        self.value.extend_from_slice(piece).map_err(|_| room)?;
        if end < usize::from(*total) {
            return Ok(ServiceReply::Done);
        }
        self.open_mailbox(number).await?;
        self.write_value(number, *object, *complete).await?;
        self.value.clear();
        Ok(ServiceReply::Done)
    }
}
