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

    /// Whether the descriptor belongs to the DMA, which has not written it back yet.
    pub fn is_with_dma(&self) -> bool {
        self.control() & OWN != 0
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
        !self.descriptor(index).is_with_dma()
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
mod tests;
