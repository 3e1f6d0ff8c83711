//! Process data, clocks and states as SOEM's `simple_test` and `ec_sample` handle them.

use super::{ACK, INIT, Slave, Soem, words};
use etherpen_segment::Fault;
use etherpen_segment::random::Random;
use etherpen_segment::rig::*;

const SAFE_OP: u16 = 4;
const OPERATIONAL: u16 = 8;

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
            for (number, managers) in managers.iter().enumerate() {
                let station = self.slaves[number].station;
                let of_kind = managers.iter().filter(|manager| manager.kind == kind);
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
