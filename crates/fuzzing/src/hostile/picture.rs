//! PNG and JPEG: announced sizes, data that unpack to a multiple, many parts.

use super::{FILE_BYTES, Hostile};

pub(super) const FILES: &[Hostile] = &[
    Hostile {
        name: "announced.png",
        make: || png(0x7FFF_FFFF, 0x7FFF_FFFF, Kind::COLOUR, &[]),
    },
    Hostile {
        name: "wide.png",
        make: || png(4_000_000, 16, Kind::CLEAR_DEEP, &[]),
    },
    Hostile {
        name: "high.png",
        make: || png(16, 4_000_000, Kind::CLEAR_DEEP, &[]),
    },
    Hostile {
        name: "deep.png",
        make: || png(8_000, 8_000, Kind::CLEAR_DEEP, &[]),
    },
    Hostile {
        name: "deep-and-turned.png",
        make: || png(8_000, 8_000, Kind::CLEAR_DEEP, &chunk(b"eXIf", &turned())),
    },
    Hostile {
        name: "interlaced.png",
        make: || {
            png(
                8_000,
                8_000,
                Kind {
                    interlaced: 1,
                    ..Kind::CLEAR_DEEP
                },
                &[],
            )
        },
    },
    Hostile {
        name: "grey.png",
        make: || {
            png(
                8_000,
                8_000,
                Kind {
                    bits: 16,
                    colour: 0,
                    interlaced: 0,
                },
                &[],
            )
        },
    },
    Hostile {
        name: "two-tones.png",
        make: || {
            png(
                8_000,
                8_000,
                Kind {
                    bits: 1,
                    colour: 0,
                    interlaced: 0,
                },
                &[],
            )
        },
    },
    Hostile {
        name: "profile.png",
        make: || png(100, 100, Kind::COLOUR, &packed_chunk(b"iCCP", b"profile\0\0")),
    },
    Hostile {
        name: "remark.png",
        make: || png(100, 100, Kind::COLOUR, &packed_chunk(b"zTXt", b"remark\0\0")),
    },
    Hostile {
        name: "chunks.png",
        make: || {
            png(
                100,
                100,
                Kind::COLOUR,
                &chunk(b"tEXt", b"a\0").repeat(FILE_BYTES / 14 - 100),
            )
        },
    },
    Hostile {
        name: "announced.jpg",
        make: || jpeg(0xC0, 65_500, 65_500, 1),
    },
    Hostile {
        name: "baseline.jpg",
        make: || jpeg(0xC0, 8_000, 8_000, 1),
    },
    Hostile {
        name: "progressive.jpg",
        make: || jpeg(0xC2, 8_000, 8_000, 1),
    },
    Hostile {
        name: "scans.jpg",
        make: || jpeg(0xC2, 8_000, 8_000, FILE_BYTES / 12 - 100),
    },
    Hostile {
        name: "scans-of-a-small-picture.jpg",
        make: || jpeg(0xC2, 64, 64, FILE_BYTES / 12 - 100),
    },
    Hostile {
        name: "tables.jpg",
        make: tables,
    },
];

/// Pixels of a PNG: bits of a channel, kind of colour, whether interlaced.
#[derive(Clone, Copy)]
struct Kind {
    bits: u8,
    colour: u8,
    interlaced: u8,
}

impl Kind {
    const COLOUR: Self = Self {
        bits: 8,
        colour: 2,
        interlaced: 0,
    };
    /// Colour with transparency, 16 bits each.
    const CLEAR_DEEP: Self = Self {
        bits: 16,
        colour: 6,
        interlaced: 0,
    };

    fn pixel_bits(self) -> u64 {
        let channels = match self.colour {
            2 => 3,
            6 => 4,
            _ => 1,
        };
        u64::from(self.bits) * channels
    }
}

fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg());
    !bytes
        .iter()
        .fold(u32::MAX, |crc, &byte| (0..8).fold(crc ^ u32::from(byte), step))
}

fn chunk(name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let content = [name, data].concat();
    [
        &(data.len() as u32).to_be_bytes(),
        content.as_slice(),
        &crc(&content).to_be_bytes(),
    ]
    .concat()
}

/// A chunk whose text unpacks to 300 times 5 MiB.
fn packed_chunk(name: &[u8; 4], head: &[u8]) -> Vec<u8> {
    chunk(name, &[head, &zeros(150 * (FILE_BYTES as u64))].concat())
}

/// Orientation 6: turned by a quarter.
fn turned() -> Vec<u8> {
    b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0".to_vec()
}

/// A PNG whose pixels are all zero, as far as 10 MiB of packed data can tell.
fn png(width: u32, height: u32, kind: Kind, chunks: &[u8]) -> Vec<u8> {
    let mut header = [width.to_be_bytes(), height.to_be_bytes()].concat();
    header.extend([kind.bits, kind.colour, 0, 0, kind.interlaced]);
    let row = |width: u64| 1 + (width * kind.pixel_bits()).div_ceil(8);
    let mut size = row(width.into()) * u64::from(height);
    if kind.interlaced == 1 {
        // Seven pictures, of which the sides are multiples of eight here.
        let [width, height] = [width, height].map(u64::from);
        size = [(8, 8), (8, 8), (4, 8), (4, 4), (2, 4), (2, 2), (1, 2)]
            .map(|(across, down)| row(width / across) * (height / down))
            .iter()
            .sum();
    }
    let room = (FILE_BYTES - chunks.len().min(FILE_BYTES - 1_000) - 200) as u64;
    let packed = zeros(size.min(150 * room));
    let signature = b"\x89PNG\r\n\x1a\n".to_vec();
    [
        signature,
        chunk(b"IHDR", &header),
        chunks.to_vec(),
        chunk(b"IDAT", &packed),
        chunk(b"IEND", &[]),
    ]
    .concat()
}

/// Packed zeros: one literal, then copies of 258 bytes at distance 1, 13 bits each, in one block with fixed codes.
fn zeros(count: u64) -> Vec<u8> {
    let mut bits = Bits::default();
    bits.put(0b011, 3);
    let mut left = count;
    while left > 0 {
        // The code of the literal 0 is 0011_0000; that of length 258 is 1100_0101, and of distance 1 five zeros.
        if left < count && left >= 258 {
            bits.put(0b1010_0011, 13);
            left -= 258;
        } else {
            bits.put(0b0000_1100, 8);
            left -= 1;
        }
    }
    bits.put(0, 7);
    let adler = ((count % 65_521) as u32) << 16 | 1;
    [&[0x78, 0x01], bits.finish().as_slice(), &adler.to_be_bytes()].concat()
}

/// Bits, the lowest first.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    open: u32,
    count: u32,
}

impl Bits {
    fn put(&mut self, bits: u32, count: u32) {
        self.open |= bits << self.count;
        self.count += count;
        while self.count >= 8 {
            self.bytes.push(self.open as u8);
            self.open >>= 8;
            self.count -= 8;
        }
    }

    fn finish(mut self) -> Vec<u8> {
        self.put(0, 7);
        self.bytes
    }
}

fn segment(marker: u8, data: &[u8]) -> Vec<u8> {
    [&[0xFF, marker], (data.len() as u16 + 2).to_be_bytes().as_slice(), data].concat()
}

/// A JPEG of three colours whose scans have one byte each.
fn jpeg(frame: u8, width: u16, height: u16, scans: usize) -> Vec<u8> {
    let mut bytes = vec![0xFF, 0xD8];
    bytes.extend(segment(0xDB, &[[0].as_slice(), &[1; 64]].concat()));
    let size = [[8].as_slice(), &height.to_be_bytes(), &width.to_be_bytes()].concat();
    bytes.extend(segment(
        frame,
        &[size.as_slice(), &[3, 1, 0x11, 0, 2, 0x11, 0, 3, 0x11, 0]].concat(),
    ));
    for table in [0x00, 0x10] {
        let mut counts = [0; 16];
        counts[0] = 1;
        bytes.extend(segment(0xC4, &[[table].as_slice(), &counts, &[0]].concat()));
    }
    let all = segment(0xDA, &[3, 1, 0, 2, 0, 3, 0, 0, if frame == 0xC2 { 0 } else { 63 }, 0]);
    let one = segment(0xDA, &[1, 1, 0, 1, 63, 0]);
    bytes.extend(all);
    bytes.push(0);
    for _ in 1..scans {
        bytes.extend(&one);
        bytes.push(0);
        bytes.push(0);
    }
    bytes.extend([0xFF, 0xD9]);
    bytes
}

/// A JPEG that defines its tables again and again.
fn tables() -> Vec<u8> {
    let picture = jpeg(0xC0, 64, 64, 1);
    let table = segment(0xDB, &[[0].as_slice(), &[1; 64]].concat());
    [
        &picture[..2],
        &table.repeat(FILE_BYTES / table.len() - 10),
        &picture[2..],
    ]
    .concat()
}
