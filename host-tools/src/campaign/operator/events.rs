//! What happens to the operator and the machine: events at their times, commands beside the session, and the healing.

use super::super::episode::{Event, FileUse, What};
use super::super::judge::product;
use super::{Board, FIRST_BESIDE, Operator};
use crate::cell::{Fault, Product, SiiFault};
use etherpen::ethercat::diagnostics::{FileRequest, Name, Piece, ServiceRequest};
use etherpen::ethercat::state::AlState;
use etherpen::link::frame::{FRAME_BYTES_MAX, decode, encode};
use etherpen::messages::{Command, DeviceMessage, HostMessage};

/// Name of the file that events use, and what they write into it.
const FILE: &str = "firmware";

impl Operator<'_> {
    /// Makes an event happen.
    pub(super) fn happen(&mut self, event: &Event) {
        let until = |duration_ms: u32| event.at_ms.saturating_add(duration_ms);
        match &event.what {
            What::Fault(words) => self.inject(words),
            What::Frames(words, count) => {
                if let Ok(fault) = words.parse::<Fault>() {
                    self.world.inject_into_frames(fault, *count);
                    self.judge.injected(fault, *count, self.now_ms);
                }
            }
            What::Command(command) => drop(self.session.command(*command)),
            What::Beside(command) => self.put_beside(*command),
            What::State(slave, state) => {
                let state = match state {
                    1 => AlState::Init,
                    2 => AlState::PreOperational,
                    3 => AlState::Bootstrap,
                    4 => AlState::SafeOperational,
                    _ => AlState::Operational,
                };
                self.judge.serviced();
                self.session.bus(ServiceRequest::SetState { slave: *slave, state });
            }
            What::File(slave, file) => {
                self.judge.serviced();
                self.use_file(*slave, file);
            }
            What::Reconnect => self.reconnect(),
            What::Unplug(duration_ms) => {
                self.up.unplug(until(*duration_ms));
                self.down.unplug(until(*duration_ms));
                self.judge.unplugged(until(*duration_ms));
            }
            What::Noise(duration_ms, per_mille) => {
                self.up.disturb(until(*duration_ms), *per_mille);
                self.down.disturb(until(*duration_ms), *per_mille);
            }
            What::StopInput(duration_ms) => self.board.stop_until_ms = until(*duration_ms),
            What::SubstituteClock(duration_ms) => self.board.substitute_until_ms = until(*duration_ms),
            What::TrajectoryWaits(duration_ms) => {
                self.board.trajectory_until_ms = until(*duration_ms);
                self.judge.disturbed(self.now_ms, Some((*duration_ms).into()));
            }
            What::PortDown(duration_ms) => {
                self.board.port_until_ms = until(*duration_ms);
                self.judge.disturbed(self.now_ms, Some((*duration_ms).into()));
            }
            // This operator's program has no log.
            What::Program(_) => {}
        }
    }

    /// Opens a file of a slave, uses a piece of it, and closes it, or leaves it open as a program that ends would.
    fn use_file(&mut self, slave: u8, file: &FileUse) {
        let opened = FileRequest {
            name: Name::try_from(FILE).unwrap_or_default(),
            password: 0,
            writes: file.writes,
            bootstrap: file.bootstrap,
        };
        self.session.bus(ServiceRequest::OpenFile { slave, file: opened });
        self.session.bus(match file.writes {
            true => ServiceRequest::WriteFile {
                slave,
                piece: Piece::from_slice(FILE.as_bytes()).unwrap_or_default(),
                last: file.closes,
            },
            false => ServiceRequest::ReadFile { slave },
        });
        if file.closes {
            self.session.bus(ServiceRequest::CloseFile { slave });
        }
    }

    /// Injects a fault of the segment's script; the reader of the episode has checked its words.
    pub(super) fn inject(&mut self, words: &str) {
        let Ok(fault) = words.parse::<Fault>() else { return };
        match fault {
            Fault::Swap(slave, _) => self.swapped.push(slave),
            Fault::Recable(one, other) => self.recabled.push((one, other)),
            _ => {}
        }
        let misleads =
            matches!(fault, Fault::Recable(..)) || matches!(fault, Fault::Sii(_, kind) if kind != SiiFault::Whole);
        self.misled_at_first |= misleads && !self.has_been_ready;
        self.world.inject(fault);
        self.judge.injected(fault, 1, self.now_ms);
    }

    /// Sends a command beside the session, which sends one after the other.
    pub(super) fn put_beside(&mut self, command: Command) {
        self.beside = self.beside.wrapping_add(1).max(FIRST_BESIDE);
        let id = self.beside;
        let mut frame = [0; FRAME_BYTES_MAX];
        if let Ok(length) = encode(&HostMessage::Command { id, command }, &mut frame) {
            self.at_once.extend(frame.iter().take(length));
            self.unanswered.push((id, command));
        }
    }

    /// Hears the answers to commands beside the session.
    pub(super) fn hear_beside(&mut self, heard: &[u8]) {
        if self.unanswered.is_empty() {
            return;
        }
        for byte in heard {
            let Some(Ok(payload)) = self.decoder.push(*byte) else {
                continue;
            };
            let Ok(DeviceMessage::Answer { id, result }) = decode::<DeviceMessage>(payload) else {
                continue;
            };
            if let Some(index) = self.unanswered.iter().position(|(asked, _)| *asked == id) {
                let (_, command) = self.unanswered.swap_remove(index);
                self.judge.answered(&command, result.is_ok());
            }
        }
    }

    /// Ends all faults: what was cut, removed, exchanged or damaged is restored.
    pub(super) fn heal(&mut self) {
        self.board = Board::default();
        self.up.heal();
        self.down.heal();
        self.world.spare_frames();
        self.inject("join");
        for slave in 1..=self.chain.slaves {
            self.inject(&format!("insert {slave}"));
            self.inject(&format!("sii {slave} whole"));
        }
        for slave in self.chain.drives.clone() {
            self.inject(&format!("stuck {slave} 0"));
            // A slow start stays: it is a property of a device, and the machine has to live with it.
            self.inject(&format!("processor {slave} transition 0"));
            self.inject(&format!("processor {slave} mailbox 0"));
        }
        // The last exchange is undone first.
        for (one, other) in std::mem::take(&mut self.recabled).into_iter().rev() {
            self.inject(&format!("recable {one} {other}"));
        }
        self.recabled.clear();
        for slave in std::mem::take(&mut self.swapped) {
            let own = self
                .chain
                .axis(slave)
                .and_then(|axis| self.config.axes.get(axis))
                .map(product);
            let name = if own == Some(Product::Cia402) {
                "cia402"
            } else {
                "ax2000"
            };
            self.inject(&format!("swap {slave} {name}"));
        }
        self.judge.healed();
        // A refusal that is repeated is that of the drawing before.
        self.session.end_path();
        (self.jog, self.job) = (None, self.job.wrapping_add(1));
    }
}
