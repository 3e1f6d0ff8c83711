//! Slaves from files of information memories, under the project's own master.

use core::future::Future;
use core::pin::Pin;
use core::task::{Context, Waker};
use etherpen_ethercat::BusQueues;
use etherpen_ethercat::configure::Direction;
use etherpen_ethercat::cyclic::{Exchange, ExchangeKind, PROCESS_BYTES_MAX};
use etherpen_ethercat::event::{BusCommand, BusEvent, BusSetup};
use etherpen_ethercat::no_drivers::NoDrivers;
use etherpen_ethercat::place::Place;
use etherpen_ethercat::slave_set::SlaveSet;
use etherpen_ethercat::supervisor::Supervisor;
use etherpen_ethercat::wire::sii::checksum;
use etherpen_segment::control::{Command, Inputs, Names};
use etherpen_segment::random::Random;
use etherpen_segment::rig::{APWR, Rig};
use etherpen_segment::{AlState, Flywheel, Segment, SegmentOptions, SlaveList};
use heapless::spsc::Consumer;
use std::io::Write as _;
use std::path::{Path, PathBuf};

const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
/// Longest bring-up, cycles.
const BRING_UP_MAX: u32 = 20_000;
/// Cycles until a value has gone through the exchange in either direction.
const THROUGH: u32 = 3;

/// A folder that is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("etherpen-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    /// Writes a file; returns its path.
    fn write(&self, name: &str, content: &[u8]) -> String {
        let path = self.0.join(name);
        std::fs::write(&path, content).expect("a file");
        path.display().to_string()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The whole information memory of a kind of slave, as a programming tool reads it through the registers.
fn dumped(kind: &str) -> Vec<u8> {
    let SlaveList { slaves, .. } = kind.parse().expect("a kind");
    let options = SegmentOptions {
        slaves,
        ..SegmentOptions::default()
    };
    let mut rig = Rig::new(Segment::new(&options, Flywheel::default()));
    rig.ask(APWR, 0, 0x0010, &[0x01, 0x10]);
    let mut image = Vec::new();
    while image.len() < 2048 {
        let word = (image.len() as u16 / 2).to_le_bytes();
        rig.write(0x1001, 0x0502, &[0x00, 0x01, word[0], word[1], 0, 0]);
        let status = rig.read(0x1001, 0x0502, 2);
        assert_eq!(status[1] & 0x80, 0, "not busy any more");
        image.extend(rig.read(0x1001, 0x0508, if status[0] & 0x40 != 0 { 8 } else { 4 }));
    }
    image
}

/// The memory of a terminal with so many bytes of outputs and inputs that lists its sync managers only.
fn generated(outputs: u8, inputs: u8) -> Vec<u8> {
    let mut image = vec![0; 128];
    // Device emulation.
    image[..2].copy_from_slice(&0x0104_u16.to_le_bytes());
    image[14] = checksum(&image[..14]);
    for (word, value) in [
        (0x08, 0x0E7E_u32),
        (0x0A, 0x0B17_0000 | u32::from(outputs) << 8 | u32::from(inputs)),
    ] {
        image[2 * word..2 * word + 4].copy_from_slice(&value.to_le_bytes());
    }
    image[2 * 0x3E] = 15;
    let manager = |start: u16, length: u8, control, kind| {
        let [low, high] = start.to_le_bytes();
        [low, high, length, 0, control, 0, 1, kind]
    };
    let mut managers = vec![manager(0x1000, outputs, 0x64, 3), manager(0x1100, inputs, 0x20, 4)];
    managers.retain(|manager| manager[2] > 0);
    for (kind, content) in [(40_u16, vec![1, 2]), (41, managers.concat())] {
        image.extend(kind.to_le_bytes());
        image.extend((content.len() as u16 / 2).to_le_bytes());
        image.extend(content);
    }
    image.resize(2048, 0xFF);
    image
}

/// A slave of a list: its word, and the bits of its inputs and outputs.
struct Member {
    word: String,
    inputs: usize,
    outputs: usize,
}

/// A master without drivers on a segment, in virtual time.
struct Bench {
    names: Names,
    segment: Segment<Flywheel>,
    exchange: Exchange<'static, NoDrivers, 16, 1024>,
    supervisor: Pin<Box<dyn Future<Output = ()>>>,
    events: Consumer<'static, BusEvent>,
    now_us: u64,
}

impl Bench {
    /// A master that is told to bring these slaves to OP.
    fn start(list: &str, kind: ExchangeKind) -> Self {
        let list: SlaveList = list.parse().expect("a list");
        let options = SegmentOptions {
            slaves: list.slaves.clone(),
            places: list.places.clone(),
            ..SegmentOptions::default()
        };
        let queues = Box::leak(Box::new(BusQueues::<NoDrivers, 16, 1024>::new()));
        let (exchange_end, supervisor_end, mut application) = queues.split();
        let setup = BusSetup {
            terminals: SlaveSet::ALL,
            exchange: kind,
            watchdog_ms: 100,
            ..BusSetup::default()
        };
        assert!(application.commands.enqueue(BusCommand::Start(setup)).is_ok());
        Self {
            names: Names::new(&list),
            segment: Segment::new(&options, Flywheel::default()),
            exchange: Exchange::new(exchange_end, MAC),
            supervisor: Box::pin(async move {
                let mut supervisor = Supervisor::new(supervisor_end);
                supervisor.run().await
            }),
            events: application.events,
            now_us: 0,
        }
    }

    /// One cycle; returns whether the bus has come up in it.
    fn cycle(&mut self) -> bool {
        for (after_control, at_us) in [(false, 0), (true, 250)] {
            let telegram = match after_control {
                false => self.exchange.input_telegram().to_vec(),
                true => self.exchange.output_telegram().to_vec(),
            };
            if !telegram.is_empty() {
                for reply in self.segment.frame(self.now_us + at_us, &telegram) {
                    self.exchange.receive(&reply);
                }
            }
        }
        self.now_us += 1_000;
        let poll = self.supervisor.as_mut().poll(&mut Context::from_waker(Waker::noop()));
        assert!(poll.is_pending());
        core::iter::from_fn(|| self.events.dequeue()).any(|event| event == BusEvent::Operational)
    }

    fn operational(&mut self) {
        for cycles in 0.. {
            assert!(cycles < BRING_UP_MAX, "not in operation");
            if self.cycle() {
                break;
            }
        }
        for _ in 0..20 {
            self.cycle();
        }
    }

    /// Sets inputs as a line at the prompt does.
    fn set(&mut self, slave: usize, inputs: &[u8]) {
        let digits: String = inputs.iter().map(|byte| format!("{byte:02x}")).collect();
        let line = format!("set n{slave} {digits}");
        match self.names.command(&line).expect("a command") {
            Some(Command::Set {
                slave,
                inputs: Inputs::Bytes(inputs),
            }) => self.segment.set_inputs(slave, &inputs),
            other => panic!("{line}: {other:?}"),
        }
    }

    /// Gets outputs as a line at the prompt does.
    fn get(&self, slave: usize) -> Option<Vec<u8>> {
        match self.names.command(&format!("get n{slave}")).expect("a command") {
            Some(Command::Get { slave, bits: None }) => self.segment.outputs(slave),
            other => panic!("{other:?}"),
        }
    }

    /// A byte of process data as the master has it, of which the slave may have fewer bits than eight.
    fn place(&self, number: usize, direction: Direction, at: usize, bits: usize) -> Place<u8> {
        let here = (bits - 8 * at).min(8) as u8;
        let place = self.exchange.bits(number, direction, 8 * at as u16, here);
        place.unwrap_or_else(|| panic!("no byte {at} of slave {number} in {direction:?}"))
    }
}

/// Random bytes with this many bits.
fn any_bits(bits: usize, random: &mut Random) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..bits.div_ceil(8)).map(|_| random.bits() as u8).collect();
    if let (Some(last), used @ 1..) = (bytes.last_mut(), bits % 8) {
        *last &= (1 << used) - 1;
    }
    bytes
}

/// Brings the slaves to OP, sets inputs and gets outputs by commands, and compares both with what the master exchanges.
fn exchange_by_commands(members: &[Member], kind: ExchangeKind, random: &mut Random) {
    let words: Vec<&str> = members.iter().map(|member| member.word.as_str()).collect();
    let mut bench = Bench::start(&words.join(","), kind);
    bench.operational();
    for (slave, word) in bench.segment.slaves().iter().zip(&words) {
        assert_eq!(slave.al_state, AlState::Operational, "{word} of {words:?}");
    }
    let errors = bench.exchange.counters().working_counter_errors;
    for round in 0..8 {
        let mut expected = Vec::new();
        for (number, member) in members.iter().enumerate() {
            let (inputs, outputs) = (any_bits(member.inputs, random), any_bits(member.outputs, random));
            if member.inputs > 0 {
                bench.set(number + 1, &inputs);
            }
            for (at, byte) in outputs.iter().enumerate() {
                let place = bench.place(number, Direction::Outputs, at, member.outputs);
                assert!(bench.exchange.set(&place, *byte));
            }
            expected.push((inputs, outputs));
        }
        for _ in 0..THROUGH {
            bench.cycle();
        }
        for (number, (member, (inputs, outputs))) in members.iter().zip(expected).enumerate() {
            let what = format!("{}, round {round}", member.word);
            for (at, byte) in inputs.iter().enumerate() {
                let place = bench.place(number, Direction::Inputs, at, member.inputs);
                assert_eq!(
                    bench.exchange.get(&place),
                    Some(*byte),
                    "byte {at} of the inputs of {what}"
                );
            }
            if member.outputs > 0 {
                assert_eq!(bench.get(number + 1), Some(outputs), "outputs of {what}");
            }
        }
    }
    assert_eq!(bench.exchange.counters().working_counter_errors, errors, "{words:?}");
}

/// A slave from a file, named after its place.
fn from_file(path: &str, place: usize, inputs: usize, outputs: usize) -> Member {
    Member {
        word: format!("sii:{path}@name=n{place}"),
        inputs,
        outputs,
    }
}

#[test]
fn slaves_from_files_of_their_memories_reach_op_and_exchange_what_commands_set_and_get() {
    let folder = Folder::new("memories");
    for seed in 0..6 {
        let mut random = Random::new(seed);
        let kinds = [
            ("ek1100", 0, 0),
            ("el1008", 8, 0),
            ("el2004", 0, 4),
            ("ai2", 32, 0),
            ("ao2", 0, 32),
        ];
        let mut members = Vec::new();
        for place in 1..=8 {
            let any = |count: u64, random: &mut Random| (random.bits() % count) as usize;
            let member = if random.bits().is_multiple_of(2) {
                let (kind, inputs, outputs) = kinds[any(5, &mut random)];
                let path = folder.write(&format!("{seed}-{place}.bin"), &dumped(kind));
                from_file(&path, place, inputs, outputs)
            } else {
                let (outputs, inputs) = (any(6, &mut random), 1 + any(6, &mut random));
                let image = generated(outputs as u8, inputs as u8);
                let path = folder.write(&format!("{seed}-{place}.bin"), &image);
                from_file(&path, place, 8 * inputs, 8 * outputs)
            };
            members.push(member);
        }
        let kind = [ExchangeKind::Split, ExchangeKind::Combined][(seed % 2) as usize];
        exchange_by_commands(&members, kind, &mut random);
    }
}

#[test]
fn process_data_of_any_length_that_a_slave_may_have_are_exchanged() {
    let folder = Folder::new("lengths");
    for seed in 0..12 {
        let mut random = Random::new(seed);
        let mut length = || match random.bits() % 3 {
            0 => PROCESS_BYTES_MAX,
            _ => (random.bits() as usize) % (PROCESS_BYTES_MAX + 1),
        };
        let members: Vec<Member> = (1..=4)
            .map(|place| {
                let (outputs, inputs) = (length(), length().max(1));
                let path = folder.write(&format!("{seed}-{place}.bin"), &generated(outputs as u8, inputs as u8));
                from_file(&path, place, 8 * inputs, 8 * outputs)
            })
            .collect();
        let kind = [ExchangeKind::Split, ExchangeKind::Combined][(seed % 2) as usize];
        exchange_by_commands(&members, kind, &mut random);
    }
}

#[test]
fn slaves_from_dumps_of_real_devices_reach_op_and_exchange_what_commands_set_and_get() {
    let Some(folder) = std::env::var_os("ETHERPEN_REAL_DEVICES") else {
        // Not `eprintln!`: the test harness shows its output only for failing tests.
        let _ = writeln!(
            std::io::stderr(),
            "ETHERPEN_REAL_DEVICES is not set: the test with dumps is left out"
        );
        return;
    };
    let path = |file: &str| Path::new(&folder).join(file).display().to_string();
    let members: Vec<Member> = [
        ("ek1100.hex", 0, 0),
        ("el2004-eeprom-dump.bin", 0, 4),
        ("el2828.hex", 0, 8),
        ("el2004-eeprom-dump.bin", 0, 4),
        ("akd.hex", 48, 48),
    ]
    .into_iter()
    .zip(1..)
    .map(|((file, inputs, outputs), place)| from_file(&path(file), place, inputs, outputs))
    .collect();
    for kind in [ExchangeKind::Split, ExchangeKind::Combined] {
        exchange_by_commands(&members, kind, &mut Random::new(5));
    }
}
