//! SDO and SDO information against a scripted mailbox: every byte that the master sends, and every answer to it.

extern crate std;

use super::acyclic::{AcyclicPort, IN_FLIGHT_MAX, Lane, Outcome, REGISTER_BYTES_MAX, Reply, Request};
use super::coe::ObjectDictionary;
use super::error::BusError;
use super::mailbox::Mailbox;
use super::wire::coe::{
    ACCESS_READ, Emergency, EntryDescription, Information, InformationRepr, Object, ObjectDescription, ObjectList, Sdo,
};
use super::wire::mailbox::{MAILBOX_HEADER_LEN, MailboxRepr, Protocol, service_data};
use super::wire::sii::MailboxWindow;
use super::wire::{Command, register};
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use heapless::spsc::Queue;
use std::collections::VecDeque;
use std::vec::Vec;
use std::{println, vec};

const MESSAGE: usize = 64;
/// Bytes of both windows: 26 of service data.
const WINDOW: u16 = 32;
const OUT: u16 = 0x1000;
const IN: u16 = 0x1080;
const OBJECT: Object = Object::new(0x2F00, 0);

/// What the master has to send next, and what the slave answers.
type Step = (Vec<u8>, Vec<Vec<u8>>);

/// A complete mailbox with a message of `protocol`.
fn message(protocol: Protocol, data: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; usize::from(WINDOW)];
    let header = MailboxRepr {
        length: data.len() as u16,
        address: 0,
        priority: 0,
        protocol,
        counter: 1,
    };
    header.emit(&mut bytes).unwrap();
    bytes[MAILBOX_HEADER_LEN..][..data.len()].copy_from_slice(data);
    bytes
}

/// The service data of an SDO message.
fn sdo(sdo: Sdo<'_>) -> Vec<u8> {
    let mut bytes = vec![0; 64];
    let length = sdo.emit(&mut bytes).unwrap();
    bytes.truncate(length);
    bytes
}

fn answer(response: Sdo<'_>) -> Vec<u8> {
    message(Protocol::Coe, &sdo(response))
}

fn information(fragments_left: u16, body: Information<'_>) -> Vec<u8> {
    let mut bytes = vec![0; 64];
    let repr = InformationRepr {
        incomplete: fragments_left > 0,
        fragments_left,
        body,
    };
    let length = repr.emit(&mut bytes).unwrap();
    bytes.truncate(length);
    bytes
}

/// Serves the two lanes: registers of the mailboxes, and the mailboxes themselves.
#[derive(Default)]
struct Slave {
    script: VecDeque<Step>,
    waiting: VecDeque<Vec<u8>>,
    /// Answers to messages beyond the script; `None` makes such a message a failure.
    anything: Option<Vec<Vec<u8>>>,
    /// Whether the mailbox for requests is full and stays so.
    is_stuck: bool,
    /// What a request to repeat brings; if empty, there is nothing to repeat.
    repetition: Vec<Vec<u8>>,
    /// The repeat bit as the slave has last answered it.
    repeat_bit: u8,
}

impl Slave {
    fn register(&mut self, request: &Request) -> Reply {
        let manager = register::sync_manager(1);
        let input_status = manager + register::SYNC_MANAGER_STATUS_OFFSET;
        let activate = manager + register::SYNC_MANAGER_ACTIVATE_OFFSET;
        let asks = (Command::Fpwr, activate) == (request.command, request.address.register());
        assert!(request.command == Command::Fprd || asks, "{request:?}");
        if asks && !self.repetition.is_empty() {
            self.waiting.extend(self.repetition.drain(..));
            self.repeat_bit = request.data[0] & register::SYNC_MANAGER_REPEAT;
        }
        let answered = manager + register::SYNC_MANAGER_PDI_OFFSET;
        let full = request.address.register() == input_status && !self.waiting.is_empty();
        let mut data = request.data.clone();
        data[0] = match request.address.register() {
            at if at == answered => self.repeat_bit,
            _ if full => register::MAILBOX_FULL_BIT,
            _ => 0,
        };
        Reply {
            data,
            outcome: Outcome::Processed { working_counter: 1 },
        }
    }

    fn message(&mut self, mut request: Request<MESSAGE>) -> Reply<MESSAGE> {
        assert_eq!(request.data.len(), usize::from(WINDOW));
        let mut working_counter = 1;
        match (request.command, request.address.register()) {
            (Command::Fpwr, OUT) if self.is_stuck => working_counter = 0,
            (Command::Fpwr, OUT) => {
                let sent = service_data(&request.data).unwrap();
                match (self.script.pop_front(), &mut self.anything) {
                    (Some((expected, answers)), _) => {
                        assert_eq!(sent, expected, "sent, expected");
                        self.waiting.extend(answers);
                    }
                    (None, Some(answers)) => self.waiting.extend(answers.pop()),
                    (None, None) => panic!("beyond the script: {sent:x?}"),
                }
            }
            (Command::Fprd, IN) => {
                request.data.copy_from_slice(&self.waiting.pop_front().unwrap());
            }
            other => panic!("{other:?}"),
        }
        Reply {
            data: request.data,
            outcome: Outcome::Processed { working_counter },
        }
    }
}

/// Runs `work` against a slave that follows a script to its end; returns the result and the mailbox.
fn run<T>(script: Vec<Step>, work: impl AsyncFnOnce(&mut ObjectDictionary<'_, '_, MESSAGE>) -> T) -> (T, Mailbox) {
    let slave = Slave {
        script: script.into(),
        ..Slave::default()
    };
    run_with(slave, work)
}

fn run_with<T>(slave: Slave, work: impl AsyncFnOnce(&mut ObjectDictionary<'_, '_, MESSAGE>) -> T) -> (T, Mailbox) {
    let window = |start| MailboxWindow { start, length: WINDOW };
    let mailbox = Mailbox::new::<MESSAGE>(0x1001, window(OUT), window(IN)).unwrap();
    run_on(mailbox, slave, work)
}

fn run_on<T>(
    mut mailbox: Mailbox,
    mut slave: Slave,
    work: impl AsyncFnOnce(&mut ObjectDictionary<'_, '_, MESSAGE>) -> T,
) -> (T, Mailbox) {
    let mut register_requests = Queue::<Request, { IN_FLIGHT_MAX + 1 }>::new();
    let mut register_replies = Queue::<Reply<REGISTER_BYTES_MAX>, { IN_FLIGHT_MAX + 1 }>::new();
    let mut message_requests = Queue::<Request<MESSAGE>, 2>::new();
    let mut message_replies = Queue::<Reply<MESSAGE>, 2>::new();
    let (ask, mut asked) = register_requests.split();
    let (mut give, given) = register_replies.split();
    let (ask_message, mut asked_message) = message_requests.split();
    let (mut give_message, given_message) = message_replies.split();
    let mut port = AcyclicPort::new(Lane::new(ask, given), Lane::new(ask_message, given_message));
    let result = {
        let mut dictionary = ObjectDictionary::new(&mut port, &mut mailbox);
        let mut future = pin!(work(&mut dictionary));
        let mut polls = 0;
        loop {
            if let Poll::Ready(value) = future.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
                break value;
            }
            polls += 1;
            assert!(polls < 20_000, "the transfer did not end");
            while let Some(request) = asked.dequeue() {
                assert!(give.enqueue(slave.register(&request)).is_ok());
            }
            while let Some(request) = asked_message.dequeue() {
                assert!(give_message.enqueue(slave.message(request)).is_ok());
            }
        }
    };
    assert!(slave.script.is_empty(), "not sent: {:?}", slave.script);
    (result, mailbox)
}

#[test]
fn a_slave_without_a_mailbox_is_sent_nothing() {
    let (read, _) = run_on(Mailbox::default(), Slave::default(), async |dictionary| {
        dictionary.read(OBJECT, 4).await
    });
    let missing = BusError::MailboxLength {
        expected: MESSAGE as u16,
        actual: 0,
    };
    assert_eq!(read, Err(missing));
}

const VALUE: [u8; 60] = {
    let mut value = [0; 60];
    let mut n = 0;
    while n < value.len() {
        value[n] = n as u8 + 1;
        n += 1;
    }
    value
};

fn segment(toggle: bool, last: bool, data: &[u8]) -> Step {
    (
        sdo(Sdo::UploadSegment { toggle }),
        vec![answer(Sdo::UploadSegmentData { toggle, last, data })],
    )
}

fn upload(complete: bool, response: Sdo<'_>) -> Step {
    (
        sdo(Sdo::Upload {
            object: OBJECT,
            complete,
        }),
        vec![answer(response)],
    )
}

fn abort(code: u32) -> Step {
    (sdo(Sdo::Abort { object: OBJECT, code }), vec![])
}

fn announced(size: u32, data: &[u8]) -> Sdo<'_> {
    Sdo::UploadNormal {
        object: OBJECT,
        size,
        data,
    }
}

/// Reads [`OBJECT`] into 60 bytes.
fn read(script: Vec<Step>) -> Result<Vec<u8>, BusError> {
    run(script, async |dictionary| {
        let mut buffer = [0; 60];
        let length = dictionary.upload_into(OBJECT, false, &mut buffer).await?;
        Ok(buffer[..length].to_vec())
    })
    .0
}

#[test]
fn a_value_is_read_in_one_message_or_in_segments_of_any_length() {
    for length in 1..=4 {
        let data = &VALUE[..length];
        let script = vec![upload(false, Sdo::UploadExpedited { object: OBJECT, data })];
        assert_eq!(read(script), Ok(data.to_vec()));
    }
    for length in [0, 5, 16] {
        let script = vec![upload(false, announced(length, &VALUE[..length as usize]))];
        assert_eq!(read(script), Ok(VALUE[..length as usize].to_vec()));
    }
    let script = vec![
        upload(false, announced(60, &VALUE[..10])),
        segment(false, false, &VALUE[10..33]),
        segment(true, false, &VALUE[33..34]),
        segment(false, false, &VALUE[34..57]),
        segment(true, true, &VALUE[57..]),
    ];
    assert_eq!(read(script), Ok(VALUE.to_vec()));
}

#[test]
fn a_transfer_that_the_slave_breaks_is_aborted_and_the_caller_hears_why() {
    let length = |expected, actual| {
        Err(BusError::SdoLength {
            object: OBJECT,
            expected,
            actual,
        })
    };
    let start = || upload(false, announced(20, &VALUE[..10]));
    let wrong = Sdo::UploadSegmentData {
        toggle: true,
        last: false,
        data: &VALUE[10..17],
    };
    let toggled = (sdo(Sdo::UploadSegment { toggle: false }), vec![answer(wrong)]);
    let toggle = Err(BusError::SdoToggle { object: OBJECT });
    assert_eq!(read(vec![start(), toggled, abort(0x0503_0000)]), toggle);
    let long = vec![upload(false, announced(61, &VALUE[..10])), abort(0x0504_0005)];
    assert_eq!(read(long), length(60, 61));
    let huge = vec![upload(false, announced(u32::MAX, &[])), abort(0x0504_0005)];
    assert_eq!(read(huge), length(60, u32::MAX));
    let more = vec![start(), segment(false, false, &VALUE[..11]), abort(0x0607_0012)];
    assert_eq!(read(more), length(20, 21));
    assert_eq!(read(vec![start(), segment(false, true, &VALUE[..9])]), length(20, 19));
    let nothing = vec![start(), segment(false, false, &[]), abort(0x0504_0001)];
    assert_eq!(read(nothing), Err(BusError::SdoAnswer { object: OBJECT }));
    let other = vec![upload(false, Sdo::DownloadDone { object: OBJECT }), abort(0x0504_0001)];
    assert_eq!(read(other), Err(BusError::SdoAnswer { object: OBJECT }));
}

#[test]
fn an_abort_during_segments_reaches_the_caller_whatever_object_it_names() {
    let refusal = Sdo::Abort {
        object: Object::new(0x0807, 6),
        code: 0x0800_0022,
    };
    let script = vec![
        upload(false, announced(20, &VALUE[..10])),
        (sdo(Sdo::UploadSegment { toggle: false }), vec![answer(refusal)]),
    ];
    let code = 0x0800_0022;
    assert_eq!(read(script), Err(BusError::SdoAbort { object: OBJECT, code }));
}

fn download(script: Vec<Step>, complete: bool, data: &[u8]) -> Result<(), BusError> {
    run(script, async |dictionary| {
        dictionary.download(OBJECT, complete, data).await
    })
    .0
}

fn part(toggle: bool, last: bool, data: &[u8]) -> Step {
    (
        sdo(Sdo::DownloadSegment { toggle, last, data }),
        vec![answer(Sdo::DownloadSegmentDone { toggle })],
    )
}

#[test]
fn a_value_is_written_in_one_message_or_in_segments_of_any_length() {
    let done = || vec![answer(Sdo::DownloadDone { object: OBJECT })];
    for (length, complete) in [(1, false), (4, false), (4, true), (0, false), (5, true), (16, false)] {
        let data = &VALUE[..length];
        let request = if (1..=4).contains(&length) {
            Sdo::DownloadExpedited {
                object: OBJECT,
                complete,
                data,
            }
        } else {
            Sdo::DownloadNormal {
                object: OBJECT,
                complete,
                size: length as u32,
                data,
            }
        };
        assert_eq!(
            download(vec![(sdo(request), done())], complete, data),
            Ok(()),
            "{length}"
        );
    }
    let start = Sdo::DownloadNormal {
        object: OBJECT,
        complete: false,
        size: 60,
        data: &VALUE[..16],
    };
    let script = vec![
        (sdo(start), done()),
        part(false, false, &VALUE[16..39]),
        part(true, true, &VALUE[39..]),
    ];
    assert_eq!(download(script, false, &VALUE), Ok(()));
    let script = vec![
        (sdo(start), done()),
        (
            sdo(Sdo::DownloadSegment {
                toggle: false,
                last: false,
                data: &VALUE[16..39],
            }),
            vec![answer(Sdo::DownloadSegmentDone { toggle: true })],
        ),
        abort(0x0503_0000),
    ];
    assert_eq!(
        download(script, false, &VALUE),
        Err(BusError::SdoToggle { object: OBJECT })
    );
}

#[test]
fn a_whole_object_is_read_by_complete_access() {
    let (value, _) = run(
        vec![upload(true, announced(6, &[2, 0, 1, 0x17, 2, 0x17]))],
        async |dictionary| {
            let mut buffer = [0; 8];
            let length = dictionary.upload_into(OBJECT, true, &mut buffer).await?;
            Ok::<_, BusError>(super::coe::split_complete(&buffer[..length]).map(|(count, rest)| (count, rest.to_vec())))
        },
    );
    assert_eq!(value, Ok(Some((2, vec![1, 0x17, 2, 0x17]))));
}

#[test]
fn messages_between_request_and_answer_are_dispatched_and_the_wait_continues() {
    let emergency = Emergency {
        code: 0x8130,
        register: 0x11,
        data: [1, 2, 3, 4, 5],
    };
    let mut emergency_bytes = [0; Emergency::LEN];
    emergency.emit(&mut emergency_bytes).unwrap();
    let other = Sdo::UploadExpedited {
        object: Object::new(0x2F00, 1),
        data: &[9],
    };
    let data = &[7][..];
    let script = vec![(
        sdo(Sdo::Upload {
            object: OBJECT,
            complete: false,
        }),
        vec![
            message(Protocol::Coe, &emergency_bytes),
            message(Protocol::Eoe, &[1, 2, 3]),
            answer(other),
            vec![0xFF; usize::from(WINDOW)],
            answer(Sdo::UploadExpedited { object: OBJECT, data }),
            message(Protocol::Coe, &emergency_bytes),
        ],
    )];
    let (value, mut mailbox) = run(script, async |dictionary| dictionary.read(OBJECT, 1).await);
    assert_eq!(value, Ok(7));
    assert_eq!(mailbox.unexpected(), 3);
    assert_eq!(mailbox.take_emergency(), Some(emergency));
    assert_eq!(mailbox.take_emergency(), None, "the second is still in the mailbox");
}

#[test]
fn a_repetition_of_the_message_before_is_counted_and_not_taken_for_the_answer() {
    let ask = || {
        sdo(Sdo::Upload {
            object: OBJECT,
            complete: false,
        })
    };
    let reply = |counter: u8, value: u8| {
        let data = &[value][..];
        let mut bytes = answer(Sdo::UploadExpedited { object: OBJECT, data });
        bytes[5] = bytes[5] & 0x0F | counter << 4;
        bytes
    };
    let slave = Slave {
        script: vec![(ask(), vec![reply(1, 7)]), (ask(), vec![])].into(),
        repetition: vec![reply(1, 7), reply(2, 8)],
        ..Slave::default()
    };
    let (values, mailbox) = run_with(slave, async |dictionary| {
        (dictionary.read(OBJECT, 1).await, dictionary.read(OBJECT, 1).await)
    });
    assert_eq!(values, (Ok(7), Ok(8)));
    assert_eq!(mailbox.unexpected(), 1);
}

#[test]
fn a_mailbox_error_ends_the_request() {
    let script = vec![(
        sdo(Sdo::Upload {
            object: OBJECT,
            complete: false,
        }),
        vec![message(Protocol::Error, &[1, 0, 4, 0])],
    )];
    assert_eq!(read(script), Err(BusError::Mailbox { detail: 4 }));
}

#[test]
fn a_list_of_objects_comes_in_fragments() {
    let list = |left, data: &[u8]| message(Protocol::Coe, &information(left, Information::List { data }));
    let request = || information(0, Information::GetList { list: 1 });
    let answers = vec![
        list(2, &[1, 0, 0x00, 0x10, 0x01, 0x10]),
        list(1, &[0x08, 0x10]),
        list(0, &[0x18, 0x10, 0x40, 0x60]),
    ];
    let (indices, _) = run(vec![(request(), answers)], async |dictionary| {
        let mut indices = vec![];
        let count = dictionary.list(ObjectList::All, |index| indices.push(index)).await?;
        Ok::<_, BusError>((count, indices))
    });
    assert_eq!(indices, Ok((5, vec![0x1000, 0x1001, 0x1008, 0x1018, 0x6040])));
    let (wrong, _) = run(
        vec![(request(), vec![list(0, &[2, 0, 0x00, 0x10])])],
        async |dictionary| dictionary.list(ObjectList::All, |_| ()).await,
    );
    let object = Object::new(0, 0);
    assert_eq!(wrong, Err(BusError::SdoAnswer { object }), "another list");
}

#[test]
fn objects_and_entries_are_described_or_refused() {
    let entry = EntryDescription {
        object: Object::new(0x1018, 1),
        value_info: 7,
        data_type: 7,
        bits: 32,
        access: ACCESS_READ,
        data: b"Vendor",
    };
    let object = ObjectDescription {
        index: 0x1018,
        data_type: 0x23,
        sub_max: 4,
        code: 9,
        name: b"Identity",
    };
    let coe = |bytes: Vec<u8>| message(Protocol::Coe, &bytes);
    let ask_object = information(0, Information::GetObject { index: 0x1018 });
    let ask_entry = |object| information(0, Information::GetEntry { object, value_info: 7 });
    let missing = Object::new(0x1018, 9);
    let refusal = information(0, Information::Error { code: 0x0609_0011 });
    let name_goes_on = information(
        0,
        Information::Object(ObjectDescription {
            name: b" Object",
            ..object
        }),
    );
    let script = vec![
        (
            ask_object,
            vec![coe(information(1, Information::Object(object))), coe(name_goes_on)],
        ),
        (
            ask_entry(entry.object),
            vec![coe(information(0, Information::Entry(entry)))],
        ),
        (ask_entry(missing), vec![coe(refusal)]),
    ];
    let (described, _) = run(script, async |dictionary| {
        let name = dictionary
            .describe(0x1018, |object| (object.sub_max, object.name.to_vec()))
            .await;
        let entry = dictionary
            .describe_entry(entry.object, |entry| (entry.bits, entry.access, entry.name().to_vec()))
            .await;
        (name, entry, dictionary.describe_entry(missing, |_| ()).await)
    });
    assert_eq!(described.0, Ok((4, b"Identity".to_vec())));
    assert_eq!(described.1, Ok((32, ACCESS_READ, b"Vendor".to_vec())));
    let code = 0x0609_0011;
    assert_eq!(described.2, Err(BusError::SdoAbort { object: missing, code }));
}

#[test]
fn no_answer_however_made_panics_or_runs_for_ever() {
    const SEED: u64 = 0x5EED_0C0E;
    println!("seed {SEED:#x}");
    let mut state = SEED;
    let mut random = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as u8
    };
    let services = [0x20, 0x30, 0x30, 0x30, 0x80, 0x10];
    let commands = [0x00, 0x01, 0x10, 0x11, 0x20, 0x41, 0x43, 0x4F, 0x60, 0x80, 0x02, 0x82];
    let mut successes = 0;
    for _ in 0..300 {
        let mut answers = vec![];
        for _ in 0..6 {
            let mut data = vec![0; usize::from(random() % 27)];
            data.iter_mut().for_each(|byte| *byte = random());
            let head = [
                0,
                services[usize::from(random()) % services.len()],
                commands[usize::from(random()) % commands.len()],
                0x00,
                0x2F,
                0,
            ];
            let length = data.len().min(head.len());
            data[..length].copy_from_slice(&head[..length]);
            answers.push(message(Protocol::Coe, &data));
        }
        let slave = Slave {
            anything: Some(answers),
            ..Slave::default()
        };
        let (ended, _) = run_with(slave, async |dictionary| {
            let mut buffer = [0; 60];
            let read = dictionary.upload_into(OBJECT, false, &mut buffer).await.is_ok();
            let written = dictionary.download(OBJECT, false, &VALUE).await.is_ok();
            let listed = dictionary.list(ObjectList::All, |_| ()).await.is_ok();
            u32::from(read) + u32::from(written) + u32::from(listed)
        });
        successes += ended;
    }
    println!("{successes} of 900 transfers went well");
}

#[test]
fn a_slave_that_takes_no_request_is_given_up_after_a_second() {
    let slave = Slave {
        is_stuck: true,
        ..Slave::default()
    };
    let (ended, _) = run_with(slave, async |dictionary| {
        dictionary.upload_into(OBJECT, false, &mut [0; 60]).await
    });
    let Err(BusError::MailboxTimeout { waited_ms }) = ended else {
        panic!("{ended:?}");
    };
    assert!((1_000..1_100).contains(&waited_ms), "{waited_ms} ms");
}
