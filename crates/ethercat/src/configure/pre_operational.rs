//! A slave in PREOP, as its driver sees it: objects, lists of process data, and where these lie in its memory.
//!
//! The driver's choice of process data is assigned and mapped; a device that refuses keeps its own. Then the lists are
//! read back (0x1C10 + the number of a sync manager names the objects assigned to it, each of which lists its entries).
//! Where such an object is missing, the SII's lists are used, or else those of the driver.
//!
//! The sync managers are those that the SII lists first for outputs and for inputs, behind those of a mailbox; of entries that
//! contradict themselves see `listed_windows`. Where it lists none, they are 2 and 3, as ETG.1000.6 numbers them, unless the other
//! direction has that one.
//!
//! Invariants: a refused assignment or mapping is not an error; every list and every wait ends.

use super::information::read_sii;
use super::objects::{ASSIGNMENT, Direction, Entry, MANAGERS_MAX, PdoChoice, Setting, Window, Windows};
use crate::acyclic::AcyclicPort;
use crate::coe::ObjectDictionary;
use crate::error::BusError;
use crate::mailbox::Mailbox;
use crate::wire::coe::Object;
use crate::wire::register;
use crate::wire::sii::{
    self, CategoryHeader, CategoryWalker, PdoEntryRecord, PdoRecord, Record, SyncManagerRecord, SyncManagerUse,
};
use crate::wire::{read_u16, write_bytes};
use heapless::Vec;

/// Most process data objects of one direction.
const PDOS_MAX: usize = 8;
/// Most entries of one process data object: the last sub-index of a list.
pub(super) const ENTRIES_MAX: u8 = 254;
/// Most read-backs of a setting until the device shows the value; one read-back takes some milliseconds.
const VERIFY_TRIES_MAX: u8 = 10;
/// Sync managers of a mailbox, before all others.
const MAILBOX_MANAGERS: u16 = 2;
/// Lowest address of process memory.
const PROCESS_MEMORY: u16 = register::PROCESS_MEMORY;
/// Words of the SII in a KiBit.
const SII_WORDS_PER_KIBIT: u16 = 64;
/// Words of a sync manager, a process data object or an entry in the SII.
const RECORD_WORDS: u16 = 4;

impl Direction {
    /// The SII's category of process data objects.
    const fn category(self) -> u16 {
        match self {
            Self::Outputs => sii::CATEGORY_RX_PDO,
            Self::Inputs => sii::CATEGORY_TX_PDO,
        }
    }
}

/// A slave in PREOP with its mailbox set up.
pub struct PreOperational<'p, 'q, const MESSAGE: usize> {
    port: &'p mut AcyclicPort<'q, MESSAGE>,
    station: u16,
    mailbox: &'p mut Mailbox,
    cycle_ns: u32,
    /// Its sync managers, once they are known; a first byte of 0 is not known.
    windows: Option<Windows>,
}

impl<'p, 'q, const MESSAGE: usize> PreOperational<'p, 'q, MESSAGE> {
    /// `windows`: sync managers that are not read from the SII, those of a slave of equal product and revision.
    pub(crate) fn new(
        port: &'p mut AcyclicPort<'q, MESSAGE>,
        station: u16,
        mailbox: &'p mut Mailbox,
        cycle_ns: u32,
        windows: Option<Windows>,
    ) -> Self {
        Self {
            port,
            station,
            mailbox,
            cycle_ns,
            windows,
        }
    }

    /// Period of the cyclic exchange, ns.
    pub fn cycle_ns(&self) -> u32 {
        self.cycle_ns
    }

    /// The slave's object dictionary.
    pub fn dictionary(&mut self) -> ObjectDictionary<'_, 'q, MESSAGE> {
        ObjectDictionary::new(self.port, self.mailbox)
    }

    /// Assigns a process data object, and writes its entries unless they are fixed; returns false if the device refused
    /// any part.
    ///
    /// # Errors
    /// Errors of the mailbox and the SII.
    pub async fn assign(&mut self, direction: Direction, choice: &PdoChoice) -> Result<bool, BusError> {
        let manager = self.listed_windows().await?.of(direction).manager;
        let index = ASSIGNMENT + u16::from(manager);
        let dictionary = &mut self.dictionary();
        let assignment = |sub| Object::new(index, sub);
        if !offer(dictionary, assignment(0), 0, 1).await? {
            return Ok(false);
        }
        let mut taken = true;
        let count = Object::new(choice.pdo, 0);
        if choice.written && offer(dictionary, count, 0, 1).await? {
            // An entry that the device cannot map is left out.
            let mut mapped = 0;
            for entry in choice.entries {
                let object = Object::new(choice.pdo, mapped + 1);
                mapped += u8::from(offer(dictionary, object, entry.mapping(), 4).await?);
            }
            taken &= usize::from(mapped) == choice.entries.len();
            taken &= offer(dictionary, count, mapped.into(), 1).await?;
        } else if choice.written {
            taken = false;
        }
        taken &= offer(dictionary, assignment(1), choice.pdo.into(), 2).await?;
        taken &= offer(dictionary, assignment(0), 1, 1).await?;
        Ok(taken)
    }

    /// Writes an object, and reads it back if the setting requires it.
    ///
    /// # Errors
    /// [`BusError::SdoAbort`] unless the setting is optional, [`BusError::ReadBack`], or errors of the mailbox.
    pub async fn write(&mut self, setting: &Setting) -> Result<(), BusError> {
        let dictionary = &mut self.dictionary();
        let mask = u32::MAX >> (32 - 8 * u32::from(setting.length.clamp(1, 4)));
        let others = match setting.adds {
            true => dictionary.read(setting.object, setting.length).await?,
            false => 0,
        };
        let value = setting.value | others;
        let expected = value & mask;
        match dictionary.write(setting.object, value, setting.length).await {
            Err(BusError::SdoAbort { .. }) if setting.optional => return Ok(()),
            other => other?,
        }
        let Some(object) = setting.verify else { return Ok(()) };
        let mut actual = 0;
        for _ in 0..VERIFY_TRIES_MAX {
            actual = dictionary.read(object, setting.length).await?;
            if setting.is_shown_by(expected, actual) {
                return Ok(());
            }
        }
        Err(BusError::ReadBack {
            object,
            expected,
            actual,
        })
    }

    /// Waits until an object of `length` bytes has a value.
    ///
    /// # Errors
    /// [`BusError::ReadBack`] after `wait_ms`, or errors of the mailbox.
    pub async fn await_value(
        &mut self,
        object: Object,
        expected: u32,
        length: u8,
        wait_ms: u32,
    ) -> Result<(), BusError> {
        let started_ms = self.port.now_ms();
        loop {
            let actual = self.dictionary().read(object, length).await?;
            if actual == expected {
                return Ok(());
            }
            if self.port.now_ms().wrapping_sub(started_ms) > wait_ms {
                return Err(BusError::ReadBack {
                    object,
                    expected,
                    actual,
                });
            }
        }
    }

    /// Passes the entries of one direction's actual process data to `take`, in their order. `choice` replaces lists
    /// that the device does not have.
    ///
    /// # Errors Those of `take`, [`BusError::Range`] for a list that is too long, [`BusError::SdoAbort`] for an object
    /// without readable entries, or errors of the mailbox and the SII.
    pub async fn entries(
        &mut self,
        direction: Direction,
        choice: &PdoChoice,
        mut take: impl FnMut(Entry) -> Result<(), BusError>,
    ) -> Result<(), BusError> {
        let station = self.station;
        let manager = self.listed_windows().await?.of(direction).manager;
        let index = ASSIGNMENT + u16::from(manager);
        let mut pdos: Vec<u16, PDOS_MAX> = Vec::new();
        let mut dictionary = self.dictionary();
        let assigned = read_list(&mut dictionary, index, PDOS_MAX as u8, 2, |pdo| {
            // The list has room for as many.
            let _ = pdos.push(pdo as u16);
            Ok(())
        });
        match assigned.await {
            Err(BusError::SdoAbort { .. }) => {
                let here = |pdo: &PdoRecord| pdo.sync_manager == manager;
                if sii_entries(self.port, station, direction, here, &mut take).await? == 0 {
                    choice.entries.iter().try_for_each(|entry| take(*entry))?;
                }
                return Ok(());
            }
            other => other?,
        }
        for pdo in pdos {
            let mut dictionary = self.dictionary();
            let entries = read_list(&mut dictionary, pdo, ENTRIES_MAX, 4, |value| {
                take(Entry::from_mapping(value))
            });
            let error = match entries.await {
                // An object with unreadable entries, none of which was passed on yet.
                Err(error @ BusError::SdoAbort { object, .. }) if object.sub == 0 => error,
                other => {
                    other?;
                    continue;
                }
            };
            let here = |record: &PdoRecord| record.index == pdo;
            if sii_entries(self.port, station, direction, here, &mut take).await? > 0 {
                continue;
            }
            if pdo != choice.pdo {
                return Err(error);
            }
            choice.entries.iter().try_for_each(|entry| take(*entry))?;
        }
        Ok(())
    }

    /// Where the process data are: the sync managers of the SII, and the first bytes of `otherwise` where it tells none.
    ///
    /// # Errors
    /// Errors of the SII.
    pub async fn windows(&mut self, otherwise: Windows) -> Result<Windows, BusError> {
        let listed = self.listed_windows().await?;
        let told = |window: Window, otherwise: Window| match window.start {
            0 => Window {
                start: otherwise.start,
                ..window
            },
            _ => window,
        };
        Ok(Windows {
            outputs: told(listed.outputs, otherwise.outputs),
            inputs: told(listed.inputs, otherwise.inputs),
        })
    }

    /// The sync managers of the SII, read once.
    async fn listed_windows(&mut self) -> Result<Windows, BusError> {
        if let Some(windows) = self.windows {
            return Ok(windows);
        }
        let has_mailbox = *self.mailbox != Mailbox::default();
        let windows = listed_windows(self.port, self.station, has_mailbox).await?;
        self.windows = Some(windows);
        Ok(windows)
    }
}

/// The first sync managers that the SII lists for outputs and for inputs, behind those of a mailbox, even without a first byte;
/// first bytes that it does not tell are 0. Sync managers that are not listed are the standard ones.
///
/// An entry whose control byte is for the other direction is used if there is no better one. Without any better entry it is not if
/// the two directions may be exchanged: there are such entries for both, or its number is the other direction's standard one.
async fn listed_windows<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    has_mailbox: bool,
) -> Result<Windows, BusError> {
    let ([mut outputs, mut inputs], [mut doubtful_outputs, mut doubtful_inputs]) = ([None; 2], [None; 2]);
    let category = find_category(port, station, sii::CATEGORY_SYNC_MANAGER).await?;
    let managers = category.map_or(0, |category| (category.words / RECORD_WORDS).min(MANAGERS_MAX));
    let first = if has_mailbox { MAILBOX_MANAGERS } else { 0 };
    for number in first..managers {
        let word = category.map_or(0, |category| category.word.saturating_add(number * RECORD_WORDS));
        let Ok(record) = SyncManagerRecord::parse(&sii_record(port, station, word).await?) else {
            continue;
        };
        // A control byte of 0 tells nothing.
        let may_be = |direction| record.control == 0 || record.control & register::CONTROL_DIRECTION == direction;
        let window = match record.usage {
            SyncManagerUse::Outputs if may_be(register::CONTROL_MASTER_WRITES) => &mut outputs,
            SyncManagerUse::Outputs => &mut doubtful_outputs,
            SyncManagerUse::Inputs if may_be(0) => &mut inputs,
            SyncManagerUse::Inputs => &mut doubtful_inputs,
            _ => continue,
        };
        if record.flags & sii::SYNC_MANAGER_VIRTUAL == 0 {
            window.get_or_insert(Window {
                manager: number as u8,
                start: if record.start < PROCESS_MEMORY { 0 } else { record.start },
            });
        }
        if outputs.is_some() && inputs.is_some() {
            break;
        }
    }
    Ok(chosen([outputs, inputs], [doubtful_outputs, doubtful_inputs]))
}

/// The sync managers for outputs and inputs, from those that are listed, and those whose entries contradict themselves.
fn chosen(sure: [Option<Window>; 2], doubtful: [Option<Window>; 2]) -> Windows {
    let standard = Windows::standard(0, 0);
    let (of_outputs, of_inputs) = (standard.outputs.manager, standard.inputs.manager);
    let [outputs, inputs] = match (sure, doubtful) {
        ([None, None], [Some(_), Some(_)]) => [None; 2],
        ([None, None], [outputs, inputs]) => [
            outputs.filter(|window| window.manager != of_inputs),
            inputs.filter(|window| window.manager != of_outputs),
        ],
        ([outputs, inputs], [more_outputs, more_inputs]) => [outputs.or(more_outputs), inputs.or(more_inputs)],
    };
    Windows::listed(outputs, inputs)
}

/// Writes a value; false when the drive refuses it.
async fn offer<const MESSAGE: usize>(
    dictionary: &mut ObjectDictionary<'_, '_, MESSAGE>,
    object: Object,
    value: u32,
    length: u8,
) -> Result<bool, BusError> {
    match dictionary.write(object, value, length).await {
        Ok(()) => Ok(true),
        Err(BusError::SdoAbort { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Reads an object whose sub-index 0 counts its values of `length` bytes, and passes the values to `take`.
///
/// # Errors
/// [`BusError::SdoAbort`] with sub-index 0 when there is no such object; then no value was passed on.
pub(super) async fn read_list<const MESSAGE: usize>(
    dictionary: &mut ObjectDictionary<'_, '_, MESSAGE>,
    index: u16,
    most: u8,
    length: u8,
    mut take: impl FnMut(u32) -> Result<(), BusError>,
) -> Result<(), BusError> {
    let object = Object::new(index, 0);
    let count = dictionary.read(object, 1).await?;
    if count > most.into() {
        return Err(BusError::Range { object });
    }
    for sub in 1..=count as u8 {
        take(dictionary.read(Object::new(index, sub), length).await?)?;
    }
    Ok(())
}

/// Passes the entries of the SII's process data objects that `chosen` selects to `take`; returns the number of objects.
pub(super) async fn sii_entries<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    direction: Direction,
    chosen: impl Fn(&PdoRecord) -> bool,
    take: &mut impl FnMut(Entry) -> Result<(), BusError>,
) -> Result<u8, BusError> {
    let Some(category) = find_category(port, station, direction.category()).await? else {
        return Ok(0);
    };
    let (mut word, end) = (category.word, category.word.saturating_add(category.words));
    let mut found = 0_u8;
    while word < end {
        let Ok(pdo) = PdoRecord::parse(&sii_record(port, station, word).await?) else {
            break;
        };
        word = word.saturating_add(RECORD_WORDS);
        if chosen(&pdo) && pdo.entries > 0 {
            found = found.saturating_add(1);
            for number in 0..u16::from(pdo.entries) {
                let at = word.saturating_add(number.saturating_mul(RECORD_WORDS));
                if at >= end {
                    break;
                }
                if let Ok(entry) = PdoEntryRecord::parse(&sii_record(port, station, at).await?) {
                    take(Entry::new(Object::new(entry.index, entry.sub), entry.bits))?;
                }
            }
        }
        word = word.saturating_add(u16::from(pdo.entries).saturating_mul(RECORD_WORDS));
    }
    Ok(found)
}

/// Reads a record of eight bytes from the SII.
async fn sii_record<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    word: u16,
) -> Result<[u8; 8], BusError> {
    let mut record = [0; 2 * RECORD_WORDS as usize];
    let mut at = 0;
    while at < record.len() {
        let part = read_sii(port, station, word.saturating_add(at as u16 / 2)).await?;
        let room = record.len() - at;
        write_bytes(&mut record, at, part.get(..part.len().min(room)).unwrap_or(&[]));
        at += part.len().max(2);
    }
    Ok(record)
}

/// Looks for a category in the SII.
async fn find_category<const MESSAGE: usize>(
    port: &mut AcyclicPort<'_, MESSAGE>,
    station: u16,
    kind: u16,
) -> Result<Option<CategoryHeader>, BusError> {
    let size = read_u16(&read_sii(port, station, sii::WORD_SIZE).await?, 0);
    let words = size.saturating_add(1).saturating_mul(SII_WORDS_PER_KIBIT);
    let mut walker = CategoryWalker::new(words);
    while let Some(word) = walker.next_word() {
        let header = read_sii(port, station, word).await?;
        match walker.feed(read_u16(&header, 0), read_u16(&header, 2)) {
            Some(category) if category.kind == kind => return Ok(Some(category)),
            _ => {}
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acyclic::{IN_FLIGHT_MAX, Lane, Outcome, Reply, Request};
    use core::pin::pin;
    use core::task::{Context, Poll, Waker};
    use heapless::spsc::Queue;
    use std::vec::Vec;

    /// Number of the sync manager of the inputs.
    const INPUTS: u8 = 3;

    /// An SII with one category of such records and nothing else.
    fn sii(category: u16, records: &[[u8; 8]]) -> Vec<u8> {
        let mut bytes = std::vec![0; 2 * usize::from(sii::WORD_CATEGORIES)];
        // Two KiBit.
        write_bytes(&mut bytes, 2 * usize::from(sii::WORD_SIZE), &[1]);
        let words = RECORD_WORDS * records.len() as u16;
        for word in [category, words] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(records.concat());
        bytes.extend([0xFF; 16]);
        bytes
    }

    /// A slave's interface to its SII.
    struct Interface {
        sii: Vec<u8>,
        /// The word that was asked for last.
        word: u16,
        /// Lengths of the next answers in turn, bytes: 4 or 8.
        lengths: Vec<usize>,
    }

    impl Interface {
        fn answer(&mut self, request: &Request) -> Reply {
            let mut data = request.data.clone();
            if request.address.register() == register::SII_CONTROL {
                match request.command.writes() {
                    true => self.word = read_u16(&data, 2),
                    false => {
                        let from = self.sii.get(2 * usize::from(self.word)..).unwrap_or(&[]);
                        let status = if self.lengths[0] == 8 {
                            register::SII_READS_8_BYTES
                        } else {
                            0
                        };
                        write_bytes(&mut data, 0, &status.to_le_bytes());
                        write_bytes(&mut data, 2, &self.word.to_le_bytes());
                        write_bytes(&mut data, 6, &from[..from.len().min(self.lengths[0])]);
                        self.lengths.rotate_left(1);
                    }
                }
            }
            let outcome = Outcome::Processed { working_counter: 1 };
            Reply { data, outcome }
        }
    }

    /// The number of objects that the SII assigns to the inputs, and their entries.
    fn inputs(records: &[[u8; 8]]) -> (Result<u8, BusError>, Vec<Entry>) {
        inputs_in_parts(records, &[8])
    }

    /// What [`inputs`] returns of an interface whose answers have these lengths in turn, bytes.
    fn inputs_in_parts(records: &[[u8; 8]], lengths: &[usize]) -> (Result<u8, BusError>, Vec<Entry>) {
        let interface = Interface {
            sii: sii(sii::CATEGORY_TX_PDO, records),
            word: 0,
            lengths: lengths.to_vec(),
        };
        let mut entries = Vec::new();
        let mut take = |entry| {
            entries.push(entry);
            Ok(())
        };
        let here = |pdo: &PdoRecord| pdo.sync_manager == INPUTS;
        let found = answered(interface, async |port| {
            sii_entries(port, 0x1001, Direction::Inputs, here, &mut take).await
        });
        (found, entries)
    }

    /// The sync managers that an SII lists.
    fn windows(records: &[[u8; 8]], has_mailbox: bool) -> Windows {
        let interface = Interface {
            sii: sii(sii::CATEGORY_SYNC_MANAGER, records),
            word: 0,
            lengths: std::vec![8],
        };
        let listed = answered(interface, async |port| listed_windows(port, 0x1001, has_mailbox).await);
        listed.expect("windows")
    }

    /// Does work over a port that this interface answers.
    fn answered<T>(mut interface: Interface, work: impl AsyncFnOnce(&mut AcyclicPort<'_, 32>) -> T) -> T {
        let mut requests = Queue::<Request, { IN_FLIGHT_MAX + 1 }>::new();
        let mut replies = Queue::<Reply, { IN_FLIGHT_MAX + 1 }>::new();
        let (mut messages, mut answers) = (Queue::<Request<32>, 2>::new(), Queue::<Reply<32>, 2>::new());
        let (ask, mut asked) = requests.split();
        let (mut give, given) = replies.split();
        let message_lane = Lane::new(messages.split().0, answers.split().1);
        let mut port = AcyclicPort::new(Lane::new(ask, given), message_lane);
        let mut work = pin!(work(&mut port));
        let mut polls = (0..1_000).map(|_| {
            let result = work.as_mut().poll(&mut Context::from_waker(Waker::noop()));
            while let Some(request) = asked.dequeue() {
                assert!(give.enqueue(interface.answer(&request)).is_ok());
            }
            result
        });
        let found = polls.find_map(|result| match result {
            Poll::Ready(found) => Some(found),
            Poll::Pending => None,
        });
        found.expect("an end")
    }

    #[test]
    fn the_sync_managers_are_the_first_that_are_listed_behind_a_mailbox() {
        let mut random = 1_u32;
        let mut below = |limit: u32| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 16) % limit
        };
        for _ in 0..2_000 {
            let has_mailbox = below(2) == 0;
            // Unused, mailboxes, outputs, inputs; some of them virtual, some with a control byte for the other direction.
            let list: Vec<(u16, u8, u8, u8)> = (0..below(9))
                .map(|_| {
                    let control = [0x64, 0x20, 0][below(3) as usize];
                    (
                        0x400 * below(8) as u16,
                        control,
                        below(5) as u8,
                        u8::from(below(4) == 0) << 2,
                    )
                })
                .collect();
            let record = |&(start, control, usage, flags): &(u16, u8, u8, u8)| {
                let [low, high] = start.to_le_bytes();
                [low, high, 0, 0, control, 0, flags, usage]
            };
            let records: Vec<[u8; 8]> = list.iter().map(record).collect();
            let found = windows(&records, has_mailbox);
            let listed = |usage, controls: &[u8]| {
                let numbered = (0_u8..).zip(&list).skip(if has_mailbox { 2 } else { 0 });
                let mut real = numbered.filter(|(_, record)| (record.2, record.3) == (usage, 0));
                let found = real.find(|(_, record)| controls.contains(&record.1));
                found.map(|(number, record)| (number, if record.0 < PROCESS_MEMORY { 0 } else { record.0 }))
            };
            let (mut outputs, mut inputs) = (listed(3, &[0x64, 0]), listed(4, &[0x20, 0]));
            let doubtful = (listed(3, &[0x20]), listed(4, &[0x64]));
            let is_of = |number: u8, entry: Option<(u8, u16)>| entry.is_some_and(|entry| entry.0 == number);
            let is_slip = is_of(3, doubtful.0) || is_of(2, doubtful.1) || doubtful.0.is_some() && doubtful.1.is_some();
            if (outputs, inputs) != (None, None) || !is_slip {
                outputs = outputs.or(doubtful.0);
                inputs = inputs.or(doubtful.1);
            }
            // The other standard one where the right one is taken.
            let free = |standard: u8, other: Option<(u8, u16)>| match other {
                Some((number, _)) if number == standard => 5 - standard,
                _ => standard,
            };
            let outputs_expected = outputs.unwrap_or((free(2, inputs), 0));
            let inputs_expected = inputs.unwrap_or((free(3, outputs), 0));
            assert_eq!(
                (found.outputs.manager, found.outputs.start),
                outputs_expected,
                "{list:?}"
            );
            assert_eq!((found.inputs.manager, found.inputs.start), inputs_expected, "{list:?}");
            assert_ne!(found.outputs.manager, found.inputs.manager, "{list:?}");
        }
    }

    #[test]
    fn entries_that_contradict_themselves_are_used_where_there_is_no_better_one() {
        let record = |start: u16, control, usage| {
            let [low, high] = start.to_le_bytes();
            [low, high, 0, 0, control, 0, 1, usage]
        };
        let (out, input) = (record(0x1100, 0x64, 3), record(0x1400, 0x20, 4));
        let (doubtful_out, doubtful_input) = (record(0x1100, 0x20, 3), record(0x1400, 0x64, 4));
        let found = |records: &[[u8; 8]]| {
            let Windows { outputs, inputs } = windows(records, false);
            [outputs, inputs].map(|window| (window.manager, window.start))
        };
        assert_eq!(found(&[doubtful_input]), [(2, 0), (0, 0x1400)]);
        assert_eq!(found(&[doubtful_input, input]), [(2, 0), (1, 0x1400)]);
        assert_eq!(found(&[doubtful_out, input]), [(0, 0x1100), (1, 0x1400)]);
        assert_eq!(found(&[doubtful_input, doubtful_out]), [(2, 0), (3, 0)]);
        // A slip in the usage alone: the number and the control byte say the same.
        let unused = record(0, 0, 0);
        assert_eq!(found(&[unused, unused, unused, doubtful_out]), [(2, 0), (3, 0)]);
        assert_eq!(found(&[unused, unused, doubtful_input]), [(2, 0), (3, 0)]);
        assert_eq!(
            found(&[unused, unused, doubtful_input, unused, doubtful_out]),
            [(2, 0), (3, 0)]
        );
        // Beside a sure entry there is no doubt about the direction.
        assert_eq!(
            found(&[unused, unused, doubtful_input, out]),
            [(3, 0x1100), (2, 0x1400)]
        );
        assert_eq!(found(&[doubtful_input, doubtful_out, out]), [(2, 0x1100), (0, 0x1400)]);
    }

    #[test]
    fn a_process_data_object_without_entries_in_the_sii_does_not_count() {
        let object = |index: u8, entries| [index, 0x1A, entries, INPUTS, 0, 0, 0, 0];
        let entry = [0x64, 0x60, 0, 0, 0, 32, 0, 0];
        let position = Entry::new(Object::new(0x6064, 0), 32);
        assert_eq!(inputs(&[object(0, 0)]), (Ok(0), Vec::new()));
        let records = [object(0, 0), object(1, 1), entry, object(2, 0)];
        assert_eq!(inputs(&records), (Ok(1), std::vec![position]));
    }
    #[test]
    fn records_are_whole_in_whatever_parts_the_sii_is_answered() {
        let object = |index: u8, entries| [index, 0x1A, entries, INPUTS, 0, 0, 0, 0];
        let entry = |index: u8, bits| [index, 0x60, 0, 0, 0, bits, 0, 0];
        let records = [
            object(0, 2),
            entry(0x64, 32),
            entry(0x41, 16),
            object(1, 1),
            entry(0x61, 8),
        ];
        let expected = [(0x6064, 32), (0x6041, 16), (0x6061, 8)];
        let expected: Vec<Entry> = expected
            .map(|(index, bits)| Entry::new(Object::new(index, 0), bits))
            .to_vec();
        for pattern in 0..32_u32 {
            let lengths = [0, 1, 2, 3, 4].map(|place| if pattern >> place & 1 == 0 { 4 } else { 8 });
            let found = inputs_in_parts(&records, &lengths);
            assert_eq!(found, (Ok(2), expected.clone()), "answers of {lengths:?} bytes");
        }
    }
}
