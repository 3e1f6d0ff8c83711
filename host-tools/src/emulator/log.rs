//! The firmware's log: defmt frames become lines.

use super::error::EmulatorError;
use defmt_decoder::{DecodeError, Table};
use std::collections::VecDeque;
use std::path::Path;

/// Log lines shown in an error.
const LINES_KEPT: usize = 10;

/// One line of the firmware's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLine {
    /// `error`, `warn`, `info`, `debug`, `trace`, or empty for a line without a level.
    pub level: String,
    /// Milliseconds since the firmware's first sample.
    pub ms: String,
    /// The text.
    pub message: String,
}

impl std::fmt::Display for LogLine {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{} {} {}", self.ms, self.level, self.message)
    }
}

/// Reads the table of log texts from a firmware image; an image without a table logs nothing.
pub(crate) fn table(image: &Path) -> Result<Option<Table>, EmulatorError> {
    let error = |cause: String| EmulatorError::Image {
        path: image.to_owned(),
        cause,
    };
    let elf = std::fs::read(image).map_err(|cause| error(cause.to_string()))?;
    Table::parse(&elf).map_err(|cause| error(cause.to_string()))
}

/// Decodes log bytes as they arrive.
pub(crate) struct Decoder<'t> {
    stream: Option<Box<dyn defmt_decoder::StreamDecoder + Send + Sync + 't>>,
    last: VecDeque<String>,
}

impl<'t> Decoder<'t> {
    pub(crate) fn new(table: Option<&'t Table>) -> Self {
        Self {
            stream: table.map(Table::new_stream_decoder),
            last: VecDeque::new(),
        }
    }

    /// Takes bytes and passes the completed lines to `line`; damaged frames are skipped.
    pub(crate) fn take(&mut self, bytes: &[u8], line: &mut dyn FnMut(&LogLine)) {
        let Some(stream) = &mut self.stream else {
            return;
        };
        stream.received(bytes);
        loop {
            match stream.decode() {
                Ok(frame) => {
                    let decoded = LogLine {
                        level: frame.level().map_or(String::new(), |level| level.as_str().to_owned()),
                        ms: frame.display_timestamp().map_or(String::new(), |time| time.to_string()),
                        message: frame.display_message().to_string(),
                    };
                    if self.last.len() == LINES_KEPT {
                        self.last.pop_front();
                    }
                    self.last.push_back(decoded.to_string());
                    line(&decoded);
                }
                Err(DecodeError::Malformed) => {}
                Err(DecodeError::UnexpectedEof) => return,
            }
        }
    }

    /// The last lines.
    pub(crate) fn last(&self) -> Vec<String> {
        self.last.iter().cloned().collect()
    }
}
