use super::*;
use crate::random::Lcg;

const TOPICS: [Topic; 2] = [
    Topic {
        name: "/a",
        schema_name: "x/msg/A",
        schema: Cow::Borrowed("uint32 a\n"),
    },
    Topic {
        name: "/b",
        schema_name: "x/msg/B",
        schema: Cow::Borrowed("uint8 b\n"),
    },
];

/// A file of `chunks` chunks of ten messages; the length of the file after each.
fn file(chunks: u64) -> (Vec<u8>, Vec<usize>) {
    let mut writer = Writer::new(Vec::new(), &TOPICS, "test").unwrap();
    writer.metadata("about", &[("key", "value".to_owned())]).unwrap();
    writer.attach("note.txt", "text/plain", b"attached", 5).unwrap();
    let mut lengths = Vec::new();
    for message in 0..chunks * 10 {
        let channel = if message % 10 == 3 { 2 } else { 1 };
        writer.message(channel, message * 1_000, &(message as u32).to_le_bytes());
        if message % 10 == 9 {
            writer.flush().unwrap();
            lengths.push(usize::try_from(writer.whole_bytes()).unwrap());
        }
    }
    writer.finish().unwrap();
    (std::mem::take(writer.sink_mut()), lengths)
}

/// Numbers of all messages that can be read, and how the file ends.
fn numbers(bytes: &[u8]) -> std::io::Result<(Vec<u32>, Option<Ending>, usize)> {
    let mut reader = Reader::new(bytes)?;
    let mut found = Vec::new();
    while let Some(message) = reader.next_message()? {
        found.push(message.data.try_into().map_or(u32::MAX, u32::from_le_bytes));
    }
    Ok((found, reader.ending(), reader.notices().len()))
}

#[test]
fn what_was_written_is_read_with_its_topics_and_what_is_attached() {
    let (bytes, _) = file(3);
    let mut reader = Reader::new(bytes.as_slice()).unwrap();
    reader.begin().unwrap();
    assert_eq!(reader.attachment("note.txt"), Some(&b"attached"[..]));
    assert_eq!(reader.metadata()[0].1, [("key".to_owned(), "value".to_owned())]);
    let message = reader.next_message().unwrap().unwrap();
    assert_eq!((message.topic, message.time_ns, message.data), ("/a", 0, &[0; 4][..]));
    assert_eq!(message.schema, "uint32 a\n");
    let (found, ending, notices) = numbers(&bytes).unwrap();
    assert_eq!(found, (0..30).collect::<Vec<u32>>());
    assert_eq!((ending, notices), (Some(Ending::Complete), 0));
}

#[test]
fn a_file_cut_anywhere_gives_every_message_before_the_cut() {
    let (bytes, lengths) = file(4);
    for length in MAGIC.len()..bytes.len() {
        let (found, ending, notices) = numbers(&bytes[..length]).unwrap();
        let whole = lengths.iter().filter(|end| **end <= length).count() * 10;
        assert!(
            found.len() >= whole && found.len() <= 40,
            "{length}: {} of {whole}",
            found.len()
        );
        assert_eq!(found, (0..found.len() as u32).collect::<Vec<u32>>(), "{length}");
        assert_eq!(notices, 0);
        // Only the magic number after the footer may be missing.
        assert_eq!(ending == Some(Ending::CutOff), length < bytes.len() - 28, "{length}");
    }
}

#[test]
fn a_changed_bit_costs_its_chunk_and_never_the_program() {
    let (bytes, lengths) = file(4);
    let mut damaged = bytes.clone();
    // In the records of the third chunk.
    damaged[lengths[1] + 80] ^= 4;
    let (found, _, notices) = numbers(&damaged).unwrap();
    let expected: Vec<u32> = (0..20).chain(30..40).collect();
    assert_eq!((found, notices), (expected, 1));

    let mut random = Lcg::new(0x5eed);
    for _ in 0..2_000 {
        let mut damaged = bytes.clone();
        for _ in 0..3 {
            let place = random.below(damaged.len());
            damaged[place] = random.bits() as u8;
        }
        // An error or the rest of the messages; nothing else.
        let _ = numbers(&damaged);
    }
}

#[test]
fn chunks_outside_of_the_wanted_time_are_left_out() {
    let (bytes, _) = file(4);
    let mut reader = Reader::new(bytes.as_slice()).unwrap();
    reader.select(12_000, 22_000);
    let mut times_ns = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        times_ns.push(message.time_ns);
    }
    assert_eq!(times_ns, (12..=22).map(|k| k * 1_000).collect::<Vec<u64>>());
}

#[test]
fn something_else_is_no_mcap_file() {
    for bytes in [&b""[..], b"t_ms,mode\n1,2\n", b"\x89MCAP"] {
        assert!(Reader::new(bytes).is_err());
    }
}
