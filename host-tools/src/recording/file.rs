//! A recording on the disk that stays readable whatever fails while it is written.

use super::recorder::{About, Recorder, Written};
use crate::error::ProgramError;
use crate::output_file::{OutputFile, unwritable};
use crate::terminal::counted;
use std::fs::File;
use std::io;
use std::path::Path;

/// A recording and the first error while it was written.
pub struct RecordingFile<'a> {
    recorder: Recorder<File>,
    path: &'a Path,
    failed: Option<io::Error>,
}

impl<'a> RecordingFile<'a> {
    /// Starts the file beside an existing recording, and replaces that once the beginning is on the disk.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn begin(path: &'a Path, about: &About) -> Result<Self, ProgramError> {
        let begun = OutputFile::create(path).and_then(|out| {
            let mut recorder = Recorder::new(out.stream()?, about)?;
            recorder.flush()?;
            out.commit()?;
            Ok(recorder)
        });
        Ok(Self {
            recorder: begun.map_err(|cause| unwritable(path, &cause))?,
            path,
            failed: None,
        })
    }

    /// Calls `write`, unless an earlier write failed.
    pub fn write(&mut self, write: impl FnOnce(&mut Recorder<File>) -> io::Result<()>) {
        if self.failed.is_none() {
            self.failed = write(&mut self.recorder).err();
        }
    }

    /// Whether a write failed.
    pub fn has_failed(&self) -> bool {
        self.failed.is_some()
    }

    /// Counters of the data taken, including data that are not yet in the file.
    pub fn taken(&self) -> Written {
        self.recorder.taken()
    }

    /// Ends the file; returns the counters of its content.
    ///
    /// # Errors
    /// The file could not be written to its end; the message says how much of it can be read.
    pub fn end(mut self) -> Result<Written, ProgramError> {
        // After a failure too: there may be space for the end of a shorter file.
        let finished = self.recorder.finish();
        let (written, taken) = (self.recorder.written(), self.recorder.taken());
        if let Some(cause) = self.failed.or(finished.err()) {
            let lost = taken.samples - written.samples;
            return Err(ProgramError::failed(
                format!(
                    "{} could not be written any further; it holds {} and can be read; samples lost: {lost}",
                    self.path.display(),
                    counted(written.samples, "sample")
                ),
                format!("{cause}; make room on the disk, or record to another one"),
            ));
        }
        Ok(written)
    }
}
