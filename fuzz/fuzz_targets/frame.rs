//! Any bytes as a received frame, and any change to the answer that the master waits for.
#![no_main]

use etherpen::ethercat::BusQueues;
use etherpen::ethercat::cyclic::{CyclicPlan, CyclicSlave, Exchange};
use etherpen::ethercat::wire::{Datagram, FrameView};
use libfuzzer_sys::fuzz_target;

const SLAVES: usize = 4;
const MESSAGE: usize = 128;

fn plan() -> CyclicPlan<SLAVES> {
    let slaves = (0..3).map(|number| CyclicSlave {
        input_address: 0x2_0000 + 32 * number,
        input_length: 6,
        output_address: 0x1_0000 + 32 * number,
        output_length: 6,
        watched: true,
        ..CyclicSlave::default()
    });
    CyclicPlan {
        slaves: slaves.collect(),
        ..CyclicPlan::default()
    }
}

/// Opens a frame to its last byte.
fn open(frame: &[u8]) {
    let Ok(view) = FrameView::new_checked(frame) else { return };
    for datagram in view.datagrams() {
        let Ok(datagram) = datagram else { break };
        let data = Datagram::new_checked(datagram.data());
        assert!(datagram.total_len() <= frame.len());
        let _ = (datagram.working_counter(), data.is_ok());
    }
}

fuzz_target!(|bytes: &[u8]| {
    open(bytes);
    let mut queues = BusQueues::<SLAVES, MESSAGE>::new();
    let (exchange_end, mut supervisor_end, _) = queues.split();
    assert!(supervisor_end.plans.enqueue(plan()).is_ok());
    let mut exchange = Exchange::new(exchange_end, [0x10, 0, 0, 0, 0, 1]);
    let mut answer = exchange.input_telegram().to_vec();
    let _ = exchange.receive(bytes);
    // Pairs of place and value change the answer; what is left over cuts it.
    let changes = bytes.chunks_exact(3);
    let cut = changes.remainder().first().copied().unwrap_or(0);
    for change in changes.take(64) {
        let place = usize::from(u16::from_le_bytes([change[0], change[1]])) % answer.len();
        answer[place] = change[2];
    }
    open(&answer);
    let length = answer.len().saturating_sub(usize::from(cut));
    let _ = exchange.receive(&answer[..length]);
    let _ = exchange.receive(&answer[..length]);
    for slave in 0..=SLAVES {
        let _ = exchange.input(slave).map(<[u8]>::len);
        exchange.output(slave).fill(cut);
    }
    let _ = exchange.output_telegram().len();
    let _ = exchange.receive(&answer);
    let _ = (exchange.al_status(), exchange.clock_ns(), exchange.counters());
});
