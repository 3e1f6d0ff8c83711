//! Addresses and fields of an EtherCAT slave controller's registers.
//!
//! The map is that of IEC 61158-4-12 (data link layer management), which every slave controller's public data sheet
//! repeats. All addresses are byte addresses in the slave's own memory; process memory starts at [`PROCESS_MEMORY`].
//!
//! Invariant: only constants and plain field structures; independent of the use of a slave.

mod clock;
mod port;

pub use clock::*;
pub use port::{DlStatus, ErrorCounters, PORTS, PortErrors, PortMedium, PortStatus, port_descriptor, port_media};

use super::{Error, check_len, check_room, read_u8, read_u16, read_u32, write_bytes};

/// Type of the slave controller, 1 byte.
pub const TYPE: u16 = 0x0000;
/// Revision of the slave controller, 1 byte.
pub const REVISION: u16 = 0x0001;
/// Build of the slave controller, 2 bytes.
pub const BUILD: u16 = 0x0002;
/// Number of FMMUs, 1 byte.
pub const FMMU_COUNT: u16 = 0x0004;
/// Number of sync managers, 1 byte.
pub const SYNC_MANAGER_COUNT: u16 = 0x0005;
/// Process memory in KiB, 1 byte.
pub const MEMORY_KIB: u16 = 0x0006;
/// Port descriptor, 1 byte, see [`port_media`].
pub const PORT_DESCRIPTOR: u16 = 0x0007;
/// Features supported, 2 bytes, see the `FEATURE_` constants.
pub const FEATURES: u16 = 0x0008;
/// Configured station address, 2 bytes; 0 after power-up.
pub const STATION_ADDRESS: u16 = 0x0010;
/// Station alias, 2 bytes.
pub const STATION_ALIAS: u16 = 0x0012;
/// Data link control, 4 bytes.
pub const DL_CONTROL: u16 = 0x0100;
/// Control of the ports' loops in [`DL_CONTROL`], two bits each; 0: a port without a link closes by itself.
pub const DL_CONTROL_PORTS: u16 = DL_CONTROL + 1;
/// The byte of [`DL_CONTROL`] that lets the slave answer to its alias.
pub const DL_CONTROL_ALIAS_BYTE: u16 = DL_CONTROL + 3;
/// Data link status, 2 bytes: link and loop of each port, see [`DlStatus`].
pub const DL_STATUS: u16 = 0x0110;
/// AL control, 2 bytes: the state requested; bit 4 acknowledges an error.
pub const AL_CONTROL: u16 = 0x0120;
/// AL status, 2 bytes: the actual state; bit 4 is the error flag.
pub const AL_STATUS: u16 = 0x0130;
/// AL status code, 2 bytes: why the last change failed.
pub const AL_STATUS_CODE: u16 = 0x0134;
/// PDI control, 1 byte: type of the interface to the slave's own processor.
pub const PDI_CONTROL: u16 = 0x0140;
/// Configuration of the slave controller, 1 byte.
pub const CONTROLLER_CONFIG: u16 = 0x0141;
/// PDI configuration, 1 byte.
pub const PDI_CONFIG: u16 = 0x0150;
/// SYNC and latch configuration of the PDI, 1 byte.
pub const SYNC_CONFIG: u16 = 0x0151;
/// Extended PDI configuration, 2 bytes.
pub const PDI_CONFIG_EXTENDED: u16 = 0x0152;
/// Event mask of the datagrams' interrupt field, 2 bytes.
pub const EVENT_MASK: u16 = 0x0200;
/// AL event request, 4 bytes.
pub const AL_EVENT: u16 = 0x0220;
/// Receive error counters, 2 bytes a port (invalid frames, receive errors), see [`ErrorCounters`].
pub const RECEIVE_ERRORS: u16 = 0x0300;
/// Forwarded receive error counters, 1 byte a port.
pub const FORWARDED_ERRORS: u16 = 0x0308;
/// Processing unit error counter, 1 byte.
pub const PROCESSING_ERRORS: u16 = 0x030C;
/// PDI error counter, 1 byte.
pub const PDI_ERRORS: u16 = 0x030D;
/// PDI error code, 1 byte.
pub const PDI_ERROR_CODE: u16 = 0x030E;
/// Lost link counters, 1 byte a port.
pub const LOST_LINKS: u16 = 0x0310;
/// Bytes from [`RECEIVE_ERRORS`] to the end of [`LOST_LINKS`]; writing any value clears the counters written.
pub const ERROR_COUNTERS_LEN: usize = 0x14;
/// Watchdog divider, 2 bytes: 40 ns times (value + 2) is the unit of the watchdogs.
pub const WATCHDOG_DIVIDER: u16 = 0x0400;
/// Watchdog time of the process data interface, 2 bytes, in watchdog units; 0 is off.
pub const WATCHDOG_PDI: u16 = 0x0410;
/// Watchdog time of the sync managers, 2 bytes, in watchdog units; 0 is off.
pub const WATCHDOG_SYNC_MANAGER: u16 = 0x0420;
/// Watchdog status, 2 bytes: bit 0 is set while the sync managers' watchdog has not expired.
pub const WATCHDOG_STATUS: u16 = 0x0440;
/// Watchdog expiry counter of the sync managers, 1 byte.
pub const WATCHDOG_COUNTER: u16 = 0x0442;
/// Watchdog expiry counter of the process data interface, 1 byte.
pub const WATCHDOG_COUNTER_PDI: u16 = 0x0443;
/// SII configuration, 1 byte: bit 0 gives access to the PDI, bit 1 takes it by force.
pub const SII_CONFIG: u16 = 0x0500;
/// SII PDI access state, 1 byte: bit 0 is set while the PDI accesses the SII.
pub const SII_PDI_ACCESS: u16 = 0x0501;
/// SII control and status, 2 bytes.
pub const SII_CONTROL: u16 = 0x0502;
/// SII word address, 4 bytes.
pub const SII_ADDRESS: u16 = 0x0504;
/// SII data, 4 or 8 bytes.
pub const SII_DATA: u16 = 0x0508;
/// First FMMU; each takes [`FMMU_LEN`] bytes.
pub const FMMU: u16 = 0x0600;
/// First sync manager; each takes [`SYNC_MANAGER_LEN`] bytes.
pub const SYNC_MANAGER: u16 = 0x0800;
/// Start of process memory.
pub const PROCESS_MEMORY: u16 = 0x1000;

/// [`FEATURES`]: distributed clocks are supported.
pub const FEATURE_CLOCKS: u16 = 1 << 2;
/// [`FEATURES`]: the distributed clocks have 64 bits.
pub const FEATURE_CLOCKS_64: u16 = 1 << 3;
/// [`FEATURES`]: enhanced link detection by MII.
pub const FEATURE_ENHANCED_LINK_MII: u16 = 1 << 6;
/// [`FEATURES`]: frames damaged before this slave are counted separately, as forwarded errors.
pub const FEATURE_SEPARATE_ERRORS: u16 = 1 << 7;
/// [`FEATURES`]: enhanced activation of the SYNC unit.
pub const FEATURE_SYNC_ACTIVATION: u16 = 1 << 8;
/// [`FEATURES`]: LRW is not supported.
pub const FEATURE_NO_LRW: u16 = 1 << 9;
/// [`FEATURES`]: BRW, APRW and FPRW are not supported.
pub const FEATURE_NO_READ_WRITE: u16 = 1 << 10;

/// [`DL_CONTROL`]: the slave also answers to its alias as station address.
pub const DL_CONTROL_ALIAS: u32 = 1 << 24;

/// Error bit of [`AL_STATUS`], acknowledge bit of [`AL_CONTROL`].
pub const AL_ERROR_BIT: u16 = 1 << 4;
/// Bit of [`AL_CONTROL`] that asks for the number of the identification switches; the same bit of [`AL_STATUS`] says
/// that [`AL_STATUS_CODE`] holds it.
pub const AL_IDENTIFY_BIT: u16 = 1 << 5;
/// State bits of [`AL_STATUS`] and [`AL_CONTROL`].
pub const AL_STATE_MASK: u16 = 0x0F;

/// Divider for a watchdog unit of 100 microseconds: 40 ns times (2498 + 2).
pub const WATCHDOG_DIVIDER_100_US: u16 = 2498;

/// Value of [`SII_CONFIG`] that gives the SII to the slave's processor (PDI).
pub const SII_TO_PDI: u8 = 1 << 0;
/// Value of [`SII_CONFIG`] that takes the SII from the PDI by force.
pub const SII_FORCE: u8 = 1 << 1;
/// [`SII_CONTROL`]: 8 bytes are read at a time instead of 4.
pub const SII_READS_8_BYTES: u16 = 1 << 6;
/// [`SII_CONTROL`]: requests a read.
pub const SII_READ: u16 = 1 << 8;
/// [`SII_CONTROL`]: requests a write.
pub const SII_WRITE: u16 = 1 << 9;
/// [`SII_CONTROL`]: requests a reload of the registers.
pub const SII_RELOAD: u16 = 1 << 10;
/// [`SII_CONTROL`]: enables the write requested together with it.
pub const SII_WRITE_ENABLE: u16 = 1 << 0;
/// [`SII_CONTROL`]: the checksum of the configuration area is wrong.
pub const SII_CHECKSUM_ERROR: u16 = 1 << 11;
/// [`SII_CONTROL`]: the configuration area has not been loaded: not yet, or its checksum is wrong.
pub const SII_LOADING: u16 = 1 << 12;
/// [`SII_CONTROL`]: the memory did not acknowledge, or the command was invalid.
pub const SII_ACKNOWLEDGE_ERROR: u16 = 1 << 13;
/// [`SII_CONTROL`]: a write was not enabled.
pub const SII_WRITE_ERROR: u16 = 1 << 14;
/// [`SII_CONTROL`]: the interface is busy.
pub const SII_BUSY: u16 = 1 << 15;

/// Most FMMUs, or sync managers, of a controller: there is register space for so many.
pub const UNITS_MAX: u8 = 16;
/// Bytes of one FMMU's registers.
pub const FMMU_LEN: usize = 16;
/// Bytes of one sync manager's registers.
pub const SYNC_MANAGER_LEN: usize = 8;
/// Offset of a sync manager's status byte.
pub const SYNC_MANAGER_STATUS_OFFSET: u16 = 5;
/// Offset of a sync manager's activation byte.
pub const SYNC_MANAGER_ACTIVATE_OFFSET: u16 = 6;
/// Offset of a sync manager's PDI control byte.
pub const SYNC_MANAGER_PDI_OFFSET: u16 = 7;
/// Sync manager status: the mailbox is full.
pub const MAILBOX_FULL_BIT: u8 = 1 << 3;
/// Sync manager activation: enabled.
pub const SYNC_MANAGER_ENABLE: u8 = 1 << 0;
/// Sync manager activation: toggled by the master to request the last mailbox again; the slave answers with the
/// corresponding bit of the PDI control byte.
pub const SYNC_MANAGER_REPEAT: u8 = 1 << 1;

/// Sync manager control: mailbox that the master writes, with an event for the slave.
pub const CONTROL_MAILBOX_OUT: u8 = 0x26;
/// Sync manager control: mailbox that the master reads, with an event for the slave.
pub const CONTROL_MAILBOX_IN: u8 = 0x22;
/// Sync manager control: three buffers that the master writes, with an event and the watchdog.
pub const CONTROL_OUTPUTS: u8 = 0x64;
/// Sync manager control: three buffers that the master reads, with an event.
pub const CONTROL_INPUTS: u8 = 0x20;
/// Sync manager control: bits of the direction; 0 if the master reads.
pub const CONTROL_DIRECTION: u8 = 0x0C;
/// Sync manager control: the direction of what the master writes.
pub const CONTROL_MASTER_WRITES: u8 = 0x04;

/// Address of a sync manager's registers.
pub const fn sync_manager(number: u8) -> u16 {
    SYNC_MANAGER + number as u16 * SYNC_MANAGER_LEN as u16
}

/// Address of an FMMU's registers.
pub const fn fmmu(number: u8) -> u16 {
    FMMU + number as u16 * FMMU_LEN as u16
}

/// One sync manager: a guarded window in process memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SyncManagerRepr {
    /// First byte of the window.
    pub start: u16,
    /// Length of the window, bytes.
    pub length: u16,
    /// Mode, direction, events and watchdog; see the `CONTROL_` constants.
    pub control: u8,
    /// Status from the slave controller; not written by a master.
    pub status: u8,
    /// Activation; see [`SYNC_MANAGER_ENABLE`].
    pub activate: u8,
    /// Control byte of the slave's own side; not written by a master.
    pub pdi_control: u8,
}

impl SyncManagerRepr {
    /// Reads the eight register bytes.
    ///
    /// # Errors
    /// [`Error::Truncated`].
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, SYNC_MANAGER_LEN)?;
        Ok(Self {
            start: read_u16(bytes, 0),
            length: read_u16(bytes, 2),
            control: read_u8(bytes, 4),
            status: read_u8(bytes, 5),
            activate: read_u8(bytes, 6),
            pdi_control: read_u8(bytes, 7),
        })
    }

    /// Writes the eight register bytes.
    ///
    /// # Errors
    /// [`Error::Room`].
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, SYNC_MANAGER_LEN)?;
        write_bytes(bytes, 0, &self.start.to_le_bytes());
        write_bytes(bytes, 2, &self.length.to_le_bytes());
        write_bytes(bytes, 4, &[self.control, self.status, self.activate, self.pdi_control]);
        Ok(())
    }
}

/// One FMMU: maps logical addresses, bit by bit, to the slave's memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FmmuRepr {
    /// First logical address.
    pub logical_start: u32,
    /// Bytes of logical memory covered.
    pub length: u16,
    /// First bit within the first logical byte, 0 to 7.
    pub logical_start_bit: u8,
    /// Last bit within the last logical byte, 0 to 7.
    pub logical_end_bit: u8,
    /// First byte in the slave's memory.
    pub physical_start: u16,
    /// First bit within the first byte of the slave's memory, 0 to 7.
    pub physical_start_bit: u8,
    /// Whether read commands are mapped.
    pub reads: bool,
    /// Whether write commands are mapped.
    pub writes: bool,
    /// Whether the FMMU is active.
    pub active: bool,
}

impl FmmuRepr {
    /// A mapping of whole bytes; inactive without bytes.
    pub const fn bytes(logical_start: u32, length: u16, physical_start: u16, reads: bool) -> Self {
        Self {
            logical_start,
            length,
            logical_start_bit: 0,
            logical_end_bit: 7,
            physical_start,
            physical_start_bit: 0,
            reads,
            writes: !reads,
            active: length > 0,
        }
    }

    /// Reads the sixteen register bytes.
    ///
    /// # Errors
    /// [`Error::Truncated`].
    pub fn parse(bytes: &[u8]) -> Result<Self, Error> {
        check_len(bytes, FMMU_LEN)?;
        Ok(Self {
            logical_start: read_u32(bytes, 0),
            length: read_u16(bytes, 4),
            logical_start_bit: read_u8(bytes, 6) & 7,
            logical_end_bit: read_u8(bytes, 7) & 7,
            physical_start: read_u16(bytes, 8),
            physical_start_bit: read_u8(bytes, 10) & 7,
            reads: read_u8(bytes, 11) & 1 != 0,
            writes: read_u8(bytes, 11) & 2 != 0,
            active: read_u8(bytes, 12) & 1 != 0,
        })
    }

    /// Writes the sixteen register bytes.
    ///
    /// # Errors
    /// [`Error::Room`].
    pub fn emit(&self, bytes: &mut [u8]) -> Result<(), Error> {
        check_room(bytes, FMMU_LEN)?;
        write_bytes(bytes, 0, &self.logical_start.to_le_bytes());
        write_bytes(bytes, 4, &self.length.to_le_bytes());
        write_bytes(bytes, 6, &[self.logical_start_bit, self.logical_end_bit]);
        write_bytes(bytes, 8, &self.physical_start.to_le_bytes());
        let direction = u8::from(self.reads) | u8::from(self.writes) << 1;
        write_bytes(
            bytes,
            10,
            &[self.physical_start_bit, direction, u8::from(self.active), 0, 0, 0],
        );
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sync_managers_and_fmmus_survive_emit_and_parse() {
        let manager = SyncManagerRepr {
            start: 0x1100,
            length: 6,
            control: CONTROL_OUTPUTS,
            status: 0x08,
            activate: SYNC_MANAGER_ENABLE,
            pdi_control: 2,
        };
        let mut bytes = [0xFF; 16];
        manager.emit(&mut bytes).unwrap();
        assert_eq!(bytes[..8], [0x00, 0x11, 6, 0, 0x64, 8, 1, 2]);
        assert_eq!(SyncManagerRepr::parse(&bytes), Ok(manager));

        let fmmu = FmmuRepr::bytes(0x0001_0006, 6, 0x1140, true);
        fmmu.emit(&mut bytes).unwrap();
        assert_eq!(bytes, [6, 0, 1, 0, 6, 0, 0, 7, 0x40, 0x11, 0, 1, 1, 0, 0, 0]);
        assert_eq!(FmmuRepr::parse(&bytes), Ok(fmmu));
        assert_eq!(
            FmmuRepr::parse(&bytes[..15]),
            Err(Error::Truncated {
                expected: 16,
                actual: 15
            })
        );
    }
}
