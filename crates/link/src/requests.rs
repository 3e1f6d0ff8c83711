//! Requests that the firmware has handed out, and their answers, kept for repetition.
//!
//! Invariant: a request is handed out once however often it arrives; a repeated request makes its answer due again.

use crate::CommandEffect;

/// A command that was handed out, with its answer.
pub(crate) struct Request<R> {
    pub(crate) id: u16,
    pub(crate) effect: CommandEffect,
    pub(crate) result: Option<Result<(), R>>,
    pub(crate) due: bool,
}

/// A kind of request that is carried out one at a time, with its answer.
pub(crate) struct Single<T> {
    id: u16,
    result: Option<T>,
    due: bool,
}

impl<T> Single<T> {
    /// Whether `id` is to be carried out; a repeated `id` makes its answer due again.
    pub(crate) fn begin(slot: &mut Option<Self>, id: u16) -> bool {
        match slot {
            Some(known) if known.id == id => {
                known.due = known.result.is_some();
                false
            }
            _ => {
                *slot = Some(Self {
                    id,
                    result: None,
                    due: false,
                });
                true
            }
        }
    }

    pub(crate) fn answer(slot: &mut Option<Self>, id: u16, result: T) {
        if let Some(known) = slot.as_mut().filter(|known| known.id == id) {
            known.result = Some(result);
            known.due = true;
        }
    }

    /// The answer that is due; returned once.
    pub(crate) fn take_due(slot: &mut Option<Self>) -> Option<(u16, &T)> {
        let known = slot.as_mut().filter(|known| known.due)?;
        known.due = false;
        known.result.as_ref().map(|result| (known.id, result))
    }
}
