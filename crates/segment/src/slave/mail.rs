//! The mailbox of a slave: takes requests, queues answers, and the faults of single requests.

use super::{MAILBOX_IN_MANAGER, MAILBOX_OUT_MANAGER, Slave};
use crate::application::AlState;
use crate::faults::kinds::{MailFault, MailStep};
use crate::mailbox::coe::{TYPE_COE, TYPE_ETHERNET, TYPE_FILE, object_of, protocol_of};
use crate::mailbox::foe::FileFault;
use crate::mailbox::objects::Objects;
use etherpen_ethercat::wire::sii::{PROTOCOL_EOE, PROTOCOL_FOE};

/// A slow processor opens the buffer of its answer this long before the answer is complete, ms.
const COMPOSING_MS: u64 = 20;
/// Frame types of Ethernet over EtherCAT: a request to set the address, and its answer.
const ETHERNET_SET_ADDRESS: u8 = 2;
const ETHERNET_ADDRESS_SET: u8 = 3;
/// Time from the answer to the announcement of the address, ms, as an AKD takes it.
const ANNOUNCE_MS: u64 = 16;
/// Error code of the emergencies of a flood.
const FLOOD_CODE: u16 = 0xFF00;

impl Slave {
    /// Schedules a fault of a mailbox request.
    pub(crate) fn spoil_mailbox(&mut self, step: MailStep, fault: MailFault) {
        self.mail_faults.push((step, fault));
    }

    /// Leaves mailbox messages unanswered for some milliseconds.
    pub(crate) fn silence(&mut self, milliseconds: u64) {
        self.silent_ms = milliseconds;
    }

    /// Sends a message of another protocol that nobody has asked for: a fragment of an Ethernet frame.
    pub(crate) fn send_ethernet(&mut self) {
        if self.application.state() >= AlState::PreOperational {
            self.mailbox.ethernet();
        }
    }

    pub(super) fn serve_mailbox(&mut self) {
        if self.silent_ms > 0 {
            self.silent_ms -= 1;
            return;
        }
        if self.application.state() < AlState::PreOperational {
            return;
        }
        self.announce_ms = match self.announce_ms {
            Some(0) => {
                self.mailbox.ethernet();
                None
            }
            left_ms => left_ms.map(|ms| ms - 1),
        };
        let message = self
            .controller
            .with_sync_manager(MAILBOX_OUT_MANAGER, |manager| manager.take_message());
        if let Some(message) = message {
            self.receive(&message);
            self.answer_ms = self.options.mailbox_ms;
        }
        if self.answer_ms > 0 {
            self.answer_ms -= 1;
            let composing = self.answer_ms < COMPOSING_MS && self.options.mailbox_ms >= COMPOSING_MS;
            self.controller
                .with_sync_manager(MAILBOX_IN_MANAGER, |manager| manager.set_composing(composing));
            return;
        }
        let (mailbox, ignores_repeats) = (&mut self.mailbox, self.options.ignores_repeats);
        self.controller.with_sync_manager(MAILBOX_IN_MANAGER, |manager| {
            if manager.repeat_is_due() && !ignores_repeats {
                if let Some(message) = mailbox.last_sent() {
                    manager.put(message);
                }
                manager.acknowledge_repeat();
            } else if manager.accepts_message()
                && let Some(message) = mailbox.next()
            {
                manager.put(&message);
            }
        });
    }

    /// Answers a mailbox message, with the scripted faults.
    fn receive(&mut self, message: &[u8]) {
        match self.mail_fault(message) {
            Some(MailFault::Silent) => return,
            Some(MailFault::Abort(code)) => return self.mailbox.abort(message, code),
            Some(MailFault::Lost) => self.mailbox.lose_next(),
            Some(MailFault::Counter) => self.mailbox.repeat_counter(),
            Some(MailFault::Flood(count)) => {
                for _ in 0..count {
                    self.mailbox.emergency(FLOOD_CODE, 0, [0; 5]);
                }
            }
            None => {}
        }
        let manager = self.controller.sync_manager(MAILBOX_IN_MANAGER);
        let capacity = manager.map_or(0, |manager| manager.length());
        let in_bootstrap = self.application.state() == AlState::Bootstrap;
        let protocols = self.device.windows().protocols;
        if in_bootstrap && protocol_of(message) == Some(TYPE_COE) {
            return self.mailbox.refuse_protocol();
        }
        let mut objects = Objects {
            dictionary: &mut self.dictionary,
            process_data: &mut self.process_data,
            device: self.device.as_mut(),
            state: self.application.state(),
        };
        match self.mailbox.receive(message, capacity, &mut objects) {
            Some((TYPE_FILE, body)) if protocols & PROTOCOL_FOE != 0 => {
                if let Some(answer) = self.files.receive(body, (message.len(), capacity), in_bootstrap) {
                    self.mailbox.send(TYPE_FILE, &answer);
                }
            }
            Some((TYPE_ETHERNET, body)) if protocols & PROTOCOL_EOE != 0 && !in_bootstrap => {
                self.receive_ethernet(body)
            }
            Some(_) => self.mailbox.refuse_protocol(),
            None => {}
        }
    }

    /// A request to set the address is answered, and announced by an Ethernet frame; frames for the device go nowhere.
    fn receive_ethernet(&mut self, body: &[u8]) {
        if body.first().is_some_and(|kind| kind & 0x0F == ETHERNET_SET_ADDRESS) {
            self.mailbox.send(TYPE_ETHERNET, &[ETHERNET_ADDRESS_SET, 0x01, 0, 0]);
            self.announce_ms = Some(ANNOUNCE_MS);
        }
    }

    /// Sets a fault of the files.
    pub(crate) fn spoil_files(&mut self, fault: FileFault) {
        self.files.spoil(fault);
    }

    /// The content of a file.
    pub(crate) fn file(&self, name: &str) -> Option<&[u8]> {
        self.files.file(name)
    }

    /// Stores a file.
    pub(crate) fn store_file(&mut self, name: &str, content: &[u8]) {
        self.files.store(name, content);
    }

    /// The fault scheduled for this request, returned once; counts down the steps of the others.
    fn mail_fault(&mut self, message: &[u8]) -> Option<MailFault> {
        let object = object_of(message);
        let mut hit = None;
        self.mail_faults.retain_mut(|(step, fault)| {
            let due = match step {
                MailStep::Request(left) => {
                    *left = left.saturating_sub(1);
                    *left == 0
                }
                MailStep::Object(index, sub) => object == Some((*index, *sub)),
            };
            if due && hit.is_none() {
                hit = Some(*fault);
                return false;
            }
            true
        });
        hit
    }
}
