//! Reading a slave's information memory (SII) through its registers.
//!
//! The master writes a command with a word address, waits for the memory, and reads control, address and data back in
//! one datagram, so that data never belong to another address. Several slaves are read in parallel: one frame carries
//! the commands, the next one the answers (IEC 61158-4-12, slave information interface).
//!
//! Invariant: every wait and every walk ends; the master only reads.

use crate::acyclic::{AcyclicPort, IN_FLIGHT_MAX, Request};
use crate::diagnostics::Name;
use crate::error::BusError;
use crate::wire::register;
use crate::wire::sii::{self, CategoryHeader, CategoryWalker, FixedPart, General};
use crate::wire::{Address, Command, read_u8, read_u16, write_bytes};
use core::ops::Range;
use heapless::Vec;

/// Longest wait for the SII to become free, ms: memories that the slave's own processor serves are slow, above all
/// after power-up.
pub const SII_TIMEOUT_MS: u32 = 1_000;
/// Most repetitions of a command that was not acknowledged.
const SII_TRIES_MAX: u8 = 3;
/// Slaves that are read in parallel.
pub const TOGETHER_MAX: usize = IN_FLIGHT_MAX;
/// Most words of a walk through the categories; also bounds its duration.
const WALK_WORDS_MAX: u16 = 1_024;

/// Control, address and data of the interface in one datagram.
const ANSWER_LEN: usize = 14;
const ANSWER_ADDRESS: usize = (register::SII_ADDRESS - register::SII_CONTROL) as usize;
const ANSWER_DATA: usize = (register::SII_DATA - register::SII_CONTROL) as usize;
/// Longest result of one read access, bytes.
const READING_MAX: usize = 8;

/// Result of one read access: 4 or 8 bytes.
pub(super) type Reading = Vec<u8, READING_MAX>;
/// One item for each of the slaves that are read in parallel.
type Each<T> = Vec<T, TOGETHER_MAX>;

/// The parts of the fixed area that the master needs: first word, and the word behind the last.
const WANTED: [(u16, u16); 2] = [
    (sii::WORD_VENDOR, sii::WORD_SERIAL + 2),
    (sii::WORD_MAILBOX_OUT, sii::WORD_PROTOCOLS + 1),
];
/// Bytes up to the end of the last part, plus the excess of one read access.
const IMAGE_LEN: usize = 2 * sii::FIXED_PART_WORDS + READING_MAX;

fn command(station: u16, word: u16) -> Request {
    let [control_low, control_high] = register::SII_READ.to_le_bytes();
    let [low, high] = word.to_le_bytes();
    let address = Address::station(station, register::SII_CONTROL);
    Request::write(Command::Fpwr, address, &[control_low, control_high, low, high, 0, 0])
}

fn question(station: u16) -> Request {
    Request::read(
        Command::Fprd,
        Address::station(station, register::SII_CONTROL),
        ANSWER_LEN,
    )
}

/// How an interface responds to a command for `word`.
enum Answer {
    /// Not finished, or the response to another command.
    Busy,
    /// The command has to be repeated.
    Refused(u16),
    Data(Reading),
}

fn answer(bytes: &[u8], word: u16) -> Answer {
    let status = read_u16(bytes, 0);
    if status & register::SII_BUSY != 0 {
        return Answer::Busy;
    }
    if status & register::SII_ACKNOWLEDGE_ERROR != 0 {
        return Answer::Refused(status);
    }
    if read_u16(bytes, ANSWER_ADDRESS) != word {
        return Answer::Busy;
    }
    let length = if status & register::SII_READS_8_BYTES != 0 {
        READING_MAX
    } else {
        READING_MAX / 2
    };
    let data = bytes.get(ANSWER_DATA..ANSWER_DATA + length).unwrap_or(&[]);
    Answer::Data(Reading::from_slice(data).unwrap_or_default())
}

/// Gives a slave's processor the SII: some read it on their way to PREOP or SAFEOP, and refuse the state otherwise (AL
/// status code 0x0050). A slave that does not take it keeps what it has.
pub async fn give_to_slave<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) {
    let address = Address::station(station, register::SII_CONFIG);
    let request = Request::write(Command::Fpwr, address, &[register::SII_TO_PDI]);
    let _ = port.answered(&request).await;
}

/// Has a slave's controller load its configuration from the SII once more, if it could not at power-up: without it,
/// neither device emulation nor the interface of the slave's processor works, and nobody reads a request for a state.
/// A memory that is damaged for good changes nothing.
pub async fn load_again<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) {
    let Ok(status) = port.read(station, register::SII_CONTROL, 2).await else {
        return;
    };
    if read_u16(&status, 0) & (register::SII_CHECKSUM_ERROR | register::SII_LOADING) == 0 {
        return;
    }
    take(port, station).await;
    let address = Address::station(station, register::SII_CONTROL);
    let reload = Request::write(Command::Fpwr, address, &register::SII_RELOAD.to_le_bytes());
    let _ = port.answered(&reload).await;
    let started_ms = port.now_ms();
    while let Ok(status) = port.read(station, register::SII_CONTROL, 2).await {
        let waited_ms = port.now_ms().wrapping_sub(started_ms);
        if read_u16(&status, 0) & register::SII_BUSY == 0 || waited_ms > SII_TIMEOUT_MS {
            break;
        }
    }
}

/// Takes a slave's SII for the master, by force.
pub async fn take<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, station: u16) {
    take_all(port, station..station.wrapping_add(1)).await;
}

/// Takes the interfaces of some slaves for the master, by force.
async fn take_all<const MESSAGE: usize>(port: &mut AcyclicPort<'_, MESSAGE>, stations: Range<u16>) {
    for value in [register::SII_FORCE, 0] {
        let requests = stations.clone().take(TOGETHER_MAX).map(|station| {
            let address = Address::station(station, register::SII_CONFIG);
            Request::write(Command::Fpwr, address, &[value])
        });
        let requests: Each<Request> = requests.collect();
        // A slave that does not answer will not be read either.
        let _ = port.send_all_until_counted(&requests, 1, |_, _| {}).await;
    }
}

/// Reads 4 or 8 bytes of each slave from word `words[slave]` on; skips slaves with `None`.
async fn read_each<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    first_station: u16,
    words: &Each<Option<u16>>,
) -> Each<Result<Reading, BusError>> {
    let silent = BusError::SiiBusy { waited_ms: 0 };
    let mut results: Each<Result<Reading, BusError>> = words.iter().map(|_| Err(silent)).collect();
    let mut open: Each<Option<u16>> = words.clone();
    for _ in 0..SII_TRIES_MAX {
        if open.iter().all(Option::is_none) {
            break;
        }
        let asked = || {
            (first_station..)
                .zip(open.clone())
                .filter_map(|(station, word)| Some((station, word?)))
        };
        let commands: Each<Request> = asked().map(|(station, word)| command(station, word)).collect();
        // The answer shows whether the command arrived.
        let _ = port.send_all_until_counted(&commands, 1, |_, _| {}).await;
        let numbers: Each<usize> = open
            .iter()
            .enumerate()
            .filter_map(|(number, word)| word.map(|_| number))
            .collect();
        let mut waiting = numbers.clone();
        let started_ms = port.now_ms();
        while !waiting.is_empty() {
            let questions: Each<Request> = waiting
                .iter()
                .map(|number| question(first_station.wrapping_add(*number as u16)))
                .collect();
            let asked = waiting.clone();
            let lost = port
                .send_all_until_counted(&questions, 1, |index, bytes| {
                    let Some(number) = asked.get(index) else { return };
                    let word = words.get(*number).copied().flatten().unwrap_or(0);
                    let result = match answer(bytes, word) {
                        Answer::Busy => return,
                        Answer::Refused(status) => Err(BusError::Sii { status }),
                        Answer::Data(data) => Ok(data),
                    };
                    waiting.retain(|waiting| waiting != number);
                    if let (Ok(_), Some(open)) = (&result, open.get_mut(*number)) {
                        *open = None;
                    }
                    if let Some(place) = results.get_mut(*number) {
                        *place = result;
                    }
                })
                .await
                .err();
            let waited_ms = port.now_ms().wrapping_sub(started_ms);
            if waited_ms > SII_TIMEOUT_MS || lost.is_some() {
                let error = lost.unwrap_or(BusError::SiiBusy { waited_ms });
                for number in waiting.drain(..) {
                    if let Some(place) = results.get_mut(number) {
                        *place = Err(error);
                    }
                    if let Some(open) = open.get_mut(number) {
                        *open = None;
                    }
                }
            }
        }
    }
    results
}

/// Reads the fixed parts of several slaves' SII in parallel: identity and mailboxes. Stations beyond [`TOGETHER_MAX`]
/// are not read.
pub async fn fixed_parts<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    stations: Range<u16>,
) -> Each<Result<FixedPart, BusError>> {
    let count = stations.len().min(TOGETHER_MAX);
    take_all(port, stations.clone()).await;
    let mut images: Each<[u8; IMAGE_LEN]> = (0..count).map(|_| [0; IMAGE_LEN]).collect();
    let mut errors: Each<Option<BusError>> = (0..count).map(|_| None).collect();
    for (from, to) in WANTED {
        let mut next: Each<Option<u16>> = errors.iter().map(|error| error.is_none().then_some(from)).collect();
        while next.iter().any(Option::is_some) {
            let readings = read_each(port, stations.start, &next).await;
            let slaves = next.iter_mut().zip(readings).zip(images.iter_mut().zip(&mut errors));
            for ((next, reading), (image, error)) in slaves {
                let Some(word) = *next else { continue };
                match reading {
                    Ok(part) => {
                        write_bytes(image, usize::from(word) * 2, &part);
                        let behind = word + (part.len() as u16 / 2).max(1);
                        *next = (behind < to).then_some(behind);
                    }
                    Err(failure) => (*next, *error) = (None, Some(failure)),
                }
            }
        }
    }
    let parts = images.iter().zip(errors).map(|(image, error)| match error {
        Some(error) => Err(error),
        None => FixedPart::parse(image).map_err(|_| BusError::Sii { status: 0 }),
    });
    parts.collect()
}

/// Reads the fixed part of one slave's SII: identity and mailboxes.
///
/// # Errors
/// [`BusError::SiiBusy`], [`BusError::Sii`], or as [`AcyclicPort::send_until_counted`].
pub async fn fixed_part<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<FixedPart, BusError> {
    let mut parts = fixed_parts(port, station..station.wrapping_add(1)).await;
    parts.pop().unwrap_or(Err(BusError::Sii { status: 0 }))
}

/// Reads 4 or 8 bytes of a slave's SII from a word on.
pub(super) async fn read_sii<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    word: u16,
) -> Result<Reading, BusError> {
    let one: Each<Option<u16>> = core::iter::once(Some(word)).collect();
    let reading = read_each(port, station, &one).await.pop();
    reading.unwrap_or(Err(BusError::Sii { status: 0 }))
}

/// Fills `bytes` from a word of a slave's SII on; returns how many bytes there were before the memory ended.
///
/// # Errors
/// As [`fixed_part`], for the first reading.
pub async fn read_words<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    word: u16,
    bytes: &mut [u8],
) -> Result<usize, BusError> {
    let mut filled = 0;
    while filled < bytes.len() {
        let Ok(offset) = u16::try_from(filled / 2) else { break };
        let Some(here) = word.checked_add(offset) else { break };
        let reading = match read_sii(port, station, here).await {
            Ok(reading) if !reading.is_empty() => reading,
            Err(error) if filled == 0 => return Err(error),
            _ => break,
        };
        let room = bytes.get_mut(filled..).unwrap_or_default();
        let copied = room.len().min(reading.len());
        write_bytes(room, 0, reading.get(..copied).unwrap_or(&[]));
        filled += copied;
    }
    Ok(filled)
}

/// Finds a category of a slave's SII; `None` when there is none.
///
/// # Errors
/// As [`fixed_part`].
pub async fn find_category<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    kind: u16,
) -> Result<Option<CategoryHeader>, BusError> {
    let mut walker = CategoryWalker::new(WALK_WORDS_MAX);
    while let Some(word) = walker.next_word() {
        let mut header = [0; 4];
        read_words(port, station, word, &mut header).await?;
        match walker.feed(read_u16(&header, 0), read_u16(&header, 2)) {
            Some(category) if category.kind == kind => return Ok(Some(category)),
            _ => {}
        }
    }
    Ok(None)
}

/// Flags of the general category of a slave's SII, see [`General::flags`]; 0 without that category.
///
/// # Errors
/// As [`fixed_part`].
pub async fn general_flags<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<u8, BusError> {
    let general = find_category(port, station, sii::CATEGORY_GENERAL).await?;
    let whole = general.filter(|general| usize::from(general.words) * 2 > General::FLAGS_AT);
    let Some(general) = whole else { return Ok(0) };
    let mut word = [0; 2];
    let at = general.word.saturating_add((General::FLAGS_AT / 2) as u16);
    read_words(port, station, at, &mut word).await?;
    Ok(read_u8(&word, General::FLAGS_AT % 2))
}

/// Alias, switches and name of a slave, for display.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Configured alias.
    pub alias: u16,
    /// Whether the device tells the number of its identification switches when it is asked by AL control.
    pub has_switch: bool,
    /// The device's name.
    pub name: Name,
}

/// Reads alias and name.
///
/// # Errors
/// As [`fixed_part`].
pub async fn summary<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
) -> Result<Summary, BusError> {
    let mut alias = [0; 2];
    read_words(port, station, sii::WORD_ALIAS, &mut alias).await?;
    let mut summary = Summary {
        alias: read_u16(&alias, 0),
        has_switch: false,
        name: Name::new(),
    };
    let Some(general) = find_category(port, station, sii::CATEGORY_GENERAL).await? else {
        return Ok(summary);
    };
    let mut names = [0; 4];
    read_words(port, station, general.word, &mut names).await?;
    summary.has_switch = general_flags(port, station).await? & sii::FLAG_IDENTITY_IN_AL_STATUS != 0;
    if let Some(strings) = find_category(port, station, sii::CATEGORY_STRINGS).await? {
        summary.name = string(port, station, strings, read_u8(&names, 3)).await?;
    }
    Ok(summary)
}

/// Reads a string of a slave's SII; empty for index 0 and for a missing string.
async fn string<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    category: CategoryHeader,
    index: u8,
) -> Result<Name, BusError> {
    let mut name = Name::new();
    let mut count = 0;
    // Number of the string being read, and how many of its bytes are still to come.
    let (mut number, mut left) = (0_u8, 0_u8);
    let words = category.words.min(WALK_WORDS_MAX);
    let mut at = 0;
    while at < words && index > 0 {
        let mut part = [0; READING_MAX];
        let wanted = part.len().min(usize::from(words - at) * 2);
        let room = part.get_mut(..wanted).unwrap_or_default();
        let read = read_words(port, station, category.word.saturating_add(at), room).await?;
        for (offset, byte) in part.iter().take(read).enumerate() {
            if at == 0 && offset == 0 {
                count = *byte;
            } else if left == 0 {
                (number, left) = (number.saturating_add(1), *byte);
            } else {
                left -= 1;
                let text = byte.is_ascii_graphic() || *byte == b' ';
                if number == index && (!text || name.push(char::from(*byte)).is_err()) {
                    return Ok(name);
                }
            }
            if number > index || index > count || number == index && left == 0 {
                return Ok(name);
            }
        }
        at = at.saturating_add((READING_MAX / 2) as u16);
    }
    Ok(name)
}
