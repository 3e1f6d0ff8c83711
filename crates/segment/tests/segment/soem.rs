//! What the master SOEM does on the wire, restated from its sources: register for register, in its order.

use crate::{TestRig, rig_of};
use etherpen_segment::random::Random;
use etherpen_segment::rig::*;
use etherpen_segment::{Fault, SegmentOptions, SlaveList};

const INIT: u16 = 1;
const PRE_OP: u16 = 2;
const SAFE_OP: u16 = 4;
const OPERATIONAL: u16 = 8;
const ACK: u16 = 0x10;
/// Most polls of a register.
const POLLS_MAX: usize = 200;
/// Words of the information memory.
const WORD_MAILBOX_OUT: u16 = 0x18;
const WORD_MAILBOX_IN: u16 = 0x1A;
const WORD_PROTOCOLS: u16 = 0x1C;

/// A slave as SOEM knows it.
#[derive(Clone, Debug, Default)]
struct Slave {
    station: u16,
    /// Whether a read of the information memory gives eight bytes; otherwise four.
    reads_eight: bool,
    /// Whether the slave has its information memory.
    is_given: bool,
    has_clock: bool,
    mailbox_out: (u16, u16),
    mailbox_in: (u16, u16),
    protocols: u16,
    counter: u8,
    /// Bytes of outputs and inputs, and where they lie in the logical memory.
    outputs: (u32, u16),
    inputs: (u32, u16),
}

/// A chain under SOEM.
struct Soem {
    rig: TestRig,
    slaves: Vec<Slave>,
}

fn words(bytes: &[u8]) -> Vec<u16> {
    bytes
        .chunks_exact(2)
        .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
        .collect()
}

impl Soem {
    fn on(list: &str) -> Self {
        let SlaveList { slaves, places, .. } = list.parse().expect("a list");
        let rig = rig_of(SegmentOptions {
            slaves,
            places,
            ..SegmentOptions::default()
        });
        Self {
            rig,
            slaves: Vec::new(),
        }
    }

    /// A broadcast write that all slaves, or some of them, count.
    fn broadcast(&mut self, register: u16, data: &[u8]) -> u16 {
        self.rig.ask(BWR, 0, register, data).1
    }

    /// `ecx_detect_slaves` and `ecx_set_slaves_to_default`.
    fn detect_and_reset(&mut self) {
        // Twice: a slave may have been in an error.
        for _ in 0..2 {
            self.broadcast(0x0120, &(INIT | ACK).to_le_bytes());
        }
        let (_, count) = self.rig.ask(BRD, 0, 0x0000, &[0; 2]);
        assert!(count > 0);
        for (register, data) in [
            (0x0101, vec![0]),
            (0x0200, vec![0x04, 0x00]),
            (0x0300, vec![0; 8]),
            (0x0600, vec![0; 3 * 16]),
            (0x0800, vec![0; 4 * 8]),
            (0x0981, vec![0]),
            (0x0910, vec![0; 4]),
            (0x0930, vec![0x00, 0x10]),
            (0x0934, vec![0x00, 0x0C]),
            (0x0103, vec![0]),
            (0x0120, (INIT | ACK).to_le_bytes().to_vec()),
            (0x0500, vec![2]),
            (0x0500, vec![0]),
        ] {
            let counted = self.broadcast(register, &data);
            // Clocks are not in every slave.
            let is_clock = (0x0900..0x0A00).contains(&register);
            assert!(counted == count || is_clock, "{register:#06x}: {counted} of {count}");
        }
        self.slaves = (0..count).map(|_| Slave::default()).collect();
    }

    /// `ecx_readeeprom`: the bytes from a word on, as many as the controller gives at once.
    fn memory(&mut self, number: usize, word: u16) -> Vec<u8> {
        let (station, eight) = (self.slaves[number].station, self.slaves[number].reads_eight);
        self.await_memory(station);
        let [low, high] = word.to_le_bytes();
        self.rig.write(station, 0x0502, &[0x00, 0x01, low, high, 0, 0]);
        self.await_memory(station);
        self.rig.read(station, 0x0508, if eight { 8 } else { 4 })
    }

    fn await_memory(&mut self, station: u16) {
        for _ in 0..POLLS_MAX {
            let status = words(&self.rig.read(station, 0x0502, 2))[0];
            assert_eq!(status & 0x7800, 0, "an error of the memory: {status:#06x}");
            if status & 0x8000 == 0 {
                return;
            }
        }
        panic!("the memory stays busy");
    }

    /// `ec_siigetbyte`, as often as wanted. A memory that the slave has is taken from it meanwhile.
    fn bytes(&mut self, number: usize, first: u16, count: u16) -> Vec<u8> {
        let Slave { station, is_given, .. } = self.slaves[number];
        if is_given {
            self.rig.write(station, 0x0500, &[2]);
            self.rig.write(station, 0x0500, &[0]);
        }
        let (mut found, mut at) = (Vec::new(), first);
        while found.len() < usize::from(count) {
            let read = self.memory(number, at / 2);
            let from = usize::from(at % 2);
            found.extend_from_slice(&read[from..]);
            at += (read.len() - from) as u16;
        }
        found.truncate(count.into());
        if is_given {
            self.rig.write(station, 0x0500, &[1]);
        }
        found
    }

    /// `ec_siifind`: the first byte of a category, and its bytes.
    fn category(&mut self, number: usize, wanted: u16) -> Option<(u16, u16)> {
        let mut at = 0x80;
        for _ in 0..POLLS_MAX {
            let header = words(&self.bytes(number, at, 4));
            match header[0] {
                0xFFFF => return None,
                kind if kind == wanted => return Some((at + 4, 2 * header[1])),
                _ => at += 4 + 2 * header[1],
            }
        }
        panic!("the categories never end");
    }

    /// `ec_siistring`.
    fn text(&mut self, number: usize, wanted: u8) -> String {
        let (mut at, _) = self.category(number, 10).expect("strings");
        let count = self.bytes(number, at, 1)[0];
        assert!((1..=count).contains(&wanted), "string {wanted} of {count}");
        at += 1;
        for _ in 1..wanted {
            at += 1 + u16::from(self.bytes(number, at, 1)[0]);
        }
        let length = u16::from(self.bytes(number, at, 1)[0]);
        String::from_utf8(self.bytes(number, at + 1, length)).expect("a text")
    }

    /// `ecx_config_init`: addresses, memory, mailboxes, PREOP.
    fn config_init(&mut self) {
        self.detect_and_reset();
        for number in 0..self.slaves.len() {
            let position = 0_u16.wrapping_sub(number as u16);
            let station = 0x1001 + number as u16;
            assert_eq!(self.rig.ask(APRD, position, 0x0140, &[0; 2]).1, 1);
            assert_eq!(self.rig.ask(APWR, position, 0x0010, &station.to_le_bytes()).1, 1);
            // The first slave destroys frames that are none of EtherCAT.
            let foreign = [u8::from(number == 0), 0];
            assert_eq!(self.rig.ask(APWR, position, 0x0100, &foreign).1, 1);
            let (read, counted) = self.rig.ask(APRD, position, 0x0010, &[0; 2]);
            assert_eq!((words(&read)[0], counted), (station, 1));
            self.rig.read(station, 0x0012, 2);
            let status = words(&self.rig.read(station, 0x0502, 2))[0];
            let slave = &mut self.slaves[number];
            (slave.station, slave.reads_eight) = (station, status & 0x0040 != 0);
        }
        for number in 0..self.slaves.len() {
            let station = self.slaves[number].station;
            let pair = |bytes: &[u8]| (words(bytes)[0], words(bytes)[1]);
            let out = pair(&self.memory(number, WORD_MAILBOX_OUT));
            let input = pair(&self.memory(number, WORD_MAILBOX_IN));
            let protocols = words(&self.memory(number, WORD_PROTOCOLS))[0];
            let features = words(&self.rig.read(station, 0x0008, 2))[0];
            let status = self.rig.read(station, 0x0110, 2);
            assert_eq!(status[0] & 1, 1, "the memory is loaded");
            let slave = &mut self.slaves[number];
            (slave.mailbox_out, slave.mailbox_in, slave.protocols) = (out, input, protocols);
            slave.has_clock = features & 0x0004 != 0;
            if out.1 > 0 {
                let manager = |(start, length): (u16, u16), control: u8| {
                    let ([a, b], [c, d]) = (start.to_le_bytes(), length.to_le_bytes());
                    [a, b, c, d, control, 0, 1, 0]
                };
                let both = [manager(out, 0x26), manager(input, 0x22)].concat();
                self.rig.write(station, 0x0800, &both);
            }
            self.slaves[number].is_given = true;
            self.rig.write(station, 0x0500, &[1]);
            self.rig.write(station, 0x0120, &(PRE_OP | ACK).to_le_bytes());
        }
        for number in 0..self.slaves.len() {
            self.state_check(number, PRE_OP);
        }
    }

    /// `ecx_statecheck` of one slave. Device emulation shows the acknowledge bit of the request.
    fn state_check(&mut self, number: usize, wanted: u16) {
        let station = self.slaves[number].station;
        for _ in 0..POLLS_MAX {
            if self.rig.al_status(station).0 & 0x0F == wanted {
                return;
            }
        }
        panic!(
            "slave {number} is not in state {wanted}: {:x?}",
            self.rig.al_status(station)
        );
    }

    /// `ecx_mbxsend` and `ecx_mbxreceive` of a CoE message: the content of the answer, without the mailbox header.
    fn coe(&mut self, number: usize, content: &[u8]) -> Vec<u8> {
        self.post(number, content);
        self.fetch(number)
    }

    fn post(&mut self, number: usize, content: &[u8]) {
        let slave = &mut self.slaves[number];
        slave.counter = slave.counter % 7 + 1;
        let mut message = (content.len() as u16).to_le_bytes().to_vec();
        message.extend_from_slice(&[0, 0, 0, 3 | slave.counter << 4]);
        message.extend_from_slice(content);
        message.resize(slave.mailbox_out.1.into(), 0);
        let (station, start) = (slave.station, slave.mailbox_out.0);
        assert_eq!(self.rig.read(station, 0x0805, 1)[0] & 0x08, 0, "the mailbox is empty");
        self.rig.write(station, start, &message);
    }

    fn fetch(&mut self, number: usize) -> Vec<u8> {
        let Slave {
            station, mailbox_in, ..
        } = self.slaves[number];
        for _ in 0..POLLS_MAX {
            if self.rig.read(station, 0x080D, 1)[0] & 0x08 != 0 {
                let mail = self.rig.read(station, mailbox_in.0, mailbox_in.1.into());
                let length = usize::from(words(&mail)[0]);
                assert_eq!(mail[5] & 0x0F, 3, "CoE");
                return mail[6..6 + length].to_vec();
            }
        }
        panic!("slave {number} does not answer");
    }

    /// `ecx_SDOread`: expedited, normal, or in segments.
    fn upload(&mut self, number: usize, index: u16, sub: u8) -> Vec<u8> {
        let [low, high] = index.to_le_bytes();
        let answer = self.coe(number, &[0, 0x20, 0x40, low, high, sub, 0, 0, 0, 0]);
        let command = answer[2];
        assert_eq!(answer[3..6], [low, high, sub], "{index:#06x}:{sub}, {answer:x?}");
        assert_eq!(command & 0xE0, 0x40, "{index:#06x}:{sub}, {answer:x?}");
        if command & 2 != 0 {
            return answer[6..6 + 4 - usize::from(command >> 2 & 3)].to_vec();
        }
        let size = u32::from_le_bytes([answer[6], answer[7], answer[8], answer[9]]) as usize;
        let mut value = answer[10..].to_vec();
        let mut toggle = 0;
        while value.len() < size {
            let part = self.coe(number, &[0, 0x20, 0x60 | toggle, low, high, sub, 0, 0, 0, 0]);
            assert_eq!(part[2] & 0x10, toggle, "toggle bit");
            let mut data = part[3..].to_vec();
            if data.len() == 7 {
                data.truncate(7 - usize::from(part[2] >> 1 & 7));
            }
            value.extend_from_slice(&data);
            toggle ^= 0x10;
        }
        value.truncate(size);
        value
    }

    /// One message of SDO information; its answer, behind the header.
    fn information(&mut self, number: usize, operation: u8, body: &[u8]) -> Vec<u8> {
        let request = [&[0, 0x80, operation, 0, 0, 0], body].concat();
        let answer = self.coe(number, &request);
        assert_eq!((answer[1], answer[2]), (0x80, operation + 1), "{answer:x?}");
        answer[6..].to_vec()
    }

    /// `ecx_readODlist`: the indices, from as many fragments as there are.
    fn object_list(&mut self, number: usize) -> Vec<u16> {
        self.post(number, &[0, 0x80, 1, 0, 0, 0, 1, 0]);
        let (mut content, mut left) = (Vec::new(), None);
        loop {
            let answer = self.fetch(number);
            assert_eq!((answer[1], answer[2] & 0x7F), (0x80, 2), "{answer:x?}");
            let now_left = words(&answer[4..6])[0];
            assert!(
                left.is_none_or(|left: u16| now_left + 1 == left),
                "fragments count down"
            );
            assert_eq!(answer[2] & 0x80 != 0, now_left > 0);
            content.extend_from_slice(&answer[6..]);
            left = Some(now_left);
            if now_left == 0 {
                break;
            }
        }
        let indices = words(&content);
        assert_eq!(indices[0], 1, "the kind of list is repeated once");
        indices[1..].to_vec()
    }
}

#[test]
fn slaveinfo_with_sdo_reads_memories_of_both_widths_and_describes_every_object_with_its_length() {
    let mut soem = Soem::on("ek1100,el2004,cia402,akd,ax2000,el1008");
    soem.config_init();
    let widths: Vec<bool> = soem.slaves.iter().map(|slave| slave.reads_eight).collect();
    assert_eq!(widths, [true, true, true, false, true, true]);
    let names = ["EK1100", "EL2004", "", "AKD", "AX2000-B110", "EL1008"];
    for (number, name) in names.into_iter().enumerate() {
        let (general, length) = soem.category(number, 30).expect("the general category");
        assert_eq!(length, 32);
        let wanted = soem.bytes(number, general, 4)[3];
        let text = soem.text(number, wanted);
        assert!(text.contains(name), "slave {number}: {text}");
    }
    let mut texts = 0;
    for number in 0..soem.slaves.len() {
        if soem.slaves[number].protocols & 0x04 == 0 {
            continue;
        }
        let indices = soem.object_list(number);
        assert!(
            indices.len() > 15 && indices.is_sorted(),
            "slave {number}: {indices:x?}"
        );
        for index in indices {
            let object = soem.information(number, 3, &index.to_le_bytes());
            assert_eq!(words(&object)[0], index);
            let (last, code, name) = (object[4], object[5], &object[6..]);
            assert!(matches!(code, 7..=9), "{index:#06x}: {code}");
            let is_name = |name: &[u8]| !name.is_empty() && name.iter().all(|letter| (b' '..=b'~').contains(letter));
            assert!(is_name(name), "{index:#06x}: {name:x?}");
            for sub in 0..=last {
                let [low, high] = index.to_le_bytes();
                // Access rights, category and whether it can be mapped.
                let entry = soem.information(number, 5, &[low, high, sub, 7]);
                assert_eq!((words(&entry)[0], entry[2]), (index, sub));
                let [kind, bits, access] = words(&entry[4..10])[..] else {
                    panic!("{entry:x?}");
                };
                let what = format!("slave {number}, {index:#06x}:{sub}, type {kind:#x}, {bits} bits");
                assert!(is_name(&entry[10..]), "{what}: {:x?}", &entry[10..]);
                if access & 0x0007 == 0 {
                    continue;
                }
                let value = soem.upload(number, index, sub);
                let bytes = usize::from(bits.div_ceil(8));
                match kind {
                    // A visible string: as long as it is described, and without an end mark.
                    9 => {
                        texts += 1;
                        assert_eq!(value.len(), bytes, "{what}: {value:x?}");
                        assert!(is_name(&value), "{what}: {value:x?}");
                    }
                    // Bytes: at most as many.
                    10 => assert!(bytes == 0 || value.len() <= bytes, "{what}: {value:x?}"),
                    1 => assert_eq!((bits, value.len()), (1, 1), "{what}"),
                    _ => assert_eq!(value.len(), bytes, "{what}: {value:x?}"),
                }
            }
        }
    }
    assert!(texts >= 5, "{texts} texts");
}

impl Soem {
    /// `ecx_configdc`: one latch by broadcast, times read back, offsets and delays written. Returns the reference.
    fn config_dc(&mut self) -> Option<u16> {
        self.broadcast(0x0900, &[0; 4]);
        let mut reference = None;
        for number in 0..self.slaves.len() {
            let Slave { station, has_clock, .. } = self.slaves[number];
            // A terminal that measures delays only says that it has a clock, and counts nothing of this.
            let (time, counted) = self.rig.ask(FPRD, station, 0x0918, &[0; 8]);
            if !has_clock || counted == 0 {
                continue;
            }
            self.rig.read(station, 0x0900, 4);
            let time = u64::from_le_bytes(time.try_into().expect("eight bytes"));
            let offset = 1_000_000_000_u64.wrapping_sub(time);
            self.rig.write(station, 0x0920, &offset.to_le_bytes());
            self.rig.write(station, 0x0928, &[0; 4]);
            reference = reference.or(Some(station));
        }
        reference
    }

    /// `ecx_config_map_group`: what CoE or the memory lists, outputs of all slaves first, then the inputs.
    fn config_map_group(&mut self) {
        let mut managers = Vec::new();
        for number in 0..self.slaves.len() {
            managers.push(match self.slaves[number].protocols & 0x04 {
                0 => self.managers_of_memory(number),
                _ => self.managers_of_objects(number),
            });
        }
        let mut logical = 0_u32;
        for kind in [3, 4] {
            for number in 0..self.slaves.len() {
                let station = self.slaves[number].station;
                let of_kind = managers[number].iter().filter(|manager| manager.kind == kind);
                for (manager, unit) in of_kind.zip(if kind == 3 { 0.. } else { 1.. }) {
                    let [a, b] = manager.start.to_le_bytes();
                    let [c, d] = manager.length.to_le_bytes();
                    let block = [a, b, c, d, manager.control, 0, 1, 0];
                    self.rig.write(station, 0x0800 + 8 * u16::from(manager.number), &block);
                    let mut fmmu = [0; 16];
                    fmmu[..4].copy_from_slice(&logical.to_le_bytes());
                    fmmu[4..6].copy_from_slice(&manager.length.to_le_bytes());
                    fmmu[7] = 7;
                    fmmu[8..10].copy_from_slice(&manager.start.to_le_bytes());
                    (fmmu[11], fmmu[12]) = (if kind == 3 { 2 } else { 1 }, 1);
                    self.rig.write(station, 0x0600 + 16 * unit, &fmmu);
                    let slave = &mut self.slaves[number];
                    let place = if kind == 3 {
                        &mut slave.outputs
                    } else {
                        &mut slave.inputs
                    };
                    *place = (logical, manager.length);
                    logical += u32::from(manager.length);
                }
            }
        }
        for number in 0..self.slaves.len() {
            let station = self.slaves[number].station;
            self.rig.write(station, 0x0500, &[1]);
            self.rig.write(station, 0x0120, &SAFE_OP.to_le_bytes());
        }
    }

    /// `ecx_readPDOmap`: sync manager types, assignments, mappings.
    fn managers_of_objects(&mut self, number: usize) -> Vec<Manager> {
        let described = self.managers_of_memory(number);
        let count = self.upload(number, 0x1C00, 0)[0];
        assert!(count >= 4, "sync managers {count}");
        let mut found = Vec::new();
        for manager in 2..count {
            let kind = self.upload(number, 0x1C00, manager + 1)[0];
            let assignment = 0x1C10 + u16::from(manager);
            let mut bits = 0_u32;
            for entry in 1..=self.upload(number, assignment, 0)[0] {
                let pdo = words(&self.upload(number, assignment, entry))[0];
                for object in 1..=self.upload(number, pdo, 0)[0] {
                    bits += u32::from(self.upload(number, pdo, object)[0]);
                }
            }
            let there = described.iter().find(|there| there.number == manager);
            let there = *there.expect("the memory lists it");
            found.push(Manager {
                kind,
                length: bits.div_ceil(8) as u16,
                ..there
            });
        }
        found
    }

    /// `ecx_siiSMnext` with `ecx_siiPDO`: sync managers with the lengths of their process data.
    fn managers_of_memory(&mut self, number: usize) -> Vec<Manager> {
        let Some((at, length)) = self.category(number, 41) else {
            return Vec::new();
        };
        let blocks = self.bytes(number, at, length);
        let mut found = Vec::new();
        for (manager, block) in (0..).zip(blocks.chunks_exact(8)) {
            let kind = block[7];
            let category = match kind {
                3 => 51,
                4 => 50,
                _ => continue,
            };
            let bits = self.bits_of_memory(number, category, manager);
            found.push(Manager {
                number: manager,
                start: words(block)[0],
                length: bits.div_ceil(8) as u16,
                control: block[4],
                kind,
            });
        }
        found
    }

    fn bits_of_memory(&mut self, number: usize, category: u16, manager: u8) -> u32 {
        let Some((at, length)) = self.category(number, category) else {
            return 0;
        };
        let content = self.bytes(number, at, length);
        let (mut rest, mut bits) = (content.as_slice(), 0);
        while rest.len() >= 8 {
            let (head, entries) = (&rest[..8], usize::from(rest[2]));
            let list = &rest[8..8 + 8 * entries];
            if head[3] == manager {
                bits += list.chunks_exact(8).map(|entry| u32::from(entry[5])).sum::<u32>();
            }
            rest = &rest[8 + 8 * entries..];
        }
        bits
    }

    /// `ecx_send_processdata` and `ecx_receive_processdata`: one LRW over everything, and the reference's time behind it.
    fn process_data(&mut self, image: &mut Vec<u8>, reference: Option<u16>) -> u16 {
        let lrw = (LRW, 0, 0, image.as_slice());
        let frame = match reference {
            Some(station) => frame_of(&[lrw, (FRMW, station, 0x0910, &[0; 8])]),
            None => frame_of(&[lrw]),
        };
        let replies = self.rig.send(&frame);
        let (data, counter) = content(&replies[0], image.len());
        *image = data;
        counter
    }

    /// `ecx_statecheck(0, ...)`: the states of all slaves at once.
    fn all_are_in(&mut self, state: u16) -> bool {
        let (seen, counted) = self.rig.ask(BRD, 0, 0x0130, &[0; 2]);
        assert_eq!(usize::from(counted), self.slaves.len());
        words(&seen)[0] & 0x1F == state
    }
}

/// A sync manager of process data.
#[derive(Clone, Copy, Debug)]
struct Manager {
    number: u8,
    start: u16,
    length: u16,
    control: u8,
    /// 3: outputs, 4: inputs.
    kind: u8,
}

/// A chain that `simple_test` has brought to OP: with its process image, its reference clock and the counter expected.
fn in_operation(list: &str) -> (Soem, Vec<u8>, Option<u16>, u16) {
    let mut soem = Soem::on(list);
    soem.config_init();
    soem.config_map_group();
    let reference = soem.config_dc();
    let bytes = |side: fn(&Slave) -> u16, slaves: &[Slave]| slaves.iter().map(side).map(usize::from).sum::<usize>();
    let total = bytes(|slave| slave.outputs.1, &soem.slaves) + bytes(|slave| slave.inputs.1, &soem.slaves);
    let with = |side: fn(&Slave) -> u16, slaves: &[Slave]| slaves.iter().filter(|slave| side(slave) > 0).count() as u16;
    let expected = 2 * with(|slave| slave.outputs.1, &soem.slaves) + with(|slave| slave.inputs.1, &soem.slaves);
    let mut image = vec![0; total];
    for number in 0..soem.slaves.len() {
        soem.state_check(number, SAFE_OP);
    }
    assert!(soem.all_are_in(SAFE_OP));
    // One exchange makes the outputs valid.
    assert_eq!(soem.process_data(&mut image, reference), expected);
    soem.broadcast(0x0120, &OPERATIONAL.to_le_bytes());
    for round in 0.. {
        assert!(round < 40, "not all slaves reach OP");
        assert_eq!(soem.process_data(&mut image, reference), expected);
        if soem.all_are_in(OPERATIONAL) {
            break;
        }
    }
    (soem, image, reference, expected)
}

#[test]
fn simple_test_maps_a_group_behind_the_outputs_its_inputs_and_exchanges_all_by_one_lrw() {
    let (mut soem, mut image, reference, expected) = in_operation("ek1100,el1008,el2004,cia402,el2008,ax2000,el1004");
    assert_eq!(reference, Some(0x1001), "the coupler has the first clock");
    let mut random = Random::new(11);
    for round in 0..50 {
        let (inputs, outputs) = (random.bits() as u8, random.bits() as u8);
        soem.rig.bus.set_inputs(2, &[inputs]);
        soem.rig.bus.set_inputs(7, &[inputs & 0x0F]);
        let at = |place: (u32, u16)| place.0 as usize;
        let (el2004, el2008) = (at(soem.slaves[2].outputs), at(soem.slaves[4].outputs));
        (image[el2004], image[el2008]) = (outputs & 0x0F, outputs);
        assert_eq!(soem.process_data(&mut image, reference), expected, "round {round}");
        assert_eq!(soem.rig.bus.outputs(3), Some(vec![outputs & 0x0F]));
        assert_eq!(soem.rig.bus.outputs(5), Some(vec![outputs]));
        assert_eq!(image[at(soem.slaves[1].inputs)], inputs);
        assert_eq!(image[at(soem.slaves[6].inputs)] & 0x0F, inputs & 0x0F);
    }
    // The last terminal takes part in the exchange of its own bits only.
    let drive = soem.slaves[5].inputs;
    assert!(drive.1 >= 6);
}

#[test]
fn ecatcheck_acknowledges_an_error_in_safeop_and_asks_for_op_again() {
    let (mut soem, mut image, reference, expected) = in_operation("ek1100,ax2000,cia402,el2004");
    for (slave, code) in [(2, 0x001A), (3, 0x001B), (2, 0x0011)] {
        let station = 0x1000 + slave as u16;
        soem.rig.bus.inject(Fault::Retreat(slave, code));
        soem.process_data(&mut image, reference);
        assert!(!soem.all_are_in(OPERATIONAL));
        assert_eq!(soem.rig.al_status(station), (SAFE_OP | 0x10, code));
        // Without the acknowledgement nothing happens.
        soem.rig.write(station, 0x0120, &OPERATIONAL.to_le_bytes());
        soem.process_data(&mut image, reference);
        assert_eq!(soem.rig.al_status(station), (SAFE_OP | 0x10, code));
        soem.rig.write(station, 0x0120, &(SAFE_OP | ACK).to_le_bytes());
        soem.process_data(&mut image, reference);
        assert_eq!(soem.rig.al_status(station), (SAFE_OP, 0));
        soem.rig.write(station, 0x0120, &OPERATIONAL.to_le_bytes());
        for _ in 0..5 {
            soem.process_data(&mut image, reference);
        }
        assert!(soem.all_are_in(OPERATIONAL), "slave {slave}, {code:#06x}");
        assert_eq!(soem.process_data(&mut image, reference), expected);
    }
    // A state that cannot follow is refused with 0x0011, and INIT with the acknowledge bit leads out.
    let station = 0x1002;
    soem.rig.write(station, 0x0120, &(INIT | ACK).to_le_bytes());
    assert_eq!(soem.rig.al_status(station), (INIT, 0));
    soem.rig.write(station, 0x0120, &OPERATIONAL.to_le_bytes());
    assert_eq!(soem.rig.al_status(station), (INIT | 0x10, 0x0011));
    assert_eq!(
        soem.process_data(&mut image, reference),
        expected - 3,
        "it takes no part"
    );
    soem.rig.write(station, 0x0120, &(INIT | ACK).to_le_bytes());
    assert_eq!(soem.rig.al_status(station), (INIT, 0));
}
