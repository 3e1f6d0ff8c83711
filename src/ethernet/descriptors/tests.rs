use super::*;
use std::vec::Vec;

const N: usize = 8;
const PLACE: Place = Place {
    descriptors: 0x3004_0000,
    buffers: 0x3004_0080,
    buffer_bytes: 1536,
};

fn descriptors() -> [Descriptor; N] {
    [const { Descriptor::new() }; N]
}

/// The DMA's side of a ring: works from its own position to the tail pointer.
struct Dma<'a> {
    descriptors: &'a [Descriptor; N],
    next: usize,
    tail: u32,
}

impl Dma<'_> {
    /// The descriptor in turn if the DMA may use it; it suspends at the tail.
    fn take(&mut self) -> Option<&Descriptor> {
        let address = PLACE.descriptors + self.next as u32 * DESCRIPTOR_BYTES;
        if address == self.tail {
            return None;
        }
        let descriptor = &self.descriptors[self.next];
        assert!(
            descriptor.control() & OWN != 0,
            "descriptor {} before the tail is not ready",
            self.next
        );
        self.next = (self.next + 1) % N;
        Some(descriptor)
    }

    /// Writes a frame back; false if no descriptor was left.
    fn receive(&mut self, status: u32) -> bool {
        let Some(descriptor) = self.take() else { return false };
        let ready = INTERRUPT_ON_COMPLETION | BUFFER_VALID;
        assert_eq!(descriptor.control() & ready, ready);
        assert_eq!(descriptor.0[2].load(Ordering::Relaxed), 0, "second buffer");
        // The write-back destroys the buffer's address.
        descriptor.write(0xDEAD_BEEF, 0xFFFF_FFFF, status);
        true
    }

    /// Sends a frame: its buffer's address and length.
    fn send(&mut self) -> Option<(u32, u32)> {
        let descriptor = self.take()?;
        let control = descriptor.control();
        assert_eq!(control & WHOLE_FRAME, WHOLE_FRAME);
        let length = descriptor.0[2].load(Ordering::Relaxed);
        assert_eq!(control & LENGTH_MASK, length);
        let buffer = descriptor.0[0].load(Ordering::Relaxed);
        descriptor.write(buffer, length, control & !OWN);
        Some((buffer, length))
    }
}

#[test]
fn received_frames_come_out_in_order_around_the_ring() {
    let memory = descriptors();
    let mut ring = ReceiveRing::start(&memory, PLACE);
    let mut dma = Dma {
        descriptors: &memory,
        next: 0,
        tail: ring.first_tail(),
    };
    for length in 60..60 + 5 * N as u32 {
        assert_eq!(ring.received(), Received::Nothing);
        assert!(dma.receive(WHOLE_FRAME | length));
        assert_eq!(ring.received(), Received::Frame(length as usize));
        assert_eq!(ring.index(), (length as usize - 60) % N);
        dma.tail = ring.give_back();
    }
}

#[test]
fn a_burst_fills_all_descriptors_but_one_and_the_ring_recovers() {
    let memory = descriptors();
    let mut ring = ReceiveRing::start(&memory, PLACE);
    let mut dma = Dma {
        descriptors: &memory,
        next: 0,
        tail: ring.first_tail(),
    };
    for _ in 0..3 {
        let taken = (0..2 * N).take_while(|_| dma.receive(WHOLE_FRAME | 64)).count();
        assert_eq!(taken, N - 1);
        for _ in 0..taken {
            assert_eq!(ring.received(), Received::Frame(64));
            dma.tail = ring.give_back();
        }
        assert_eq!(ring.received(), Received::Nothing);
    }
}

#[test]
fn the_dma_never_reaches_a_descriptor_that_was_just_given_back() {
    let memory = descriptors();
    let mut ring = ReceiveRing::start(&memory, PLACE);
    let mut dma = Dma {
        descriptors: &memory,
        next: 0,
        tail: ring.first_tail(),
    };
    while dma.receive(WHOLE_FRAME | 64) {}
    let given = ring.index();
    dma.tail = ring.give_back();
    assert!(dma.receive(WHOLE_FRAME | 64), "one descriptor was freed");
    assert!(!dma.receive(WHOLE_FRAME | 64));
    assert_eq!(dma.next, given, "the DMA waits at the descriptor given back");
}

#[test]
fn damaged_cut_and_context_descriptors_are_unusable() {
    const FIRST: u32 = 1 << 29;
    const LAST: u32 = 1 << 28;
    for status in [
        WHOLE_FRAME | ERROR_SUMMARY | 64,
        WHOLE_FRAME | CONTEXT | 64,
        FIRST | 1536,
        LAST | 64,
        WHOLE_FRAME | (PLACE.buffer_bytes + 1),
        0,
    ] {
        let memory = descriptors();
        let mut ring = ReceiveRing::start(&memory, PLACE);
        let mut dma = Dma {
            descriptors: &memory,
            next: 0,
            tail: ring.first_tail(),
        };
        assert!(dma.receive(status));
        assert_eq!(ring.received(), Received::Unusable, "status {status:#x}");
        dma.tail = ring.give_back();
        assert!(dma.receive(WHOLE_FRAME | 60));
        assert_eq!(ring.received(), Received::Frame(60), "after status {status:#x}");
    }
}

#[test]
fn frames_are_sent_from_their_own_buffers_with_their_lengths() {
    let memory = descriptors();
    let mut ring = TransmitRing::start(&memory, PLACE);
    let mut dma = Dma {
        descriptors: &memory,
        next: 0,
        tail: PLACE.descriptors,
    };
    assert_eq!(dma.send(), None);
    for frame in 0..3 * N {
        assert!(ring.has_room());
        let buffer = PLACE.buffers + ring.index() as u32 * PLACE.buffer_bytes;
        dma.tail = ring.hand_over(60 + frame);
        assert_eq!(dma.send(), Some((buffer, 60 + frame as u32)));
        assert_eq!(dma.send(), None);
    }
}

#[test]
fn a_full_transmit_ring_refuses_and_loses_nothing() {
    let memory = descriptors();
    let mut ring = TransmitRing::start(&memory, PLACE);
    let mut dma = Dma {
        descriptors: &memory,
        next: 0,
        tail: PLACE.descriptors,
    };
    let mut handed: Vec<u32> = Vec::new();
    while ring.has_room() {
        handed.push(60 + handed.len() as u32);
        dma.tail = ring.hand_over(59 + handed.len());
    }
    assert_eq!(handed.len(), N - 1);
    let sent: Vec<u32> = core::iter::from_fn(|| dma.send().map(|(_, length)| length)).collect();
    assert_eq!(sent, handed);
    assert!(ring.has_room());
}

#[test]
fn memory_that_holds_anything_at_power_on_makes_no_frame() {
    let memory = descriptors();
    for descriptor in &memory {
        descriptor.write(u32::MAX, u32::MAX, u32::MAX);
    }
    assert!(TransmitRing::start(&memory, PLACE).has_room());
    let ring = ReceiveRing::start(&memory, PLACE);
    assert_eq!(ring.received(), Received::Nothing);
}

#[test]
fn rings_restarted_after_a_bus_error_discard_frames_in_progress_and_work() {
    let memory = descriptors();
    for frames in 0..N {
        // The DMA stops in the middle of whatever it does: some frames received, none fetched, one half written.
        let mut ring = ReceiveRing::start(&memory, PLACE);
        let mut dma = Dma {
            descriptors: &memory,
            next: 0,
            tail: ring.first_tail(),
        };
        assert_eq!(ring.received(), Received::Nothing, "after {frames} frames");
        assert!((0..frames).all(|_| dma.receive(WHOLE_FRAME | 64)));
        memory[frames].write(0xDEAD_BEEF, 0xFFFF_FFFF, OWN);
        for _ in 0..frames {
            assert_eq!(ring.received(), Received::Frame(64));
            ring.give_back();
        }
        assert_eq!(ring.received(), Received::Nothing, "after {frames} frames");
    }
    let mut ring = TransmitRing::start(&memory, PLACE);
    while ring.has_room() {
        ring.hand_over(60);
    }
    let mut ring = TransmitRing::start(&memory, PLACE);
    assert!(ring.has_room());
    let tail = ring.hand_over(100);
    let mut dma = Dma {
        descriptors: &memory,
        next: 0,
        tail,
    };
    assert_eq!(dma.send().map(|(_, length)| length), Some(100));
    assert_eq!(dma.send(), None, "what waited before the error is not sent");
}
