//! Access of a master to the objects of one slave, through the mailbox.

use crate::application::AlState;
use crate::mailbox::abort::Abort;
use crate::mailbox::dictionary::{Content, Dictionary, Object, ObjectCode, ObjectEntry, access};
use crate::mailbox::live_objects::LiveObjects;
use crate::mailbox::process_data::ProcessData;

/// Access to the objects of one slave in its present state.
pub(crate) struct Objects<'a> {
    /// The object table.
    pub(crate) dictionary: &'a mut Dictionary,
    /// Assignment and mapping.
    pub(crate) process_data: &'a mut ProcessData,
    /// The device that provides the live values.
    pub(crate) device: &'a mut dyn LiveObjects,
    /// State of the application layer.
    pub(crate) state: AlState,
}

impl Objects<'_> {
    /// The value of an entry, little-endian.
    pub(crate) fn upload(&self, index: u16, sub: u8) -> Result<Vec<u8>, Abort> {
        let entry = self.dictionary.entry(index, sub)?;
        if entry.access & access::READ == 0 {
            return Err(Abort::WRITE_ONLY);
        }
        Ok(match &entry.content {
            Content::Fixed(value) | Content::Bytes { value, .. } => value.clone(),
            Content::Number { value, .. } => entry.kind.encode(*value),
            Content::Live if entry.kind.bytes().is_none() => {
                self.device.bytes(index, sub).ok_or(Abort::NO_SUB_INDEX)?
            }
            Content::Live => entry
                .kind
                .encode(self.device.get(index, sub).ok_or(Abort::NO_SUB_INDEX)?),
            Content::ProcessData => entry
                .kind
                .encode(self.process_data.get(index, sub).ok_or(Abort::NO_SUB_INDEX)?),
        })
    }

    /// Writes an entry.
    pub(crate) fn download(&mut self, index: u16, sub: u8, value: &[u8]) -> Result<(), Abort> {
        let entry = self.dictionary.entry(index, sub)?;
        self.check_write(entry)?;
        let kind = entry.kind;
        match &entry.content {
            Content::Fixed(_) => Err(Abort::READ_ONLY),
            Content::Live => self.device.set(index, sub, kind.decode(value)?),
            Content::ProcessData => {
                let number = kind.decode(value)?;
                self.process_data.set(index, sub, number, self.dictionary)
            }
            Content::Number { .. } | Content::Bytes { .. } => self.dictionary.store(index, sub, value),
        }
    }

    /// All entries of an object as one value: from sub-index 0 (as 16 bits) or from sub-index 1.
    pub(crate) fn upload_complete(&self, index: u16, first: u8) -> Result<Vec<u8>, Abort> {
        let object = self.complete(index, first)?;
        let mut value = Vec::new();
        let count = self.upload(index, 0)?.first().copied().unwrap_or(0);
        if first == 0 {
            value.extend_from_slice(&[count, 0]);
        }
        for entry in object.entries.iter().filter(|entry| (1..=count).contains(&entry.sub)) {
            value.extend(self.upload(index, entry.sub)?);
        }
        Ok(value)
    }

    /// Writes all entries of an object; a list is emptied first and gets its count last.
    pub(crate) fn download_complete(&mut self, index: u16, first: u8, value: &[u8]) -> Result<(), Abort> {
        let object = self.complete(index, first)?;
        let is_list = object
            .entry(0)
            .is_some_and(|entry| matches!(entry.content, Content::ProcessData));
        let parts: Vec<(u8, usize)> = object
            .entries
            .iter()
            .filter(|entry| entry.sub > 0)
            .map(|entry| (entry.sub, entry.kind.bytes().unwrap_or(0)))
            .collect();
        let (count, mut rest) = match value.split_first_chunk::<2>() {
            Some(([count, _], rest)) if first == 0 => (Some(*count), rest),
            None if first == 0 => return Err(Abort::TOO_SHORT),
            _ => (None, value),
        };
        let kept = self.process_data.clone();
        if is_list {
            self.download(index, 0, &[0])?;
        }
        let mut written = 0;
        let result = (|| {
            for (sub, bytes) in parts {
                let Some((part, behind)) = rest.split_at_checked(bytes).filter(|_| bytes > 0) else {
                    break;
                };
                if count.is_some_and(|count| sub > count) || part.is_empty() {
                    break;
                }
                self.download(index, sub, part)?;
                (rest, written) = (behind, sub);
            }
            match count {
                Some(count) if count != written => Err(Abort::TOO_SHORT),
                _ if !rest.is_empty() => Err(Abort::TOO_LONG),
                _ if is_list => self.download(index, 0, &[written]),
                _ => Ok(()),
            }
        })();
        if result.is_err() {
            *self.process_data = kept;
        }
        result
    }

    fn complete(&self, index: u16, first: u8) -> Result<&Object, Abort> {
        let object = self.dictionary.object(index)?;
        let varies = object.entries.iter().any(|entry| entry.kind.bytes().is_none());
        match (object.code, first) {
            (ObjectCode::Variable, _) => Err(Abort::UNSUPPORTED_ACCESS),
            _ if varies => Err(Abort::VARIABLE_LENGTH),
            (_, 0 | 1) => Ok(object),
            _ => Err(Abort::UNSUPPORTED_ACCESS),
        }
    }

    fn check_write(&self, entry: &ObjectEntry) -> Result<(), Abort> {
        let bit = match self.state {
            AlState::Init | AlState::PreOperational | AlState::Bootstrap => 0x08,
            AlState::SafeOperational => 0x10,
            AlState::Operational => 0x20,
        };
        match entry.access & access::WRITE {
            0 => Err(Abort::READ_ONLY),
            rights if rights & bit == 0 => Err(Abort::STATE),
            _ => Ok(()),
        }
    }
}
