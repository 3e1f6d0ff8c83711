//! A small chain of drives for tests of the master: registers, SII, mailbox, and nothing that moves.
//!
//! It answers at once and does exactly what the master's steps need; `etherpen-segment` is the complete virtual
//! segment.

use etherpen_ethercat::wire::coe::{Object, SDO_LEN, Sdo};
use etherpen_ethercat::wire::mailbox::{self, MAILBOX_HEADER_LEN, MailboxRepr, Protocol};
use etherpen_ethercat::wire::register::{self, FmmuRepr, SyncManagerRepr};
use etherpen_ethercat::wire::{
    Command, Datagram, DatagramRepr, Datagrams, FrameView, PAYLOAD_OFFSET, SOURCE_BIT, read_u8, read_u16, write_bytes,
};
use std::collections::BTreeMap;
use std::vec;
use std::vec::Vec;

const MEMORY: usize = 0x2000;

/// How a drive rounds a value to its own unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rounding {
    Down,
    Up,
}

impl Rounding {
    pub(crate) fn of(self, value: u32, unit: u32) -> u32 {
        match self {
            Self::Down => value / unit * unit,
            Self::Up => value.div_ceil(unit) * unit,
        }
    }
}

/// One slave.
pub(crate) struct FakeSlave {
    pub(crate) memory: Vec<u8>,
    pub(crate) sii: Vec<u8>,
    pub(crate) objects: BTreeMap<(u16, u8), Vec<u8>>,
    pub(crate) connected: bool,
    pub(crate) refuse_state: Option<(u8, u16)>,
    pub(crate) downloads: usize,
    pub(crate) mute: bool,
    /// Objects whose writing is refused.
    pub(crate) read_only: Vec<u16>,
    /// Objects that take a value and keep the one that they have.
    pub(crate) deaf: Vec<u16>,
    /// Objects of 32 bits that it keeps as a multiple of a unit of its own, rounded down or up.
    pub(crate) coarse: Vec<(u16, u32, Rounding)>,
    /// Only INIT clears the error flag.
    pub(crate) sticky_error: bool,
    /// Whether it has no processor: it copies AL control to AL status.
    pub(crate) emulated: bool,
    /// Milliseconds until its processor has started up and reads AL control.
    pub(crate) boots: u32,
    /// Its alias.
    pub(crate) alias: u16,
    /// Lowest AL state in which it shows the mode that was set.
    pub(crate) shows_mode_in: u8,
    /// Number of its identification switches.
    pub(crate) switch: Option<u16>,
    /// Whether its processor reads the SII on the way to PREOP.
    pub(crate) reads_sii: bool,
    /// Number of FMMUs; a write that reaches beyond them is refused.
    pub(crate) fmmus: usize,
    /// Whether it answers where its inputs are mapped.
    pub(crate) gives_inputs: bool,
    unread: Option<u8>,
    answers: Vec<Vec<u8>>,
    fetched: Vec<u8>,
    mailbox_counter: u8,
}

impl FakeSlave {
    /// An AX2000-B110 after power-up.
    pub(crate) fn drive() -> Self {
        let mut sii = vec![0; 128];
        for (word, value) in [(8, 2_u32), (10, 0x07D0_6014), (12, 0x110A), (14, 0)] {
            write_bytes(&mut sii, word * 2, &value.to_le_bytes());
        }
        for (word, value) in [(0x18, 0x1800_u16), (0x19, 512), (0x1A, 0x1C00), (0x1B, 512), (0x1C, 4)] {
            write_bytes(&mut sii, word * 2, &value.to_le_bytes());
        }
        let mut slave = Self {
            memory: Vec::new(),
            sii,
            objects: BTreeMap::new(),
            connected: true,
            refuse_state: None,
            downloads: 0,
            mute: false,
            read_only: Vec::new(),
            deaf: Vec::new(),
            coarse: Vec::new(),
            sticky_error: false,
            emulated: false,
            boots: 0,
            alias: 0,
            shows_mode_in: 0,
            switch: None,
            reads_sii: false,
            fmmus: 16,
            gives_inputs: true,
            unread: None,
            answers: Vec::new(),
            fetched: Vec::new(),
            mailbox_counter: 0,
        };
        slave.power_up();
        slave
    }

    /// Resets everything except SII and product.
    pub(crate) fn power_up(&mut self) {
        self.memory = vec![0; MEMORY];
        self.memory[usize::from(register::AL_STATUS)] = 1;
        write_bytes(
            &mut self.memory,
            usize::from(register::STATION_ALIAS),
            &self.alias.to_le_bytes(),
        );
        self.objects = BTreeMap::new();
        for (object, bytes) in [
            ((0x1C12, 0), vec![1]),
            ((0x1C12, 1), vec![0x01, 0x17]),
            ((0x1C13, 0), vec![1]),
            ((0x1C13, 1), vec![0x01, 0x1B]),
            ((0x6060, 0), vec![0]),
            ((0x60C2, 1), vec![0]),
            ((0x60C2, 2), vec![0]),
            ((0x6085, 0), vec![0; 4]),
            ((0x1008, 0), b"AX2000-B110 EtherCAT Drive".to_vec()),
        ] {
            self.objects.insert(object, bytes);
        }
    }

    fn u16_at(&self, at: u16) -> u16 {
        read_u16(&self.memory, usize::from(at))
    }

    pub(crate) fn manager(&self, number: u8) -> SyncManagerRepr {
        SyncManagerRepr::parse(&self.memory[usize::from(register::sync_manager(number))..]).unwrap()
    }

    pub(crate) fn set_al(&mut self, status: u8, code: u16) {
        self.memory[usize::from(register::AL_STATUS)] = status;
        write_bytes(
            &mut self.memory,
            usize::from(register::AL_STATUS_CODE),
            &code.to_le_bytes(),
        );
    }

    fn set_full(&mut self, number: u8, full: bool) {
        let at = usize::from(register::sync_manager(number) + register::SYNC_MANAGER_STATUS_OFFSET);
        self.memory[at] = if full { register::MAILBOX_FULL_BIT } else { 0 };
    }

    fn read(&mut self, at: u16, data: &mut [u8]) -> bool {
        let mail = self.manager(1);
        let from_mailbox = mail.activate & 1 != 0 && at == mail.start && data.len() == usize::from(mail.length);
        if from_mailbox && mail.status & register::MAILBOX_FULL_BIT == 0 {
            return false;
        }
        data.copy_from_slice(&self.memory[usize::from(at)..][..data.len()]);
        if from_mailbox {
            self.fetched = data.to_vec();
            self.set_full(1, false);
            self.next_answer();
        }
        true
    }

    fn next_answer(&mut self) {
        if self.manager(1).status & register::MAILBOX_FULL_BIT == 0 && !self.answers.is_empty() {
            let answer = self.answers.remove(0);
            let start = usize::from(self.manager(1).start);
            write_bytes(&mut self.memory, start, &answer);
            self.set_full(1, true);
        }
    }

    fn write(&mut self, at: u16, data: &[u8]) -> bool {
        let mail = self.manager(0);
        if mail.activate & 1 != 0 && at == mail.start && data.len() == usize::from(mail.length) {
            self.mail(data);
            return true;
        }
        let fmmus = register::FMMU..register::fmmu(16);
        let end = usize::from(at) + data.len();
        if fmmus.contains(&at) && end > usize::from(register::FMMU) + self.fmmus * register::FMMU_LEN {
            return false;
        }
        let has_sii = self.memory[usize::from(register::SII_CONFIG)] & 1 == 0;
        match at {
            register::AL_CONTROL if self.unread.is_some() => return false,
            register::SII_CONTROL if !has_sii => return false,
            _ => write_bytes(&mut self.memory, usize::from(at), data),
        }
        let repeat = register::sync_manager(1) + register::SYNC_MANAGER_ACTIVATE_OFFSET;
        match at {
            register::AL_CONTROL if self.boots > 0 => self.unread = Some(data[0]),
            register::AL_CONTROL => self.change_state(data[0]),
            register::SII_CONTROL if data.len() == 6 => {
                self.memory[usize::from(at) + 1] = 0;
                let word = usize::from(self.u16_at(register::SII_ADDRESS));
                let image = self.sii.get(word * 2..).unwrap_or(&[]).to_vec();
                let answer = image.get(..4).unwrap_or(&[0xFF; 4]);
                write_bytes(&mut self.memory, usize::from(register::SII_DATA), answer);
            }
            _ if at == repeat && (data[0] ^ self.memory[usize::from(repeat) + 1]) & 2 != 0 => {
                self.memory[usize::from(repeat) + 1] ^= 2;
                self.answers.insert(0, self.fetched.clone());
                self.next_answer();
            }
            _ => {}
        }
        true
    }

    fn change_state(&mut self, control: u8) {
        if self.emulated {
            return self.set_al(control & 0x1F, 0);
        }
        let now = self.memory[usize::from(register::AL_STATUS)];
        let wanted = control & 0x0F;
        if let Some(number) = self.switch.filter(|_| control & 0x20 != 0 && now & 0x1F == wanted) {
            return self.set_al(wanted | 0x20, number);
        }
        if wanted == 1 {
            self.mailbox_counter = 0;
            self.answers.clear();
        }
        if self.sticky_error && now & 0x10 != 0 && wanted != 1 {
            return;
        }
        if now & 0x10 != 0 && control & 0x10 == 0 && wanted > now & 0x0F {
            return;
        }
        match self.refuse_state {
            _ if self.reads_sii
                && wanted == 2
                && now == 1
                && self.memory[usize::from(register::SII_CONFIG)] & 1 == 0 =>
            {
                self.set_al(now | 0x10, 0x50)
            }
            Some((state, code)) if state == wanted && now & 0x0F < state => self.set_al(now | 0x10, code),
            _ if wanted == 8 && now & 0x0F < 4 => self.set_al(now | 0x10, 0x11),
            _ => self.set_al(wanted, 0),
        }
    }

    fn mail(&mut self, message: &[u8]) {
        let header = MailboxRepr::parse(message).unwrap();
        if self.mute || header.counter == self.mailbox_counter {
            return;
        }
        self.mailbox_counter = header.counter;
        let answer = self.answer_sdo(mailbox::service_data(message).unwrap());
        let reply = MailboxRepr {
            length: answer.len() as u16,
            protocol: Protocol::Coe,
            ..header
        };
        let mut bytes = vec![0; usize::from(self.manager(1).length)];
        reply.emit(&mut bytes).unwrap();
        write_bytes(&mut bytes, MAILBOX_HEADER_LEN, &answer);
        self.answers.push(bytes);
        self.next_answer();
    }

    fn answer_sdo(&mut self, request: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0; SDO_LEN + 64];
        let missing = |object: Object| Sdo::Abort {
            object,
            code: 0x0602_0000,
        };
        let length = match Sdo::parse_request(request).unwrap() {
            Sdo::DownloadExpedited { object, data, .. } => {
                self.downloads += 1;
                match self.objects.get_mut(&(object.index, object.sub)) {
                    _ if self.read_only.contains(&object.index) => Sdo::Abort {
                        object,
                        code: 0x0601_0002,
                    }
                    .emit(&mut bytes),
                    Some(value) if value.len() == data.len() => {
                        if !self.deaf.contains(&object.index) {
                            *value = data.to_vec();
                        }
                        if let Some((_, unit, rounding)) = self.coarse.iter().find(|(index, ..)| *index == object.index)
                        {
                            let written = u32::from_le_bytes(data.try_into().unwrap());
                            *value = rounding.of(written, *unit).to_le_bytes().to_vec();
                        }
                        Sdo::DownloadDone { object }.emit(&mut bytes)
                    }
                    Some(_) => Sdo::Abort {
                        object,
                        code: 0x0607_0010,
                    }
                    .emit(&mut bytes),
                    None => missing(object).emit(&mut bytes),
                }
            }
            Sdo::Upload { object, .. } => {
                let shown = if object.index == 0x6061 {
                    (0x6060, 0)
                } else {
                    (object.index, object.sub)
                };
                let state = self.memory[usize::from(register::AL_STATUS)] & 0x0F;
                if object.index == 0x6061 && state < self.shows_mode_in {
                    let length = Sdo::UploadExpedited { object, data: &[0] }.emit(&mut bytes);
                    bytes.truncate(length.unwrap());
                    return bytes;
                }
                match self.objects.get(&shown) {
                    Some(data) if data.len() <= 4 => Sdo::UploadExpedited { object, data }.emit(&mut bytes),
                    // The first ten bytes here, the others in a segment.
                    Some(data) => {
                        let size = data.len() as u32;
                        Sdo::UploadNormal {
                            object,
                            size,
                            data: &data[..10],
                        }
                        .emit(&mut bytes)
                    }
                    None => missing(object).emit(&mut bytes),
                }
            }
            Sdo::UploadSegment { toggle } => {
                let data = &self.objects[&(0x1008, 0)][10..];
                Sdo::UploadSegmentData {
                    toggle,
                    last: true,
                    data,
                }
                .emit(&mut bytes)
            }
            other => panic!("not served: {other:?}"),
        };
        bytes.truncate(length.unwrap());
        bytes
    }

    fn logical(&mut self, repr: &DatagramRepr, data: &mut [u8]) -> u16 {
        let mut counter = 0;
        for number in 0..4 {
            let at = usize::from(register::fmmu(number));
            let mapping = FmmuRepr::parse(&self.memory[at..]).unwrap();
            let offset = mapping.logical_start.wrapping_sub(repr.address.0) as usize;
            let inside = offset.saturating_add(mapping.length.into()) <= data.len();
            if !mapping.active || !inside || self.memory[usize::from(register::AL_STATUS)] & 0x0F < 4 {
                continue;
            }
            let start = usize::from(mapping.physical_start);
            let window = &mut data[offset..offset + usize::from(mapping.length)];
            if mapping.reads && repr.command.reads() && self.gives_inputs {
                window.copy_from_slice(&self.memory[start..][..window.len()]);
                counter += 1;
            }
            if mapping.writes && repr.command.writes() {
                write_bytes(&mut self.memory, start, window);
                counter += if repr.command.reads() { 2 } else { 1 };
            }
        }
        counter
    }

    fn process(&mut self, bytes: &mut [u8]) {
        let mut datagram = Datagram::new_checked(bytes).unwrap();
        let repr = DatagramRepr::parse(&datagram).unwrap();
        let (device, at) = (repr.address.device(), repr.address.register());
        let addressed = match repr.command {
            Command::Nop => false,
            Command::Aprd | Command::Apwr => device == 0,
            Command::Fprd | Command::Fpwr => device == self.u16_at(register::STATION_ADDRESS),
            _ => true,
        };
        let mut data = datagram.data().to_vec();
        let mut counter = datagram.working_counter();
        if repr.command.is_logical() {
            counter += self.logical(&repr, &mut data);
        } else if addressed && repr.command.writes() {
            counter += u16::from(self.write(at, &data));
        } else if addressed && repr.command.reads() {
            let before = data.clone();
            if self.read(at, &mut data) {
                counter += 1;
            }
            if repr.command == Command::Brd {
                data.iter_mut().zip(before).for_each(|(new, old)| *new |= old);
            }
        }
        datagram.data_mut().copy_from_slice(&data);
        datagram.set_working_counter(counter);
        if repr.command.counts_position() {
            datagram.set_address(etherpen_ethercat::wire::Address::new(device.wrapping_add(1), at));
        }
    }
}

/// A chain of slaves.
pub(crate) struct FakeSegment {
    pub(crate) slaves: Vec<FakeSlave>,
}

impl FakeSegment {
    /// Some AX2000-B110.
    pub(crate) fn drives(number: usize) -> Self {
        Self {
            slaves: (0..number).map(|_| FakeSlave::drive()).collect(),
        }
    }

    /// Lets a millisecond pass.
    pub(crate) fn millisecond(&mut self) {
        for slave in &mut self.slaves {
            slave.boots = slave.boots.saturating_sub(1);
            if let Some(control) = slave.unread.take_if(|_| slave.boots == 0) {
                slave.change_state(control);
            }
        }
    }

    /// Sends a frame through the connected slaves, in place.
    pub(crate) fn process(&mut self, frame: &mut [u8]) {
        let payload = FrameView::new_checked(frame).unwrap().payload().to_vec();
        let mut chain = Datagrams::new(&payload);
        while let Some(range) = chain.next_range() {
            let range = range.unwrap();
            let bytes = &mut frame[PAYLOAD_OFFSET + range.start..PAYLOAD_OFFSET + range.end];
            for slave in self.slaves.iter_mut().filter(|slave| slave.connected) {
                slave.process(bytes);
            }
        }
        frame[6] |= SOURCE_BIT;
    }

    /// AL states in chain order.
    pub(crate) fn states(&self) -> Vec<u8> {
        self.slaves
            .iter()
            .map(|slave| read_u8(&slave.memory, usize::from(register::AL_STATUS)))
            .collect()
    }
}
