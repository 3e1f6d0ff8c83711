//! Files of a slave: read and written as a whole (FoE).

use super::access::{AccessError, BusAccess};
use etherpen::ethercat::diagnostics::{FileRequest, Name, PIECE_BYTES_MAX, Piece, ServiceReply, ServiceRequest};
use serde::Serialize;

/// Longest file that is read, bytes: a slave that never ends is not followed further.
pub(crate) const FILE_BYTES_MAX: usize = 256 << 20;

/// A file of a slave, and how it is opened.
#[derive(Clone, Debug)]
pub(crate) struct RemoteFile {
    /// The slave, from 1.
    pub(crate) slave: u8,
    /// Name of the file; at most [`NAME_BYTES_MAX`](etherpen::ethercat::diagnostics::NAME_BYTES_MAX) bytes.
    pub(crate) name: Name,
    /// Password; 0 for none.
    pub(crate) password: u32,
    /// Whether the slave is brought to BOOT first.
    pub(crate) bootstrap: bool,
}

/// What was transferred, as JSON.
#[derive(Debug, Serialize)]
pub(crate) struct Transferred {
    pub(crate) slave: u8,
    pub(crate) name: String,
    pub(crate) bytes: usize,
    /// Whether the slave was in BOOT; it is in INIT now.
    pub(crate) bootstrap: bool,
}

impl RemoteFile {
    /// Reads the file; `tell` gets the number of bytes so far.
    ///
    /// # Errors
    /// The slave refused, or the bus was lost. `None` beyond [`FILE_BYTES_MAX`].
    pub(crate) fn read(
        &self,
        access: &mut dyn BusAccess,
        mut tell: impl FnMut(usize),
    ) -> Result<Option<Vec<u8>>, AccessError> {
        self.open(access, false)?;
        let slave = self.slave.saturating_sub(1);
        let content = (|| {
            let mut content = Vec::new();
            while content.len() <= FILE_BYTES_MAX {
                match access.request(ServiceRequest::ReadFile { slave })? {
                    ServiceReply::FilePiece { piece, last } => {
                        content.extend_from_slice(&piece);
                        tell(content.len());
                        if last {
                            return Ok(Some(content));
                        }
                    }
                    _ => return Err(AccessError::Foreign),
                }
            }
            Ok(None)
        })();
        self.close(access, content)
    }

    /// Writes the file; `tell` gets the number of bytes so far.
    ///
    /// # Errors
    /// The slave refused, or the bus was lost.
    pub(crate) fn write(
        &self,
        access: &mut dyn BusAccess,
        content: &[u8],
        mut tell: impl FnMut(usize),
    ) -> Result<(), AccessError> {
        self.open(access, true)?;
        let slave = self.slave.saturating_sub(1);
        let written = (|| {
            let mut sent = 0;
            let empty: &[u8] = &[];
            for part in content
                .chunks(PIECE_BYTES_MAX)
                .chain(content.is_empty().then_some(empty))
            {
                sent += part.len();
                let request = ServiceRequest::WriteFile {
                    slave,
                    piece: Piece::from_slice(part).unwrap_or_default(),
                    last: sent == content.len(),
                };
                done(access.request(request)?)?;
                tell(sent);
            }
            Ok(())
        })();
        self.close(access, written)
    }

    /// What was transferred.
    pub(crate) fn transferred(&self, bytes: usize) -> Transferred {
        Transferred {
            slave: self.slave,
            name: self.name.as_str().to_owned(),
            bytes,
            bootstrap: self.bootstrap,
        }
    }

    fn open(&self, access: &mut dyn BusAccess, writes: bool) -> Result<(), AccessError> {
        let file = FileRequest {
            name: self.name.clone(),
            password: self.password,
            writes,
            bootstrap: self.bootstrap,
        };
        let slave = self.slave.saturating_sub(1);
        done(access.request(ServiceRequest::OpenFile { slave, file })?)
    }

    /// Closes the file; an error before it counts more than one of closing.
    fn close<T>(&self, access: &mut dyn BusAccess, result: Result<T, AccessError>) -> Result<T, AccessError> {
        let slave = self.slave.saturating_sub(1);
        let closed = access.request(ServiceRequest::CloseFile { slave }).and_then(done);
        result.and_then(|value| closed.map(|()| value))
    }
}

fn done(reply: ServiceReply) -> Result<(), AccessError> {
    match reply {
        ServiceReply::Done => Ok(()),
        _ => Err(AccessError::Foreign),
    }
}
