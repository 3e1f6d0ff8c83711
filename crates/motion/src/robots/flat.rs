//! A table of dimensions in a configuration file, read before its kind is known.
//!
//! The kind may stand anywhere among the keys, so the values are kept until all have been read. Then the kind's own type
//! reads them: it fills what is missing and refuses a key that it does not have, by its name.

use super::kind::Kind;
use core::fmt;
use core::marker::PhantomData;
use heapless::{String, Vec};
use serde::de::value::{MapDeserializer, SeqDeserializer};
use serde::de::{Error, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, forward_to_deserialize_any};

/// Longest key, bytes.
const KEY_BYTES_MAX: usize = 40;
/// Most keys beside the kind.
const KEYS_MAX: usize = 16;
/// Most numbers of one key.
const NUMBERS_MAX: usize = 4;

/// The kind and all other keys.
pub(super) struct Table {
    /// The kind; the default one if the table does not name it.
    pub(super) kind: Kind,
    /// All other keys with their values.
    pub(super) rest: Entries,
}

/// Keys with their values.
pub(super) struct Entries(Vec<Entry, KEYS_MAX>);

/// A key with its value.
struct Entry(String<KEY_BYTES_MAX>, Value);

/// A value of a dimension.
enum Value {
    One(Number),
    List(Vec<Number, NUMBERS_MAX>),
}

/// A number, whole or not, as the file writes it.
#[derive(Clone, Copy)]
enum Number {
    Whole(i64),
    Fraction(f64),
}

impl Table {
    /// Reads a table.
    ///
    /// # Errors
    /// The kind is unknown, or a value is neither a number nor a short list of numbers.
    pub(super) fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(TableVisitor)
    }
}

impl Entries {
    /// The dimensions of a kind.
    ///
    /// # Errors
    /// A key that the kind does not have, or a value of another form.
    pub(super) fn into_dimensions<'de, T: Deserialize<'de>, E: Error>(self) -> Result<T, E> {
        let entries = self.0.iter().map(|entry| (entry.0.as_str(), entry));
        T::deserialize(MapDeserializer::new(entries))
    }
}

struct TableVisitor;

impl<'de> Visitor<'de> for TableVisitor {
    type Value = Table;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a table of dimensions")
    }

    fn visit_map<M: MapAccess<'de>>(self, mut map: M) -> Result<Table, M::Error> {
        let (mut kind, mut rest) = (None, Vec::new());
        while let Some(Key(key)) = map.next_key()? {
            if key == "kind" {
                kind = Some(map.next_value()?);
                continue;
            }
            let value = map.next_value()?;
            if rest.push(Entry(key, value)).is_err() {
                return Err(M::Error::invalid_length(KEYS_MAX + 1, &"at most 16 dimensions"));
            }
        }
        Ok(Table {
            kind: kind.unwrap_or_default(),
            rest: Entries(rest),
        })
    }
}

/// A key of the table.
struct Key(String<KEY_BYTES_MAX>);

impl<'de> Deserialize<'de> for Key {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct KeyVisitor;
        impl Visitor<'_> for KeyVisitor {
            type Value = Key;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the name of a dimension")
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<Key, E> {
                String::try_from(name).map(Key).map_err(|_| E::unknown_field(name, &[]))
            }
        }
        deserializer.deserialize_str(KeyVisitor)
    }
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ValueVisitor;
        impl<'de> Visitor<'de> for ValueVisitor {
            type Value = Value;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or a list of numbers")
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Value, E> {
                Ok(Value::One(Number::Whole(value)))
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Value, E> {
                Ok(Value::One(match i64::try_from(value) {
                    Ok(whole) => Number::Whole(whole),
                    Err(_) => Number::Fraction(value as f64),
                }))
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Value, E> {
                Ok(Value::One(Number::Fraction(value)))
            }

            fn visit_seq<S: SeqAccess<'de>>(self, mut items: S) -> Result<Value, S::Error> {
                let mut list = Vec::new();
                while let Some(value) = items.next_element()? {
                    let number = match value {
                        Value::One(number) => number,
                        Value::List(_) => return Err(S::Error::custom("a list of lists is no dimension")),
                    };
                    if list.push(number).is_err() {
                        return Err(S::Error::invalid_length(NUMBERS_MAX + 1, &"at most 4 numbers"));
                    }
                }
                Ok(Value::List(list))
            }
        }
        deserializer.deserialize_any(ValueVisitor)
    }
}

/// Gives a value to the type of its key, and names the key in an error.
struct EntryDeserializer<'a, E>(&'a Entry, PhantomData<E>);

/// Gives a number to its type.
struct NumberDeserializer<E>(Number, PhantomData<E>);

impl<'a, E: Error> IntoDeserializer<'_, E> for &'a Entry {
    type Deserializer = EntryDeserializer<'a, E>;

    fn into_deserializer(self) -> Self::Deserializer {
        EntryDeserializer(self, PhantomData)
    }
}

impl<E: Error> IntoDeserializer<'_, E> for Number {
    type Deserializer = NumberDeserializer<E>;

    fn into_deserializer(self) -> Self::Deserializer {
        NumberDeserializer(self, PhantomData)
    }
}

impl<'de, E: Error> Deserializer<'de> for EntryDeserializer<'_, E> {
    type Error = E;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, E> {
        let Entry(key, value) = self.0;
        let result = match value {
            Value::One(number) => NumberDeserializer(*number, PhantomData).deserialize_any(visitor),
            Value::List(list) => {
                let mut items = SeqDeserializer::new(list.iter().copied());
                visitor
                    .visit_seq(&mut items)
                    .and_then(|value| items.end().map(|()| value))
            }
        };
        result.map_err(|cause: E| E::custom(format_args!("{key}: {cause}")))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

impl<'de, E: Error> Deserializer<'de> for NumberDeserializer<E> {
    type Error = E;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, E> {
        match self.0 {
            Number::Whole(value) => visitor.visit_i64(value),
            Number::Fraction(value) => visitor.visit_f64(value),
        }
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map struct enum identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use crate::robots::{Geometry, Kind, ScaraGeometry};
    use std::string::{String, ToString};

    fn read(text: &str) -> Result<Geometry, String> {
        toml::from_str(text).map_err(|cause: toml::de::Error| cause.to_string())
    }

    #[test]
    fn a_table_without_a_kind_is_a_delta_robot_and_what_is_missing_is_the_kinds_own() {
        assert_eq!(read(""), Ok(Geometry::default()));
        assert_eq!(read("forearm_mm = 800"), Ok(Kind::Delta.geometry()));
        for kind in Kind::ALL {
            assert_eq!(read(&std::format!("kind = \"{}\"", kind.name())), Ok(kind.geometry()));
        }
        let scara = ScaraGeometry {
            elbow: -1,
            inner_link_mm: 325.0,
            shoulder_range_rad: [-1.0, 2.0],
            ..ScaraGeometry::default()
        };
        // The kind may stand last, and a length be a whole number.
        let text = "shoulder_range_rad = [-1, 2.0]\nelbow = -1\ninner_link_mm = 325\nkind = \"scara\"\n";
        assert_eq!(read(text), Ok(Geometry::Scara(scara)));
    }

    #[test]
    fn a_written_table_is_read_again() {
        for kind in Kind::ALL {
            let text = toml::to_string(&kind.geometry()).unwrap();
            assert!(
                text.starts_with(&std::format!("kind = \"{}\"\n", kind.name())),
                "{text}"
            );
            assert_eq!(read(&text), Ok(kind.geometry()), "{text}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, named) in [
            ("kind = \"hexapod\"", "unknown variant `hexapod`"),
            ("kind = \"gantry\"\nforearm_mm = 800.0", "unknown field `forearm_mm`"),
            ("rod_mm = 265.0", "unknown field `rod_mm`"),
            (
                "kind = \"scara\"\nelbow = 0.5",
                "invalid type: floating point `0.5`, expected i8",
            ),
            ("kind = \"scara\"\nelbow = 1000", "1000"),
            ("x_range_mm = [0.0, [1.0]]", "a list of lists"),
            ("kind = \"gantry\"\nx_range_mm = [0.0]", "invalid length 1"),
            ("kind = \"gantry\"\nx_range_mm = [0.0, 1.0, 2.0]", "invalid length 3"),
            ("kind = \"gantry\"\nx_range_mm = 5.0", "x_range_mm"),
            ("forearm_mm = \"long\"", "a number or a list of numbers"),
            ("forearm_mm = [1, 2, 3, 4, 5]", "at most 4 numbers"),
            (&std::format!("{} = 1.0", "long".repeat(20)), "unknown field `longlong"),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(named), "{text}:\n{error}");
        }
        let many: String = (0..17).map(|key| std::format!("key_{key} = 1.0\n")).collect();
        assert!(read(&many).unwrap_err().contains("at most 16 dimensions"));
    }
}
