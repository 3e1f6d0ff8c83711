//! Keyboard input of the operator: Ctrl-C, Ctrl-C again, Enter.

use crate::job::Control;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

/// A key, or a signal that acts as one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Key {
    /// Ctrl-C.
    Interrupt,
    /// A request to end from another process.
    Terminate,
    /// Enter.
    Enter,
}

/// Keys in the order in which they were pressed.
pub(super) struct Operator {
    keys: Receiver<Key>,
    /// What stood before each Enter.
    lines: Receiver<String>,
    /// Whether Enter can still arrive.
    reads: Arc<AtomicBool>,
    /// Whether a hold was requested.
    pub(super) held: bool,
    /// Whether a line arrived early on a standard input that is not a terminal.
    early: bool,
}

impl Operator {
    /// Starts listening. If signals cannot be watched, they end the program as usual.
    pub(super) fn start() -> Self {
        let (sender, keys) = mpsc::channel();
        let pressed = sender.clone();
        let (written, lines) = mpsc::channel();
        let reads = Arc::new(AtomicBool::new(true));
        let reading = reads.clone();
        if let Ok(mut signals) = Signals::new([SIGINT, SIGTERM, SIGHUP]) {
            std::thread::spawn(move || {
                for signal in signals.forever() {
                    let key = if signal == SIGINT {
                        Key::Interrupt
                    } else {
                        Key::Terminate
                    };
                    if sender.send(key).is_err() {
                        return;
                    }
                }
            });
        }
        std::thread::spawn(move || {
            for line in std::io::stdin().lines().map_while(Result::ok) {
                if written.send(line).is_err() || pressed.send(Key::Enter).is_err() {
                    return;
                }
            }
            reading.store(false, Ordering::Release);
        });
        Self {
            keys,
            lines,
            reads,
            held: false,
            early: false,
        }
    }

    /// Records an Enter that nothing waited for. It is ignored on a terminal, where a person answers prompts.
    pub(super) fn note_early_enter(&mut self) {
        self.early |= !std::io::stdin().is_terminal();
    }

    /// Waits for the next key; an early Enter counts as one.
    pub(super) fn wait_or_early(&mut self) -> Option<Key> {
        match std::mem::take(&mut self.early) {
            true => Some(Key::Enter),
            false => self.wait(),
        }
    }

    /// Waits for the next key; `None` once standard input has ended.
    pub(super) fn wait(&mut self) -> Option<Key> {
        loop {
            // Keys pressed before the end are in the channel by then.
            let reads = self.reads.load(Ordering::Acquire);
            match self.keys.recv_timeout(Duration::from_millis(50)) {
                Ok(key) => return Some(key),
                Err(RecvTimeoutError::Timeout) if reads => {}
                Err(_) => return None,
            }
        }
    }

    /// Waits for a key that answers a question asked now: on a terminal, an Enter from before was meant for something
    /// else. `None` once standard input has ended.
    pub(super) fn wait_fresh(&mut self) -> Option<Key> {
        self.fresh(std::io::stdin().is_terminal())
    }

    fn fresh(&mut self, is_terminal: bool) -> Option<Key> {
        while let Some(key) = self.next_key() {
            if key != Key::Enter || !is_terminal {
                return Some(key);
            }
        }
        self.wait()
    }

    /// Waits for a line that answers a question asked now; a line from before counts unless it was typed on a terminal. `None`
    /// after Ctrl-C, a request to end, or the end of standard input.
    pub(super) fn answer(&mut self) -> Option<String> {
        if std::io::stdin().is_terminal() {
            while self.lines.try_recv().is_ok() {}
            self.fresh(true).filter(|key| *key == Key::Enter)?;
        }
        loop {
            while let Some(key) = self.next_key() {
                Some(key).filter(|key| *key == Key::Enter)?;
            }
            if let Ok(line) = self.lines.try_recv() {
                return Some(line);
            }
            self.wait().filter(|key| *key == Key::Enter)?;
        }
    }

    /// The oldest key not yet taken.
    pub(super) fn next_key(&mut self) -> Option<Key> {
        self.keys.try_recv().ok()
    }

    /// The oldest key as a control of a job that moves: Ctrl-C holds, Enter resumes, a second Ctrl-C cancels.
    pub(super) fn next_control(&mut self) -> Option<Control> {
        Some(match self.next_key()? {
            Key::Enter => {
                self.held = false;
                Control::Resume
            }
            Key::Interrupt if !self.held => {
                self.held = true;
                Control::Hold
            }
            Key::Interrupt | Key::Terminate => Control::Cancel,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_enter_from_before_the_question_answers_it_only_from_a_pipe() {
        let pressed = |keys: &[Key]| {
            let (sender, received) = mpsc::channel();
            keys.iter().for_each(|key| sender.send(*key).expect("somebody listens"));
            let operator = Operator {
                keys: received,
                lines: mpsc::channel().1,
                reads: Arc::new(AtomicBool::new(false)),
                held: false,
                early: false,
            };
            (sender, operator)
        };
        let (_keyboard, mut operator) = pressed(&[Key::Enter, Key::Enter]);
        assert_eq!(operator.fresh(true), None);
        let (_keyboard, mut operator) = pressed(&[Key::Enter, Key::Terminate]);
        assert_eq!(operator.fresh(true), Some(Key::Terminate));
        let (_pipe, mut operator) = pressed(&[Key::Enter, Key::Interrupt]);
        assert_eq!(operator.fresh(false), Some(Key::Enter));
    }
}
