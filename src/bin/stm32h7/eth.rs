//! Ethernet MAC and DMA of the STM32H743: descriptor rings behind the network driver trait.
//!
//! The critical tasks own this driver, so it never locks, blocks, logs or panics. Frames are built and read in the
//! DMA's own buffers; a token lends the buffer of one descriptor and passes it on when the token is consumed. There is
//! no interrupt for a sent frame, and wakers are ignored: the caller polls from the interrupt of a received frame. The
//! library's `ethernet::descriptors` manages the ownership of descriptors; memory, registers and their order are here.
//!
//! Foreign frames: the MAC's filter only passes frames that EtherCAT's own master has sent (`keep_foreign_frames_out`).
//! With EtherCAT in UDP, other frames are needed; a run of `bus_frame` then takes at most a ring of them, and the
//! timer's tasks come first: among waiting interrupts of one priority the core takes the lowest number, and ETH's
//! number is higher than both of TIM1's. Foreign frames thus cost a critical task at most one such run, and a reply
//! that they push out of the ring is a lost frame like any other.
//!
//! Register layouts: RM0433, chapter "Ethernet (ETH)".

use super::{phy, timer};
use crate::shared::frames;
use core::cell::UnsafeCell;
use core::ptr;
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Context;
use embassy_net_driver::{Capabilities, Driver, HardwareAddress, LinkState};
use etherpen::black_box::{Direction, FrameNote};
use etherpen::board::PortState;
use etherpen::ethernet::descriptors::{DESCRIPTOR_BYTES, Descriptor, Place, ReceiveRing, Received, TransmitRing};
use etherpen::robot_bus::MASTER_ADDRESS;
use stm32_metapac::{ETH, RCC, SYSCFG, syscfg::vals::EthSelPhy};

/// Descriptors of a ring. A cycle exchanges two frames; the rest is for foreign frames until the next interrupt.
pub(crate) const RING_LENGTH: usize = 8;
/// Bytes of a buffer: a frame of full length, its check sequence, rounded up to whole cache lines.
const BUFFER_SIZE: usize = 1536;
/// Longest frame without its check sequence, bytes.
const FRAME_LENGTH_MAX: usize = 1514;
/// Transfers of a bus burst of the DMA: short, so that it shares the bus matrix with the processor.
const BURST_LENGTH: u8 = 8;

/// Mask of an address filter: the first byte on the wire, the lowest of the address' low half.
const FIRST_BYTE_IGNORED: u8 = 1;

const _: () = assert!(FRAME_LENGTH_MAX + 4 <= BUFFER_SIZE && BUFFER_SIZE.is_multiple_of(32));

/// Received frames that were dropped: damaged, cut, or longer than a buffer.
pub(crate) static FRAMES_DROPPED: AtomicU32 = AtomicU32::new(0);
/// Times the receive ring was full, so that frames were lost in the MAC.
pub(crate) static RING_EXHAUSTED: AtomicU32 = AtomicU32::new(0);
/// Fatal bus errors of the DMA; each resets the MAC, which restarts with empty rings.
pub(crate) static BUS_ERRORS: AtomicU32 = AtomicU32::new(0);

/// Sum of all errors. Safe in any task.
pub(crate) fn errors() -> u32 {
    [&FRAMES_DROPPED, &RING_EXHAUSTED, &BUS_ERRORS]
        .iter()
        .fold(0, |sum, count| sum.wrapping_add(count.load(Ordering::Relaxed)))
}

#[repr(C, align(32))]
struct Buffer(UnsafeCell<[u8; BUFFER_SIZE]>);

/// Descriptors with a buffer each.
#[repr(C)]
struct Storage {
    descriptors: [Descriptor; RING_LENGTH],
    buffers: [Buffer; RING_LENGTH],
}

// SAFETY: descriptors are atomics. A buffer is reached through a token alone, which borrows the ring of the only
// `Ethernet` mutably, and only while the DMA does not own its descriptor.
unsafe impl Sync for Storage {}

impl Storage {
    const fn new() -> Self {
        Storage {
            descriptors: [const { Descriptor::new() }; RING_LENGTH],
            buffers: [const { Buffer(UnsafeCell::new([0; BUFFER_SIZE])) }; RING_LENGTH],
        }
    }

    fn place(&self) -> Place {
        Place {
            descriptors: self.descriptors.as_ptr() as u32,
            buffers: self.buffers.as_ptr() as u32,
            buffer_bytes: BUFFER_SIZE as u32,
        }
    }

    /// The start of a buffer; the index is masked, so that no bounds check can panic.
    fn buffer(&self, index: usize) -> *mut u8 {
        self.buffers[index & (RING_LENGTH - 1)].0.get().cast()
    }
}

const _: () = assert!(RING_LENGTH.is_power_of_two() && size_of::<Buffer>() == BUFFER_SIZE);

// The section lies in SRAM3, is not cached (`memory.rs`) and not loaded at start: starting the rings writes every
// descriptor before the DMA runs, and no byte of a buffer is read before the DMA or the processor has written it.
#[unsafe(link_section = ".eth_dma.receive")]
static ETH_DMA_RECEIVE: Storage = Storage::new();
#[unsafe(link_section = ".eth_dma.transmit")]
static ETH_DMA_TRANSMIT: Storage = Storage::new();

type Receive = ReceiveRing<'static, RING_LENGTH>;
type Transmit = TransmitRing<'static, RING_LENGTH>;

/// Both rings, once the DMA runs.
struct Rings {
    receive: Receive,
    transmit: Transmit,
}

/// The MAC, its DMA and both rings. One exists.
pub(crate) struct Ethernet {
    hardware_address: [u8; 6],
    /// Whether frames of other senders are dropped.
    own_frames_only: bool,
    /// None until the DMA's reset has ended.
    rings: Option<Rings>,
}

impl Ethernet {
    /// Clocks the MAC, selects RMII and starts its reset; the pins must be assigned already.
    ///
    /// The reset ends only when the PHY's reference clock runs. Nothing waits for it: the rings start at the first
    /// [`Driver::transmit`] or [`Driver::receive`] after it, so a board without a PHY keeps running with the link down.
    pub(crate) fn new(hardware_address: [u8; 6]) -> Self {
        // The interface is selected while the MAC is held in reset (RM0433, SYSCFG_PMCR).
        RCC.ahb1rstr().modify(|reset| reset.set_ethrst(true));
        SYSCFG.pmcr().modify(|mode| mode.set_eth_sel_phy(EthSelPhy::RMII));
        // SYSCFG is on a slower bus: read back, so that the selection has arrived when the reset ends.
        let _ = SYSCFG.pmcr().read();
        RCC.ahb1enr().modify(|enable| {
            enable.set_ethen(true);
            enable.set_ethtxen(true);
            enable.set_ethrxen(true);
        });
        let _ = RCC.ahb1enr().read();
        RCC.ahb1rstr().modify(|reset| reset.set_ethrst(false));
        reset();
        Ethernet {
            hardware_address,
            own_frames_only: false,
            rings: None,
        }
    }

    /// Sets whether the MAC drops frames that the EtherCAT master has not sent itself: these then need no descriptor,
    /// no interrupt and no time of a critical task. A dedicated EtherCAT wire has no use for other frames.
    pub(crate) fn keep_foreign_frames_out(&mut self, own_frames_only: bool) {
        if self.own_frames_only != own_frames_only {
            self.own_frames_only = own_frames_only;
            self.filter();
        }
    }

    /// Accepts its own address and broadcast, which EtherCAT frames use; if requested, only frames whose sender is the
    /// master. A slave sets a bit of the sender's first byte, so that byte is not compared. Multicast is not needed,
    /// and the check sequence is always verified.
    fn filter(&self) {
        ETH.ethernet_mac()
            .macpfr()
            .write(|filter| filter.set_saf(self.own_frames_only));
    }

    /// Ends the interrupt's request and counts errors. Call it before checking for frames, so that a frame that arrives
    /// meanwhile raises another interrupt.
    pub(crate) fn acknowledge(&mut self) {
        let status = ETH.ethernet_dma().dmacsr();
        let seen = status.read();
        // Every flag is cleared by writing one.
        status.write_value(seen);
        let _ = status.read();
        if seen.rbu() {
            RING_EXHAUSTED.fetch_add(1, Ordering::Relaxed);
        }
        if seen.fbe() {
            BUS_ERRORS.fetch_add(1, Ordering::Relaxed);
            self.rings = None;
            reset();
        }
    }

    /// The rings; starts them once the reset has ended.
    fn rings(&mut self) -> Option<&mut Rings> {
        if self.rings.is_none() && !ETH.ethernet_dma().dmamr().read().swr() {
            self.rings = Some(self.start());
        }
        self.rings.as_mut()
    }

    /// Sets MAC, queues and DMA up after their reset. Bounded: register writes and one pass over the rings.
    fn start(&self) -> Rings {
        let mac = ETH.ethernet_mac();
        // The register has reserved bits that are set after a reset: they are kept.
        mac.maccr().modify(|control| {
            control.set_fes(true);
            control.set_dm(true);
            // Strips padding and check sequence of frames with a length field, and the check sequence of the others.
            control.set_acs(true);
            control.set_cst(true);
        });
        let [_, b, c, d, e, f] = MASTER_ADDRESS;
        mac.macahr(0).write(|high| {
            high.set_addrhi(u16::from_le_bytes([e, f]));
            high.set_mbc(FIRST_BYTE_IGNORED);
            high.set_sa(true);
            high.set_ae(true);
        });
        mac.macalr(0)
            .write(|low| low.set_addrlo(u32::from_le_bytes([0, b, c, d])));
        self.filter();
        let [a, b, c, d, e, f] = self.hardware_address;
        // The write of the low half activates both halves, so it comes last.
        mac.maca0hr().modify(|high| high.set_addrhi(u16::from_le_bytes([e, f])));
        mac.maca0lr()
            .write(|low| low.set_addrlo(u32::from_le_bytes([a, b, c, d])));
        // The MAC's statistics would interrupt at half of their range.
        mac.mmc_rx_interrupt_mask().write(|mask| {
            mask.set_rxcrcerpim(true);
            mask.set_rxalgnerpim(true);
            mask.set_rxucgpim(true);
            mask.set_rxlpiuscim(true);
            mask.set_rxlpitrcim(true);
        });
        mac.mmc_tx_interrupt_mask().write(|mask| {
            mask.set_txscolgpim(true);
            mask.set_txmcolgpim(true);
            mask.set_txgpktim(true);
            mask.set_txlpiuscim(true);
            mask.set_txlpitrcim(true);
        });
        // Store and forward: a frame leaves without underrun, and arrives checked.
        ETH.ethernet_mtl().mtltx_qomr().modify(|mode| mode.set_tsf(true));
        ETH.ethernet_mtl().mtlrx_qomr().modify(|mode| mode.set_rsf(true));
        let rings = start_dma();
        mac.maccr().modify(|control| {
            control.set_te(true);
            control.set_re(true);
        });
        rings
    }
}

/// Starts the reset of MAC, queues and DMA; it clears their settings and the enabled interrupts with them.
fn reset() {
    ETH.ethernet_dma().dmamr().modify(|mode| mode.set_swr(true));
}

fn start_dma() -> Rings {
    let (received, sent) = (ETH_DMA_RECEIVE.place(), ETH_DMA_TRANSMIT.place());
    let rings = Rings {
        receive: ReceiveRing::start(&ETH_DMA_RECEIVE.descriptors, received),
        transmit: TransmitRing::start(&ETH_DMA_TRANSMIT.descriptors, sent),
    };
    let dma = ETH.ethernet_dma();
    // Descriptors follow each other without a gap.
    const { assert!(size_of::<Descriptor>() == DESCRIPTOR_BYTES as usize) };
    dma.dmaccr().modify(|control| control.set_dsl(0));
    // Ring length registers hold the index of the last descriptor.
    dma.dmactx_dlar().write(|list| list.0 = sent.descriptors);
    dma.dmactx_rlr()
        .write(|length| length.set_tdrl((RING_LENGTH - 1) as u16));
    dma.dmacrx_dlar().write(|list| list.0 = received.descriptors);
    dma.dmacrx_rlr()
        .write(|length| length.set_rdrl((RING_LENGTH - 1) as u16));
    dma.dmactx_cr().modify(|control| control.set_txpbl(BURST_LENGTH));
    dma.dmacrx_cr().modify(|control| {
        control.set_rxpbl(BURST_LENGTH);
        control.set_rbsz(BUFFER_SIZE as u16);
    });
    // Normal: a frame arrived. Abnormal: no descriptor was left, or the bus refused an access.
    dma.dmacier().write(|enable| {
        enable.set_nie(true);
        enable.set_rie(true);
        enable.set_aie(true);
        enable.set_rbue(true);
        enable.set_fbee(true);
    });
    // The descriptors are in memory before the DMA is notified.
    cortex_m::asm::dsb();
    dma.dmactx_dtpr().write(|tail| tail.0 = sent.descriptors);
    dma.dmacrx_dtpr().write(|tail| tail.0 = rings.receive.first_tail());
    dma.dmactx_cr().modify(|control| control.set_st(true));
    dma.dmacrx_cr().modify(|control| control.set_sr(true));
    rings
}

/// Returns the receive descriptor in turn to the DMA.
fn give_back(ring: &mut Receive) {
    let tail = ring.give_back();
    // The descriptor is in memory before the DMA is notified.
    cortex_m::asm::dsb();
    ETH.ethernet_dma().dmacrx_dtpr().write(|register| register.0 = tail);
}

/// Length of the received frame in turn, bytes; unusable ones are given back and counted, at most one ring of them.
fn received_length(ring: &mut Receive) -> Option<usize> {
    for _ in 0..RING_LENGTH {
        match ring.received() {
            Received::Nothing => return None,
            Received::Frame(length) => return Some(length),
            Received::Unusable => drop_frame(ring),
        }
    }
    None
}

#[cold]
#[inline(never)]
fn drop_frame(ring: &mut Receive) {
    FRAMES_DROPPED.fetch_add(1, Ordering::Relaxed);
    give_back(ring);
}

/// Whether the DMA has not begun to write into a received frame's buffer since the frame was given back. Safe in any
/// task.
pub(crate) fn is_readable(note: &FrameNote) -> bool {
    if note.direction() == Direction::Sent {
        return true;
    }
    let first = ETH_DMA_RECEIVE.buffers.as_ptr() as u32;
    let index = note.place.wrapping_sub(first) as usize / BUFFER_SIZE;
    let Some(descriptor) = ETH_DMA_RECEIVE.descriptors.get(index) else {
        return false;
    };
    let current = ETH.ethernet_dma().dmaccarx_dr().read().0;
    descriptor.is_with_dma() && current != ptr::from_ref(descriptor) as u32
}

impl Driver for Ethernet {
    type RxToken<'a> = RxToken<'a>;
    type TxToken<'a> = TxToken<'a>;

    fn receive(&mut self, _context: &mut Context) -> Option<(RxToken<'_>, TxToken<'_>)> {
        let Rings { receive, transmit } = self.rings()?;
        let length = received_length(receive)?;
        transmit
            .has_room()
            .then_some((RxToken { ring: receive, length }, TxToken { ring: transmit }))
    }

    fn transmit(&mut self, _context: &mut Context) -> Option<TxToken<'_>> {
        let transmit = &mut self.rings()?.transmit;
        transmit.has_room().then_some(TxToken { ring: transmit })
    }

    fn link_state(&mut self, _context: &mut Context) -> LinkState {
        if self.rings.is_some() && phy::port() == PortState::Up {
            LinkState::Up
        } else {
            LinkState::Down
        }
    }

    fn capabilities(&self) -> Capabilities {
        let mut capabilities = Capabilities::default();
        capabilities.max_transmission_unit = FRAME_LENGTH_MAX;
        capabilities.max_burst_size = Some(RING_LENGTH - 1);
        capabilities
    }

    fn hardware_address(&self) -> HardwareAddress {
        HardwareAddress::Ethernet(self.hardware_address)
    }
}

/// A received frame; dropped without being consumed, it is offered again.
pub(crate) struct RxToken<'a> {
    ring: &'a mut Receive,
    length: usize,
}

impl embassy_net_driver::RxToken for RxToken<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, read: F) -> R {
        let buffer = ETH_DMA_RECEIVE.buffer(self.ring.index());
        // SAFETY: `received` has seen the descriptor in turn without OWN (acquire), so the DMA has finished with the
        // buffer, and it starts again only after `give_back`; the token's `&mut` keeps everyone else away until then.
        let frame = unsafe { core::slice::from_raw_parts_mut(buffer, self.length.min(BUFFER_SIZE)) };
        frames::note(Direction::Received, frame.as_ptr(), frame.len(), timer::free_run());
        let result = read(frame);
        give_back(self.ring);
        result
    }
}

/// Room for one frame.
pub(crate) struct TxToken<'a> {
    ring: &'a mut Transmit,
}

impl embassy_net_driver::TxToken for TxToken<'_> {
    /// `length` is at most the capabilities' frame length; a longer one is cut to the buffer.
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, length: usize, build: F) -> R {
        let buffer = ETH_DMA_TRANSMIT.buffer(self.ring.index());
        let length = length.min(BUFFER_SIZE);
        // SAFETY: `has_room` has seen the descriptor in turn without OWN (acquire), so the DMA has finished with the
        // buffer, and it starts again only after `hand_over`; the token's `&mut` keeps everyone else away until then.
        let frame = unsafe { core::slice::from_raw_parts_mut(buffer, length) };
        let result = build(frame);
        frames::note(Direction::Sent, frame.as_ptr(), length, timer::free_run());
        let tail = self.ring.hand_over(length);
        // Frame and descriptor are in memory before the DMA is notified.
        cortex_m::asm::dsb();
        ETH.ethernet_dma().dmactx_dtpr().write(|register| register.0 = tail);
        result
    }
}
