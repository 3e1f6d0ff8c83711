//! Cable diagnosis: ports, cables and error counters.
//!
//! A damaged frame is counted by the first slave that receives it, at the port where it enters: the cable in that port
//! is the bad one. The counters (0x0300 to 0x0313, IEC 61158-4-12) start at 0 when the bus is brought up.
//!
//! Invariant: one slave's counters are read at a time, and a cable is reported when its counters have grown.

use super::super::acyclic::Request;
use super::super::diagnostics::{ClockInfo, PortInfo, SlaveErrors};
use super::super::driver::SlaveFactory;
use super::super::error::BusError;
use super::super::event::BusEvent;
use super::super::slave::Condition;
use super::super::topology::{self, Parents};
use super::super::wire::coe::Emergency;
use super::super::wire::register::{ErrorCounters, PORTS};
use super::super::wire::{Address, Command, read_u8, read_u16, read_u32, register};
use super::LookList;
use super::bus::{Bus, LOOK_MAX};
use heapless::Vec;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Reads which ports of the slaves are in use.
    pub(super) async fn read_ports(&mut self) {
        let Self { port, slaves, .. } = self;
        for chunk in slaves.chunks_mut(LOOK_MAX) {
            let mut requests: LookList<Request> = LookList::new();
            for slave in chunk.iter() {
                let address = Address::station(slave.station(), register::DL_STATUS);
                // The list has room for one frame's slaves.
                let _ = requests.push(Request::read(Command::Fprd, address, 2));
            }
            // The ports of a slave that does not answer keep their last state.
            let _ = port
                .send_all_until_counted(&requests, 1, |number, bytes| {
                    if let Some(slave) = chunk.get_mut(number) {
                        slave.dl_status = read_u16(bytes, 0);
                    }
                })
                .await;
        }
    }

    fn parents(&self) -> Parents<SLAVES> {
        let dl_status: Vec<u16, SLAVES> = self.slaves.iter().map(|slave| slave.dl_status).collect();
        topology::parents(&dl_status)
    }

    /// The slaves at the other ends of a slave's cables.
    pub(super) fn partners(&self, number: usize) -> [Option<u8>; PORTS] {
        let dl_status = self.slaves.get(number).map_or(0, |slave| slave.dl_status);
        topology::partners(&self.parents(), number, dl_status)
    }

    /// A slave's ports with their partners.
    pub(super) fn ports(&self, number: usize) -> [PortInfo; PORTS] {
        let dl_status = self.slaves.get(number).map_or(0, |slave| slave.dl_status);
        let mut ports = topology::ports(dl_status);
        for (port, partner) in ports.iter_mut().zip(self.partners(number)) {
            port.partner = partner;
        }
        ports
    }

    /// Reads a slave's error counters.
    pub(super) async fn errors(&mut self, number: usize) -> Result<SlaveErrors, BusError> {
        let station = self.slaves.get(number).map_or(0, super::super::slave::Slave::station);
        let length = register::ERROR_COUNTERS_LEN;
        let bytes = self.port.read(station, register::RECEIVE_ERRORS, length).await?;
        // As many bytes as requested came back.
        let counters = ErrorCounters::parse(&bytes).unwrap_or_default();
        let watchdog = self.port.read(station, register::WATCHDOG_COUNTER, 1).await?;
        Ok(SlaveErrors {
            ports: counters.ports,
            partners: self.partners(number),
            processing_unit: counters.processing_errors,
            processor_interface: counters.pdi_errors,
            watchdog: read_u8(&watchdog, 0),
        })
    }

    /// Forgets the last counters of the cables.
    pub(super) fn forget_errors(&mut self) {
        for slave in &mut self.slaves {
            slave.port_errors = [0; PORTS];
        }
    }

    /// Reads the next slave's counters and reports the cables whose error counts have grown.
    pub(super) async fn check_cables(&mut self) {
        let number = self.cable_next % self.slaves.len().max(1);
        self.cable_next = number + 1;
        let Some(slave) = self.slaves.get(number) else { return };
        let (station, before) = (slave.station(), slave.port_errors);
        let length = register::ERROR_COUNTERS_LEN;
        let Ok(bytes) = self.port.read(station, register::RECEIVE_ERRORS, length).await else {
            return;
        };
        let counters = ErrorCounters::parse(&bytes).unwrap_or_default();
        let now = counters
            .ports
            .map(|port| u16::from(port.invalid_frames.max(port.receive_errors)) + u16::from(port.lost_links));
        if let Some(slave) = self.slaves.get_mut(number) {
            slave.port_errors = now;
        }
        for (port, (now, before)) in (0_u8..).zip(now.into_iter().zip(before)) {
            if now > before {
                let partners = self.partners(number);
                let event = BusEvent::CableErrors {
                    position: number as u8,
                    port,
                    partner: partners.get(usize::from(port)).copied().flatten(),
                    count: now - before,
                };
                self.emit(event).await;
            }
        }
    }

    /// Reads how often the processor watchdog of the last inspected slave has expired, and reports an expiry in OP: the
    /// slave's process data were stale. Controllers without that watchdog never count.
    pub(super) async fn look_at_processor(&mut self) {
        let number = self.cable_next.saturating_sub(1);
        let Some(slave) = self.slaves.get(number) else { return };
        let (station, before) = (slave.station(), slave.processor_stops);
        let Ok(bytes) = self.port.read(station, register::WATCHDOG_COUNTER_PDI, 1).await else {
            return;
        };
        let expiries = read_u8(&bytes, 0);
        let Some(slave) = self.slaves.get_mut(number) else {
            return;
        };
        let is_operational = slave.condition == Condition::Operational;
        // After a reset or a repair the counter may start at any value.
        slave.processor_stops = is_operational.then_some(expiries);
        if is_operational && before.is_some_and(|before| expiries != before) {
            let position = number as u8;
            self.emit(BusEvent::ProcessorStopped { position, expiries }).await;
        }
    }

    /// Fetches unsolicited messages from the mailbox of the last inspected slave, and reports its emergencies.
    pub(super) async fn check_mailbox(&mut self) {
        let number = self.cable_next.saturating_sub(1);
        let Some(slave) = self.slaves.get_mut(number) else {
            return;
        };
        if slave.condition != Condition::Operational || slave.fixed.mailbox_in.length == 0 {
            return;
        }
        // A slave that does not answer is detected elsewhere.
        let _ = slave.mailbox.drain(&mut self.port).await;
        while let Some(emergency) = self.take_emergency(number) {
            let position = number as u8;
            self.emit(BusEvent::Emergency { position, emergency }).await;
        }
    }

    /// Takes the next emergency of a slave and stores it as the slave's last one.
    fn take_emergency(&mut self, number: usize) -> Option<Emergency> {
        let slave = self.slaves.get_mut(number)?;
        let emergency = slave.mailbox.take_emergency()?;
        slave.emergency = Some(emergency);
        Some(emergency)
    }

    /// A slave's clock, if it has one.
    pub(super) async fn clock(&mut self, number: usize, station: u16) -> Result<Option<ClockInfo>, BusError> {
        let features = self.port.read_u16(station, register::FEATURES).await?;
        let time = Request::read(Command::Fprd, Address::station(station, register::DC_SYSTEM_TIME), 4);
        if features & register::FEATURE_CLOCKS == 0 || self.port.answered(&time).await?.1 == 0 {
            return Ok(None);
        }
        let delay = self.port.read(station, register::DC_DELAY, 4).await?;
        let difference = self.port.read(station, register::DC_TIME_DIFFERENCE, 4).await?;
        Ok(Some(ClockInfo {
            is_64_bit: features & register::FEATURE_CLOCKS_64 != 0,
            delay_ns: read_u32(&delay, 0),
            // The clock that is distributed is compared with none.
            difference_ns: match self.distributor() == Some(number) {
                true => 0,
                false => register::time_difference_ns(read_u32(&difference, 0)),
            },
        }))
    }
}
