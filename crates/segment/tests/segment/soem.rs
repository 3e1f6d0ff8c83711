//! What the master SOEM does on the wire, restated from its sources: register for register, in its order.

mod process_data;

use crate::{TestRig, rig_of};
use etherpen_segment::rig::*;
use etherpen_segment::{SegmentOptions, SlaveList};

const INIT: u16 = 1;
const PRE_OP: u16 = 2;
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
