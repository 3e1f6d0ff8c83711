//! Writes a flat table as Apache Parquet: required columns, plain encoding, no compression.
//!
//! Written after the format's specification (<https://parquet.apache.org/docs/file-format/>, metadata in Thrift's
//! compact protocol). Even without its default features, the `parquet` crate adds fifty crates for what takes two
//! hundred lines here. Invariant: memory holds one group of rows and the positions of the earlier groups.

use std::io::{self, Write};

/// Rows of a group.
const GROUP_ROWS: usize = 1 << 16;
const MAGIC: &[u8; 4] = b"PAR1";

/// Type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Unsigned integers, 32 bits.
    Int,
    /// Single precision.
    Float,
    /// Double precision.
    Double,
    /// UTF-8.
    Text,
}

/// A value of a row.
#[derive(Clone, Debug, PartialEq)]
pub enum Field {
    /// For [`Kind::Int`].
    Int(u32),
    /// For [`Kind::Float`] and [`Kind::Double`].
    Real(f64),
    /// For [`Kind::Text`].
    Text(String),
}

struct Column {
    name: String,
    kind: Kind,
    /// Values of the open group.
    values: Vec<u8>,
}

/// Position of a column in a group.
struct Chunk {
    offset: u64,
    length: u64,
}

struct Group {
    rows: u64,
    chunks: Vec<Chunk>,
}

/// Writes one table.
pub struct Writer<W> {
    out: W,
    length: u64,
    columns: Vec<Column>,
    rows: usize,
    groups: Vec<Group>,
}

impl<W: Write> Writer<W> {
    /// Starts a table.
    ///
    /// # Errors
    /// Errors of the sink.
    pub fn new(mut out: W, columns: Vec<(String, Kind)>) -> io::Result<Self> {
        out.write_all(MAGIC)?;
        let column = |(name, kind)| Column {
            name,
            kind,
            values: Vec::new(),
        };
        Ok(Self {
            out,
            length: MAGIC.len() as u64,
            columns: columns.into_iter().map(column).collect(),
            rows: 0,
            groups: Vec::new(),
        })
    }

    /// Adds a row: one value for each column.
    ///
    /// # Errors
    /// Errors of the sink; [`io::ErrorKind::InvalidInput`] for a value of the wrong kind, or for too few or too many
    /// values.
    pub fn row(&mut self, fields: impl IntoIterator<Item = Field>) -> io::Result<()> {
        let mut fields = fields.into_iter();
        for column in &mut self.columns {
            let values = &mut column.values;
            match (column.kind, fields.next()) {
                (Kind::Int, Some(Field::Int(value))) => values.extend(value.to_le_bytes()),
                (Kind::Float, Some(Field::Real(value))) => values.extend((value as f32).to_le_bytes()),
                (Kind::Double, Some(Field::Real(value))) => values.extend(value.to_le_bytes()),
                (Kind::Text, Some(Field::Text(text))) => {
                    values.extend((text.len() as u32).to_le_bytes());
                    values.extend(text.as_bytes());
                }
                _ => return Err(io::ErrorKind::InvalidInput.into()),
            }
        }
        if fields.next().is_some() {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        self.rows += 1;
        if self.rows >= GROUP_ROWS {
            self.end_group()
        } else {
            Ok(())
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.length += bytes.len() as u64;
        Ok(())
    }

    fn end_group(&mut self) -> io::Result<()> {
        let rows = std::mem::take(&mut self.rows);
        if rows == 0 {
            return Ok(());
        }
        let mut chunks = Vec::new();
        let mut columns = std::mem::take(&mut self.columns);
        for column in &mut columns {
            let offset = self.length;
            let mut head = Struct::default();
            let size = column.values.len() as i64;
            head.int(1, DATA_PAGE).int(2, size).int(3, size);
            head.structure(5, |page| {
                page.int(1, rows as i64).int(2, PLAIN).int(3, RLE).int(4, RLE);
            });
            let head = head.end();
            self.write(&head)?;
            self.write(&column.values)?;
            column.values.clear();
            chunks.push(Chunk {
                offset,
                length: self.length - offset,
            });
        }
        self.columns = columns;
        self.groups.push(Group {
            rows: rows as u64,
            chunks,
        });
        Ok(())
    }

    /// Writes the rest and the end of the file.
    ///
    /// # Errors
    /// Errors of the sink.
    pub fn finish(mut self) -> io::Result<W> {
        self.end_group()?;
        let metadata = self.metadata();
        self.write(&metadata)?;
        self.write(&(metadata.len() as u32).to_le_bytes())?;
        self.write(MAGIC)?;
        self.out.flush()?;
        Ok(self.out)
    }

    fn metadata(&self) -> Vec<u8> {
        let rows: u64 = self.groups.iter().map(|group| group.rows).sum();
        let mut file = Struct::default();
        file.int(1, 2);
        file.list(2, self.columns.len() + 1, |element| {
            element.text(4, "etherpen").int(5, self.columns.len() as i64);
            for column in &self.columns {
                element.next();
                element
                    .int(1, column.kind.physical())
                    .int(3, REQUIRED)
                    .text(4, &column.name);
                if let Some(converted) = column.kind.converted() {
                    element.int(6, converted);
                }
            }
        });
        file.long(3, rows);
        file.list(4, self.groups.len(), |group| {
            for (k, of) in self.groups.iter().enumerate() {
                if k > 0 {
                    group.next();
                }
                group.list(1, of.chunks.len(), |chunk| self.chunks(chunk, of));
                group.long(2, of.chunks.iter().map(|chunk| chunk.length).sum());
                group.long(3, of.rows);
            }
        });
        file.text(6, concat!("etherpen ", env!("CARGO_PKG_VERSION")));
        file.end()
    }

    fn chunks(&self, out: &mut Struct, group: &Group) {
        for (k, (chunk, column)) in group.chunks.iter().zip(&self.columns).enumerate() {
            if k > 0 {
                out.next();
            }
            out.long(2, chunk.offset);
            out.structure(3, |of| {
                of.int(1, column.kind.physical());
                of.ints(2, &[PLAIN, RLE]).texts(3, &[&column.name]).int(4, UNCOMPRESSED);
                of.long(5, group.rows)
                    .long(6, chunk.length)
                    .long(7, chunk.length)
                    .long(9, chunk.offset);
            });
        }
    }
}

const DATA_PAGE: i64 = 0;
const PLAIN: i64 = 0;
const RLE: i64 = 3;
const REQUIRED: i64 = 0;
const UNCOMPRESSED: i64 = 0;

impl Kind {
    /// Number of the physical type.
    fn physical(self) -> i64 {
        match self {
            Self::Int => 1,
            Self::Float => 4,
            Self::Double => 5,
            Self::Text => 6,
        }
    }

    /// Number of the logical type, if there is one in addition to the physical type.
    fn converted(self) -> Option<i64> {
        match self {
            Self::Text => Some(0),
            Self::Int => Some(13),
            Self::Float | Self::Double => None,
        }
    }
}

/// Types of Thrift's compact protocol.
mod thrift {
    pub(super) const I32: u8 = 5;
    pub(super) const I64: u8 = 6;
    pub(super) const BINARY: u8 = 8;
    pub(super) const LIST: u8 = 9;
    pub(super) const STRUCT: u8 = 12;
}

/// Appends the fields of a struct in Thrift's compact protocol; field numbers have to ascend.
#[derive(Default)]
struct Struct {
    bytes: Vec<u8>,
    /// Number of the last field.
    last: u8,
}

impl Struct {
    fn field(&mut self, number: u8, kind: u8) {
        self.bytes.push(number.saturating_sub(self.last) << 4 | kind);
        self.last = number;
    }

    fn int(&mut self, number: u8, value: i64) -> &mut Self {
        self.field(number, thrift::I32);
        self.zigzag(value);
        self
    }

    fn long(&mut self, number: u8, value: u64) -> &mut Self {
        self.field(number, thrift::I64);
        self.zigzag(value as i64);
        self
    }

    fn text(&mut self, number: u8, text: &str) -> &mut Self {
        self.field(number, thrift::BINARY);
        self.put_text(text);
        self
    }

    fn ints(&mut self, number: u8, values: &[i64]) -> &mut Self {
        self.field(number, thrift::LIST);
        self.list_head(values.len(), thrift::I32);
        values.iter().for_each(|value| self.zigzag(*value));
        self
    }

    fn texts(&mut self, number: u8, texts: &[&str]) -> &mut Self {
        self.field(number, thrift::LIST);
        self.list_head(texts.len(), thrift::BINARY);
        texts.iter().for_each(|text| self.put_text(text));
        self
    }

    fn structure(&mut self, number: u8, fill: impl FnOnce(&mut Self)) -> &mut Self {
        self.field(number, thrift::STRUCT);
        self.nested(fill);
        self
    }

    /// A list of structs: `fill` writes the fields of the first and calls [`next`](Self::next) before those of each
    /// further one.
    fn list(&mut self, number: u8, count: usize, fill: impl FnOnce(&mut Self)) -> &mut Self {
        self.field(number, thrift::LIST);
        self.list_head(count, thrift::STRUCT);
        if count > 0 {
            self.nested(fill);
        }
        self
    }

    fn nested(&mut self, fill: impl FnOnce(&mut Self)) {
        let last = std::mem::take(&mut self.last);
        fill(self);
        self.bytes.push(0);
        self.last = last;
    }

    /// Ends a struct of a list and starts the next one.
    fn next(&mut self) {
        self.bytes.push(0);
        self.last = 0;
    }

    fn list_head(&mut self, count: usize, kind: u8) {
        if count < 15 {
            self.bytes.push((count as u8) << 4 | kind);
        } else {
            self.bytes.push(0xf0 | kind);
            self.varint(count as u64);
        }
    }

    fn put_text(&mut self, text: &str) {
        self.varint(text.len() as u64);
        self.bytes.extend(text.as_bytes());
    }

    fn zigzag(&mut self, value: i64) {
        self.varint((value << 1 ^ value >> 63) as u64);
    }

    /// Encodes seven bits in each byte, the lowest first.
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    fn end(mut self) -> Vec<u8> {
        self.bytes.push(0);
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thrift_fields_are_put_as_its_compact_protocol_has_them() {
        let mut fields = Struct::default();
        fields.int(1, 150).text(4, "ab").long(5, 300);
        fields.ints(6, &[0, -1]);
        fields.structure(8, |inner| {
            inner.int(3, 1);
        });
        let expected = [
            0x15, 0xac, 0x02, 0x38, 2, b'a', b'b', 0x16, 0xd8, 0x04, 0x19, 0x25, 0, 1, 0x2c, 0x35, 2, 0, 0,
        ];
        assert_eq!(fields.end(), expected);
    }

    #[test]
    fn a_row_of_other_kinds_is_refused() {
        let mut table = Writer::new(Vec::new(), vec![("a".into(), Kind::Int)]).unwrap();
        assert!(table.row([Field::Real(1.0)]).is_err());
        assert!(table.row([]).is_err());
        assert!(table.row([Field::Int(1), Field::Int(2)]).is_err());
    }
}
