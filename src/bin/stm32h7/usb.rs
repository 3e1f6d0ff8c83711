//! The board's own USB connector as a second port of the link: a CDC-ACM serial port on OTG_FS.
//!
//! `usb-device` and `usbd-serial` implement the protocol, `synopsys-usb-otg` the controller's registers; clock, supply,
//! names, and the transfer of bytes between packets and the link's queues are here. All of it runs at the link's
//! priority. At most `EVENTS_PER_MS_MAX` events reported by the controller's flag registers are served in a
//! millisecond: if the host sends more, the rest waits in the controller, which makes the host retry. A packet is taken
//! only when the queue has room for it, so nothing is lost; data for a host that has disconnected are discarded. The
//! driver waits for the controller without a limit only while it empties a FIFO or is reset, for a few clocks. If such
//! a wait never ended, the watchdog would reset the chip, as for any task that hangs, also during start-up
//! (`start_up.rs`).
//!
//! Clock: HSI48, trimmed by the host's start of frame, which comes every millisecond. It needs neither a PLL nor the
//! ST-LINK's 8 MHz, so a board without these can report that over USB. The connector's supply is not monitored (its
//! sense pin is not used): a pulled cable is a bus without frames, and a new connection begins with a bus reset.
//!
//! Registers: RM0433, chapters "OTG_HS", "CRS" and "PWR".

use super::clocks::BUS_HZ;
use super::start_up::Waits;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};
use etherpen::controller::HostBytes;
use heapless::String;
use stm32_metapac::crs::vals::Syncsrc;
use stm32_metapac::{CRS, Interrupt, PWR, RCC, USB_OTG_FS};
use synopsys_usb_otg::{PhyType, UsbBus, UsbPeripheral};
use usb_device::bus::{UsbBus as _, UsbBusAllocator};
use usb_device::device::{StringDescriptors, UsbDevice, UsbDeviceBuilder, UsbDeviceState, UsbVidPid};
use usb_device::{LangID, UsbError};
use usbd_serial::{CdcAcmClass, USB_CLASS_CDC};

/// Vendor and product number: the first test number of pid.codes. It is not assigned to any product, so it must not be
/// used outside of development.
const VENDOR_PRODUCT: UsbVidPid = UsbVidPid(0x1209, 0x0001);
/// Names that the host shows. `etherpen doctor` recognises the port by them and by the numbers above.
const MANUFACTURER: &str = "etherpen";
const PRODUCT: &str = "etherpen robot controller";
/// Largest current drawn from the connector, mA; the board has its own supply.
const CURRENT_MAX_MA: usize = 100;

/// Longest packet of an endpoint at full speed, bytes.
const PACKET_BYTES: usize = 64;
/// Longest packet that is sent: a shorter one than the longest ends a transfer, so no empty one has to follow.
const SENT_PACKET_BYTES: usize = PACKET_BYTES - 1;
/// Words that keep received packets: those of the control and of the data endpoint.
const MEMORY_WORDS: usize = 2 * PACKET_BYTES / 4;
/// Events of the controller that are served in a millisecond: the link's full rate takes six.
const EVENTS_PER_MS_MAX: u32 = 32;
/// The endpoint of control transfers, from the host.
const CONTROL_OUT: u8 = 0;
/// Speed code (OTG_DSTS) that neither this controller nor its driver knows.
const LOW_SPEED: u8 = 0b10;
/// Longest wait for the supply detector before the port is started anyway, ms.
const SUPPLY_WAIT_MS: u32 = 10;
/// The start of frame of OTG_FS as the source of the clock recovery (CRS_CFGR, revision V): the value that the register
/// description leaves unnamed; the one named "USB" is OTG_HS.
const FRAMES_OF_OTG_FS: Syncsrc = Syncsrc::from_bits(0b11);

/// Events left in this millisecond.
static EVENTS_LEFT: AtomicU32 = AtomicU32::new(0);

/// The controller.
struct Otg;

// SAFETY: the register block is that of OTG_FS, which only `Usb` uses, except for its global interrupt switch, written
// at the same priority; it exists as long as the chip runs. `Usb::start` has already done the work of `enable`.
unsafe impl UsbPeripheral for Otg {
    const REGISTERS: *const () = USB_OTG_FS.as_ptr().cast_const().cast();
    // The chip's OTG_FS has the register layout of OTG_HS (RM0433: OTG_HS2) with only the internal full-speed PHY.
    const HIGH_SPEED: bool = true;
    const FIFO_DEPTH_WORDS: usize = 1024;
    const ENDPOINT_COUNT: usize = 9;

    fn enable() {}

    fn ahb_frequency_hz(&self) -> u32 {
        BUS_HZ
    }

    fn phy_type(&self) -> PhyType {
        PhyType::InternalFullSpeed
    }
}

/// Permanent memory of the port.
pub(crate) struct Memory {
    packets: [u32; MEMORY_WORDS],
    bus: MaybeUninit<UsbBusAllocator<UsbBus<Otg>>>,
    serial_number: String<24>,
    usb: MaybeUninit<Usb>,
}

impl Memory {
    pub(crate) const fn new() -> Self {
        Self {
            packets: [0; MEMORY_WORDS],
            bus: MaybeUninit::uninit(),
            serial_number: String::new(),
            usb: MaybeUninit::uninit(),
        }
    }
}

/// The port with the link's ends of the byte queues.
pub(crate) struct Usb {
    device: UsbDevice<'static, UsbBus<Otg>>,
    port: CdcAcmClass<'static, UsbBus<Otg>>,
    bytes: &'static mut HostBytes<'static>,
    /// Bytes that could not be sent yet.
    packet: [u8; SENT_PACKET_BYTES],
    packet_bytes: usize,
    open: bool,
}

impl Usb {
    /// Starts clock, supply and controller; the pins must be assigned already. `unique` distinguishes boards.
    ///
    /// Never inlined: what it builds would lie in the frame of the start-up, the deepest of all stacks.
    #[inline(never)]
    pub(crate) fn start(
        memory: &'static mut Memory,
        unique: &[u8; 12],
        bytes: &'static mut HostBytes<'static>,
        waits: &mut Waits,
    ) -> &'static mut Self {
        start_clock_and_supply(waits);
        let digits = unique.iter().flat_map(|byte| [byte >> 4, byte & 0xF]);
        for digit in digits.filter_map(|digit| char::from_digit(digit.into(), 16)) {
            // There is room: two digits a byte.
            let _ = memory.serial_number.push(digit);
        }
        let bus = memory.bus.write(UsbBus::new(Otg, &mut memory.packets));
        let port = CdcAcmClass::new(bus, PACKET_BYTES as u16);
        let names = StringDescriptors::new(LangID::EN_US)
            .manufacturer(MANUFACTURER)
            .product(PRODUCT)
            .serial_number(&memory.serial_number);
        let builder = UsbDeviceBuilder::new(bus, VENDOR_PRODUCT)
            .device_class(USB_CLASS_CDC)
            .self_powered(true)
            .max_packet_size_0(PACKET_BYTES as u8)
            .and_then(|builder| builder.max_power(CURRENT_MAX_MA))
            .and_then(|builder| builder.strings(&[names]));
        let Ok(builder) = builder else {
            panic!("one language, a packet size and a current that exist")
        };
        memory.usb.write(Self {
            device: builder.build(),
            port,
            bytes,
            packet: [0; SENT_PACKET_BYTES],
            packet_bytes: 0,
            open: false,
        })
    }

    /// Serves the events that the controller reports, as many as are left in this millisecond.
    pub(crate) fn service(&mut self) {
        let mut left = EVENTS_LEFT.load(Ordering::Relaxed);
        loop {
            self.watch();
            self.receive();
            self.transmit();
            if !reports() {
                break;
            }
            let Some(fewer) = left.checked_sub(1) else {
                set_interrupt(false);
                break;
            };
            left = fewer;
            drop_invalid_events();
            self.device.poll(&mut [&mut self.port]);
            // A packet that the control endpoint did not expect and left would block it, and all behind it.
            let _ = self.device.bus().read(CONTROL_OUT.into(), &mut [0; PACKET_BYTES]);
        }
        EVENTS_LEFT.store(left, Ordering::Relaxed);
    }

    /// Notes whether a program on the host has the port open.
    fn watch(&mut self) {
        let open = self.device.state() == UsbDeviceState::Configured && self.port.dtr();
        if open != self.open {
            self.open = open;
            defmt::info!("USB: port {=str}", if open { "open" } else { "closed" });
        }
    }

    fn receive(&mut self) {
        let mut packet = [0; PACKET_BYTES];
        if self.bytes.room() < packet.len() {
            return;
        }
        if let Ok(count) = self.port.read_packet(&mut packet) {
            self.bytes.received(packet.get(..count).unwrap_or_default());
        }
    }

    fn transmit(&mut self) {
        if !self.open {
            self.bytes.discard();
            self.packet_bytes = 0;
            return;
        }
        if self.packet_bytes == 0 {
            self.packet_bytes = self.bytes.to_send(&mut self.packet);
        }
        let packet = self.packet.get(..self.packet_bytes).unwrap_or_default();
        if !packet.is_empty() && self.port.write_packet(packet) != Err(UsbError::WouldBlock) {
            self.packet_bytes = 0;
        }
    }
}

/// Renews the port's events for a new millisecond and releases its task; called by the link task, which has the same
/// priority.
pub(crate) fn release() {
    EVENTS_LEFT.store(EVENTS_PER_MS_MAX, Ordering::Relaxed);
    set_interrupt(true);
    rtic::pend(Interrupt::OTG_FS);
}

/// Whether the controller reports anything that is enabled.
fn reports() -> bool {
    USB_OTG_FS.gintsts().read().0 & USB_OTG_FS.gintmsk().read().0 != 0
}

/// Removes invalid states from the controller, at which the driver would panic.
fn drop_invalid_events() {
    let flags = USB_OTG_FS.gintsts().read();
    if flags.rxflvl() && usize::from(USB_OTG_FS.grxstsr().read().epnum()) >= Otg::ENDPOINT_COUNT {
        let _ = USB_OTG_FS.grxstsp().read();
    }
    if flags.enumdne() && USB_OTG_FS.dsts().read().enumspd().to_bits() == LOW_SPEED {
        USB_OTG_FS.gintsts().write(|clear| clear.set_enumdne(true));
    }
}

fn set_interrupt(enabled: bool) {
    USB_OTG_FS.gahbcfg().modify(|bus| bus.set_gint(enabled));
}

fn start_clock_and_supply(waits: &mut Waits) {
    RCC.apb1henr().modify(|enable| enable.set_crsen(true));
    // The clock enable takes effect two bus cycles later; a read back spends them.
    let _ = RCC.apb1henr().read();
    CRS.cfgr().modify(|recovery| recovery.set_syncsrc(FRAMES_OF_OTG_FS));
    CRS.cr().modify(|recovery| {
        recovery.set_autotrimen(true);
        recovery.set_cen(true);
    });
    // The board feeds VDD33USB with 3.3 V; the chip's own regulator stays off, the detector lets the PHY work.
    PWR.cr3().modify(|supply| supply.set_usb33den(true));
    if !waits.wait(SUPPLY_WAIT_MS, || PWR.cr3().read().usb33rdy()) {
        defmt::error!("USB: no supply at VDD33USB");
    }
    RCC.ahb1enr().modify(|enable| enable.set_usb_otg_fsen(true));
    let _ = RCC.ahb1enr().read();
    // Else the controller waits, while the core sleeps, for the clock of an external PHY that is not there.
    RCC.ahb1lpenr().modify(|asleep| asleep.set_usb_otg_fs_ulpilpen(false));
}
