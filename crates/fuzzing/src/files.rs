//! Any bytes as files and lines of the tools that are neither drawings nor recordings: black boxes, firmware images, cells, test
//! cases, slave information files, and commands to a segment.

use etherpen::application::{Fault, Mode};
use etherpen::black_box::{EventLog, Keep, Memory};
use etherpen_segment::control::Names;
use etherpen_segment::{EsiDevice, SlaveList};
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

/// The memory of a board that has changed its mode and had a fault.
static RECORDED: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let memory = Box::new(Memory::new());
    memory.start(Keep::Nothing);
    memory.set_counts_per_s(480_000_000);
    let mut events = EventLog::new(&memory);
    for ms in 1..40 {
        let mode = if ms % 20 < 10 { Mode::Idle } else { Mode::Moving };
        let fault = (ms == 39).then_some(Fault::Blind {
            blind_ms: 6,
            limit_ms: 5,
        });
        events.watch(ms, mode, fault);
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
        assert!(image.function(&function.name).is_some());
        let _ = image.function_at(function.address);
    }
    let _ = image.has_double_precision();
}

/// An image for a Cortex-M with a part that is loaded, a section and no symbols; one for another processor.
pub(crate) fn elf_seeds() -> Vec<Vec<u8>> {
    const HEAD: u16 = 52;
    const PROGRAM: u16 = 32;
    const SECTION: u16 = 40;
    let halves = |halves: &[u16]| halves.iter().flat_map(|half| half.to_le_bytes()).collect::<Vec<u8>>();
    let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    let names = b"\0.text\0.names\0";
    let file = |machine: u16| {
        let at = u32::from(HEAD + PROGRAM);
        let sections = at + 4 + names.len() as u32 + 2;
        [
            b"\x7FELF\x01\x01\x01".to_vec(),
            vec![0; 9],
            halves(&[2, machine]),
            words(&[1, 0x0800_0000, HEAD.into(), sections, 0x0500_0000]),
            halves(&[HEAD, PROGRAM, 1, SECTION, 3, 2]),
            words(&[1, at, 0x0800_0000, 0x0800_0000, 4, 4, 5, 4]),
            vec![0x70, 0x47, 0, 0],
            names.to_vec(),
            vec![0; 2],
            vec![0; SECTION.into()],
            words(&[1, 1, 6, 0x0800_0000, at, 4, 0, 0, 4, 0]),
            words(&[7, 3, 0, 0, at + 4, names.len() as u32, 0, 0, 1, 0]),
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
        assert!(Contents::of(&black_box_seeds()[0]).is_ok());
        let image = Image::parse(&elf_seeds()[0]).expect("an image");
        assert!(image.loads().len() == 1 && image.section(".text").is_some());
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
