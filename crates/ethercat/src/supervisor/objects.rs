//! Requests for a slave's object dictionary.
//!
//! Invariant: the supervisor's buffer holds a completely read value, or is empty.

use super::super::coe::ObjectDictionary;
use super::super::diagnostics::{
    EntryInfo, INDICES_MAX, NAME_BYTES_MAX, Name, ObjectInfo, ServiceError, ServiceReply, ServiceResult,
};
use super::super::driver::SlaveFactory;
use super::super::wire::coe::{Object, ObjectList};
use super::bus::Bus;
use heapless::Vec;

impl<F: SlaveFactory, const SLAVES: usize, const MESSAGE: usize> Bus<'_, F, SLAVES, MESSAGE> {
    /// Reads an object into the buffer.
    pub(super) async fn upload(&mut self, number: usize, object: Object, complete: bool) -> Result<(), ServiceError> {
        let Self {
            port, slaves, value, ..
        } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        // The buffer has its greatest length.
        let _ = value.resize(MESSAGE, 0);
        let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
        let result = dictionary.upload_into(object, complete, value).await;
        value.truncate(*result.as_ref().unwrap_or(&0));
        result?;
        Ok(())
    }

    /// Writes the value in the buffer to an object.
    pub(super) async fn write_value(
        &mut self,
        number: usize,
        object: Object,
        complete: bool,
    ) -> Result<(), ServiceError> {
        let Self {
            port, slaves, value, ..
        } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
        dictionary.download(object, complete, value).await?;
        Ok(())
    }

    /// The indices of a slave's dictionary, from the one with number `first` on.
    pub(super) async fn object_list(&mut self, number: usize, first: u16) -> ServiceResult {
        let Self { port, slaves, .. } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
        let mut indices: Vec<u16, INDICES_MAX> = Vec::new();
        let mut total = 0_u16;
        let take = |index| {
            if total >= first {
                // Indices that find no room are requested next.
                let _ = indices.push(index);
            }
            total = total.saturating_add(1);
        };
        dictionary.list(ObjectList::All, take).await?;
        Ok(ServiceReply::Objects { total, indices })
    }

    /// The description of an object.
    pub(super) async fn object_description(&mut self, number: usize, index: u16) -> ServiceResult {
        let Self { port, slaves, .. } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
        let described = dictionary.describe(index, |object| ObjectInfo {
            index: object.index,
            data_type: object.data_type,
            sub_max: object.sub_max,
            code: object.code,
            name: text(object.name),
        });
        Ok(ServiceReply::Object(described.await?))
    }

    /// The description of an entry.
    pub(super) async fn entry_description(&mut self, number: usize, object: Object) -> ServiceResult {
        let Self { port, slaves, .. } = self;
        let slave = slaves.get_mut(number).ok_or(ServiceError::Interrupted)?;
        let mut dictionary = ObjectDictionary::new(port, &mut slave.mailbox);
        let described = dictionary.describe_entry(object, |entry| EntryInfo {
            object: entry.object,
            data_type: entry.data_type,
            bits: entry.bits,
            access: entry.access,
            name: text(entry.name()),
        });
        Ok(ServiceReply::Entry(described.await?))
    }
}

/// A name up to its first byte that is not UTF-8 or NUL; cut off if it is too long.
fn text(bytes: &[u8]) -> Name {
    let mut name = Name::new();
    for chunk in bytes.utf8_chunks().take(1) {
        for character in chunk.valid().chars().take_while(|character| *character != '\0') {
            if name.len() + character.len_utf8() > NAME_BYTES_MAX || name.push(character).is_err() {
                break;
            }
        }
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_ends_at_its_first_nul_or_at_what_is_no_text() {
        for (bytes, name) in [
            (&b"AX2006"[..], "AX2006"),
            (b"AX2006\0\0", "AX2006"),
            (b"AX\x002006", "AX"),
            (b"\0AX", ""),
            (b"AX\xFF2006", "AX"),
            ("Ger\u{E4}t".as_bytes(), "Ger\u{E4}t"),
            (b"", ""),
        ] {
            assert_eq!(text(bytes).as_str(), name, "{bytes:?}");
        }
        // No character is cut in two.
        let long = "\u{E4}".repeat(NAME_BYTES_MAX);
        assert!((NAME_BYTES_MAX - 1..=NAME_BYTES_MAX).contains(&text(long.as_bytes()).len()));
    }
}
