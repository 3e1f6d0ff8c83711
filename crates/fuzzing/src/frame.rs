//! Any bytes as a received frame, and as changes to the answer that the master waits for.
//!
//! The first bytes choose encapsulation, kind of exchange, clock and the slaves' shares; the rest is the frame, or the
//! changes.

use core::net::Ipv4Addr;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use etherpen::ethercat::BusQueues;
use etherpen::ethercat::acyclic::{Outcome, Request};
use etherpen::ethercat::cyclic::{
    Arrival, CyclicPlan, CyclicSlave, Exchange, ExchangeKind, Ignored, PROCESS_BYTES_MAX, ReferenceClock,
};
use etherpen::ethercat::encapsulation::Encapsulation;
use etherpen::ethercat::wire::{Address, Command, Datagram, FrameView, UdpRepr};
use etherpen::robot_bus::RobotDrives;

const SLAVES: usize = 4;
const MESSAGE: usize = 128;
const MAC: [u8; 6] = [0x10, 0, 0, 0, 0, 1];
const UDP: UdpRepr = UdpRepr::request(MAC, Ipv4Addr::new(10, 0, 2, 15), Ipv4Addr::new(10, 0, 2, 2));

/// What is exchanged: flags, and for each slave two lengths and the distance of its inputs from its outputs.
struct Choice {
    flags: u8,
    shares: [[u8; 3]; SLAVES],
}

impl Choice {
    fn new(bytes: &[u8]) -> Option<(Self, &[u8])> {
        let (&flags, rest) = bytes.split_first()?;
        let (shares, rest) = rest.split_first_chunk::<{ 3 * SLAVES }>()?;
        let shares = core::array::from_fn(|slave| core::array::from_fn(|byte| shares[3 * slave + byte]));
        Some((Self { flags, shares }, rest))
    }

    fn encapsulation(&self) -> Encapsulation {
        match self.flags & 3 {
            0 | 1 => Encapsulation::Raw,
            2 => Encapsulation::Udp(UDP),
            _ => Encapsulation::Bare,
        }
    }

    fn plan(&self) -> CyclicPlan<RobotDrives, SLAVES> {
        // One length in four is too long, and the share is left out.
        let length = |byte: u8| u16::from(byte) % (PROCESS_BYTES_MAX as u16 * 4 / 3);
        let slaves = (0..)
            .zip(self.shares)
            .map(|(number, [input, output, distance])| CyclicSlave {
                input_address: 0x1_0000_u32.wrapping_mul(number).wrapping_add(distance.into()),
                input_length: length(input),
                output_address: 0x1_0000_u32.wrapping_mul(number).wrapping_add(32),
                output_length: length(output),
                watched: number != 3,
                ..CyclicSlave::default()
            });
        CyclicPlan {
            slaves: slaves.collect(),
            exchange: if self.flags & 4 == 0 {
                ExchangeKind::Split
            } else {
                ExchangeKind::Combined
            },
            clock: (self.flags & 8 != 0).then_some(ReferenceClock {
                station: 0x1001,
                slaves: 4,
                wide: self.flags & 16 != 0,
                is_spread: self.flags & 16 == 0,
                time_number: 0,
                period: ReferenceClock::period_of_ns(1_000_000),
            }),
            ..CyclicPlan::default()
        }
    }

    fn asks_acyclic(&self) -> bool {
        self.flags & 32 != 0
    }
}

/// Opens a frame to its last byte.
fn open(frame: &[u8]) {
    let _ = UdpRepr::parse(frame).map(|(_, payload)| assert!(frame.get(payload).is_some()));
    let Ok(view) = FrameView::new_checked(frame) else {
        return;
    };
    for datagram in view.datagrams() {
        let Ok(datagram) = datagram else { break };
        let data = Datagram::new_checked(datagram.data());
        assert!(datagram.total_len() <= frame.len());
        let _ = (datagram.working_counter(), data.is_ok());
    }
}

/// Changes a frame: pairs of place and value; what is left over cuts it.
fn change(frame: &mut Vec<u8>, changes: &[u8]) {
    let changes = changes.chunks_exact(3);
    let cut = usize::from(changes.remainder().first().copied().unwrap_or(0));
    for change in changes.take(64) {
        let place = usize::from(u16::from_le_bytes([change[0], change[1]])) % frame.len();
        frame[place] = change[2];
    }
    frame.truncate(frame.len().saturating_sub(cut));
}

/// Receives a frame twice: it is used once at most, and counted each time that it is not.
fn receive(exchange: &mut Exchange<'_, RobotDrives, SLAVES, MESSAGE>, frame: &[u8]) -> Arrival {
    let before = exchange.counters().frames_ignored();
    let arrival = exchange.receive(frame);
    let again = exchange.receive(frame);
    let ignored = match arrival {
        Arrival::Ignored(kind) => {
            assert_eq!(again, Arrival::Ignored(kind));
            2
        }
        Arrival::Input | Arrival::Output => {
            assert_eq!(again, Arrival::Ignored(Ignored::Duplicate));
            1
        }
    };
    assert_eq!(exchange.counters().frames_ignored(), before + ignored);
    arrival
}

/// Passes the bytes to an exchange.
pub(crate) fn run(bytes: &[u8]) {
    open(bytes);
    let Some((choice, bytes)) = Choice::new(bytes) else {
        return;
    };
    let mut queues = BusQueues::<RobotDrives, SLAVES, MESSAGE>::new();
    let (exchange_end, mut supervisor_end, _) = queues.split();
    let plan = choice.plan();
    assert!(supervisor_end.plans.enqueue(plan.clone()).is_ok());
    let mut exchange = Exchange::new(exchange_end, MAC);
    exchange.set_encapsulation(choice.encapsulation());

    let request = Request::read(Command::Fprd, Address::station(0x1001, 0x0130), 2);
    let mut reply = pin!(supervisor_end.port.transact(&request));
    let mut context = Context::from_waker(Waker::noop());
    if choice.asks_acyclic() {
        assert!(reply.as_mut().poll(&mut context).is_pending());
    }

    let mut answer = exchange.input_telegram().to_vec();
    let unasked = receive(&mut exchange, bytes);
    change(&mut answer, bytes);
    open(&answer);
    let came = receive(&mut exchange, &answer);
    for (slave, share) in plan.slaves.iter().enumerate() {
        let input = exchange.input(slave).map(<[u8]>::len);
        assert!(input.is_none_or(|length| length == usize::from(share.input_length)));
        let output = exchange.output(slave);
        assert!(output.is_empty() || output.len() == usize::from(share.output_length));
        output.fill(0xA5);
    }
    assert!(exchange.input(SLAVES).is_none() && exchange.output(SLAVES).is_empty());

    let mut answer = exchange.output_telegram().to_vec();
    if !answer.is_empty() {
        change(&mut answer, bytes);
        receive(&mut exchange, &answer);
    }
    let _ = (exchange.al_status(), exchange.clock_ns());
    exchange.input_telegram();
    if choice.asks_acyclic() {
        let Poll::Ready(reply) = reply.as_mut().poll(&mut context) else {
            panic!("a request without a reply");
        };
        let back = [unasked, came].contains(&Arrival::Input);
        assert_eq!(matches!(reply.outcome, Outcome::Processed { .. }), back);
    }
}

/// Every encapsulation and kind of exchange, with frames that the segment's rig writes.
pub(crate) fn seeds() -> Vec<Vec<u8>> {
    use etherpen_segment::rig::{BRD, FPRD, LRD, LRW, frame_of};
    let frames = [
        frame_of(&[(BRD, 0, 0x0130, &[0; 2])]),
        frame_of(&[(LRD, 0, 1, &[0; 24]), (FPRD, 0x1001, 0x0130, &[0; 2])]),
        frame_of(&[(LRW, 0, 1, &[0x5A; 24])]),
    ];
    let flags = [0, 2, 3, 4, 8 | 4, 8 | 16, 32, 32 | 8 | 2, 32 | 4 | 3];
    let shares = [[6, 6, 0], [6, 6, 8], [4, 2, 0], [0, 0, 0]].concat();
    let of = |flags: u8, frame: &[u8]| [&[flags], shares.as_slice(), frame].concat();
    let all = flags
        .iter()
        .flat_map(|flags| frames.iter().map(|frame| of(*flags, frame)));
    all.collect()
}
