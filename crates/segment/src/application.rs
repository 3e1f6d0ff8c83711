//! The application layer's state machine of a slave: INIT, PREOP, BOOT, SAFEOP, OP and their checks.
//!
//! One step up at a time, any step down. BOOT is reached from INIT, and left for INIT, by a slave that has mailboxes for
//! it. A refusal or a fallback sets the error bit and an AL status code; until the
//! master has acknowledged it, every other request is ignored. Sync managers are checked all the
//! time. States and codes: IEC 61158-6-12, AL control and AL status.

/// How long a request for OP waits for outputs, ms.
const OUTPUTS_WAIT_MS: u32 = 200;

const ACKNOWLEDGE: u16 = 0x10;
const STATE_MASK: u16 = 0x0F;
const ERROR: u16 = 0x10;
/// AL control: the master asks for the device's number. AL status: the status code is this number.
const IDENTIFICATION: u16 = 0x20;

/// AL status codes.
pub(crate) mod code {
    /// The requested state cannot follow the present one.
    pub(crate) const INVALID_CHANGE: u16 = 0x0011;
    /// No such state.
    pub(crate) const UNKNOWN_STATE: u16 = 0x0012;
    /// Bootstrap is not supported.
    pub(crate) const NO_BOOTSTRAP: u16 = 0x0013;
    /// The mailbox sync managers are not those of BOOT.
    pub(crate) const BOOTSTRAP_MAILBOX: u16 = 0x0015;
    /// The mailbox sync managers are invalid.
    pub(crate) const MAILBOX: u16 = 0x0016;
    /// The process-data watchdog expired, or no outputs arrived.
    pub(crate) const WATCHDOG: u16 = 0x001B;
    /// The output sync manager is invalid.
    pub(crate) const OUTPUTS: u16 = 0x001D;
    /// The input sync manager is invalid.
    pub(crate) const INPUTS: u16 = 0x001E;
    /// The information memory cannot be read: the master has not given the access.
    pub(crate) const INFORMATION: u16 = 0x0050;
    /// Synchronisation was lost in OP.
    pub(crate) const SYNC_LOST: u16 = 0x002C;
    /// No SYNC0 pulse arrived.
    pub(crate) const NO_SYNC: u16 = 0x002D;
    /// The SYNC unit's registers are inconsistent.
    pub(crate) const SYNC_INVALID: u16 = 0x0030;
}

/// State of a slave's application layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AlState {
    /// No communication with the application.
    Init = 1,
    /// Mailbox only.
    PreOperational = 2,
    /// Firmware update: the mailboxes of this state, and files.
    Bootstrap = 3,
    /// Mailbox and inputs, outputs safe.
    SafeOperational = 4,
    /// Mailbox, inputs and outputs.
    Operational = 8,
}

impl AlState {
    /// The state of an AL status or AL control register; `None` for a number that is no state of a slave here.
    pub(crate) fn from_number(register: u16) -> Option<Self> {
        Some(match register & STATE_MASK {
            1 => Self::Init,
            2 => Self::PreOperational,
            3 => Self::Bootstrap,
            4 => Self::SafeOperational,
            8 => Self::Operational,
            _ => return None,
        })
    }
}

/// Conditions checked in a transition.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Readiness {
    pub(crate) mailbox: bool,
    /// Whether the mailbox sync managers are those of BOOT; `None` without this state.
    pub(crate) bootstrap: Option<bool>,
    pub(crate) outputs: bool,
    pub(crate) inputs: bool,
    pub(crate) outputs_received: bool,
    /// Whether the information memory is available where it is needed.
    pub(crate) information: bool,
    /// Whether the SYNC unit is off, or its registers are consistent.
    pub(crate) sync_valid: bool,
    /// Whether the SYNC unit is off, or pulses arrive.
    pub(crate) synchronous: bool,
}

/// State, error bit and code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Application {
    state: AlState,
    error: bool,
    code: u16,
    waiting_ms: Option<u32>,
    /// Number that the device tells when it is asked.
    number: Option<u16>,
    asked: bool,
}

impl Default for Application {
    fn default() -> Self {
        Self {
            state: AlState::Init,
            error: false,
            code: 0,
            waiting_ms: None,
            number: None,
            asked: false,
        }
    }
}

impl Application {
    /// The present state.
    pub(crate) fn state(&self) -> AlState {
        self.state
    }

    /// The application of a device with this number on its switches.
    pub(crate) fn with_number(number: Option<u16>) -> Self {
        Self {
            number,
            ..Self::default()
        }
    }

    /// Content of the AL status register.
    pub(crate) fn status(&self) -> u16 {
        let identification = if self.identification().is_some() {
            IDENTIFICATION
        } else {
            0
        };
        self.state as u16 | identification | if self.error { ERROR } else { 0 }
    }

    /// Content of the AL status code register.
    pub(crate) fn code_register(&self) -> u16 {
        self.identification().unwrap_or(self.code)
    }

    /// Code of the last refusal or fallback; 0 without one.
    pub(crate) fn code(&self) -> u16 {
        self.code
    }

    /// The number that the device tells at present: it is asked, and no error needs the register.
    fn identification(&self) -> Option<u16> {
        self.number.filter(|_| self.asked && !self.error)
    }

    /// Falls back to a lower state without a request, with a code.
    pub(crate) fn retreat(&mut self, to: AlState, code: u16) {
        self.state = self.state.min(to);
        self.refuse(code);
    }

    /// Refuses the request if it is for this state, regardless of the checks.
    pub(crate) fn deny(&mut self, control: u16, state: AlState, code: u16) -> bool {
        let denied = control & STATE_MASK == state as u16 && !self.ignores(control);
        if denied {
            self.refuse(code);
        }
        denied
    }

    /// Falls back if a sync manager is no longer as the present state needs it.
    pub(crate) fn check(&mut self, ready: Readiness) {
        let cyclic = self.state >= AlState::SafeOperational;
        if self.state == AlState::Bootstrap {
            if ready.bootstrap != Some(true) {
                self.retreat(AlState::Init, code::BOOTSTRAP_MAILBOX);
            }
        } else if self.state >= AlState::PreOperational && !ready.mailbox {
            self.retreat(AlState::Init, code::MAILBOX);
        } else if cyclic && !ready.outputs {
            self.retreat(AlState::PreOperational, code::OUTPUTS);
        } else if cyclic && !ready.inputs {
            self.retreat(AlState::PreOperational, code::INPUTS);
        }
    }

    /// Whether an unacknowledged error hides this request. In INIT, a request for INIT is an acknowledgement.
    fn ignores(&self, control: u16) -> bool {
        let stays_in_init = self.state == AlState::Init && control & STATE_MASK == AlState::Init as u16;
        self.error && control & ACKNOWLEDGE == 0 && !stays_in_init
    }

    /// Advances a waiting request for OP by one millisecond.
    pub(crate) fn step(&mut self, ready: Readiness) {
        let Some(waited_ms) = self.waiting_ms else { return };
        if ready.outputs_received && ready.synchronous {
            self.waiting_ms = None;
            self.state = AlState::Operational;
        } else if waited_ms + 1 >= OUTPUTS_WAIT_MS {
            let no_sync = ready.outputs_received;
            self.refuse(if no_sync { code::NO_SYNC } else { code::WATCHDOG });
        } else {
            self.waiting_ms = Some(waited_ms + 1);
        }
    }

    /// Handles a write to the AL control register.
    pub(crate) fn request(&mut self, control: u16, ready: Readiness) {
        if self.ignores(control) {
            return;
        }
        self.error = false;
        self.code = 0;
        self.asked = control & IDENTIFICATION != 0;
        let Some(target) = AlState::from_number(control) else {
            return self.refuse(code::UNKNOWN_STATE);
        };
        self.waiting_ms = None;
        if target == AlState::Bootstrap || self.state == AlState::Bootstrap {
            self.change_bootstrap(target, ready);
        } else if target > self.state {
            self.climb(target, ready);
        } else {
            self.state = target;
        }
    }

    /// Handles a request for BOOT, or in BOOT.
    fn change_bootstrap(&mut self, target: AlState, ready: Readiness) {
        use AlState::{Bootstrap, Init};
        match (self.state, target, ready.bootstrap) {
            (_, Bootstrap, None) => self.refuse(code::NO_BOOTSTRAP),
            (Bootstrap, Bootstrap, _) => {}
            (Init, Bootstrap, Some(false)) => self.refuse(code::BOOTSTRAP_MAILBOX),
            (Init, Bootstrap, Some(true)) if !ready.information => self.refuse(code::INFORMATION),
            (Init, Bootstrap, Some(true)) | (Bootstrap, Init, _) => self.state = target,
            _ => self.refuse(code::INVALID_CHANGE),
        }
    }

    fn climb(&mut self, target: AlState, ready: Readiness) {
        use AlState::{Init, Operational, PreOperational, SafeOperational};
        match (self.state, target) {
            (Init, PreOperational) if !ready.mailbox => self.refuse(code::MAILBOX),
            (Init, PreOperational) if !ready.information => self.refuse(code::INFORMATION),
            (PreOperational, SafeOperational) if !ready.outputs => self.refuse(code::OUTPUTS),
            (PreOperational, SafeOperational) if !ready.inputs => self.refuse(code::INPUTS),
            (PreOperational, SafeOperational) if !ready.sync_valid => self.refuse(code::SYNC_INVALID),
            (SafeOperational, Operational) if !(ready.outputs_received && ready.synchronous) => {
                self.waiting_ms = Some(0);
            }
            (Init, PreOperational) | (PreOperational, SafeOperational) | (SafeOperational, Operational) => {
                self.state = target;
            }
            _ => self.refuse(code::INVALID_CHANGE),
        }
    }

    fn refuse(&mut self, code: u16) {
        self.waiting_ms = None;
        self.error = true;
        self.code = code;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READY: Readiness = Readiness {
        mailbox: true,
        bootstrap: None,
        outputs: true,
        inputs: true,
        outputs_received: true,
        information: true,
        sync_valid: true,
        synchronous: true,
    };

    fn after(requests: &[u16], ready: Readiness) -> (u16, u16) {
        let mut application = Application::default();
        for request in requests {
            application.request(*request, ready);
        }
        (application.status(), application.code())
    }

    #[test]
    fn the_way_to_op_has_no_short_cut() {
        assert_eq!(after(&[2, 4, 8], READY), (8, 0));
        assert_eq!(after(&[4], READY), (0x11, code::INVALID_CHANGE));
        assert_eq!(after(&[2, 8], READY), (0x12, code::INVALID_CHANGE));
        assert_eq!(after(&[3], READY), (0x11, code::NO_BOOTSTRAP));
        assert_eq!(after(&[2, 7], READY), (0x12, code::UNKNOWN_STATE));
    }

    #[test]
    fn bootstrap_is_reached_from_init_and_left_for_init() {
        let with = |bootstrap| Readiness {
            bootstrap: Some(bootstrap),
            ..READY
        };
        assert_eq!(after(&[3], with(true)), (0x03, 0));
        assert_eq!(after(&[3, 1, 2], with(true)), (0x02, 0));
        assert_eq!(after(&[3], with(false)), (0x11, code::BOOTSTRAP_MAILBOX));
        for requests in [&[3, 2][..], &[3, 4], &[3, 8]] {
            assert_eq!(
                after(requests, with(true)),
                (0x13, code::INVALID_CHANGE),
                "{requests:?}"
            );
        }
        for requests in [&[2, 3][..], &[2, 4, 3], &[2, 4, 8, 3]] {
            assert_eq!(after(requests, with(true)).1, code::INVALID_CHANGE, "{requests:?}");
        }
        let mut application = Application::default();
        application.request(3, with(true));
        application.check(with(false));
        assert_eq!(
            (application.status(), application.code()),
            (0x11, code::BOOTSTRAP_MAILBOX)
        );
    }

    #[test]
    fn each_step_up_checks_what_it_needs() {
        let no_mailbox = Readiness {
            mailbox: false,
            ..READY
        };
        assert_eq!(after(&[2], no_mailbox), (0x11, code::MAILBOX));
        let no_outputs = Readiness {
            outputs: false,
            ..READY
        };
        assert_eq!(after(&[2, 4], no_outputs), (0x12, code::OUTPUTS));
        let no_inputs = Readiness { inputs: false, ..READY };
        assert_eq!(after(&[2, 4], no_inputs), (0x12, code::INPUTS));
    }

    #[test]
    fn an_error_hides_every_request_until_it_is_acknowledged() {
        assert_eq!(after(&[4, 2], READY), (0x11, code::INVALID_CHANGE));
        assert_eq!(after(&[4, 0x11, 2], READY), (0x02, 0));
        assert_eq!(after(&[4, 0x01], READY), (0x01, 0), "in INIT the request acknowledges");
        assert_eq!(
            after(&[2, 8, 1], READY),
            (0x12, code::INVALID_CHANGE),
            "nor a step down"
        );
        assert_eq!(after(&[2, 8, 0x11], READY), (0x01, 0));
        assert_eq!(after(&[2, 8, 0x14], READY), (0x04, 0), "acknowledged, and a step up");
    }

    #[test]
    fn a_device_with_switches_tells_their_number_while_it_is_asked_and_has_no_error() {
        let seen = |number, requests: &[u16]| {
            let mut application = Application::with_number(number);
            for request in requests {
                application.request(*request, READY);
            }
            (application.status(), application.code_register())
        };
        assert_eq!(seen(Some(7), &[2]), (0x02, 0));
        assert_eq!(seen(Some(7), &[2, 0x22]), (0x22, 7));
        assert_eq!(seen(Some(7), &[2, 0x22, 0x02]), (0x02, 0));
        assert_eq!(seen(Some(7), &[2, 0x22, 0x28]), (0x12, code::INVALID_CHANGE));
        assert_eq!(seen(None, &[2, 0x22]), (0x02, 0));
    }

    #[test]
    fn a_sync_manager_that_is_lost_ends_the_state_that_needs_it() {
        let lost = |mailbox, outputs, inputs| Readiness {
            mailbox,
            outputs,
            inputs,
            ..READY
        };
        for (ready, expected) in [
            (lost(true, false, true), (0x12, code::OUTPUTS)),
            (lost(true, true, false), (0x12, code::INPUTS)),
            (lost(false, true, true), (0x11, code::MAILBOX)),
        ] {
            let mut application = Application::default();
            for request in [2, 4, 8] {
                application.request(request, READY);
            }
            application.check(ready);
            assert_eq!((application.status(), application.code()), expected);
        }
    }

    #[test]
    fn without_the_information_memory_there_is_no_way_out_of_init() {
        let kept = Readiness {
            information: false,
            ..READY
        };
        assert_eq!(after(&[2], kept), (0x11, code::INFORMATION));
    }

    #[test]
    fn op_without_outputs_ends_in_the_watchdog_code() {
        let silent = Readiness {
            outputs_received: false,
            ..READY
        };
        let mut application = Application::default();
        for request in [2, 4, 8] {
            application.request(request, silent);
        }
        for _ in 0..OUTPUTS_WAIT_MS - 1 {
            application.step(silent);
            assert_eq!(application.status(), 4);
        }
        application.step(silent);
        assert_eq!((application.status(), application.code()), (0x14, code::WATCHDOG));
    }
}
