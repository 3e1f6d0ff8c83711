//! Any bytes as files and lines of the tools that are neither drawings nor recordings: black boxes, firmware images, cells, test
//! cases, slave information files, and commands to a segment.

use etherpen::application::{Fault, Mode};
use etherpen::black_box::{Direction, EventLog, FrameNote, FrameNotes, FrameSource, Keep, Memory, Recorder};
use etherpen::control::sampler::CycleReport;
use etherpen_segment::control::Names;
use etherpen_segment::{EsiDevice, SlaveList};
use heapless::spsc::Queue;
use host_tools::black_box::contents::Contents;
use host_tools::black_box::export::{json, mcap, pcapng};
use host_tools::black_box::image;
use host_tools::campaign::episode::Episode;
use host_tools::cell::Physics;
use host_tools::firmware_image::Image;
use std::sync::LazyLock;

/// First byte of an input that is not the memory itself, but changes to a recorded one.
const CHANGES: u8 = 1;
/// Bytes of a change: the number of a word, 16 bits, and its value.
const CHANGE_BYTES: usize = 6;

/// Milliseconds of the recording.
const RECORDED_MS: u32 = 40;

/// Frames whose words follow from their places.
#[derive(Default)]
struct Frames(FrameNotes);

impl FrameSource for Frames {
    fn notes(&self) -> &FrameNotes {
        &self.0
    }

    fn word(&self, note: &FrameNote, index: usize) -> u32 {
        note.place.wrapping_add(index as u32)
    }

    fn is_intact(&self, _: &FrameNote) -> bool {
        true
    }
}

/// The memory of a board that has changed its mode and had a fault, with a sample and two frames for each millisecond.
static RECORDED: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let memory = Box::new(Memory::new());
    memory.start(Keep::Nothing);
    memory.set_counts_per_s(480_000_000);
    let (mut new, mut passed) = (Queue::<CycleReport, 4>::new(), Queue::<CycleReport, 4>::new());
    let ((mut reports, taken), (passed_on, mut link)) = (new.split(), passed.split());
    let mut recorder = Recorder::new(&memory, taken, passed_on);
    let (mut events, frames) = (EventLog::new(&memory), Frames::default());
    for cycle in 1..RECORDED_MS {
        let report = CycleReport {
            cycle,
            following: true,
            valid: [true; 4],
            ..CycleReport::default()
        };
        assert!(reports.enqueue(report).is_ok(), "the recorder takes each report");
        frames.0.note(Direction::Sent, cycle, 60, 480_000 * cycle);
        frames.0.note(Direction::Received, !cycle, 64, 480_000 * cycle + 96_000);
        recorder.tick(&frames);
        link.dequeue().expect("each report is handed on");
        let mode = if cycle % 20 < 10 { Mode::Idle } else { Mode::Moving };
        let fault = (cycle == RECORDED_MS - 1).then_some(Fault::Blind {
            blind_ms: 6,
            limit_ms: 5,
        });
        events.watch(cycle.into(), mode, fault);
    }
    image(&memory)
});

/// Reads a black box's memory, whole or changed in some words, and writes it in each format.
pub(crate) fn black_box(bytes: &[u8]) {
    let changed = match bytes.split_first() {
        Some((&CHANGES, changes)) => {
            let mut memory = RECORDED.clone();
            for change in changes.chunks_exact(CHANGE_BYTES) {
                let at = 4 * usize::from(u16::from_le_bytes([change[0], change[1]]));
                if let Some(word) = memory.get_mut(at..at + 4) {
                    word.copy_from_slice(&change[2..]);
                }
            }
            memory
        }
        _ => bytes.to_vec(),
    };
    let Ok(contents) = Contents::of(&changed) else { return };
    json(&contents).expect("JSON");
    for written in [pcapng(&contents), mcap(&contents, None)] {
        assert!(written.is_ok_and(|file| !file.is_empty()));
    }
}

/// A recorded memory, an unrecorded one that is too short, and changes here and there.
pub(crate) fn black_box_seeds() -> Vec<Vec<u8>> {
    let change = |word: u16, value: u32| [&word.to_le_bytes()[..], &value.to_le_bytes()].concat();
    let changes = |words: &[(u16, u32)]| {
        let changes = words.iter().flat_map(|(word, value)| change(*word, *value));
        [CHANGES].into_iter().chain(changes).collect()
    };
    let mut seeds = vec![RECORDED.clone(), vec![0; 64], changes(&[])];
    // The first words are the head of the memory; the others are spread over it.
    seeds.extend((0..16).map(|word| changes(&[(word, 0), (word + 1, u32::MAX)])));
    seeds.extend((0..64).map(|part| changes(&[(part * 1_021, 0x0102_0304), (part * 1_021 + 1, 7)])));
    seeds
}

/// Reads a firmware image.
pub(crate) fn elf(bytes: &[u8]) {
    let image = match Image::parse(bytes) {
        Ok(image) => image,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let flashed: u64 = image.loads().iter().map(|load| u64::from(load.size)).sum();
    assert_eq!(u64::from(image.flash_bytes()), flashed.min(u32::MAX.into()));
    for section in image.sections() {
        let _ = (image.section(&section.name), image.word(section.address));
    }
    for function in image.functions() {
        // Symbols of a damaged image may share a name, and functions an address.
        let _ = (image.function(&function.name), image.function_at(function.address));
    }
    let _ = image.has_double_precision();
}

/// An image for a Cortex-M with a part that is loaded, a section and two functions of which one calls the other; one for another
/// processor.
pub(crate) fn elf_seeds() -> Vec<Vec<u8>> {
    const HEAD: u16 = 52;
    const PROGRAM: u16 = 32;
    const SECTION: u16 = 40;
    const FLASH: u32 = 0x0800_0000;
    let halves = |halves: &[u16]| halves.iter().flat_map(|half| half.to_le_bytes()).collect::<Vec<u8>>();
    let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    // `caller`: push {lr}; bl callee; pop {pc}. `callee`: bx lr.
    let code = halves(&[0xB500, 0xF000, 0xF801, 0xBD00, 0x4770, 0]);
    let section_names = b"\0.text\0.names\0.symtab\0.strtab\0\0\0";
    let names = b"\0caller\0callee\0\0";
    let symbol = |name: u32, from: u32, size: u32| {
        let kind: [u8; 4] = [0x12, 0, 1, 0];
        [words(&[name, FLASH + from + 1, size]), kind.to_vec()].concat()
    };
    let symbols = [vec![0; 16], symbol(1, 0, 8), symbol(8, 8, 2)].concat();
    let file = |machine: u16| {
        let code_at = u32::from(HEAD + PROGRAM);
        let section_names_at = code_at + code.len() as u32;
        let symbols_at = section_names_at + section_names.len() as u32;
        let names_at = symbols_at + symbols.len() as u32;
        let sections_at = names_at + names.len() as u32;
        let section = |[name, kind, address]: [u32; 3], at: u32, size: usize, [link, info, entry]: [u32; 3]| {
            words(&[
                name,
                kind,
                if kind == 1 { 6 } else { 0 },
                address,
                at,
                size as u32,
                link,
                info,
                4,
                entry,
            ])
        };
        [
            b"\x7FELF\x01\x01\x01".to_vec(),
            vec![0; 9],
            halves(&[2, machine]),
            words(&[1, FLASH, HEAD.into(), sections_at, 0x0500_0000]),
            halves(&[HEAD, PROGRAM, 1, SECTION, 5, 2]),
            words(&[1, code_at, FLASH, FLASH, code.len() as u32, code.len() as u32, 5, 4]),
            code.clone(),
            section_names.to_vec(),
            symbols.clone(),
            names.to_vec(),
            vec![0; SECTION.into()],
            section([1, 1, FLASH], code_at, code.len(), [0; 3]),
            section([7, 3, 0], section_names_at, section_names.len(), [0; 3]),
            section([14, 2, 0], symbols_at, symbols.len(), [4, 1, 16]),
            section([22, 3, 0], names_at, names.len(), [0; 3]),
        ]
        .concat()
    };
    vec![file(40), file(62)]
}

/// Reads a cell's file.
pub(crate) fn cell_toml(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Err(error) = text.parse::<Physics>() {
        assert!(!error.to_string().is_empty());
    }
}

/// The cells that the product knows, and single values.
pub(crate) fn cell_seeds() -> Vec<Vec<u8>> {
    let known = [Physics::NOMINAL, Physics::PESSIMISTIC];
    let mut seeds: Vec<Vec<u8>> = known
        .iter()
        .map(|cell| toml::to_string(cell).expect("a cell is written").into_bytes())
        .collect();
    seeds.extend(["", "payload_kg = -1.0\n", "payload_kg = nan\n"].map(|text| text.as_bytes().to_vec()));
    seeds
}

/// Reads a test case of the campaign; what is written of it is read as the same.
pub(crate) fn case(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Episode::parse(text) {
        Ok(episode) => {
            let written = episode.to_text();
            let again = Episode::parse(&written).expect("what was written is read");
            assert_eq!(again.to_text(), written);
        }
        Err(error) => assert!(!error.is_empty()),
    }
}

/// Two of the kept cases.
pub(crate) fn case_seeds() -> Vec<Vec<u8>> {
    [
        include_str!("../../../tests/campaign/clock-waits-while-the-fault-is-not-heard.toml"),
        include_str!("../../../tests/campaign/refused-drawing-ordered-again.toml"),
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}

/// Reads a slave information file: its first device, and the one of a name.
pub(crate) fn esi(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    for wanted in [None, Some("IO-1"), Some("0x100"), Some("IO-1:2")] {
        match EsiDevice::parse(text, wanted) {
            Ok(device) => assert!(device.name().len() <= text.len()),
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
}

/// A device with the parts that the reader knows.
pub(crate) fn esi_seeds() -> Vec<Vec<u8>> {
    let device = r##"<EtherCATInfo><Vendor><Id>#x0E7E</Id></Vendor><Descriptions><Devices>
<Device><Type ProductCode="#x100" RevisionNo="#x20000">IO-1</Type><Name LcId="1033">Terminal</Name>
<Profile><Dictionary><DataTypes><DataType><Name>ARR</Name><BaseType>INT</BaseType><BitSize>32</BitSize>
<ArrayInfo><LBound>1</LBound><Elements>2</Elements></ArrayInfo></DataType></DataTypes><Objects>
<Object><Index>#x1008</Index><Name>Name</Name><Type>STRING(4)</Type><BitSize>32</BitSize>
<Info><DefaultString>IO-1</DefaultString></Info><Flags><Access>ro</Access></Flags></Object>
<Object><Index>#x8000</Index><Name>List</Name><Type>ARR</Type><BitSize>32</BitSize></Object></Objects></Dictionary></Profile>
<Fmmu>Outputs</Fmmu><Sm DefaultSize="2" StartAddress="#x1100" ControlByte="#x64" Enable="1">Outputs</Sm>
<RxPdo Fixed="1" Sm="0"><Index>#x1600</Index><Name>Out</Name>
<Entry><Index>#x7000</Index><SubIndex>1</SubIndex><BitLen>16</BitLen><Name>Value</Name></Entry></RxPdo>
<Mailbox><CoE SdoInfo="1"/></Mailbox><Dc><OpMode><AssignActivate>#x300</AssignActivate></OpMode></Dc>
<Eeprom><ByteSize>2048</ByteSize><ConfigData>080E03440A000000</ConfigData></Eeprom>
</Device></Devices></Descriptions></EtherCATInfo>"##;
    vec![device.as_bytes().to_vec(), b"<EtherCATInfo/>".to_vec()]
}

/// Reads a list of slaves in the first line, and commands to them in the others.
pub(crate) fn control(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let (first, lines) = text.split_once('\n').unwrap_or(("", text));
    let list = match first.parse::<SlaveList>() {
        Ok(list) => list,
        Err(error) => return assert!(!error.to_string().is_empty()),
    };
    let names = Names::new(&list);
    for line in lines.lines() {
        if let Err(error) = names.command(line) {
            assert!(!error.to_string().is_empty());
        }
    }
}

/// Each command once.
pub(crate) fn control_seeds() -> Vec<Vec<u8>> {
    let lines = "ek1100,el1008@name=door,el2004,cia402@alias=3*2\nhelp\nlist\nset door.1 1\nget door\nget 3.1\n\
         fault power door 500\nfault stuck 4 100 # a comment\nplug 2\nunplug 2\nquit\n";
    vec![lines.as_bytes().to_vec(), b"ax2000*4\nget 4\n".to_vec()]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What cannot be read at all shows little.
    #[test]
    fn every_kind_of_input_begins_with_some_that_are_read() {
        let text = |seed: &Vec<u8>| String::from_utf8(seed.clone()).expect("text");
        let contents = Contents::of(&black_box_seeds()[0]).expect("a recording");
        assert!(contents.samples.len() > 30 && contents.frames.len() > 30);
        let image = Image::parse(&elf_seeds()[0]).expect("an image");
        assert!(image.loads().len() == 1 && image.section(".text").is_some());
        assert_eq!(image.functions().len(), 2);
        for seed in &cell_seeds()[..2] {
            text(seed).parse::<Physics>().expect("a cell");
        }
        for seed in &case_seeds() {
            Episode::parse(&text(seed)).expect("a case");
        }
        let device = EsiDevice::parse(&text(&esi_seeds()[0]), Some("IO-1")).expect("a device");
        assert_eq!(device.name(), "Terminal");
        for seed in &control_seeds() {
            let seed = text(seed);
            let (list, lines) = seed.split_once('\n').expect("lines");
            let names = Names::new(&list.parse().expect("a list"));
            for line in lines.lines() {
                names.command(line).unwrap_or_else(|error| panic!("{line}: {error}"));
            }
        }
    }
}
