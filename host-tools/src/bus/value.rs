//! Conversion between values of objects as text and bytes on the bus (CiA 301: little-endian).

use serde_json::Value;

/// How bytes are interpreted.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
#[value(rename_all = "lower")]
pub(crate) enum Type {
    /// Unsigned, 8 bits.
    U8,
    /// Signed, 8 bits.
    I8,
    /// Unsigned, 16 bits.
    U16,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 32 bits.
    U32,
    /// Signed, 32 bits.
    I32,
    /// Unsigned, 64 bits.
    U64,
    /// Signed, 64 bits.
    I64,
    /// Floating point, 32 bits.
    F32,
    /// Floating point, 64 bits.
    F64,
    /// Text.
    String,
    /// Bytes, two hexadecimal digits each.
    Bytes,
}

impl Type {
    /// The type for a data type's number (CiA 301, object dictionary data types).
    pub(crate) fn from_number(number: u16) -> Option<Self> {
        Some(match number {
            0x0001 | 0x0005 => Self::U8,
            0x0002 => Self::I8,
            0x0003 => Self::I16,
            0x0004 => Self::I32,
            0x0006 => Self::U16,
            0x0007 => Self::U32,
            0x0008 => Self::F32,
            0x0009 => Self::String,
            0x0011 => Self::F64,
            0x0015 => Self::I64,
            0x001B => Self::U64,
            _ => return None,
        })
    }

    /// Its name, as in the command's option.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::I8 => "i8",
            Self::U16 => "u16",
            Self::I16 => "i16",
            Self::U32 => "u32",
            Self::I32 => "i32",
            Self::U64 => "u64",
            Self::I64 => "i64",
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::String => "string",
            Self::Bytes => "bytes",
        }
    }

    /// Length of a value, bytes; `None` if any length is valid.
    fn length(self) -> Option<usize> {
        match self {
            Self::U8 | Self::I8 => Some(1),
            Self::U16 | Self::I16 => Some(2),
            Self::U32 | Self::I32 | Self::F32 => Some(4),
            Self::U64 | Self::I64 | Self::F64 => Some(8),
            Self::String | Self::Bytes => None,
        }
    }

    /// Smallest and largest whole number; `None` for a type that is not an integer.
    fn range(self) -> Option<(i128, i128)> {
        let bits = 8 * u32::try_from(self.length()?).ok()?;
        match self {
            Self::U8 | Self::U16 | Self::U32 | Self::U64 => Some((0, (1 << bits) - 1)),
            Self::I8 | Self::I16 | Self::I32 | Self::I64 => Some((-(1 << (bits - 1)), (1 << (bits - 1)) - 1)),
            _ => None,
        }
    }

    /// The bytes of a value in text form: decimal, `0x` hexadecimal, text or pairs of hexadecimal digits.
    ///
    /// # Errors
    /// What is wrong with the text, and what the type accepts.
    pub(crate) fn encode(self, text: &str) -> Result<Vec<u8>, String> {
        let name = self.name();
        match (self, self.range()) {
            (_, Some((low, high))) => {
                let number =
                    integer(text).ok_or(format!("'{text}' is no whole number; {name} takes {low} to {high}"))?;
                if !(low..=high).contains(&number) {
                    return Err(format!("{text} is out of range; {name} takes {low} to {high}"));
                }
                let length = self.length().unwrap_or(0);
                Ok(number.to_le_bytes().into_iter().take(length).collect())
            }
            (Self::F32, _) => {
                let number: f32 = text.parse().map_err(|_| format!("'{text}' is no number"))?;
                if number.is_infinite() && !text.to_ascii_lowercase().contains("inf") {
                    return Err(format!(
                        "{text} is out of range; f32 takes {:e} to {:e}",
                        f32::MIN,
                        f32::MAX
                    ));
                }
                Ok(number.to_le_bytes().to_vec())
            }
            (Self::F64, _) => {
                let number: f64 = text.parse().map_err(|_| format!("'{text}' is no number"))?;
                if number.is_infinite() && !text.to_ascii_lowercase().contains("inf") {
                    return Err(format!(
                        "{text} is out of range; f64 takes {:e} to {:e}",
                        f64::MIN,
                        f64::MAX
                    ));
                }
                Ok(number.to_le_bytes().to_vec())
            }
            (Self::String, _) => Ok(text.as_bytes().to_vec()),
            _ => bytes(text).ok_or(format!(
                "'{text}' is not made of bytes; write two hexadecimal digits for each: 0fa0"
            )),
        }
    }

    /// The value of bytes as JSON; `None` if they do not fit the type.
    pub(crate) fn decode(self, bytes: &[u8]) -> Option<Value> {
        if self.length().is_some_and(|length| length != bytes.len()) {
            return None;
        }
        Some(match self {
            Self::U8 | Self::U16 | Self::U32 | Self::U64 => unsigned(bytes).into(),
            Self::I8 | Self::I16 | Self::I32 | Self::I64 => signed(bytes).into(),
            Self::F32 => number(f64::from(f32::from_le_bytes(bytes.try_into().ok()?))),
            Self::F64 => number(f64::from_le_bytes(bytes.try_into().ok()?)),
            Self::String => {
                let text = String::from_utf8_lossy(bytes);
                text.trim_end_matches('\0').into()
            }
            Self::Bytes => hex(bytes).into(),
        })
    }
}

/// Bytes as hexadecimal digits.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// JSON has no infinite numbers: these become text.
fn number(number: f64) -> Value {
    serde_json::Number::from_f64(number).map_or_else(|| number.to_string().into(), Value::Number)
}

fn unsigned(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte))
}

fn signed(bytes: &[u8]) -> i64 {
    let unused = 64_u32.saturating_sub(8 * u32::try_from(bytes.len()).unwrap_or(8));
    (unsigned(bytes) << unused.min(63)).cast_signed() >> unused.min(63)
}

/// A whole number, decimal or `0x` hexadecimal, with or without a sign.
fn integer(text: &str) -> Option<i128> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text),
    };
    let number = match digits.strip_prefix("0x").or(digits.strip_prefix("0X")) {
        Some(digits) => i128::from(u64::from_str_radix(digits, 16).ok()?),
        None if digits.starts_with('+') => return None,
        None => digits.parse().ok()?,
    };
    Some(if negative { -number } else { number })
}

fn bytes(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<char> = text
        .chars()
        .filter(|sign| !sign.is_whitespace() && *sign != ':')
        .collect();
    if !digits.len().is_multiple_of(2) {
        return None;
    }
    let byte = |pair: &[char]| match *pair {
        [high, low] => u8::try_from(high.to_digit(16)? << 4 | low.to_digit(16)?).ok(),
        _ => None,
    };
    digits.chunks(2).map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_and_read_in_every_type() {
        let cases: [(Type, &str, &[u8]); 10] = [
            (Type::U8, "255", &[255]),
            (Type::I8, "-2", &[0xFE]),
            (Type::U16, "0x0A0b", &[0x0B, 0x0A]),
            (Type::I16, "-32768", &[0, 0x80]),
            (Type::U32, "4294967295", &[255; 4]),
            (Type::I32, "-1", &[255; 4]),
            (Type::U64, "0xffffffffffffffff", &[255; 8]),
            (Type::I64, "-9223372036854775808", &[0, 0, 0, 0, 0, 0, 0, 0x80]),
            (Type::F32, "1.5", &[0, 0, 0xC0, 0x3F]),
            (Type::F64, "-2", &[0, 0, 0, 0, 0, 0, 0, 0xC0]),
        ];
        for (kind, text, bytes) in cases {
            assert_eq!(kind.encode(text).as_deref(), Ok(bytes), "{text}");
            let shown = kind.decode(bytes).expect("it fits").to_string();
            assert!(kind.encode(&shown).as_deref() == Ok(bytes), "{kind:?} {text} {shown}");
        }
        assert_eq!(Type::String.decode(b"AX2000\0\0"), Some("AX2000".into()));
        assert_eq!(Type::Bytes.encode("0f A0"), Ok(vec![0x0F, 0xA0]));
        assert_eq!(Type::U16.decode(&[1]), None);
    }

    #[test]
    fn a_number_out_of_range_is_refused_with_the_range() {
        let cases = [
            (Type::U8, "256", "0 to 255"),
            (Type::U8, "-1", "0 to 255"),
            (Type::I8, "128", "-128 to 127"),
            (Type::I16, "0x8000", "-32768 to 32767"),
            (Type::U32, "4294967296", "0 to 4294967295"),
            (Type::I64, "9223372036854775808", "9223372036854775807"),
            (Type::F32, "1e39", "3.4028235e38"),
            (Type::F64, "1e400", "e308"),
            (Type::U16, "1.5", "whole number"),
            (Type::Bytes, "abc", "two hexadecimal digits"),
        ];
        for (kind, text, hint) in cases {
            let refused = kind.encode(text).expect_err(text);
            assert!(refused.contains(hint) && refused.contains(text), "{refused}");
        }
    }
}
