//! Recordings and information memories.

use super::{FILE_BYTES, Hostile};

pub(super) const FILES: &[Hostile] = &[
    Hostile {
        name: "record-length.mcap",
        make: || mcap(&[], &record(5, u64::MAX, &[])),
    },
    Hostile {
        name: "attachment-length.mcap",
        make: || mcap(&[], &record(9, 64 << 20, &[0; 64])),
    },
    Hostile {
        name: "skipped-length.mcap",
        make: || mcap(&[], &record(0x80, u64::MAX, &[])),
    },
    Hostile {
        name: "chunk-length.mcap",
        make: || mcap(&[], &record(6, u64::MAX, &chunk_head(0))),
    },
    Hostile {
        name: "chunks-of-messages.mcap",
        make: || chunk(&message(1)),
    },
    Hostile {
        name: "empty-chunks.mcap",
        make: || mcap(&[], &record(6, 40, &[chunk_head(0), vec![0; 8]].concat())),
    },
    Hostile {
        name: "messages.mcap",
        make: || mcap(&sample_channel(1), &message(1)),
    },
    Hostile {
        name: "samples.mcap",
        make: || mcap(&sample_channel(1), &sample()),
    },
    Hostile {
        name: "channels.mcap",
        make: || each(|number| channel(number as u16, "/x")),
    },
    Hostile {
        name: "topics.mcap",
        make: topics,
    },
    Hostile {
        name: "malformed.mcap",
        make: || mcap(&[], &record(4, 0, &[])),
    },
    Hostile {
        name: "attachments.mcap",
        make: || mcap(&[], &attachment()),
    },
    Hostile {
        name: "metadata.mcap",
        make: || mcap(&[], &metadata()),
    },
    Hostile {
        name: "entries.mcap",
        make: entries,
    },
    Hostile {
        name: "configuration.mcap",
        make: configuration,
    },
    Hostile {
        name: "empty.sii",
        make: || vec![0xFF; FILE_BYTES],
    },
    Hostile {
        name: "categories.sii",
        make: || [vec![0; 128], [1, 0, 0, 0].repeat((1 << 20) / 4 - 32)].concat(),
    },
];

const MAGIC: &[u8] = b"\x89MCAP0\r\n";

fn record(kind: u8, length: u64, content: &[u8]) -> Vec<u8> {
    [&[kind], length.to_le_bytes().as_slice(), content].concat()
}

fn whole(kind: u8, content: &[u8]) -> Vec<u8> {
    record(kind, content.len() as u64, content)
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// A file of one record after a head.
fn mcap(head: &[u8], part: &[u8]) -> Vec<u8> {
    let count = (FILE_BYTES - MAGIC.len() - head.len()) / part.len();
    [MAGIC, head, &part.repeat(count)].concat()
}

fn each(part: impl Fn(usize) -> Vec<u8>) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    for number in 0.. {
        let part = part(number);
        if bytes.len() + part.len() > FILE_BYTES {
            break;
        }
        bytes.extend(part);
    }
    bytes
}

/// Fields of a chunk in front of its records: times, size, no checksum, no compression.
fn chunk_head(size: u64) -> Vec<u8> {
    [[0; 16].as_slice(), &size.to_le_bytes(), &[0; 8]].concat()
}

/// One chunk of small messages.
fn chunk(message: &[u8]) -> Vec<u8> {
    let messages = message.repeat((FILE_BYTES - 200) / message.len());
    let size = messages.len() as u64;
    let content = [chunk_head(size), size.to_le_bytes().to_vec(), messages].concat();
    [MAGIC, &sample_channel(1), &whole(6, &content)].concat()
}

fn channel(number: u16, topic: &str) -> Vec<u8> {
    let content = [
        &number.to_le_bytes(),
        [1, 0].as_slice(),
        &text(topic),
        &text("cdr"),
        &[0; 4],
    ]
    .concat();
    whole(4, &content)
}

fn sample_channel(number: u16) -> Vec<u8> {
    channel(number, "/sample")
}

fn message_of(channel: u16, time_ns: u64, data: &[u8]) -> Vec<u8> {
    let times = [time_ns.to_le_bytes(), [0; 8]].concat();
    whole(5, &[&channel.to_le_bytes(), [0; 4].as_slice(), &times, data].concat())
}

fn message(channel: u16) -> Vec<u8> {
    message_of(channel, u64::MAX, &[])
}

/// A sample of zeros.
fn sample() -> Vec<u8> {
    message_of(1, 1_000_000, &[[0, 1, 0, 0].as_slice(), &[0; 200]].concat())
}

/// All channels that a file can name, then messages of the last one.
fn topics() -> Vec<u8> {
    let channels: Vec<u8> = (0..=u16::MAX).flat_map(|number| channel(number, "/x")).collect();
    mcap(&channels, &message(u16::MAX))
}

fn attachment() -> Vec<u8> {
    whole(9, &[vec![0; 16], text("a"), text("b"), vec![0; 8], vec![0; 4]].concat())
}

fn metadata() -> Vec<u8> {
    whole(12, &[text("a"), vec![0; 4]].concat())
}

/// One record of metadata with as many entries as fit.
fn entries() -> Vec<u8> {
    let entries = [text(""), text("")].concat().repeat((FILE_BYTES - 100) / 8);
    let content = [text("a"), (entries.len() as u32).to_le_bytes().to_vec(), entries].concat();
    [MAGIC, &whole(12, &content)].concat()
}

/// A configuration of 10 MiB in the recording.
fn configuration() -> Vec<u8> {
    let toml = "a.".repeat(FILE_BYTES / 2 - 100) + "a = 1";
    let size = (toml.len() as u64).to_le_bytes().to_vec();
    let content = [
        vec![0; 16],
        text("etherpen.toml"),
        text("x"),
        size,
        toml.into_bytes(),
        vec![0; 4],
    ]
    .concat();
    [MAGIC, &whole(9, &content)].concat()
}
