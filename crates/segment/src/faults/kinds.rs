//! Kinds of faults on the segment: one value for each fault of the script language.

use crate::application::AlState;
use crate::drive::resolver::ResolverFault;
use crate::eeprom::SiiFault;
use crate::mailbox::foe::FileFault;

/// A fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The request never reaches the slaves.
    Drop,
    /// The slaves process the request, the reply is lost.
    Lose,
    /// The reply arrives this many frames later.
    Delay(u64),
    /// The reply arrives twice.
    Duplicate,
    /// The reply is cut after this many bytes.
    Truncate(usize),
    /// This many bytes follow the reply, and its header counts them.
    Overlong(u16),
    /// This is added to the index of the reply's datagrams.
    Index(u8),
    /// This is added to the working counters of the reply.
    Counter(i16),
    /// The EtherCAT header of the reply has this type, 0 to 15.
    Type(u8),
    /// The last datagram of the reply announces another one.
    More,
    /// The reply's datagrams have the circulating bit.
    Circulate,
    /// The reply carries a VLAN tag.
    Vlan,
    /// A frame of another protocol arrives before the reply.
    Foreign,
    /// The request itself arrives before the reply.
    Reflect,
    /// No frame gets through for this many milliseconds.
    Stall(u64),
    /// The cable behind this slave is pulled; 0 is the master's.
    Cut(usize),
    /// The cable behind this slave is plugged in; 0 is the master's.
    Plug(usize),
    /// All cables are plugged in.
    Join,
    /// The cable behind this slave destroys the next frames; 0 is the master's.
    Crc(usize, u64),
    /// This slave is bypassed.
    Remove(usize),
    /// This slave returns.
    Insert(usize),
    /// The cables of two slaves are exchanged: they change places in the chain, each with its motor and its power. The cables
    /// lie open for 500 ms.
    Recable(usize, usize),
    /// No frame that only writes process data gets through for this many milliseconds.
    Mute(u64),
    /// A slave takes no process data for some milliseconds.
    Deaf(usize, u64),
    /// This slave is replaced by another product.
    Swap(usize, Product),
    /// A slave is without power for some milliseconds.
    Power(usize, u64),
    /// A slave falls back to SAFEOP with an AL status code.
    Retreat(usize, u16),
    /// A slave falls back to a lower state with an AL status code.
    Fall(usize, AlState, u16),
    /// A slave refuses the next request for a state with an AL status code.
    Refuse(usize, AlState, u16),
    /// A slave's processor is stopped for some milliseconds.
    Processor(usize, u64),
    /// A fault of a slave's information memory.
    Sii(usize, SiiFault),
    /// A slave answers no mailbox message for some milliseconds.
    Silence(usize, u64),
    /// A fault of one mailbox request of a slave.
    Mailbox(usize, MailStep, MailFault),
    /// A slave sends an unasked message of another protocol, an Ethernet fragment, through its mailbox.
    Ethernet(usize),
    /// A fault of a slave's file server.
    File(usize, FileFault),
    /// The manners of a slave's processor change, without a restart.
    Manner(usize, Manner),
    /// A drive faults with an error code.
    Drive(usize, u16),
    /// A drive has no mains voltage for some milliseconds.
    Mains(usize, u64),
    /// A fault of a drive's resolver for some milliseconds.
    Resolver(usize, ResolverFault, u64),
    /// A drive's resolver slips on its shaft by this many increments, permanently.
    Jump(usize, i32),
    /// The resolvers of two drives are exchanged for some milliseconds.
    Exchange(usize, usize, u64),
}

/// Selects a mailbox request of a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MailStep {
    /// The n-th from now on, from 1.
    Request(u32),
    /// The next SDO request for this index and sub-index.
    Object(u16, u8),
}

/// Fault of a mailbox request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MailFault {
    /// The request is aborted with this code.
    Abort(u32),
    /// The request is not answered.
    Silent,
    /// The answer is lost; only a repeat request returns it.
    Lost,
    /// The answer has the counter of the previous message.
    Counter,
    /// This many emergencies arrive before the answer.
    Flood(u8),
}

/// One of the manners of a slave's processor; see [`crate::SlaveOptions`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manner {
    /// Whether it reads the information memory on the way to PREOP.
    ReadsSii(bool),
    /// Whether it ignores requests to give its last mailbox message again.
    IgnoresRepeats(bool),
    /// How long it starts after power-up, ms.
    Boot(u64),
    /// How long a change of state takes, ms.
    Transition(u64),
    /// How long the answer to a mailbox message takes, ms.
    Mailbox(u64),
}

/// A product that can replace a slave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Product {
    /// Servo drive AX2000-B110.
    Ax2000,
    /// Generic CiA 402 servo drive.
    Cia402,
    /// Servo drive AKD.
    Akd,
    /// Bus coupler.
    Ek1100,
}

impl Product {
    /// Names in the script language.
    pub(crate) const NAMES: [(&str, Self); 4] = [
        ("ax2000", Self::Ax2000),
        ("cia402", Self::Cia402),
        ("akd", Self::Akd),
        ("ek1100", Self::Ek1100),
    ];
}

impl Fault {
    /// Whether the fault affects a single frame.
    pub(crate) fn is_of_frame(self) -> bool {
        matches!(
            self,
            Self::Drop
                | Self::Lose
                | Self::Delay(_)
                | Self::Duplicate
                | Self::Truncate(_)
                | Self::Overlong(_)
                | Self::Index(_)
                | Self::Counter(_)
                | Self::Type(_)
                | Self::More
                | Self::Circulate
                | Self::Vlan
                | Self::Foreign
                | Self::Reflect
        )
    }

    /// The slave affected, from 1.
    pub(crate) fn slave(self) -> Option<usize> {
        match self {
            Self::Remove(slave)
            | Self::Insert(slave)
            | Self::Deaf(slave, _)
            | Self::Swap(slave, _)
            | Self::Power(slave, _)
            | Self::Retreat(slave, _)
            | Self::Fall(slave, ..)
            | Self::Refuse(slave, ..)
            | Self::Processor(slave, _)
            | Self::Sii(slave, _)
            | Self::Silence(slave, _)
            | Self::Mailbox(slave, ..)
            | Self::Ethernet(slave)
            | Self::Manner(slave, _)
            | Self::File(slave, _)
            | Self::Drive(slave, _)
            | Self::Mains(slave, _)
            | Self::Resolver(slave, ..)
            | Self::Jump(slave, _) => Some(slave),
            Self::Exchange(one, other, _) | Self::Recable(one, other) => Some(one.max(other)),
            _ => None,
        }
    }

    /// The cable affected: the one behind this slave; 0 is the master's.
    pub(crate) fn cable(self) -> Option<usize> {
        match self {
            Self::Cut(cable) | Self::Plug(cable) | Self::Crc(cable, _) => Some(cable),
            _ => None,
        }
    }

    /// Its keyword in the script language.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Drop => "drop",
            Self::Lose => "lose",
            Self::Delay(_) => "delay",
            Self::Duplicate => "duplicate",
            Self::Truncate(_) => "truncate",
            Self::Overlong(_) => "overlong",
            Self::Index(_) => "index",
            Self::Counter(_) => "counter",
            Self::Type(_) => "type",
            Self::More => "more",
            Self::Circulate => "circulate",
            Self::Vlan => "vlan",
            Self::Foreign => "foreign",
            Self::Reflect => "reflect",
            Self::Stall(_) => "stall",
            Self::Cut(_) => "cut",
            Self::Plug(_) => "plug",
            Self::Join => "join",
            Self::Crc(..) => "crc",
            Self::Remove(_) => "remove",
            Self::Insert(_) => "insert",
            Self::Recable(..) => "recable",
            Self::Mute(_) => "mute",
            Self::Deaf(..) => "deaf",
            Self::Swap(..) => "swap",
            Self::Power(..) => "power",
            Self::Retreat(..) => "retreat",
            Self::Fall(..) => "fall",
            Self::Refuse(..) => "refuse",
            Self::Processor(..) => "pdi",
            Self::Sii(..) => "sii",
            Self::Silence(..) => "silence",
            Self::Mailbox(..) => "mailbox",
            Self::Ethernet(..) => "eoe",
            Self::Manner(..) => "processor",
            Self::File(..) => "foe",
            Self::Drive(..) => "fault",
            Self::Mains(..) => "mains",
            Self::Resolver(_, ResolverFault::Stuck, _) => "stuck",
            Self::Resolver(_, ResolverFault::Slip(_), _) => "slip",
            Self::Resolver(_, ResolverFault::Reversed, _) => "reverse",
            Self::Resolver(_, ResolverFault::Noise(_), _) => "noise",
            Self::Jump(..) => "jump",
            Self::Exchange(..) => "exchange",
        }
    }
}
