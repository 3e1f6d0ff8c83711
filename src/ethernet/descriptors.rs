//! DMA descriptor rings of the Ethernet MAC in STM32H5 and STM32H7.
//!
//! The rings are words in memory that the DMA reads and writes; all logic that needs neither addresses nor registers is
//! here and runs on the host. A descriptor belongs to the DMA only while its OWN bit is set *and* it is before the tail
//! pointer. One descriptor of either ring always stays behind the tail: the DMA fetches a descriptor's address word
//! before its OWN bit, so it must not come near one that is being written, and a full ring must differ from an empty
//! one.
//!
//! Formats: RM0433, chapter "Ethernet (ETH)", normal descriptors in read and write-back form.

use core::sync::atomic::{AtomicU32, Ordering};

/// Bytes from one descriptor to the next.
pub const DESCRIPTOR_BYTES: u32 = 16;

/// Word 3: the DMA owns the descriptor.
const OWN: u32 = 1 << 31;
/// Word 3 of a receive descriptor: interrupt when it is written back.
const INTERRUPT_ON_COMPLETION: u32 = 1 << 30;
/// Word 3, written back: this is a context descriptor, not a frame.
const CONTEXT: u32 = 1 << 30;
/// Word 3: the frame starts and ends here. For transmission, padding and check sequence are added, no checksum.
const WHOLE_FRAME: u32 = 1 << 29 | 1 << 28;
/// Word 3 of a receive descriptor: the buffer's address is valid.
const BUFFER_VALID: u32 = 1 << 24;
/// Word 3, written back: any receive error.
const ERROR_SUMMARY: u32 = 1 << 15;
/// Word 3: frame length, bytes.
const LENGTH_MASK: u32 = 0x7FFF;

/// One descriptor in memory.
#[repr(C, align(16))]
pub struct Descriptor([AtomicU32; 4]);

const _: () = assert!(size_of::<Descriptor>() == DESCRIPTOR_BYTES as usize);

impl Descriptor {
    /// A descriptor with all words zero, which belongs to the processor.
    pub const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; 4])
    }

    #[inline]
    fn control(&self) -> u32 {
        self.0[3].load(Ordering::Acquire)
    }

    #[inline]
    fn write(&self, buffer: u32, length: u32, control: u32) {
        self.0[0].store(buffer, Ordering::Relaxed);
        self.0[1].store(0, Ordering::Relaxed);
        self.0[2].store(length, Ordering::Relaxed);
        self.0[3].store(control, Ordering::Release);
    }
}

impl Default for Descriptor {
    fn default() -> Self {
        Self::new()
    }
}

/// Addresses of a ring, as seen by the DMA.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Address of the first descriptor.
    pub descriptors: u32,
    /// Address of the first descriptor's buffer.
    pub buffers: u32,
    /// Length of each buffer, and the distance between two buffers, bytes.
    pub buffer_bytes: u32,
}

/// `N` descriptors, a power of two of at least 4, with a buffer each, used in turn.
struct Ring<'a, const N: usize> {
    descriptors: &'a [Descriptor; N],
    place: Place,
    /// Always below `N`.
    next: usize,
}

impl<'a, const N: usize> Ring<'a, N> {
    const MASK: usize = {
        assert!(N.is_power_of_two() && N >= 4, "ring length");
        N - 1
    };

    const fn descriptor(&self, index: usize) -> &'a Descriptor {
        &self.descriptors[index & Self::MASK]
    }

    const fn address(&self, index: usize) -> u32 {
        self.place.descriptors + (index & Self::MASK) as u32 * DESCRIPTOR_BYTES
    }

    const fn buffer(&self) -> u32 {
        self.place.buffers + self.next as u32 * self.place.buffer_bytes
    }

    const fn advance(&mut self) {
        self.next = (self.next + 1) & Self::MASK;
    }

    fn is_ours(&self, index: usize) -> bool {
        self.descriptor(index).control() & OWN == 0
    }
}

/// State of the current receive descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// The DMA has not finished with the descriptor.
    Nothing,
    /// A complete, undamaged frame of this many bytes without its check sequence.
    Frame(usize),
    /// A damaged frame, a part of a longer frame, or no frame: the descriptor has to be given back.
    Unusable,
}

/// The ring of received frames.
pub struct ReceiveRing<'a, const N: usize>(Ring<'a, N>);

impl<'a, const N: usize> ReceiveRing<'a, N> {
    /// Gives every descriptor to the DMA. The tail pointer to start with is [`ReceiveRing::first_tail`].
    pub fn start(descriptors: &'a [Descriptor; N], place: Place) -> Self {
        let mut ring = Self(Ring {
            descriptors,
            place,
            next: 0,
        });
        for _ in 0..N {
            ring.give_back();
        }
        ring
    }

    /// Initial tail pointer after [`ReceiveRing::start`]: all but the last descriptor belong to the DMA.
    pub const fn first_tail(&self) -> u32 {
        self.0.address(N - 1)
    }

    /// Index of the current buffer, below `N`. The buffer may be read after [`ReceiveRing::received`] has returned
    /// `Frame`, until [`ReceiveRing::give_back`].
    pub const fn index(&self) -> usize {
        self.0.next
    }

    /// Reads the state of the current descriptor.
    pub fn received(&self) -> Received {
        let status = self.0.descriptor(self.0.next).control();
        let length = status & LENGTH_MASK;
        if status & OWN != 0 {
            Received::Nothing
        } else if status & (WHOLE_FRAME | CONTEXT | ERROR_SUMMARY) == WHOLE_FRAME && length <= self.0.place.buffer_bytes
        {
            Received::Frame(length as usize)
        } else {
            Received::Unusable
        }
    }

    /// Prepares the current descriptor for another frame and returns the new tail pointer: this descriptor, so that the
    /// DMA gets the one before it. The memory write has to be complete before the register is written.
    pub fn give_back(&mut self) -> u32 {
        let tail = self.0.address(self.0.next);
        let control = OWN | INTERRUPT_ON_COMPLETION | BUFFER_VALID;
        self.0.descriptor(self.0.next).write(self.0.buffer(), 0, control);
        self.0.advance();
        tail
    }
}

/// The ring of frames to send.
pub struct TransmitRing<'a, const N: usize>(Ring<'a, N>);

impl<'a, const N: usize> TransmitRing<'a, N> {
    /// Empties the ring. The tail pointer to start with is the first descriptor's address.
    pub fn start(descriptors: &'a [Descriptor; N], place: Place) -> Self {
        for descriptor in descriptors {
            descriptor.write(0, 0, 0);
        }
        Self(Ring {
            descriptors,
            place,
            next: 0,
        })
    }

    /// Whether a frame fits besides the one descriptor that stays behind the tail.
    pub fn has_room(&self) -> bool {
        self.0.is_ours(self.0.next) && self.0.is_ours(self.0.next + 1)
    }

    /// Index of the current buffer, below `N`. The buffer may be written after [`TransmitRing::has_room`] has returned
    /// true, until [`TransmitRing::hand_over`].
    pub const fn index(&self) -> usize {
        self.0.next
    }

    /// Passes the frame of `length` bytes in the current buffer to the DMA and returns the new tail pointer: the next
    /// descriptor. The memory write has to be complete before the register is written.
    pub fn hand_over(&mut self, length: usize) -> u32 {
        let length = (length as u32).min(self.0.place.buffer_bytes);
        let control = OWN | WHOLE_FRAME | length;
        self.0.descriptor(self.0.next).write(self.0.buffer(), length, control);
        self.0.advance();
        self.0.address(self.0.next)
    }
}

#[cfg(test)]
mod tests {
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
}
